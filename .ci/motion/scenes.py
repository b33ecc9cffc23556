"""What stands around the arm, and moves drawn in it. Boxes: centre and half edges, m, frame of the base."""

import math

# A wall in the plane x = 0.5 with an opening of 0.5 m by 0.5 m.
WINDOW = [
    [0.5, 0.625, 0.3, 0.02, 0.375, 0.8],
    [0.5, -0.625, 0.3, 0.02, 0.375, 0.8],
    [0.5, 0.0, 0.9, 0.02, 0.25, 0.2],
    [0.5, 0.0, -0.15, 0.02, 0.25, 0.35],
]
SHELF = [
    [0.75, 0.0, 0.0, 0.2, 0.5, 0.015],
    [0.75, 0.0, 0.45, 0.2, 0.5, 0.015],
    [0.75, 0.0, 0.9, 0.2, 0.5, 0.015],
    [0.75, 0.5, 0.45, 0.2, 0.015, 0.45],
    [0.75, -0.5, 0.45, 0.2, 0.015, 0.45],
    [0.96, 0.0, 0.45, 0.015, 0.5, 0.45],
]
BIN = [
    [0.55, 0.0, -0.05, 0.25, 0.25, 0.015],
    [0.30, 0.0, 0.10, 0.015, 0.25, 0.15],
    [0.80, 0.0, 0.10, 0.015, 0.25, 0.15],
    [0.55, 0.25, 0.10, 0.25, 0.015, 0.15],
    [0.55, -0.25, 0.10, 0.25, 0.015, 0.15],
]
# An arm of the same size that stands bent over, 0.9 m away.
SECOND_ARM = [
    [0.9, 0.0, -0.5, 0.05, 0.05, 0.5],
    [0.9, 0.0, 0.15, 0.06, 0.06, 0.15],
    [0.75, 0.0, 0.35, 0.2, 0.06, 0.06],
    [0.55, 0.0, 0.6, 0.05, 0.05, 0.25],
    [0.55, 0.15, 0.85, 0.05, 0.2, 0.05],
]
POSTS = [
    [0.45 * math.cos(angle), 0.45 * math.sin(angle), 0.1, 0.04, 0.04, 0.7]
    for angle in (0.0, 1.1, -1.1, 2.4)
]
SCENES = {
    "nothing": [],
    "table": [[0.6, 0.0, 0.0, 0.35, 0.6, 0.02]],
    "wall": [[0.45, 0.0, 0.3, 0.02, 1.0, 0.8]],
    "shelf": SHELF,
    "second arm": SECOND_ARM,
    "four posts": POSTS,
    "ceiling": [[0.0, 0.0, 0.95, 1.2, 1.2, 0.02]],
    "two walls": [[0.0, 0.5, 0.3, 1.0, 0.02, 0.9], [0.0, -0.5, 0.3, 1.0, 0.02, 0.9]],
    "bin": BIN,
    "window": WINDOW,
}


def moves(robot, around, rng, count):
    """Pairs of poses that touch nothing, drawn evenly inside the joint ranges."""
    low, high = robot.q_min_rad + 0.03, robot.q_max_rad - 0.03
    free = []
    while len(free) < 2 * count:
        drawn = rng.uniform(low, high, (256, len(low)))
        free.extend(drawn[~around.contacts(drawn)])
    return [(free[2 * k], free[2 * k + 1]) for k in range(count)]
