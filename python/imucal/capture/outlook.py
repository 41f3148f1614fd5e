"""Prediction for an unfinished recording: accuracy of its calibration, and the motion that is missing."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Final

from imucal.capture.events import Row
from imucal.errors import ImucalError
from imucal.estimation.inspection import inspect
from imucal.planning.groups import GROUPS, PlannedParameter, Size, worst_of
from imucal.recording.recording import Recording
from imucal.units import units_of

__all__ = ["Outlook", "outlook_of"]

NOT_YET: Final = "not determined yet"
# Units in which standard deviations are shown, by SI unit.
SHOWN_IN: Final = {"1": "ppm", "m/s^2": "mg", "rad/s": "deg/h"}
NAMES: Final = {
    "accel_sensitivity": "accelerometer sensitivity",
    "accel_bias": "accelerometer bias",
    "gyro_sensitivity": "gyroscope sensitivity",
    "gyro_bias": "gyroscope bias",
}


@dataclass(frozen=True)
class Outlook:
    """Predicted accuracy of a calibration from the samples recorded so far.

    worst    largest standard deviation of the parameters of each group; None if a parameter of the group is
             not determined
    missing  description of the missing motion; None if the recording determines all parameters
    before   the field `worst` of the prediction before the last pose was recorded
    absent   groups of parameters that belong to a sensor that the recording does not have
    """

    worst: Mapping[str, Size | None] = field(default_factory=dict)
    missing: str | None = "no pose was held yet"
    before: Mapping[str, Size | None] = field(default_factory=dict)
    absent: Collection[str] = ()

    def reaches(self, targets: Mapping[str, float]) -> bool:
        """Whether the predicted standard deviation of every group with a target is within its target."""
        return not self._above(targets)

    def short_of(self, targets: Mapping[str, float]) -> str:
        """A text that lists the parameter groups whose predicted standard deviation exceeds the target."""
        return "; ".join(
            f"{NAMES[group]} {_shown(size)}, target {_target(target, size)}"
            for group, (size, target) in self._above(targets).items()
        )

    def _above(self, targets: Mapping[str, float]) -> dict[str, tuple[Size | None, float]]:
        sizes = {group: self.worst.get(group) for group in targets}
        return {
            group: (size, targets[group])
            for group, size in sizes.items()
            if size is None or size.value > targets[group]
        }

    def change(self, before: Outlook) -> str:
        """Describe the change of the predicted standard deviations since the earlier prediction `before`."""
        parts = []
        for group, size in self.worst.items():
            old = before.worst.get(group)
            if size is not None and old is not None:
                percent = 100.0 * (size.value / old.value - 1.0)
                parts.append(f"{NAMES[group]} {_shown(old)} -> {_shown(size)} ({percent:+.0f} %)")
            elif size is not None:
                parts.append(f"{NAMES[group]} {_shown(size)}")
        unknown = [
            NAMES[group] for group in NAMES if self.worst.get(group) is None and group not in self.absent
        ]
        if unknown:
            parts.append(f"{NOT_YET}: {', '.join(unknown)}")
        return "; ".join(parts)

    def rows(self, targets: Mapping[str, float]) -> tuple[Row, ...]:
        """The rows of the displayed table of accuracies, one per group of parameters."""
        rows = []
        for group in GROUPS:
            size, before = self.worst.get(group), self.before.get(group)
            target = _target(targets[group], size) if group in targets else ""
            rows.append(Row(NAMES[group], _shown(before) if before else "", _shown(size), target))
        return tuple(rows)


def outlook_of(recording: Recording, gravity_mps2: float, before: Outlook | None = None) -> Outlook:
    """Predict the standard deviations that the parameters of a calibration from this recording would have.

    before   the prediction for the recording without its last pose
    """
    earlier = {} if before is None else before.worst
    absent = () if recording.angular_rate is not None else ("gyro_sensitivity", "gyro_bias")
    try:
        inspection = inspect(recording, gravity_mps2=gravity_mps2)
    except ImucalError as error:
        return Outlook({}, str(error), earlier, absent)
    parameters = [PlannedParameter(p.name, p.std, p.unit) for p in inspection.predicted_sigma]
    worst = {group: size for group, size in worst_of(parameters, ()).items() if group not in absent}
    return Outlook(worst, inspection.missing, earlier, absent)


def _shown(size: Size | None) -> str:
    """A standard deviation as text in the unit of datasheets; `NOT_YET` if it is None."""
    if size is None:
        return NOT_YET
    unit = SHOWN_IN.get(size.unit, size.unit)
    return f"{size.value / units_of(size.unit)[unit]:.3g} {unit}"


def _target(target: float, size: Size | None) -> str:
    return _shown(Size(target, size.unit)) if size is not None else f"{target:g}"
