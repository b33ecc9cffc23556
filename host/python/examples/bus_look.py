"""Who is on a bus, how are the modules, and what passes in a second? Nothing is set, nothing moves.

python bus_look.py [SPEC]
"""

import sys

import numpy as np

import cubecell


def main(spec: str) -> None:
    bus = cubecell.Bus(spec)
    try:
        found = bus.scan()
    except cubecell.CubecellError as error:
        # What happened, where, and what to do next.
        print(error)
        sys.exit(error.exit_code)
    print(f"{found.bus}: {len(found.module)} modules {'answer' if found.asked else 'are heard'}; missing: {found.missing or 'none'}")
    for module, position_rad, homed in zip(found.module, found.position_rad, found.homed, strict=True):
        print(f"module {module}: {position_rad:+.4f} rad, {'homed' if homed else 'not homed'}")
    log = bus.record(1.0, controller=spec == "sim")
    ids, counts = np.unique(log.frames["id"], return_counts=True)
    print(f"{len(log.frames['t_s'])} frames in a second, {len(ids)} identifiers; most often 0x{ids[counts.argmax()]:X}" if len(ids) else "no frames")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "sim")
