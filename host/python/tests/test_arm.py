"""An arm that stays connected, in the simulated cell."""

import os
import signal
import threading
import time

import cubecell
import numpy as np
import pytest


def test_home_moves_and_a_path_end_where_the_joints_are_measured() -> None:
    with cubecell.connect(seed=3) as arm:
        assert arm.joints == 6 and arm.state().state == "idle" and not arm.state().homed.any()
        q = arm.home()
        stands = arm.state()
        assert stands.state == "ready" and stands.homed.all() and stands.q_rad is not None
        assert np.allclose(stands.q_rad, q, atol=1e-3)
        target = [0.2, -1.0, -1.2, 0.1, 0.4, 0.0]
        moved = arm.move(target)
        assert 0.5 < moved.duration_s < 30 and moved.off_rad is not None and 0 < moved.off_rad < 0.01
        measured = arm.state().q_rad
        assert measured is not None and np.abs(measured - target).max() < 0.01
        arm.move(by={1: 0.3, 6: -0.2})
        turned = arm.state().q_rad
        assert turned is not None and np.allclose(turned - measured, [0.3, 0, 0, 0, 0, -0.2], atol=0.01)
        there = arm.move(arm.move(turned + 0.0).q_rad)
        assert there.duration_s == 0.0 and "nothing has moved" in there.text
        rows = np.array([[0.0, -1.0, -1.2, 0.0, 0.4, 0.0], [0.3, -1.1, -1.1, 0.0, 0.4, 0.0], [0.3, -1.3, -1.0, 0.0, 0.4, 0.0]])
        assert arm.run(rows).q_rad.tolist() == rows[-1].tolist()
        timed = arm.run(rows, [0.0, 2.0, 4.0])
        assert timed.duration_s == pytest.approx(4.0)
        post = [*cubecell.Robot("powercube6").hand(rows[1])[:3, 3], 0.02, 0.02, 0.02]
        with pytest.raises(cubecell.CubecellError, match="touch"):
            arm.run(rows, obstacles=[post])
        arm.gripper.open()
        arm.gripper.close()
    with pytest.raises(cubecell.CubecellError, match="closed"):
        arm.state()


def test_the_hand_goes_to_a_place_and_on_a_straight_line() -> None:
    with cubecell.connect() as arm:
        arm.home()
        arm.move(to=[0.5, 0.15, 0.45])
        moved = arm.move(to=[0.5, -0.15, 0.45], straight=True)
        assert moved.off_rad is not None and moved.off_rad < 0.01
        with pytest.raises(cubecell.CubecellError, match="straight line breaks") as refused:
            arm.move(to=[3.0, 0.0, 0.5], straight=True)
        assert refused.value.exit_code == 3 and "the arm stands" in str(refused.value)


def test_what_cannot_be_is_refused_before_anything_moves() -> None:
    with pytest.raises(ValueError, match="may_move"):
        cubecell.connect("can0")
    with pytest.raises(cubecell.CubecellError):
        cubecell.connect("socketcand://127.0.0.1:1/can0", may_move=True)
    with cubecell.connect() as arm:
        with pytest.raises(cubecell.CubecellError, match="hom"):
            arm.move([0.0] * 6)
        before = arm.home()
        with pytest.raises(cubecell.CubecellError, match="5 angles"):
            arm.move([0.0] * 5)
        with pytest.raises(ValueError, match="one of"):
            arm.move()
        with pytest.raises(cubecell.CubecellError, match="outside"):
            arm.run([[0.0] * 6, [9.0] * 6])
        with pytest.raises(cubecell.CubecellError, match="speed"):
            arm.run([[0.0] * 6, [2.0, 0, 0, 0, 0, 0]], [0.0, 0.1])
        with pytest.raises(cubecell.CubecellError, match="finite|number"):
            arm.move(to=[float("nan"), 0.0, 0.5])
        here = arm.state().q_rad
        assert here is not None and np.allclose(here, before, atol=1e-3)


def test_a_stop_from_another_thread_ends_the_motion_and_the_next_motion_goes_on() -> None:
    with cubecell.connect() as arm:
        home = arm.home()
        errors: list[cubecell.CubecellError] = []

        def go() -> None:
            try:
                # Minutes of virtual time: it is at work whenever the other thread gets its turn.
                arm.move(by={1: 1.0}, speed_share=0.005)
            except cubecell.CubecellError as error:
                errors.append(error)

        thread = threading.Thread(target=go)
        thread.start()
        while arm.progress != "run" and thread.is_alive():
            time.sleep(0.01)
        time.sleep(0.3)
        arm.stop()
        thread.join(timeout=60)
        assert len(errors) == 1 and errors[0].exit_code in (6, 13), errors
        stopped = arm.state()
        assert stopped.q_rad is not None and 1e-4 < stopped.q_rad[0] - home[0] < 0.9 and stopped.state == "stopped"
        arm.move(by={1: 0.1})
        reached = arm.state().q_rad
        assert reached is not None and np.allclose(reached - stopped.q_rad, [0.1, 0, 0, 0, 0, 0], atol=0.01)


def test_ctrl_c_brings_the_arm_to_rest_and_then_interrupts() -> None:
    # A shell lets what it starts in the background ignore Ctrl-C, and Python then does the same.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with cubecell.connect() as arm:
            arm.home()
            threading.Timer(0.5, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
            with pytest.raises(KeyboardInterrupt):
                for turn in range(1000):
                    arm.move(by={1: 0.5 if turn % 2 == 0 else -0.5}, speed_share=0.05)
            one, two = arm.state().q_rad, arm.state().q_rad
            assert one is not None and two is not None and np.abs(one - two).max() < 1e-3
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_stream_leads_joints_and_hand_and_says_what_it_refused() -> None:
    with cubecell.connect() as arm:
        arm.home()
        begin = np.radians([0, -60, -80, 0, 30, 0])
        arm.move(begin)
        with arm.servo(speed_share=0.3) as stream:
            for _ in range(100):
                stream.joints(begin + [0.2, 0, 0, 0, 0, 0])
                state = stream.wait(0.02)
            assert state.limited is None and abs(state.q_rad[0] - 0.2) < 1e-6
            for _ in range(100):
                stream.twist([0, 0, 0.05, 0, 0, 0])
                stream.wait(0.02)
            # No command for longer than it holds: the arm stands.
            assert np.abs(stream.wait(0.7).qd_rad_s).max() < 1e-9
            stream.hand([9.0, 9.0, 9.0])
            stream.wait(0.1)
            assert stream.state.refused == 1 and "does not come there" in str(stream.state.last_refused)
            for wrong in ([float("nan")] * 6, [0.0] * 9):
                with pytest.raises(cubecell.CubecellError):
                    stream.joints(wrong)
        assert stream.result is not None and stream.result["outcome"] == "at_rest"
        assert stream.result["end_off_rad"] < 3e-3 and stream.result["restarts"] == 0
        end = arm.state().q_rad
        assert end is not None and abs(end[0] - 0.2) < 5e-3
        # The connection goes on.
        assert arm.move(begin).off_rad is not None
        with pytest.raises(ValueError):
            arm.servo(hold_s=0.0)


def test_an_exception_in_a_stream_and_a_stop_leave_a_standing_arm() -> None:
    with cubecell.connect() as arm:
        arm.home()
        with pytest.raises(RuntimeError, match="mine"), arm.servo() as stream:
            stream.speeds([0.2, 0, 0, 0, 0, 0])
            stream.wait(0.3)
            raise RuntimeError("mine")
        assert stream.result is not None and stream.result["outcome"] == "at_rest"
        assert arm.state().state == "ready"
        with pytest.raises(cubecell.CubecellError) as stopped, arm.servo() as stream:
            stream.speeds([0.2, 0, 0, 0, 0, 0])
            stream.wait(0.3)
            stopper = threading.Thread(target=arm.stop)
            stopper.start()
            for _ in range(20):
                stream.wait(0.02)
        stopper.join()
        assert stopped.value.exit_code == 6, stopped.value
        assert arm.state().state in ("ready", "stopped")


def test_an_industrial_robot_moves_follows_and_streams_on_one_connection() -> None:
    with cubecell.connect(robot="kr16_2") as arm:
        first = arm.move(joints=np.radians([20, -80, 100, 0, 60, 0]), speed_share=0.4)
        assert first.off_rad is not None and first.off_rad < 1e-3
        arm.gripper.close()
        back = arm.move(by={1: -0.2}, speed_share=0.4)
        assert back.q_rad[0] == pytest.approx(np.radians(20) - 0.2, abs=1e-3)
        path = np.linspace(back.q_rad, np.radians([0, -90, 90, 0, 90, 0]), 3)
        followed = arm.run(path, speed_share=0.4)
        assert followed.end_off_rad is not None and followed.end_off_rad < 1e-3
        with arm.servo() as stream:
            for _ in range(20):
                stream.speeds([0.1, 0, 0, 0, 0, 0])
                stream.wait(0.02)
        state = arm.state()
        assert state.state == "ready" and state.q_rad is not None
        assert 0.005 < state.q_rad[0] < 0.1
