"""Buses: the package against the program, in the simulated cell and over a socket."""

import contextlib
import json
import os
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import cubecell
import numpy as np
import pytest

CUBECTL = os.environ["CUBECTL"]
#: Module 4 does not answer.
SILENT = 'schema_version = 1\nname = "silent"\nduration_s = 1.0\n\n[[fault]]\nkind = "silent"\ntarget = "module 4"\nstart_s = 0.0\nlength_s = 1000.0\n'


def cubectl(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([CUBECTL, *words], capture_output=True, text=True)


@contextlib.contextmanager
def served(*words: str) -> Iterator[str]:
    """The simulated cell in another process, at a free port; the place."""
    command = [CUBECTL, "sim", "--bus", "socketcand://127.0.0.1:0/can0", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        try:
            assert process.stdout is not None
            yield process.stdout.readline().split()[1]
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(timeout=60)


def test_who_is_there_and_how_is_what_the_program_tells() -> None:
    bus = cubecell.Bus(seed=7)
    reported = json.loads(cubectl("status", "--seed", "7", "--json").stdout)
    for mine in (bus.scan(), bus.status()):
        assert mine.details == reported["modules"] and mine.bus == reported["bus"] and mine.asked and mine.missing == []
        assert mine.module.tolist() == [1, 2, 3, 4, 5, 6] and not mine.homed.any()
        assert mine.position_rad.tolist() == [module["position_rad"] for module in reported["modules"]]
    assert bus.scan([2, 5]).module.tolist() == [2, 5]


def test_silence_is_an_error_with_the_next_step_of_the_program(tmp_path: Path) -> None:
    scenario = tmp_path / "silent.toml"
    scenario.write_text(SILENT)
    bus = cubecell.Bus(scenario=scenario)
    assert bus.scan().missing == [4] and bus.scan().module.tolist() == [1, 2, 3, 5, 6]
    reported = cubectl("status", "--scenario", str(scenario))
    with pytest.raises(cubecell.CubecellError) as refused:
        bus.status()
    assert refused.value.exit_code == reported.returncode == 8
    assert str(refused.value) in reported.stderr and "module 4 does not answer" in reported.stderr and "next: " in reported.stderr
    assert bus.status([1, 2]).module.tolist() == [1, 2]
    with pytest.raises(cubecell.CubecellError, match="no module answers") as refused:
        bus.scan([20, 21])
    assert refused.value.exit_code == 8
    for spec, code in (("socketcand://127.0.0.1:1/can0", 7), ("nosuchcan7", 7)):
        reported = cubectl("status", "--bus", spec)
        with pytest.raises(cubecell.CubecellError) as refused:
            cubecell.Bus(spec).scan()
        assert refused.value.exit_code == reported.returncode != 0, reported.stderr
        assert str(refused.value) in reported.stderr
    with pytest.raises(cubecell.CubecellError) as refused:
        cubecell.Bus(robot="no_such_robot").record(0.1)
    assert refused.value.exit_code == 4


def test_what_passes_is_recorded_as_the_program_does(tmp_path: Path) -> None:
    log = cubecell.Bus(seed=3).record(0.5, controller=True)
    assert cubectl("log", "record", str(tmp_path / "boot"), "--seed", "3", "--for-s", "0.5", "--controller").returncode == 0
    theirs = cubecell.Log(tmp_path / "boot.log")
    assert len(log.frames["t_s"]) == len(theirs.frames["t_s"]) > 100
    for name, column in log.frames.items():
        close = np.abs(column.astype(float) - theirs.frames[name].astype(float)).max()
        assert close < (1.1e-6 if name == "t_s" else 1e-12), name
    assert set(log.positions["module"]) == {1, 2, 3, 4, 5, 6} and log.torn is None
    # Nobody speaks on a bus without a controller, and recording does not either.
    assert len(cubecell.Bus().record(0.2).frames["t_s"]) == 0


def test_a_bus_over_a_socket_is_read_and_left_as_it_was() -> None:
    with served("--seed", "5") as spec:
        bus = cubecell.Bus(spec, robot="powercube6")
        found = bus.scan()
        assert found.asked and found.module.tolist() == [1, 2, 3, 4, 5, 6] and found.missing == []
        reported = json.loads(cubectl("status", "--bus", spec, "--json").stdout)
        assert bus.status().state.tolist() == [module["state"] for module in reported["modules"]]
        # Two hosts at once: what one asks, the other records.
        asking = threading.Thread(target=lambda: cubectl("status", "--bus", spec))
        asking.start()
        log = bus.record(3.0)
        asking.join()
        assert len(log.frames["t_s"]) > 20 and not log.frames["sent"].any()
        with pytest.raises(cubecell.CubecellError, match="module 9 does not answer"):
            bus.status([1, 9])


def test_beside_a_controller_nothing_is_sent() -> None:
    with served("--controller") as spec:
        end = time.monotonic() + 60
        found = cubecell.Bus(spec).scan()
        while found.asked and time.monotonic() < end:
            found = cubecell.Bus(spec).scan()
        assert not found.asked and found.controller is not None and found.controller["node_id"] == 10
        assert found.module.tolist() == [1, 2, 3, 4, 5, 6] and np.isfinite(found.position_rad).all()
