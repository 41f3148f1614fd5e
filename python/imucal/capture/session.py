"""Guided recording: requests poses, decides which rests count as poses, and reports events.

A `Session` needs no terminal, and its clock is the time of the samples.

    session = Session(columns, Order())
    for rows in stream:
        for event in session.feed(rows): ...
        session.snapshot

The requested poses are repeated in rounds. A round has as many poses as there are requested up directions. A
pose counts if two conditions hold: the compiled library detects a rest of at least `hold_s`, and the up
direction at this rest differs from that of the last pose and from those of all earlier poses of the round.
The counted poses depend on the samples only, so a recording can be continued from its file.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.capture.events import Event, Pose, Snapshot
from imucal.capture.outlook import Outlook, outlook_of
from imucal.capture.poses import (
    NEAR_DEG,
    SAME_DEG,
    angle_deg,
    attitude_with,
    next_pose,
    pose_words,
    standard_poses,
    turn_words,
)
from imucal.capture.samples import Samples
from imucal.capture.sight import Held, Sight, look
from imucal.capture.watch import Watch
from imucal.errors import ImucalError, InputError
from imucal.planning.targets import targets_of
from imucal.stand.stream import TICKS_PER_S
from imucal.units import STANDARD_GRAVITY_MPS2

__all__ = ["Order", "Session"]

# Interval at which the recording so far is evaluated, s of the samples' time.
EVERY_S: Final = 0.25
# A recording of up to this number of samples is evaluated every `EVERY_S`, which takes a small share of the
# time of a processor. For longer recordings, the interval grows in proportion to the number of samples.
SAMPLES_OF_EVERY: Final = 200_000
# POSES is the default number of poses if no accuracy targets are given. POSES_WITH_TARGETS is the minimum
# number of poses if targets are given. It is nine, the number of parameters of an accelerometer.
POSES: Final = 18
POSES_WITH_TARGETS: Final = 9
# Minimum duration of a rest that counts as an attempt at a pose, s. Shorter rests are pauses in a rotation.
ATTEMPT_S: Final = 0.6
# If the unit is at rest in a pose that was already recorded, a message refuses the pose after this time, s.
REPEATED_S: Final = 0.7
# If the unit stays in a complete pose, a message says that the pose is complete. STAYS_S is the time from the
# completion of the pose to the first message, s. STAYS_AGAIN_S is the interval between repetitions, s.
STAYS_S: Final = 1.5
STAYS_AGAIN_S: Final = 8.0
# Samples are missing if a time step exceeds both `GAP_S`, s, and `GAP_STEPS` median time steps.
GAP_S: Final = 0.05
GAP_STEPS: Final = 5.0
# While a recording grows, the ends of a rest change by at most this time from one evaluation to the next, s.
ENDS_MOVE_S: Final = 0.5


@dataclass(frozen=True)
class Order:
    """Requirements on a guided recording.

    hold_s        time for which a pose is held, s
    poses         number of poses. None means one pose per direction in `directions`. Without directions, it
                  means 18 poses, or at least 9 poses if there are targets
    targets       largest permitted standard deviation of each group of parameters, as in `imucal.plan`
    directions    up directions in the body frame, in order; None: the faces, edges and corners of a box
    gravity_mps2  local gravity, m/s^2
    """

    hold_s: float = 3.0
    poses: int | None = None
    targets: Mapping[str, float | str] = field(default_factory=dict)
    directions: Sequence[FloatArray] | None = None
    gravity_mps2: float = STANDARD_GRAVITY_MPS2

    def __post_init__(self) -> None:
        if not 1.0 <= self.hold_s <= 60.0:
            raise InputError(f"the hold time is {self.hold_s:g} s: give 1 to 60 s")
        if self.poses is not None and self.poses < 1:
            raise InputError(f"{self.poses} poses: give at least 1")
        targets_of(self.targets, ())

    @property
    def wanted(self) -> int:
        """Number of poses after which the recording may end."""
        if self.poses is not None:
            return self.poses
        if self.directions is not None:
            return len(self.directions)
        return POSES_WITH_TARGETS if self.targets else POSES


class Session:
    """A guided recording; `columns` are the column names of the samples."""

    def __init__(self, columns: Sequence[str], order: Order) -> None:
        if not any(name in TICKS_PER_S for name in columns):
            raise InputError(f"the unit sends {', '.join(columns)}: a time is needed")
        for axis in "xyz":
            if not any(name.startswith(f"accel_{axis}_") for name in columns):
                raise InputError(
                    f"the unit sends {', '.join(columns)}: accel_x, accel_y and accel_z are needed"
                )
        self.order = order
        self.samples = Samples(columns)
        self.poses: list[Pose] = []
        self.snapshot = Snapshot(hold_s=order.hold_s, wanted=order.wanted)
        self.done = False
        self._watch = Watch()
        self._targets = targets_of(order.targets, ())
        self._directions = list(order.directions or standard_poses())
        self._outlook = Outlook()
        self._next_look_s = 0.0
        # The rest that was in progress at the last evaluation, and the kinds of the messages about this rest.
        self._before: Held | None = None
        self._said: set[str] = set()
        self._reminded_s = -np.inf
        self._asked: int | None = None
        self._attitude = np.eye(3)

    # Methods that receive samples.

    def feed(self, rows: FloatArray) -> list[Event]:
        """Add samples, (N, columns), and return the new messages.

        When the recording is complete (`done`), further samples are ignored.
        """
        events: list[Event] = []
        while len(rows) and not self.done:
            # Samples are split at the times of the evaluations, so that the result does not depend on the
            # number of samples that arrive at once.
            times_s = self.samples.times_s(rows)
            due = np.flatnonzero(times_s >= self._next_look_s)
            count = int(due[0]) + 1 if len(due) else len(rows)
            self.samples.append(rows[:count])
            if len(due):
                now_s = float(times_s[count - 1])
                self._next_look_s = now_s + EVERY_S * max(1.0, len(self.samples) / SAMPLES_OF_EVERY)
                events += self._look()
            rows = rows[count:]
        return events

    def resume(self, rows: FloatArray) -> list[Event]:
        """Continue a recording from its earlier samples, which were recorded with the same `order`."""
        self.samples.append(rows)
        if not len(rows):
            return []
        now_s = float(self.samples.times_s(rows[-1:])[0])
        self._next_look_s = now_s + EVERY_S
        try:
            sight = look(self.samples.recording(), self.order.gravity_mps2)
        except ImucalError:
            return [Event(now_s, "info", "resumed", f"{len(rows)} samples are in the file")]
        for rest in sight.rests:
            if rest.duration_s >= self.order.hold_s - ENDS_MOVE_S and self._same(rest.up) is None:
                self._add(rest)
        self._outlook = outlook_of(self.samples.recording(), self.order.gravity_mps2)
        self._watch.forget_gaps()
        text = f"{len(self.poses)} poses of {self.order.wanted} are in the file already"
        events = [Event(now_s, "info", "resumed", text)]
        if self._is_complete():
            return [*events, self._finish(now_s)]
        return [*events, *self._ask(now_s, None)]

    def undo(self) -> tuple[int, list[Event]]:
        """Drop the last pose and all samples after the pose before it.

        Returns the number of kept rows, and messages.
        """
        now_s = self.snapshot.time_s
        if not self.poses:
            return len(self.samples), [Event(now_s, "info", "nothing_to_undo", "there is no pose to drop")]
        dropped = self.poses.pop()
        kept = 0
        if self.poses:
            kept = int(np.searchsorted(self.samples.times_s(self.samples.rows), self.poses[-1].end_s + 1e-9))
        self.samples.truncate(kept)
        self._next_look_s = self.poses[-1].end_s if kept else 0.0
        self._before, self._said, self.done = None, set(), False
        self._watch.forget_gaps()
        self._outlook = outlook_of(self.samples.recording(), self.order.gravity_mps2) if kept else Outlook()
        text = (
            f"pose {dropped.number} ({pose_words(dropped.up)}) is dropped; {len(self.poses)} poses are left"
        )
        return kept, [Event(now_s, "info", "undone", text), *self._ask(now_s, None)]

    # The following methods evaluate the recording so far.

    def _look(self) -> list[Event]:
        now_s = float(self.samples.times_s(self.samples.rows[-1:])[0])
        try:
            recording = self.samples.recording()
            sight = look(recording, self.order.gravity_mps2)
        except ImucalError as error:
            return [Event(now_s, "warning", "unreadable", str(error))] if self._first("unreadable") else []
        events = self._watch.look(sight, recording)
        if self._asked is None:
            events += self._ask(now_s, None)
        self._update_ends(sight)
        current, before = sight.current, self._before
        if before is not None and (current is None or current.start_s > before.end_s):
            events += self._left(before, now_s)
            self._said = set()
        if current is not None:
            events += self._holding(current, now_s)
        self._before = current
        self._show(sight)
        return events

    def _holding(self, current: Held, now_s: float) -> list[Event]:
        """Messages while the unit is still."""
        held_s = current.duration_s
        mine = self._of(current)
        if mine is not None:
            if held_s < self.order.hold_s + STAYS_S or now_s - self._reminded_s < STAYS_AGAIN_S:
                return []
            self._reminded_s = now_s
            text = (
                f"pose {mine.number} is complete, and the unit is still in it: rotate it to {self._request()}"
            )
            return [Event(now_s, "refused", "stays", text)]
        same = self._same(current.up)
        if same is not None:
            if held_s < REPEATED_S or not self._first("repeated"):
                return []
            text = (
                f"this is pose {same.number} again ({pose_words(same.up)}), "
                f"{angle_deg(same.up, current.up):.0f} deg "
                f"from it: rotate the unit to {self._request()}"
            )
            return [Event(now_s, "refused", "repeated", text)]
        if held_s >= self.order.hold_s:
            return self._take(current, now_s)
        if held_s >= ATTEMPT_S and self._first("hold"):
            text = f"{pose_words(current.up)}: hold it still for {self.order.hold_s:g} s"
            return [Event(now_s, "hold", "hold", text)]
        return []

    def _left(self, rest: Held, now_s: float) -> list[Event]:
        """Messages after the unit has left a rest."""
        if self._of(rest) is not None or self._same(rest.up) is not None or rest.duration_s < ATTEMPT_S:
            return []
        if self._has_gap(rest.end_s, now_s):
            text = (
                f"{pose_words(rest.up)}: data are missing after {rest.duration_s:.1f} s, so the pose does "
                "not count yet: hold the unit still for longer"
            )
            return [Event(now_s, "refused", "interrupted", text)]
        text = (
            f"moved too early: held still for {rest.duration_s:.1f} s, and {self.order.hold_s:g} s are "
            f"needed; the pose {pose_words(rest.up)} does not count, hold it again"
        )
        return [Event(now_s, "refused", "moved_too_early", text)]

    def _has_gap(self, start_s: float, end_s: float) -> bool:
        """Whether samples are missing in an interval."""
        times_s = self.samples.times_s(self.samples.rows)
        steps_s = np.diff(times_s[max(int(np.searchsorted(times_s, start_s)) - 1, 0) :])
        return bool(
            len(steps_s) and steps_s.max() > max(GAP_STEPS * float(np.median(np.diff(times_s))), GAP_S)
        )

    def _take(self, rest: Held, now_s: float) -> list[Event]:
        before = self._outlook
        pose = self._add(rest)
        self._outlook = outlook_of(self.samples.recording(), self.order.gravity_mps2, before)
        asked = self._asked
        other = (
            "; it is not the requested pose, but it also counts"
            if asked is not None and angle_deg(self._directions[asked], pose.up) > NEAR_DEG
            else ""
        )
        text = f"pose {pose.number} of {self.order.wanted} is taken: {pose_words(pose.up)}{other}"
        events = [Event(now_s, "taken", "taken", f"{text}; {self._outlook.change(before)}")]
        if self._is_complete():
            return [*events, self._finish(now_s)]
        if len(self.poses) >= self.order.wanted:
            events.append(Event(now_s, "info", "not_enough", self._lacks()))
        return [*events, *self._ask(now_s, pose.up)]

    # Methods that accept or refuse poses.

    def _add(self, rest: Held) -> Pose:
        pose = Pose(len(self.poses) + 1, rest.start_s, rest.end_s, rest.up)
        self.poses.append(pose)
        return pose

    @property
    def _round(self) -> list[Pose]:
        """The poses of the current round; a round has one pose for each requested up direction."""
        start = len(self.poses) // len(self._directions) * len(self._directions)
        return self.poses[start:]

    def _of(self, rest: Held) -> Pose | None:
        """The pose that was recorded during `rest`; None if the rest does not count as a pose."""
        return next((p for p in self.poses if p.start_s < rest.end_s and rest.start_s < p.end_s), None)

    def _same(self, up: FloatArray) -> Pose | None:
        """A pose of the current round, or the last pose, with an up direction close to `up`; else None."""
        known = [*self._round, *self.poses[-1:]]
        return next((pose for pose in known if angle_deg(pose.up, up) < SAME_DEG), None)

    def _update_ends(self, sight: Sight) -> None:
        """Update the ends of the poses, because the ends of rests change slightly as samples arrive."""
        for i, pose in enumerate(self.poses):
            rest = next((r for r in sight.rests if r.start_s < pose.end_s and pose.start_s < r.end_s), None)
            if rest is not None:
                self.poses[i] = dataclasses.replace(pose, start_s=rest.start_s, end_s=rest.end_s)

    def _ask(self, now_s: float, current: FloatArray | None) -> list[Event]:
        """Request the next pose. `current` is the up direction of the present pose, or None."""
        is_held = [any(angle_deg(pose.up, up) < NEAR_DEG for pose in self._round) for up in self._directions]
        asked = next_pose(self._directions, is_held, current)
        # A pose between two requested directions counts for both directions. Therefore all directions may
        # have been held before the round has its full number of poses. In this case `asked` is None.
        self._asked = 0 if asked is None else asked
        up = self._directions[self._asked]
        self._attitude = attitude_with(up, self._attitude)
        turn = "" if current is None else f" ({turn_words(current, up)})"
        number = len(self.poses) + 1
        text = f"pose {number} of {max(self.order.wanted, number)}: rotate the unit to {pose_words(up)}{turn}"
        if current is None and not self.poses:
            text = f"pose 1 of {self.order.wanted}: hold the unit still with {pose_words(up)}"
        return [Event(now_s, "next", "next", text)]

    def _request(self) -> str:
        return "the next pose" if self._asked is None else pose_words(self._directions[self._asked])

    # Methods that end the recording.

    def _is_complete(self) -> bool:
        return (
            len(self.poses) >= self.order.wanted
            and self._outlook.missing is None
            and self._outlook.reaches(self._targets)
        )

    def _lacks(self) -> str:
        if self._outlook.missing is not None:
            return f"more poses are needed: {self._outlook.missing}"
        return (
            f"more poses are needed, the targets are not reached yet: {self._outlook.short_of(self._targets)}"
        )

    def _finish(self, now_s: float) -> Event:
        self.done = True
        self.snapshot = dataclasses.replace(
            self.snapshot,
            state="finished",
            request="",
            attitude=None,
            poses=len(self.poses),
            rows=self._outlook.rows(self._targets),
            missing=None,
        )
        return Event(
            now_s, "finished", "finished", f"all is recorded, with {len(self.poses)} poses: put the unit down"
        )

    def _show(self, sight: Sight) -> None:
        if self.done:
            return
        current = sight.current
        mine = None if current is None else self._of(current)
        counts = current is not None and mine is None and self._same(current.up) is None
        self.snapshot = Snapshot(
            state="holding" if counts else "taken" if mine is not None else "waiting",
            request=self._request(),
            attitude=self._attitude,
            held_s=min(current.duration_s, self.order.hold_s) if counts and current is not None else 0.0,
            hold_s=self.order.hold_s,
            steadiness=sight.steadiness,
            poses=len(self.poses),
            wanted=self.order.wanted,
            rows=self._outlook.rows(self._targets),
            missing=self._outlook.missing,
            time_s=sight.now_s,
            samples=len(self.samples),
        )

    def _first(self, what: str) -> bool:
        """Whether no message of the kind `what` was sent in the current rest. Marks the kind as sent."""
        if what in self._said:
            return False
        self._said.add(what)
        return True
