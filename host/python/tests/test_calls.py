"""Long calls: other threads run meanwhile, and Ctrl-C ends them at once."""

import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cubecell
import pytest

TARGET_M = [1.0, 1.0, -1.0]
#: Far longer than a test may take.
LONG = {
    "plan": "cubecell.plan('powercube6', [1.0, 1.0, -1.0], starts=10**6)",
    "simulate": "[cubecell.simulate(plan, seed=seed) for seed in range(10**6)]",
    "tune": "[cubecell.tune('powercube6') for _ in range(10**6)]",
}
#: Says when the call has begun; says when Ctrl-C has ended it, by the clock of all processes.
SCRIPT = """
import signal
import time
import cubecell
# A shell lets what it starts in the background ignore Ctrl-C, and Python then does the same.
signal.signal(signal.SIGINT, signal.default_int_handler)
plan = cubecell.plan('powercube6', [1.0, 1.0, -1.0], fast=True)
print('ready', flush=True)
try:
    {call}
except KeyboardInterrupt:
    print(time.monotonic(), flush=True)
"""


@pytest.mark.parametrize("name", LONG)
def test_ctrl_c_ends_a_long_call(name: str) -> None:
    script = SCRIPT.format(call=LONG[name])
    command = [sys.executable, "-c", script]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stdout.readline() == "ready\n"
        time.sleep(1.0)
        assert process.poll() is None, "the call is still under way"
        sent = time.monotonic()
        os.kill(process.pid, signal.SIGINT)
        try:
            reported, errors = process.communicate(timeout=60)
        finally:
            process.kill()
    assert process.returncode == 0, errors
    print(f"{name}: {1e3 * (float(reported) - sent):.0f} ms after the signal")


def test_the_handler_of_a_program_is_asked_and_stays() -> None:
    heard: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: heard.append(number))
    try:
        mine = signal.getsignal(signal.SIGINT)
        threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT)).start()
        # A handler that does not raise does not end the call.
        plan = cubecell.plan("powercube6", TARGET_M, time_budget_s=1.0, starts=10**6)
        assert heard == [signal.SIGINT] and plan.data["search"] and signal.getsignal(signal.SIGINT) is mine
    finally:
        signal.signal(signal.SIGINT, before)


def test_other_threads_run_while_a_plan_is_searched() -> None:
    count, done = 0, threading.Event()

    def work() -> None:
        nonlocal count
        while not done.wait(0.001):
            count += 1

    counter = threading.Thread(target=work)
    counter.start()
    try:
        cubecell.plan("powercube6", TARGET_M, time_budget_s=1.0, starts=10**6)
    finally:
        done.set()
        counter.join()
    # With the lock held it would not count at all.
    assert count >= 10


def test_plans_of_several_threads_are_the_same() -> None:
    with ThreadPoolExecutor(4) as pool:
        plans = list(pool.map(lambda _: cubecell.plan("powercube6", TARGET_M, fast=True), range(8)))
    assert len({plan.json for plan in plans}) == 1


def test_nothing_is_printed(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    plan = cubecell.plan("powercube6", TARGET_M, time_budget_s=1.5, starts=10**6)
    cubecell.simulate(plan)
    cubecell.tune("powercube6")
    plan.write(tmp_path / "plan.json")
    assert capfd.readouterr() == ("", "")
