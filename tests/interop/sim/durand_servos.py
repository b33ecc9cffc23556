"""Our controller drives servos whose CANopen side is durand, unmodified, in virtual time beside a simulated servo.

    python durand_servos.py CUBECTL ROBOT_FILE PORT PORT PORT

One port of the bus for these nodes, one for the controller, one for the programs that order: each is a station with a queue of its own.

durand is the slave of CiA 301: service data, process data, SYNC, heartbeat, emergencies. The objects of CiA 402 are written here, from the
standard: durand has none. Its servo reaches each target with the next SYNC. Judged is what durand received and holds.
"""

import collections
import os
import re
import signal
import subprocess
import sys
import tempfile
import time

from durand import Array, DatatypeEnum as T, MinimalNode, Record, Variable, set_scheduler
from durand.services.nmt import StateEnum
from lockstep_bus import LockstepBus, Station, Timers

NODES, PERIOD_S, COUNTS_PER_TURN, RATED_MNM = range(4, 9), 0.003, 409_600, 50_000
RAD = COUNTS_PER_TURN / 6.283185307179586
OFF, READY, ON, ENABLED, STOPPING, FAULT = 0x40, 0x21, 0x23, 0x27, 0x07, 0x08
NAMES = {OFF: "off", READY: "ready", ON: "on", ENABLED: "enabled", STOPPING: "quick stop", FAULT: "fault"}
HEARTBEAT_LOST, OVER_CURRENT = 0x8130, 0x2310
PLAIN = {
    0x6007: (T.INTEGER16, 1), 0x603F: (T.UNSIGNED16, 0), 0x6040: (T.UNSIGNED16, 0), 0x6041: (T.UNSIGNED16, OFF),
    0x605A: (T.INTEGER16, 2), 0x605E: (T.INTEGER16, 2), 0x6060: (T.INTEGER8, 0), 0x6061: (T.INTEGER8, 0),
    0x6064: (T.INTEGER32, 0), 0x6065: (T.UNSIGNED32, 4096), 0x6066: (T.UNSIGNED16, 10), 0x6076: (T.UNSIGNED32, RATED_MNM),
    0x607A: (T.INTEGER32, 0), 0x6085: (T.UNSIGNED32, COUNTS_PER_TURN), 0x60B2: (T.INTEGER16, 0), 0x6502: (T.UNSIGNED32, 1 << 7),
}  # fmt: skip
READ_ONLY = {0x603F, 0x6041, 0x6061, 0x6064, 0x6076, 0x6502}
RECORDS = {
    0x1029: [(T.UNSIGNED8, 0)],
    0x608F: [(T.UNSIGNED32, 4096), (T.UNSIGNED32, 1)],
    0x6091: [(T.UNSIGNED32, 100), (T.UNSIGNED32, 1)],
    0x60C2: [(T.UNSIGNED8, 1), (T.INTEGER8, -3)],
    0x60FE: [(T.UNSIGNED32, 0), (T.UNSIGNED32, 0)],
}
Target = collections.namedtuple("Target", "at counts torque state")


class Servo:
    """One node of durand with a drive."""

    def __init__(self, bus, number):
        self.bus, self.station = bus, Station(bus)
        self.node = MinimalNode(self.station, number)
        self.od = od = self.node.object_dictionary
        for index, (kind, value) in PLAIN.items():
            od[index] = Variable(kind, "ro" if index in READ_ONLY else "rw", value, name=f"object {index:04X}")
        for index, members in RECORDS.items():
            record = Record(name=f"record {index:04X}")
            for sub, (kind, value) in enumerate(members, 1):
                access = "ro" if index in (0x608F, 0x6091) else "rw"
                record[sub] = Variable(kind, access, value, name=f"object {index:04X}:{sub}")
            od[index] = record
        od[0x1016] = Array(Variable(T.UNSIGNED32, "rw", 0, name="consumer heartbeat"), length=1)
        od.write(0x1000, 0, 0x0002_0192)
        od.update_callbacks[(0x6040, 0)].add(self.take_control)
        od.update_callbacks[(0x6060, 0)].add(lambda mode: od.write(0x6061, 0, mode))
        od.update_callbacks[(0x607A, 0)].add(self.take_target)
        od.update_callbacks[(0x1016, 1)].add(self.supervise)
        self.station.add_subscription(0x77F, self.take_heartbeat)
        self.node.sync.callbacks.add(self.count_sync)
        self.state, self.word, self.syncs, self.timer = OFF, 0, 0, None
        self.states, self.targets, self.errors = [OFF], [], []

    def go_to(self, state):
        if state == ENABLED and self.state != ENABLED:
            self.check("target is the position before there is torque", self.od.read(0x607A, 0) == self.od.read(0x6064, 0))
            self.check("SYNC runs before there is torque", self.syncs > 2)
            self.check("mode 8 is in force before there is torque", self.od.read(0x6061, 0) == 8)
        if state != self.state:
            self.state = state
            self.states.append(state)
        # Voltage, remote; the target is followed.
        follows = 1 << 12 if state == ENABLED else 0
        self.od.write(0x6041, 0, state | 0x0210 | follows)

    def check(self, what, holds):
        # durand leaves out what a callback raises.
        if not holds:
            self.errors.append(f"node {self.node.node_id} at {self.bus.now:.4f} s: {what}")

    def take_control(self, word):
        rises, self.word = word & 0x80 and not self.word & 0x80, word
        if self.state == FAULT:
            if rises:
                self.od.write(0x603F, 0, 0)
                self.node.emcy.set(0, 0)
                self.go_to(OFF)
            return
        command = word & 0x0F
        if not command & 0b0010:
            self.go_to(OFF)
        elif not command & 0b0100:
            self.go_to(STOPPING if self.state in (ENABLED, STOPPING) else OFF)
        elif self.state == STOPPING:
            pass
        elif command & 0b0111 == 0b0110:
            self.go_to(READY)
        elif self.state == READY:
            self.go_to(ON)
        elif self.state == ON and command == 0x0F:
            self.go_to(ENABLED)
        elif self.state == ENABLED and command == 0x07:
            self.go_to(ON)

    def take_target(self, counts):
        self.targets.append(Target(self.bus.now, counts, self.od.read(0x60B2, 0), self.state))
        if self.state == ENABLED:
            # Where it is with the next SYNC.
            self.od.write(0x6064, 0, counts)

    def count_sync(self):
        self.syncs += 1

    def fail(self, code):
        self.od.write(0x603F, 0, code)
        self.node.emcy.set(code, 1)
        self.go_to(FAULT)

    def supervise(self, _entry):
        if self.timer is not None:
            self.bus.timers.cancel(self.timer)
        self.timer = None

    def take_heartbeat(self, _cob_id, _data):
        entry = self.od.read(0x1016, 1)
        self.supervise(entry)
        if entry >> 16 == 0x7F and entry & 0xFFFF:
            self.timer = self.bus.timers.add((entry & 0xFFFF) / 1000, self.miss_host)

    def miss_host(self):
        self.timer = None
        if self.state != FAULT:
            self.fail(HEARTBEAT_LOST)

    def moved(self, since_s):
        return [target for target in self.targets if target.at >= since_s and target.state == ENABLED]


def steps(targets):
    return [b.counts - a.counts for a, b in zip(targets, targets[1:])]


def smooth(servo, targets, a_max_rad_s2):
    """While the joint moves: a target with each SYNC, and no acceleration beyond the limit but by the rounding to counts."""
    moving = [at for at, step in enumerate(steps(targets)) if step]
    if not moving:
        return
    targets = targets[moving[0] : moving[-1] + 2]
    servo.check("a motion has targets", len(targets) > 50)
    gaps = [b.at - a.at for a, b in zip(targets, targets[1:])]
    servo.check(f"a target in each period, {min(gaps)} to {max(gaps)} s", all(abs(gap - PERIOD_S) < 5e-5 for gap in gaps))
    by_step = steps(targets)
    most = a_max_rad_s2 * PERIOD_S**2 * RAD + 2
    servo.check("no jump", all(abs(b - a) <= most for a, b in zip(by_step, by_step[1:])))


class Cell:
    """The bus with durand's servos, and programs of ours on it."""

    def __init__(self, cubectl, robot, own, controllers, programs):
        self.cubectl, self.robot = cubectl, robot
        self.controllers, self.orders = (f"lockstep://127.0.0.1:{port}/can0" for port in (controllers, programs))
        self.timers = Timers()
        set_scheduler(self.timers)
        self.bus = LockstepBus("127.0.0.1", own, self.timers)
        self.servos = [Servo(self.bus, number) for number in NODES]

    def start(self, *words):
        place = self.controllers if words[0] == "controller" else self.orders
        return subprocess.Popen(
            [self.cubectl, *words, "--robot", self.robot, "--bus", place],
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip

    def run(self, what, until):
        """Virtual time passes until that holds; it is fast, and a program may take its time to start."""
        end_s = time.monotonic() + 60
        while not until():
            assert time.monotonic() < end_s, f"{what} has not come"
            self.bus.turn()

    def pass_s(self, seconds):
        end_s = self.bus.now + seconds
        self.run("a time", lambda: self.bus.now >= end_s)

    def end(self, program, code):
        """Its turns are taken until it has ended."""
        self.run("the end of a program", lambda: program.poll() is not None)
        text = program.stdout.read()
        assert program.returncode == code, f"{program.args}: exit code {program.returncode}, not {code}:\n{text}"
        return text

    def check(self):
        """What the servos noted."""
        errors = [error for servo in self.servos for error in servo.errors]
        assert not errors, "\n".join(errors)


def configured(servo):
    """What the controller wrote, as durand holds it."""
    od, node = servo.od, servo.node
    assert node.nmt.state == StateEnum.OPERATIONAL
    assert node.rpdo[0].mapping == ((0x6040, 0), (0x607A, 0), (0x60B2, 0)), node.rpdo[0].mapping
    assert node.tpdo[0].mapping == ((0x6041, 0), (0x6064, 0)), node.tpdo[0].mapping
    assert (node.rpdo[0].transmission_type, node.tpdo[0].transmission_type) == (1, 1)
    assert node.rpdo[0].enable and node.tpdo[0].enable
    assert not any(pdo.enable for pdo in (*node.rpdo[2:], *node.tpdo[1:]))
    supervised = od.read(0x1016, 1)
    assert supervised >> 16 == 0x7F and 3 * 3 <= supervised & 0xFFFF <= 100, hex(supervised)
    assert od.read(0x60C2, 1) * 10.0 ** od.read(0x60C2, 2) == PERIOD_S
    held = {index: od.read(index, 0) for index in (0x1017, 0x6007, 0x605A, 0x605E, 0x6060)}
    assert held == {0x1017: 50, 0x6007: 1, 0x605A: 6, 0x605E: 2, 0x6060: 8}, held
    assert od.read(0x1029, 1) == 1


def main(cubectl, robot, *ports):
    cell = Cell(cubectl, robot, *ports)
    servos = cell.servos
    controller = cell.start("controller", "run", "--period-ms", "3")

    # Found: configured, enabled, its supervision proven by a fault, enabled again. No target leaves the place.
    cell.run("held", lambda: all(servo.states.count(ENABLED) == 2 for servo in servos))
    for servo in servos:
        configured(servo)
        states = [NAMES[state] for state in servo.states]
        assert states == ["off", "ready", "on", "enabled", "fault", "off", "ready", "on", "enabled"], states
        assert all(target.counts == 0 for target in servo.targets)
    print("found: configured and read back, supervision proven, torque at rest")

    # A motion of one second and more: joint 6 is node 8.
    since = cell.bus.now
    program = cell.start("move", "--joints", "0,0.1,0.2,0,0.3,0.5", "--home", "--yes")
    print(cell.end(program, 0).strip().splitlines()[-1])
    for servo, end_rad in zip(servos, (0.1, 0.2, 0.0, 0.3, 0.5)):
        targets = servo.moved(since)
        smooth(servo, targets, 2.7)
        off = targets[-1].counts - end_rad * RAD
        assert abs(off) <= 0.001 * RAD, f"node {servo.node.node_id}: {off} counts from the end"
        assert servo.state == ENABLED
    moved = [target.torque for target in servos[0].moved(since)]
    assert max(map(abs, moved)) > 20, "the torque of the arm is fed forward"
    print("motion: ends at", [servo.od.read(0x6064, 0) for servo in servos], "counts")

    # Ctrl-C in the middle: virtual time stands until the program has the signal.
    since, last = cell.bus.now, servos[-1]
    program = cell.start("move", "--joints", "0,0.1,0.2,0,0.3,-0.5", "--yes")
    cell.run("half of the way", lambda: last.od.read(0x6064, 0) < 0.1 * RAD)
    program.send_signal(signal.SIGINT)
    time.sleep(0.3)
    cell.end(program, 6)
    cell.pass_s(0.5)
    targets = last.moved(since)
    smooth(last, targets, 2.7)
    assert steps(targets)[-50:] == [0] * 50, "it stands"
    assert -0.45 * RAD < targets[-1].counts < 0.1 * RAD, targets[-1]
    assert all(servo.state == ENABLED for servo in servos), "a stop holds the arm"
    print("stopped on the way at", targets[-1].counts, "counts, with torque")

    # One fails in a motion: the others come to rest and are held.
    since = cell.bus.now
    program = cell.start("move", "--joints", "0,0.4,0.5,0,0.3,0.5", "--yes")
    cell.run("a motion", lambda: servos[0].od.read(0x6064, 0) > 0.2 * RAD)
    failed_at = cell.bus.now
    servos[1].fail(OVER_CURRENT)
    text = cell.end(program, 13)
    assert "current" in text, text
    cell.pass_s(0.5)
    for servo in servos[:1] + servos[2:]:
        targets = servo.moved(since)
        after = [target for target in targets if target.at > failed_at + 4 * PERIOD_S]
        speeds = [abs(step) for step in steps(after)]
        servo.check("slower in each period", all(b <= a + 2 for a, b in zip(speeds, speeds[1:])))
        servo.check("it stands", speeds[-50:] == [0] * 50)
        assert servo.state == ENABLED
    assert servos[1].state == FAULT and servos[1].word & 0x0F == 0x02, "the order for a quick stop"
    print("a servo fails: the others stand with torque")

    # The controller ends: each servo stops by itself.
    controller.send_signal(signal.SIGINT)
    time.sleep(0.3)
    cell.run("the supervision", lambda: all(servo.state == FAULT for servo in servos))
    errors = [servo.od.read(0x603F, 0) for servo in servos]
    assert errors == [HEARTBEAT_LOST, OVER_CURRENT] + 3 * [HEARTBEAT_LOST], [hex(error) for error in errors]
    print("the controller ends: heartbeat lost, fault", hex(errors[0]))
    cell.check()

    # The data sheet that durand writes of itself, beside the node; and the same with a type that it does not have.
    own = servos[3].node.eds.content
    other = re.sub(r"(\[6065\][^\[]*DataType=)0x7", r"\g<1>0x6", own)
    assert other != own
    with tempfile.TemporaryDirectory() as folder:
        sheet = os.path.join(folder, "durand.eds")
        for content, code, said in (
            (own, 0, r"^node 7: 4\d objects as in "),
            (other, 9, r"^node 7, 6065:00 object 6065: the node gives 4 bytes, the sheet says 2$"),
        ):
            with open(sheet, "w") as file:
                file.write(content)
            text = cell.end(cell.start("modules", "show", "--eds", sheet, "--node", "7"), code)
            assert re.search(said, text, re.MULTILINE), text
    print("data sheet: as the node, and a type that is not is named")


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], *map(int, sys.argv[3:6]))
