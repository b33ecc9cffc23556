"""A client of a simulated bus in virtual time, for nodes of durand: its network and its timers."""

import heapq
import itertools
import socket
import threading

from durand.network import NetworkABC
from durand.scheduler import AbstractScheduler

# Longest wait: programs may join at any time.
TURN_S = 0.01


class Timers(AbstractScheduler):
    """Timers of durand in virtual time, s."""

    def __init__(self):
        self.now, self._queue, self._number, self._lock = 0.0, [], itertools.count(), threading.Lock()

    @property
    def lock(self):
        return self._lock

    def add(self, delay, callback, args=(), kwargs=None):
        entry = [self.now + delay, next(self._number), lambda: callback(*args, **(kwargs or {}))]
        heapq.heappush(self._queue, entry)
        return entry

    def cancel(self, entry):
        entry[2] = None

    def run_to(self, now):
        while self._queue and self._queue[0][0] <= now + 1e-9:
            self.now, _, callback = heapq.heappop(self._queue)
            if callback is not None:
                callback()
        self.now = now

    def next_s(self):
        return self._queue[0][0] if self._queue else self.now + TURN_S


class Station(NetworkABC):
    """The network of one node: its subscriptions."""

    def __init__(self, bus):
        self.bus, self.subscriptions = bus, {}
        bus.stations.append(self)

    def add_subscription(self, cob_id, callback):
        self.subscriptions[cob_id] = callback

    def remove_subscription(self, cob_id):
        self.subscriptions.pop(cob_id)

    def send(self, cob_id, msg):
        self.bus.send(cob_id, msg)


class LockstepBus:
    """The connection: time passes only in `turn`."""

    def __init__(self, host, port, timers):
        self.stations, self.timers, self.frames = [], timers, []
        self._socket = socket.create_connection((host, port))
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._text, self._said = "", []
        self._answer("hi")
        for question in ("open can0", "rawmode"):
            self._say(question)
            self._answer("ok")
        self._say("lockstep")
        self._to_turn()

    def _say(self, words):
        self._socket.sendall(f"< {words} >".encode())

    def _words(self):
        while ">" not in self._text:
            data = self._socket.recv(65536)
            if not data:
                raise ConnectionError("the bus has closed the connection")
            self._text += data.decode()
        message, self._text = self._text.split(">", 1)
        return message.replace("<", "").split()

    def _answer(self, wanted):
        words = self._words()
        assert words == [wanted], words

    def _to_turn(self):
        while True:
            words = self._words()
            if words[0] == "frame":
                self.frames.append((float(words[2]), words[1], bytes.fromhex("".join(words[3:]))))
            elif words[0] == "time":
                self.now = float(words[1])
                return
            else:
                assert words[0] == "rtr", words

    def send(self, cob_id, msg):
        self._said.append(f"< send {cob_id:03X} {len(msg)} {bytes(msg).hex(' ')} >")

    def turn(self):
        """Handles what came, ends the turn, and returns at the next one."""
        self.timers.run_to(self.now)
        frames, self.frames = self.frames, []
        for _, id_text, data in frames:
            # Ids of three digits are those of 11 bits.
            if len(id_text) != 3:
                continue
            cob_id = int(id_text, 16)
            for station in self.stations:
                callback = station.subscriptions.get(cob_id)
                if callback is not None:
                    callback(cob_id, data)
        until = max(min(self.timers.next_s(), self.now + TURN_S), self.now)
        said, self._said = "".join(self._said), []
        self._socket.sendall(f"{said}< wait {until:.6f} 0.000000 >".encode())
        self._to_turn()

    def close(self):
        self._socket.close()
