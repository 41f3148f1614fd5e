"""Parsing of lines of a GRBL controller: status reports, alarms, locks, and welcome messages.

Lines have no checksum. A report is used only if its form is exact, including the number of decimals, and the
driver checks its position against the commanded motion. Alarms, locks and welcome messages are recognised
even if characters are missing, because a lost character must not hide an alarm or a restart.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from difflib import SequenceMatcher
from typing import Final, TypeAlias

__all__ = ["ALARMS", "ERRORS", "Parser", "Report", "Triple", "is_alarm", "is_lock", "is_welcome", "number_in"]

Triple: TypeAlias = tuple[float, float, float]

NUMBER: Final = r"-?\d+\.\d{3,4}"
STATES: Final = "Idle|Run|Hold|Jog|Alarm|Door|Check|Home|Sleep|Tool"
REPORT: Final = re.compile(
    rf"<({STATES})(?::(\d+))?\|([MW])Pos:({NUMBER}(?:,{NUMBER})*)((?:\|[A-Za-z]+(?::[^|<>]*)?)*)>"
)
OFFSET: Final = re.compile(rf"\|WCO:({NUMBER}(?:,{NUMBER})*)(?:\||$)")
# Order of the axes in reports and settings.
AXES: Final = "XYZABCUVW"
MM_PER_INCH: Final = 25.4
# Minimum similarity, from 0 to 1, for a damaged line to be recognised as a known text. A line that has lost
# half of its characters still has this similarity.
ALIKE: Final = 0.6
WELCOMES: Final = ("Grbl 1.1h ['$' for help]", "GrblHAL 1.1f ['$' or '$HELP' for help]")
LOCKS: Final = (
    "[MSG:'$H'|'$X' to unlock]",
    "[MSG:Reset to continue]",
    "[MSG:Check Limits]",
    "[MSG:Homing cycle required]",
    "[MSG:Emergency stop]",
)

# Meaning of GRBL's alarm and error codes.
ALARMS: Final = {
    1: "a limit switch was hit: the position is lost",
    2: "the target is beyond the travel of an axis ($130 to $132, soft limits)",
    3: "the controller was reset while motors turned: the position is uncertain",
    6: "homing was reset",
    7: "a safety door opened while homing",
    8: "homing could not move off the limit switch",
    9: "homing did not find the limit switch",
    10: "emergency stop",
    11: "homing is required",
    12: "a limit switch is engaged",
    17: "a motor has reported a fault",
}
ERRORS: Final = {
    1: "a command letter was expected",
    2: "a number is missing or in a wrong format",
    3: "a $ command is unknown",
    8: "a $ command needs an idle controller",
    9: "the controller is locked by an alarm",
    11: "a line is too long",
    13: "the safety door is open",
    15: "a jog exceeds the travel",
    20: "a command is unknown",
    22: "the feed rate is missing",
    31: "a line has an angle without a command that uses it",
}
# Number of the error with which a locked controller answers a line of G-code.
LOCKED_ERROR: Final = 9


@dataclass(frozen=True)
class Report:
    """A status report.

    state         state of the controller
    part          substate: `Hold:0` means that the motors are at rest, `Door:0` that the door is closed
    position_deg  machine position of the three motors, outermost first
    offset_deg    offset of work coordinates; None if the report does not contain it
    count         number of axes that the controller reports
    arrived_s     host time of arrival, s
    asked_s       host time of the query, s, if it is known
    """

    state: str
    part: str | None
    position_deg: Triple | None
    offset_deg: Triple | None
    count: int
    arrived_s: float
    asked_s: float | None = None

    @property
    def stands(self) -> bool:
        """Whether all motors are at rest."""
        return self.state in ("Idle", "Alarm") or (self.state, self.part) == ("Hold", "0")


class Parser:
    """Reads reports for three axis letters, outermost motor first.

    in_inches  whether the controller reports inches ($13=1); one millimetre is one degree
    """

    def __init__(self, letters: str) -> None:
        self.indices = tuple(AXES.index(letter) for letter in letters)
        self.in_inches = False

    def report(self, line: str, arrived_s: float, asked_s: float | None = None) -> Report | None:
        """The report in a line; None if the line is not a complete report.

        A report with work positions has no machine position. The driver refuses such a controller with a
        message.
        """
        match = REPORT.fullmatch(line)
        if match is None:
            return None
        numbers = match[4].split(",")
        offset = OFFSET.search(match[5] or "")
        return Report(
            match[1],
            match[2],
            self._mapped(numbers) if match[3] == "M" else None,
            None if offset is None else self._mapped(offset[1].split(",")),
            len(numbers),
            arrived_s,
            asked_s,
        )

    def _mapped(self, numbers: list[str]) -> Triple | None:
        """The angles of the three motors from the numbers of all axes.

        None if an axis is missing or a number lacks a decimal.
        """
        decimals = 4 if self.in_inches else 3
        if max(self.indices) >= len(numbers):
            return None
        if any(len(number.partition(".")[2]) != decimals for number in numbers):
            return None
        scale = MM_PER_INCH if self.in_inches else 1.0
        x, y, z = (scale * float(numbers[i]) for i in self.indices)
        return (x, y, z)


def is_welcome(line: str) -> bool:
    """Whether a possibly damaged line is the welcome message that a controller sends after a restart."""
    return "for help" in line or any(_alike(line, text) for text in WELCOMES)


def is_alarm(line: str) -> bool:
    """Whether a possibly damaged line, such as `ALRM:1` or `ALARM`, reports an alarm."""
    word, colon, _ = line.upper().partition(":")
    return _alike(word[:6] if colon else word[:5], "ALARM", 0.7)


def is_lock(line: str) -> bool:
    """Whether a possibly damaged line is the message that the controller is locked."""
    return any(_alike(line, text, 0.8) for text in LOCKS)


def number_in(line: str) -> int:
    """The number after the colon of a line such as `ALARM:1`; 0 if it is missing."""
    digits = line.partition(":")[2].strip()
    return int(digits) if digits.isdigit() else 0


def _alike(line: str, text: str, share: float = ALIKE) -> bool:
    return SequenceMatcher(None, line, text, autojunk=False).ratio() >= share
