"""Monitors a GRBL controller for states in which it pauses, such as a feed hold.

A pause is reported at once. The run fails unless the user ends the pause.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from imucal.stand.clock import Clock
from imucal.stand.driver import Event
from imucal.stand.grbl_port import RESUME
from imucal.stand.grbl_session import GrblSession, StoppedError, Timeouts
from imucal.stand.link import LinkLostError

__all__ = ["Pause"]

# Interval between two requests to resume, s.
RESUME_EVERY_S: Final = 0.5
# For each state of the controller in which the run waits for the user: event code and text.
PAUSES: Final = {
    "Hold": ("feed_hold", "feed hold: press cycle start at the controller"),
    "Door": ("safety_door", "the safety door is open: close it and press cycle start at the controller"),
}
# For each state of the controller that ends the run: code and text of the reason.
ENDS: Final = {
    "Alarm": ("alarm", "the controller is locked by an alarm"),
    "Sleep": (
        "sleep",
        "the controller sleeps and the motors are not powered, so their position is not known",
    ),
    "Check": ("check_mode", "the controller is in check mode, in which nothing moves"),
    "Jog": ("foreign_motion", "the motors are moved by someone else (jog)"),
    "Home": ("foreign_motion", "the motors are moved by someone else (homing)"),
    "Tool": ("tool_change", "the controller waits for a tool change"),
}


class Pause:
    """Monitors the state of a controller during a run.

    resumes  whether to end a hold without waiting for the user; a safety door must be closed first
    message  instruction for the user; empty if there is no pause
    """

    def __init__(self, session: GrblSession, timeouts: Timeouts, clock: Clock, *, resumes: bool) -> None:
        self._session, self._timeouts, self._clock, self._resumes = session, timeouts, clock, resumes
        self.message = ""
        self._state = ""
        self._since_s = self._polled_s = self._asked_s = 0.0
        self._events: list[Event] = []

    def is_active(self) -> bool:
        """Whether the program has to wait. Raises StoppedError for a state that ends the run.

        Raises LinkLostError if the controller has not reported for `stall_s`. Samples of the unit do not
        count as reports.
        """
        now_s = self._clock.now_s()
        passed_s, self._polled_s = now_s - self._polled_s, now_s
        if not self._session.port.is_open:
            return False
        silent_s = now_s - self._session.reported_s
        if silent_s > self._timeouts.stall_s:
            raise LinkLostError(f"{self._session.port.name} has been silent for {silent_s:.1f} s")
        report = self._session.report
        state = report.state if report is not None else ""
        if state in ENDS:
            raise StoppedError(*ENDS[state])
        if state not in PAUSES or self._session.is_stopping:
            if self._state:
                self._events.append(Event("continued", f"after {now_s - self._since_s:.0f} s"))
            self.forget()
            return False
        if state != self._state:
            self._state, self._since_s = state, now_s
            code, self.message = PAUSES[state]
            self._events.append(Event(code, self.message))
        self._session.paused_s += passed_s
        if now_s - self._since_s > self._timeouts.pause_s:
            code, text = PAUSES[state]
            raise StoppedError(code, f"{text}; the pause has lasted more than {self._timeouts.pause_s:.0f} s")
        is_open_door = state == "Door" and report is not None and report.part != "0"
        if self._resumes and not is_open_door and now_s - self._asked_s > RESUME_EVERY_S:
            self._asked_s = now_s
            self._session.port.send(RESUME)
        return True

    def forget(self) -> None:
        """End the pause without an event."""
        self._state = self.message = ""

    def take_events(self) -> Sequence[Event]:
        """Events since the last call."""
        events, self._events = self._events, []
        return events
