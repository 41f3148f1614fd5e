"""A controller and a unit at pseudo-terminals: what the `grbl` driver and the recording are tried on.

Both can be slow, lose bytes, and be pulled out and put back; a path that stays the same leads to them.
"""

import os
import pty
import random
import select
import threading
import time
import tty
from collections import deque
from pathlib import Path

TURN_S = 0.002


class Port:
    """One end of a pseudo-terminal whose other end is at `path`; a subclass says what happens in a `turn`."""

    def __init__(self, path, latency_s=0.0):
        self.path, self.latency_s = Path(path), latency_s
        self.master = self.slave = None
        self.late = deque()
        self.error = None
        self._end = threading.Event()
        self.plug()

    def __enter__(self):
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._end.set()
        self._thread.join()
        self.unplug()
        if self.error is not None:
            raise self.error

    def plug(self):
        self.master, self.slave = pty.openpty()
        tty.setraw(self.slave)
        os.set_blocking(self.master, False)
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(self.slave))

    def unplug(self):
        if self.master is not None:
            os.close(self.master)
            os.close(self.slave)
            self.master = self.slave = None
            self.path.unlink(missing_ok=True)

    def write(self, data):
        """Send after the latency; what the reader leaves lying is not lost, as with a slow cable."""
        if data:
            self.late.append((time.monotonic() + self.latency_s, data))

    def _run(self):
        try:
            while not self._end.is_set():
                if self.master is None:
                    self.late.clear()
                    time.sleep(TURN_S)
                else:
                    ready, _, _ = select.select([self.master], [], [], TURN_S)
                    self.receive(os.read(self.master, 65536) if ready else b"")
                    self._deliver()
                self.turn()
        # A failed assertion in a thread must reach the test.
        except Exception as error:
            self.error = error

    def _deliver(self):
        while self.late and self.late[0][0] <= time.monotonic():
            due_s, data = self.late.popleft()
            try:
                done = os.write(self.master, data)
            except BlockingIOError:
                done = 0
            if done < len(data):
                self.late.appendleft((due_s, data[done:]))
                return

    def receive(self, data):
        """Bytes from the other end."""

    def turn(self):
        """A moment later."""


class ControllerPort(Port):
    """A controller whose time runs `scale` times as fast as ours.

    loss    share of the bytes that get lost, either way
    script  [(condition on the controller, function of this port)], done once each, in this order
    """

    def __init__(self, path, controller, *, scale=12.0, latency_s=0.0, loss=0.0, seed=1, script=()):
        super().__init__(path, latency_s)
        self.controller, self.scale, self.loss = controller, scale, loss
        self.draw, self.script = random.Random(seed), deque(script)
        self.lost = 0
        self._seen_s = time.monotonic()

    def receive(self, data):
        self.controller.receive(self._thinned(data))

    def turn(self):
        now_s = time.monotonic()
        self.controller.advance((now_s - self._seen_s) * self.scale)
        self._seen_s = now_s
        while self.script and self.script[0][0](self.controller):
            self.script.popleft()[1](self)
        said = self.controller.take()
        if self.master is not None:
            self.write(self._thinned(said))

    def _thinned(self, data):
        kept = bytes(byte for byte in data if self.draw.random() >= self.loss)
        self.lost += len(data) - len(kept)
        return kept


class UnitPort(Port):
    """A unit that sends a packet for each sample, `rate_hz` a second, as long as it is let.

    packet   number of a sample -> its bytes
    damage   (number, bytes, draw) -> what arrives instead; None sends it as it is
    """

    def __init__(self, path, packet, *, rate_hz=1000.0, damage=None, seed=1, count=None):
        super().__init__(path)
        self.packet, self.rate_hz, self.count = packet, rate_hz, count
        self.damage, self.draw = damage, random.Random(seed)
        self.sent, self.intact = 0, []
        self._started_s = None

    def turn(self):
        now_s = time.monotonic()
        # The first samples come once somebody may listen.
        self._started_s = self._started_s or now_s
        due = int((now_s - self._started_s) * self.rate_hz)
        due = due if self.count is None else min(due, self.count)
        while self.sent < due:
            whole = self.packet(self.sent)
            sent = whole if self.damage is None else self.damage(self.sent, whole, self.draw)
            if self.master is not None:
                self.write(sent)
                if sent == whole:
                    self.intact.append(self.sent)
            self.sent += 1
