"""What does a recording hold? Frames, drives, tracking errors and states, from its tables.

python log_tables.py THROW-FOLDER-OR-LOG
"""

import sys

import numpy as np

import cubecell


def main(path: str) -> None:
    log = cubecell.Log(path)
    seconds = log.frames["t_s"][-1] - log.frames["t_s"][0]
    print(f"{len(log.frames['t_s'])} frames in {seconds:.2f} s")
    for module in np.unique(log.positions["module"]):
        q_rad = log.positions["position_rad"][log.positions["module"] == module]
        print(f"drive {module}: {len(q_rad)} positions from {q_rad.min():+.3f} to {q_rad.max():+.3f} rad")
    for joint in np.unique(log.joints["joint"]):
        error_mrad = 1e3 * np.abs(log.joints["error_q_rad"][log.joints["joint"] == joint])
        print(f"joint {joint}: tracking error at most {error_mrad.max():.2f} mrad")
    states, t_s = log.group["state"], log.group["t_s"]
    changes = np.flatnonzero(np.append(True, states[1:] != states[:-1]))
    print("states:", " ".join(f"{states[i]} ({t_s[i]:.2f} s)" for i in changes))


if __name__ == "__main__":
    main(sys.argv[1])
