"""Ways between bodies, judged by the package's own contacts and by hand."""

import cubecell
import numpy as np
import pytest

POST = [0.45, 0.0, 0.5, 0.05, 0.05, 0.2]
FROM_RAD, TO_RAD = [-0.6, -1.0, -1.4, 0.0, 0.5, 0.0], [0.6, -1.0, -1.4, 0.0, 0.5, 0.0]


@pytest.fixture(scope="module")
def robot() -> cubecell.Robot:
    return cubecell.Robot("powercube6")


def test_a_way_goes_around_what_is_in_the_way_and_keeps_its_share_of_the_limits(robot: cubecell.Robot) -> None:
    hand_m = robot.hand([0.0, -1.0, -1.4, 0.0, 0.5, 0.0])[:3, 3]
    around = cubecell.Surroundings(robot, [[*hand_m, 0.05, 0.05, 0.05]])
    assert not around.is_free_line(FROM_RAD, TO_RAD) and cubecell.Surroundings(robot).is_free_line(FROM_RAD, TO_RAD)
    way = around.way(FROM_RAD, TO_RAD, speed_share=0.3)
    assert way is not None
    motion = way.sample(step_s=2e-3)
    assert not around.contacts(motion.q_rad).any()
    assert np.allclose(motion.q_rad[[0, -1]], [FROM_RAD, TO_RAD])
    assert np.all(np.abs(motion.qd_rad_s) <= 0.3 * robot.qd_max_rad_s * (1 + 1e-6))
    assert np.all(np.abs(motion.qdd_rad_s2) <= 0.3 * robot.qdd_max_rad_s2 * (1 + 1e-6))
    assert around.way(TO_RAD, TO_RAD) is None
    # The line between both is refused with what touches on it.
    with pytest.raises(cubecell.CubecellError, match="corner 1 to the next .*obstacle 1"):
        around.through([FROM_RAD, TO_RAD])
    again = around.through(np.vstack([FROM_RAD, [0.0, -1.0, 0.0, 0.0, 0.5, 0.0], TO_RAD]))
    assert again is not None and not around.contacts(again.sample(step_s=2e-3).q_rad).any()


def test_contacts_are_those_of_each_row(robot: cubecell.Robot) -> None:
    in_floor = [0.0, np.pi / 3, -1.0, 0.0, 0.0, 0.0]
    rows = np.array([FROM_RAD, in_floor])
    boxes = [[0.0, 0.0, -1.0, 2.0, 2.0, 0.9]]
    assert cubecell.Surroundings(robot, boxes).contacts(rows).tolist() == [False, True]
    with pytest.raises(ValueError, match="six numbers"):
        cubecell.Surroundings(robot, [[0.0, 0.0, 0.0]])


def test_a_line_from_rest_to_rest_takes_the_time_of_its_slowest_joint(robot: cubecell.Robot) -> None:
    limits = robot.qd_max_rad_s, robot.qdd_max_rad_s2
    way = cubecell.along(robot, [FROM_RAD, TO_RAD], *limits)
    v, a, length = float(limits[0][0]), float(limits[1][0]), 1.2
    assert abs(way.duration_s - (length / v + v / a if length > v * v / a else 2 * np.sqrt(length / a))) < 1e-9
    slower = cubecell.along(robot, [FROM_RAD, TO_RAD], *limits, robot.qddd_max_rad_s3)
    assert slower.duration_s > way.duration_s
    with pytest.raises(cubecell.CubecellError, match="positive"):
        cubecell.along(robot, [FROM_RAD, TO_RAD], -limits[0], limits[1])
