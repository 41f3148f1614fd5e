"""GRBL 1.1 over a serial port: bytes to lines, and what they say."""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final

from imucal.stand.link import LinkLostError

__all__ = ["ALARMS", "ERRORS", "RX_BUFFER", "GrblPort", "Report", "report_of"]

# Characters that the controller keeps before it has read them.
RX_BUFFER: Final = 128
# A reset that is lost leaves old lines in the controller, whose answers pass for those of new ones: three of
# them are as good as one, and do not get lost all together.
RESET, HOLD, STATUS = b"\x18" * 3, b"!", b"?"
NUMBERS: Final = r"(-?\d+\.\d+),(-?\d+\.\d+),(-?\d+\.\d+)"
STATES: Final = "Idle|Run|Hold|Jog|Alarm|Door|Check|Home|Sleep"
REPORT: Final = re.compile(rf"<({STATES})(?::(\d))?\|([MW])Pos:{NUMBERS}(?:,[-\d.,]*)?(\|.*)?>")
OFFSET: Final = re.compile(rf"\|WCO:{NUMBERS}")
# Longer than any line of the controller: then the end of a line was lost.
LONGEST: Final = 512

# What the codes mean, in the words of GRBL's own tables.
ALARMS: Final = {
    1: "a limit switch was hit: the position is lost",
    2: "the target is beyond the travel of an axis ($130 to $132, soft limits)",
    3: "a reset while motors turned: the position is uncertain",
    6: "homing was reset",
    7: "a safety door opened while homing",
    8: "homing could not leave the limit switch",
    9: "homing did not find the limit switch",
}
ERRORS: Final = {
    1: "a command letter was expected",
    2: "a number is missing or in a wrong format",
    3: "a $ command is not known",
    8: "a $ command needs the controller to be idle",
    9: "it is locked by an alarm",
    11: "a line is too long",
    15: "a jog is beyond the travel",
    20: "a command is not known",
    22: "there is no feed rate",
}


@dataclass(frozen=True)
class Report:
    """A status report: the state, its number (0 of `Hold:0` says that it stands), and the position, deg."""

    state: str
    part: str | None
    position_deg: tuple[float, float, float] | None

    @property
    def stands(self) -> bool:
        """Whether no motor turns."""
        return self.state in ("Idle", "Alarm") or (self.state, self.part) == ("Hold", "0")


class GrblPort:
    """An open port; every method raises LinkLostError once the other end is gone."""

    def __init__(self, port: str, baud: int, open_port: Callable[[str, int], Any]) -> None:
        self.name = port
        self._baud, self._open_port = baud, open_port
        self._port: Any = None
        self._left = b""

    @property
    def is_open(self) -> bool:
        """Whether it is open, on this side at least."""
        return self._port is not None and bool(self._port.is_open)

    def open(self) -> None:
        """Open it, or open it again."""
        self.close()
        self._left = b""
        self._port = self._open_port(self.name, self._baud)

    def send(self, data: bytes) -> None:
        """Send bytes, all of them."""
        self._guarded(lambda: self._port.write(data))

    def lines(self) -> list[str]:
        """The lines that have arrived since the last call, without their ends, empty ones left out."""
        data: bytes = self._guarded(lambda: self._port.read(self._port.in_waiting or 1))
        *lines, self._left = (self._left + data).split(b"\n")
        if len(self._left) > LONGEST:
            lines, self._left = [*lines, self._left], b""
        texts = [line.decode("ascii", "replace").strip() for line in lines]
        return [text for text in texts if text]

    def close(self) -> None:
        """Close it; must not fail."""
        if self._port is not None:
            # A port that is gone may refuse.
            with suppress(Exception):
                self._port.close()

    def _guarded(self, work: Any) -> Any:
        try:
            return work()
        # pyserial lets errors of termios, and of a port that is gone, through.
        except Exception as error:
            raise LinkLostError(f"{self.name} is lost: {error}") from None


def report_of(
    line: str, offset_deg: tuple[float, ...] | None
) -> tuple[Report, tuple[float, ...] | None] | None:
    """The report in a line, and the work offset that is known after it; None if the line is no whole report.

    With $10 without its first bit the controller reports work positions: its machine position is known once
    it has told the offset, which it does from time to time.
    """
    match = REPORT.fullmatch(line)
    if match is None:
        return None
    told = OFFSET.search(match[7] or "")
    if told is not None:
        offset_deg = tuple(float(told[i]) for i in (1, 2, 3))
    x, y, z = (float(match[i]) for i in (4, 5, 6))
    if match[3] == "M":
        return Report(match[1], match[2], (x, y, z)), offset_deg
    if offset_deg is None:
        return Report(match[1], match[2], None), None
    dx, dy, dz = offset_deg
    return Report(match[1], match[2], (x + dx, y + dy, z + dz)), offset_deg
