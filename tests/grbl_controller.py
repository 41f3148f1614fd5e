"""A controller that speaks GRBL 1.1, with a clock of its own: the other side of the `grbl` driver in tests.

Written from GRBL's interface description and settings list: welcome, ok and error, `?` reports, a receive
buffer of 128 characters, a planner of 15 blocks, ALARM, `$X`, `$$`, `$I`, soft reset, feed hold. Motion is
integrated in small steps of time, not by a formula. Between blocks it stops, which a `G4` in between
asks for anyway.
"""

import math
import re
from collections import deque

RX_BUFFER = 128
PLANNER = 15
LINE = 80
TICK_S = 0.001
DWELL_STEP_S = 0.05
WELCOME = b"\r\nGrbl 1.1h ['$' for help]\r\n"
LOCKED = b"[MSG:'$H'|'$X' to unlock]\r\n"
WORD = re.compile(r"([A-Z])([-+]?(?:\d+\.?\d*|\.\d+))")


class Controller:
    """Bytes in by `receive`, bytes out of `take`, time by `advance`."""

    def __init__(self, max_rate_dpm=(21600.0,) * 3, acceleration=(1000.0,) * 3, axes="XYZ", locked=False):
        self.max_rate_dpm, self.acceleration, self.axes = max_rate_dpm, acceleration, axes
        self.clock_s = 0.0
        self.position = [0.0, 0.0, 0.0]
        self.out = bytearray()
        self.overflowed = 0
        self.reached_deg = 0.0
        # Every pose at which it dwelt, and for how long.
        self.dwelt = []
        self.busy_s = 0.0
        self._start(locked)

    def _start(self, locked):
        """What a reset does: all is forgotten but the position."""
        self.rx, self.line = bytearray(), bytearray()
        self.blocks, self.block, self.speed = deque(), None, 0.0
        self.dwell, self.waiting = None, None
        self.offset, self.feed = [0.0, 0.0, 0.0], None
        self.planned = list(self.position)
        self.state = "Alarm" if locked else "Idle"
        self.out += WELCOME + (LOCKED if locked else b"")

    # --- what comes from outside ---

    def receive(self, data):
        for byte in data:
            char = bytes([byte])
            if char == b"?":
                self.out += self.report()
            elif char == b"\x18":
                self.reset()
            elif char == b"!":
                self.state = "Hold" if self.state == "Run" else self.state
            elif char == b"~":
                self.state = "Run" if self.state == "Hold" else self.state
            elif len(self.rx) < RX_BUFFER:
                self.rx += char
            else:
                self.overflowed += 1

    def take(self):
        data, self.out = bytes(self.out), bytearray()
        return data

    def reset(self):
        """Ctrl-X: motors that turn lose their place, and the controller locks."""
        moving = self.speed > 0.0
        if moving:
            self.out += b"ALARM:3\r\n"
        self._start(locked=moving or self.state == "Alarm")

    def power_cycle(self):
        """It starts anew and takes where the motors stand for zero."""
        self.position = [0.0, 0.0, 0.0]
        self._start(locked=False)

    def alarm(self, code):
        self.out += f"ALARM:{code}\r\n".encode()
        self.blocks.clear()
        self.block, self.speed, self.dwell, self.waiting = None, 0.0, None, None
        self.rx.clear()
        self.planned, self.state = list(self.position), "Alarm"
        self.out += b"[MSG:Reset to continue]\r\n"

    def report(self):
        state = self.state
        if state == "Hold":
            state = "Hold:0" if self.speed == 0.0 else "Hold:1"
        position = ",".join(f"{angle:.3f}" for angle in self.position)
        return f"<{state}|MPos:{position}|FS:{60 * self.speed:.0f},0>\r\n".encode()

    # --- time ---

    def advance(self, duration_s):
        end_s = self.clock_s + duration_s
        while self.clock_s < end_s - 1e-12:
            self._serve()
            tick_s = min(TICK_S, end_s - self.clock_s)
            self.clock_s += tick_s
            if self.block is not None or self.dwell is not None:
                self.busy_s += tick_s
            self._turn(tick_s)
            if self.dwell is not None:
                self.dwell -= tick_s
                if self.dwell <= 1e-9:
                    self.dwell = None
                    self.out += b"ok\r\n"
        self._serve()

    @property
    def idle(self):
        return not (
            self.rx or self.blocks or self.block or self.dwell is not None or self.waiting is not None
        )

    def _serve(self):
        """Read lines for as long as nothing holds the parser up."""
        while True:
            if self.waiting is not None:
                if self.block is not None or self.blocks or self.state == "Hold":
                    return
                seconds, self.waiting = self.waiting, None
                self.dwell = DWELL_STEP_S * math.ceil(round(seconds / DWELL_STEP_S, 6))
                self.dwelt.append((tuple(self.position), self.dwell))
                if self.dwell == 0.0:
                    self.dwell = None
                    self.out += b"ok\r\n"
            if self.dwell is not None or len(self.blocks) >= PLANNER or not self.rx:
                return
            char = self.rx.pop(0)
            if char in b"\r\n":
                line, self.line = self.line.decode("ascii", "replace"), bytearray()
                self._execute(line)
            elif len(self.line) < LINE:
                self.line.append(char)

    def _turn(self, tick_s):
        if self.block is None:
            if not self.blocks or self.state not in ("Idle", "Run"):
                return
            self.block, self.state = self.blocks.popleft(), "Run"
        start, target, rate, acceleration, done, length = self.block
        left = length - done
        if self.state == "Hold":
            speed = max(self.speed - acceleration * tick_s, 0.0)
        elif left <= self.speed**2 / (2 * acceleration) + self.speed * tick_s:
            # With the deceleration that ends at the target; in the last tick it arrives.
            speed = max(self.speed - self.speed**2 / (2 * left) * tick_s, 0.0)
        else:
            speed = min(self.speed + acceleration * tick_s, rate)
        done += (self.speed + speed) / 2 * tick_s
        self.speed = speed
        arrives = speed == 0.0 and self.state != "Hold"
        share = 1.0 if arrives else min(done / length, 1.0)
        self.position = [a + share * (b - a) for a, b in zip(start, target, strict=True)]
        self.reached_deg = max(self.reached_deg, *map(abs, self.position))
        self.block = (start, target, rate, acceleration, done, length)
        if share == 1.0:
            self.position, self.block, self.speed = list(target), None, 0.0
            self.state = "Run" if self.blocks else "Idle"

    # --- lines ---

    def _execute(self, line):
        line = re.sub(r"\([^)]*\)|;.*", "", line).replace(" ", "").upper()
        if line in ("$X", "$$", "$I", "$"):
            self.out += self._setting(line)
        elif line.startswith("$"):
            self.out += b"error:3\r\n"
        elif self.state == "Alarm":
            self.out += b"error:9\r\n" if line else b"ok\r\n"
        else:
            answer = self._gcode(line) if line else b"ok\r\n"
            self.out += answer

    def _setting(self, line):
        if line == "$X":
            if self.state != "Alarm":
                return b"ok\r\n"
            self.state = "Idle"
            return b"[MSG:Caution: Unlocked]\r\nok\r\n"
        if line == "$I":
            return b"[VER:1.1h.20190825:]\r\n[OPT:V,15,128]\r\nok\r\n"
        settings = [("10", 1), ("13", 0), ("20", 0), ("21", 1), ("22", 0)]
        settings += [(f"10{i}", 100.0) for i in range(3)]
        settings += [(f"11{i}", rate) for i, rate in enumerate(self.max_rate_dpm)]
        settings += [(f"12{i}", a) for i, a in enumerate(self.acceleration)]
        settings += [(f"13{i}", 10000.0) for i in range(3)]
        text = "".join(f"${k}={v:.3f}\r\n" if isinstance(v, float) else f"${k}={v}\r\n" for k, v in settings)
        return text.encode() + b"ok\r\n"

    def _gcode(self, line):
        words = WORD.findall(line)
        if "".join(letter + number for letter, number in words) != line:
            return b"error:2\r\n" if line[0].isalpha() else b"error:1\r\n"
        codes = {float(number) for letter, number in words if letter in "GM"}
        values = {letter: float(number) for letter, number in words if letter not in "GM"}
        if {4.0, 53.0} <= codes or {0.0, 1.0} <= codes:
            return b"error:21\r\n"
        if not codes <= {0.0, 1.0, 2.0, 4.0, 21.0, 53.0, 90.0, 92.0, 94.0} or set(values) - set(
            self.axes + "FP"
        ):
            return b"error:20\r\n"
        if "F" in values:
            self.feed = values["F"]
        named = {i: values[letter] for i, letter in enumerate(self.axes) if letter in values}
        if 4.0 in codes:
            if "P" not in values:
                return b"error:28\r\n"
            self.waiting = values["P"]
            return b""
        if 92.0 in codes:
            for i, angle in named.items():
                self.offset[i] = self.planned[i] - angle
        elif named:
            if not self.feed:
                return b"error:22\r\n"
            base = [0.0] * 3 if 53.0 in codes else self.offset
            target = [named[i] + base[i] if i in named else self.planned[i] for i in range(3)]
            self._plan(target)
        return b"ok\r\n"

    def _plan(self, target):
        turn = [b - a for a, b in zip(self.planned, target, strict=True)]
        length = math.sqrt(sum(part * part for part in turn))
        if length == 0.0:
            return
        shares = [abs(part) / length for part in turn]
        rate = min([self.feed, *(m / s for m, s in zip(self.max_rate_dpm, shares, strict=True) if s)]) / 60
        acceleration = min(a / s for a, s in zip(self.acceleration, shares, strict=True) if s)
        self.blocks.append((list(self.planned), list(target), rate, acceleration, 0.0, length))
        self.planned = list(target)
