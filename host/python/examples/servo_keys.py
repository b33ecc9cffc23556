"""Lead the hand with keys: w a s d and r f move it, any other key lets it rest, q ends.

    python servo_keys.py                    in the simulated cell
    python servo_keys.py can0               with an arm; nobody may be near
    python servo_keys.py sim wwwwddddrrrr   these keys instead of the keyboard, one per tenth of a second
"""

from __future__ import annotations

import select
import sys
import termios
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager

import cubecell
import numpy as np

#: Speed of the hand, m/s, and time between two looks at the keyboard, s.
SPEED_M_S, LOOK_S = 0.06, 0.1
#: A key that is held repeats at least this often, s.
REPEAT_S = 0.6
WAYS = {"w": (1, 0, 0), "s": (-1, 0, 0), "a": (0, 1, 0), "d": (0, -1, 0), "r": (0, 0, 1), "f": (0, 0, -1)}
READY_RAD = np.radians([0, -60, -80, 0, 30, 0])


@contextmanager
def keyboard() -> Iterator[None]:
    """Keys come one by one, and are not shown."""
    before = termios.tcgetattr(sys.stdin)
    tty.setcbreak(sys.stdin)
    try:
        yield
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)


def typed() -> Iterator[str]:
    """The key that is held, every ``LOOK_S``; empty for none."""
    held, until = "", 0.0
    with keyboard():
        while True:
            while select.select([sys.stdin], [], [], 0)[0]:
                held, until = sys.stdin.read(1), time.monotonic() + REPEAT_S
            yield held if time.monotonic() < until else ""
            time.sleep(LOOK_S)


def main(bus: str = "sim", keys: str | None = None) -> None:
    with cubecell.connect(bus, may_move=True) as arm:
        arm.home()
        arm.move(READY_RAD)
        with arm.servo() as stream:
            for key in typed() if keys is None else keys:
                if key == "q":
                    break
                way = WAYS.get(key, (0, 0, 0))
                stream.twist([SPEED_M_S * part for part in way] + [0.0, 0.0, 0.0])
                # On a bus the keyboard keeps the time, in the simulated cell it passes here.
                state = stream.wait(LOOK_S if bus == "sim" or keys is not None else 0.0)
                if state.limited:
                    print(f"{state.t_s:.1f} s: {state.limited}")
        end = arm.state().q_rad
        assert end is not None and stream.result is not None
        print(f"{stream.result['commands_taken']} commands; the arm stands at {np.degrees(end).round(1)} deg")


if __name__ == "__main__":
    main(*sys.argv[1:])
