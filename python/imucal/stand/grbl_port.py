"""Serial port of a GRBL 1.1 controller: splits bytes into lines and parses status reports."""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final

from imucal.stand.link import LinkLostError

__all__ = ["ALARMS", "ERRORS", "RX_BUFFER", "GrblPort", "Report", "report_of"]

# Size of the controller's receive buffer, characters.
RX_BUFFER: Final = 128
# Reset three times: if a single reset byte were lost, the answers to old lines would be taken for new
# answers.
RESET, HOLD, STATUS = b"\x18" * 3, b"!", b"?"
NUMBERS: Final = r"(-?\d+\.\d+),(-?\d+\.\d+),(-?\d+\.\d+)"
STATES: Final = "Idle|Run|Hold|Jog|Alarm|Door|Check|Home|Sleep"
REPORT: Final = re.compile(rf"<({STATES})(?::(\d))?\|([MW])Pos:{NUMBERS}(?:,[-\d.,]*)?(\|.*)?>")
OFFSET: Final = re.compile(rf"\|WCO:{NUMBERS}")
# Length above which a line without an end is treated as damaged, characters; longer than any line of GRBL.
LONGEST: Final = 512

# Meaning of GRBL's alarm and error codes.
ALARMS: Final = {
    1: "a limit switch was hit: the position is lost",
    2: "the target is beyond the travel of an axis ($130 to $132, soft limits)",
    3: "a reset while motors turned: the position is uncertain",
    6: "homing was reset",
    7: "a safety door opened while homing",
    8: "homing could not move off the limit switch",
    9: "homing did not find the limit switch",
}
ERRORS: Final = {
    1: "a command letter was expected",
    2: "a number is missing or in a wrong format",
    3: "a $ command is unknown",
    8: "a $ command needs an idle controller",
    9: "the controller is locked by an alarm",
    11: "a line is too long",
    15: "a jog exceeds the travel",
    20: "a command is unknown",
    22: "the feed rate is missing",
}


@dataclass(frozen=True)
class Report:
    """A status report: state, substate (`Hold:0` means that the motors are at rest), and position, deg."""

    state: str
    part: str | None
    position_deg: tuple[float, float, float] | None

    @property
    def stands(self) -> bool:
        """Whether all motors are at rest."""
        return self.state in ("Idle", "Alarm") or (self.state, self.part) == ("Hold", "0")


class GrblPort:
    """An open serial port. Every method except `close` raises LinkLostError once the device is gone."""

    def __init__(self, port: str, baud: int, open_port: Callable[[str, int], Any]) -> None:
        self.name = port
        self._baud, self._open_port = baud, open_port
        self._port: Any = None
        self._left = b""

    @property
    def is_open(self) -> bool:
        """Whether the port is open on the host."""
        return self._port is not None and bool(self._port.is_open)

    def open(self) -> None:
        """Open or reopen the port."""
        self.close()
        self._left = b""
        self._port = self._open_port(self.name, self._baud)

    def send(self, data: bytes) -> None:
        """Send all bytes."""
        self._guarded(lambda: self._port.write(data))

    def lines(self) -> list[str]:
        """Complete lines received since the last call, without line ends and empty lines."""
        data: bytes = self._guarded(lambda: self._port.read(self._port.in_waiting or 1))
        *lines, self._left = (self._left + data).split(b"\n")
        if len(self._left) > LONGEST:
            lines, self._left = [*lines, self._left], b""
        texts = [line.decode("ascii", "replace").strip() for line in lines]
        return [text for text in texts if text]

    def close(self) -> None:
        """Close the port; never raises."""
        if self._port is not None:
            # pyserial may raise when it closes a port whose device is gone.
            with suppress(Exception):
                self._port.close()

    def _guarded(self, work: Any) -> Any:
        try:
            return work()
        # pyserial passes on other exceptions for a lost device, such as those of termios.
        except Exception as error:
            raise LinkLostError(f"{self.name} is lost: {error}") from None


def report_of(
    line: str, offset_deg: tuple[float, ...] | None
) -> tuple[Report, tuple[float, ...] | None] | None:
    """The report in a line, and the work offset known after it; None if the line is no complete report.

    With bit 0 of setting $10 cleared, the controller reports work positions. The machine position is then
    known only after a report with the offset, which the controller includes from time to time.
    """
    match = REPORT.fullmatch(line)
    if match is None:
        return None
    commanded = OFFSET.search(match[7] or "")
    if commanded is not None:
        offset_deg = tuple(float(commanded[i]) for i in (1, 2, 3))
    x, y, z = (float(match[i]) for i in (4, 5, 6))
    if match[3] == "M":
        return Report(match[1], match[2], (x, y, z)), offset_deg
    if offset_deg is None:
        return Report(match[1], match[2], None), None
    dx, dy, dz = offset_deg
    return Report(match[1], match[2], (x + dx, y + dy, z + dz)), offset_deg
