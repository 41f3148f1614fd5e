"""Comparison of two calibrations: tests whether their parameters differ significantly.

    difference = b - a,    covariance = covariance of a + covariance of b

a and b are the parameters of the two calibrations. For an unchanged unit the difference has this covariance,
because the errors of the two recordings are independent. There are two tests, each with half of the false
alarm rate that the argument `sigmas` of `diff` sets. The first test is applied to every single parameter,
with Bonferroni's correction. The second test is a chi2 test of all parameters together, which detects small
changes of many parameters.

Calibrations in different body frames or with different axes are compared in the symmetric frame (in which
the accelerometer's sensitivity is symmetric) and before axis remapping. A parameter without a standard
deviation, as in a calibration of another program, is listed and not tested.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Any, Final

import numpy as np

import imucal._core as _core
from imucal.arrays import FloatArray
from imucal.calibration.calibration import Calibration
from imucal.calibration.frame import for_columns, in_frame
from imucal.calibration.provenance import Provenance
from imucal.calibration.triad import base_count
from imucal.document.plain import plain
from imucal.errors import InputError
from imucal.recording.axes import UNCHANGED

__all__ = ["Change", "Difference", "diff"]

SCHEMA: Final = "imucal.difference/1"
SIGMAS: Final = 3.0


@dataclass(frozen=True)
class Change:
    """One parameter, compared between two calibrations.

    before, after   values of the parameter in the two calibrations; 0 in a calibration without the effect
    std             standard deviation of the difference, from both covariances; None if it is not known
    moved           whether the difference exceeds `Difference.limit_sigmas`; False if `std` is None
    """

    name: str
    unit: str
    before: float
    after: float
    std: float | None
    moved: bool

    @property
    def difference(self) -> float:
        """The value `after` minus the value `before`."""
        return self.after - self.before

    @property
    def sigmas(self) -> float | None:
        """The difference in standard deviations.

        It is infinite if a parameter with a standard deviation of zero has changed, and None if the standard
        deviation is not known.
        """
        if self.std is None:
            return None
        if self.difference == 0.0:
            return 0.0
        return self.difference / self.std if self.std > 0 else math.copysign(math.inf, self.difference)


@dataclass(frozen=True)
class Difference:
    """The comparison of two calibrations.

    changes           every parameter, in the order of the file
    limit_sigmas      limit of the difference of a single parameter, in standard deviations of the difference
    false_alarm       probability that two calibrations of an unchanged unit have the verdict `moved`
    chi2, dof, p_value   joint test of all parameters with a standard deviation; without such parameters, chi2
                         and p_value are None
    notes             remarks about the two calibrations, such as different body frames
    serial_numbers, provenances   of the first calibration, and of the second
    """

    changes: tuple[Change, ...]
    limit_sigmas: float
    false_alarm: float
    chi2: float | None
    dof: int
    p_value: float | None
    notes: tuple[str, ...]
    serial_numbers: tuple[str | None, str | None] = (None, None)
    provenances: tuple[Provenance, Provenance] = (Provenance(), Provenance())

    @property
    def moved(self) -> tuple[Change, ...]:
        """The parameters whose difference exceeds the limit.

        The largest difference in standard deviations comes first.
        """
        return tuple(sorted((c for c in self.changes if c.moved), key=lambda c: -abs(c.sigmas or 0.0)))

    @property
    def verdict(self) -> str:
        """`same` (within the uncertainties), `moved`, or `unknown` if no parameter can be tested."""
        if self.p_value is None:
            return "unknown"
        return "moved" if self.reasons else "same"

    @property
    def reasons(self) -> tuple[str, ...]:
        """The reasons for the verdict `moved` (largest difference first) or `unknown`; empty for `same`."""
        if self.p_value is None:
            return (
                "no parameter has a standard deviation in both calibrations, so no difference can be tested: "
                "compare calibrations from recordings (imucal calibrate)",
            )
        single = tuple(
            f"{c.name} has moved by {c.difference:.4g} {c.unit}, {abs(c.sigmas or 0.0):.1f} sigma (the limit "
            f"is {self.limit_sigmas:.2f})".replace(" 1,", ",")
            for c in self.moved
        )
        if self.p_value < self.false_alarm / 2:
            joint = f"all parameters jointly: chi2 is {self.chi2:.4g} with {self.dof} degrees of freedom, p "
            return (*single, joint + f"{self.p_value:.2g}")
        return single

    def to_dict(self) -> dict[str, Any]:
        """The document of `imucal diff --json`."""
        first, second = (
            {"serial_number": serial_number, "provenance": plain(provenance)}
            for serial_number, provenance in zip(self.serial_numbers, self.provenances, strict=True)
        )
        same = first["serial_number"] == second["serial_number"]
        return {
            "schema": SCHEMA,
            "serial_number": first["serial_number"] if same else None,
            "verdict": self.verdict,
            "reasons": list(self.reasons),
            "limit_sigmas": self.limit_sigmas,
            "false_alarm": self.false_alarm,
            "joint": None
            if self.p_value is None
            else {"chi2": self.chi2, "degrees_of_freedom": self.dof, "p_value": self.p_value},
            "parameters": [
                {
                    **plain(c),
                    "difference": c.difference,
                    "sigmas": c.sigmas if c.sigmas is not None and math.isfinite(c.sigmas) else None,
                }
                for c in self.changes
            ],
            "notes": list(self.notes),
            "imucal_version": str(_core.__version__),
            "before": first,
            "after": second,
        }


def diff(before: Calibration, after: Calibration, *, sigmas: float = SIGMAS) -> Difference:
    """Compare two calibrations of a unit.

    sigmas   sets the false alarm rate: the probability that a normal variable deviates from its mean by more
             than this number of standard deviations. With 3, 0.27 % of the comparisons of an unchanged unit
             give the verdict `moved`

    If only one calibration has an effect, the values of the effect count as exactly zero in the other
    calibration, and its shape (a time constant) is not compared. Parameters that the file of another program
    does not state are not compared either. Calibrations with different body frames or axes are compared in
    the symmetric frame. Raises InputError for different raw units, and for effects that cannot be expressed
    in the symmetric frame.
    """
    if not (math.isfinite(sigmas) and sigmas > 0):
        raise InputError(f"sigmas is {sigmas}: a positive number is needed")
    notes = _notes(before, after)
    if before.sensors != after.sensors:
        which = "first" if before.gyroscope is None else "second"
        notes.append(
            f"the {which} calibration has no gyroscope, so only the accelerometers are compared, without "
            "effects"
        )
        before, after = _accelerometer(before), _accelerometer(after)
    _require_same_units(before, after)
    lacking = [
        (f"the {place} calibration, of {imported.program},", imported)
        for place, calibration in (("first", before), ("second", after))
        if (imported := calibration.provenance.imported) is not None
    ]
    if (before.frame, before.axes) != (after.frame, after.axes) or before.frame == "given":
        notes.append(_of_frames(before, after))
        before, after = (in_frame(for_columns(c), "symmetric") for c in (before, after))
    names, units = _names(before, after)
    not_stated = [name for name in names if any(imported.lacks(name) for _, imported in lacking)]
    for which, imported in lacking:
        missing = [name for name in names if imported.lacks(name)]
        if missing:
            notes.append(f"{which} does not state {', '.join(missing)}: not compared")
    known = [name for name in names if name not in not_stated]
    units = [unit for name, unit in zip(names, units, strict=True) if name in known]
    values = np.array([_values(calibration, known) for calibration in (before, after)])
    tested = [name for name in known if not (_lacks_std(before, name) or _lacks_std(after, name))]
    if len(tested) < len(known):
        notes += _without_std(before, after, known)
    covariance = _covariance(before, tested) + _covariance(after, tested)
    std = dict(zip(tested, np.sqrt(np.diag(covariance)).tolist(), strict=True))
    false_alarm = 2 * NormalDist().cdf(-sigmas)
    limit = -NormalDist().inv_cdf(false_alarm / 4 / max(len(tested), 1))
    changes = tuple(
        Change(name, unit, float(a), float(b), s := std.get(name), s is not None and abs(b - a) > limit * s)
        for name, unit, a, b in zip(known, units, values[0].tolist(), values[1].tolist(), strict=True)
    )
    chi2, dof = _joint(np.array([c.difference for c in changes if c.std is not None]), covariance)
    return Difference(
        changes,
        limit,
        false_alarm,
        chi2 if tested else None,
        dof,
        _core.chi2_p_value(chi2, dof) if tested else None,
        tuple(notes),
        (before.serial_number, after.serial_number),
        (before.provenance, after.provenance),
    )


def _require_same_units(before: Calibration, after: Calibration) -> None:
    pairs = (
        (
            "the accelerometer is in",
            before.accel_unit,
            after.accel_unit,
            "calibrate both in the same raw units",
        ),
        ("the gyroscope is in", before.gyro_unit, after.gyro_unit, "calibrate both in the same raw units"),
    )
    for what, a, b, way_out in pairs:
        if a != b:
            raise InputError(f"{what} {a} in the first and {b} in the second calibration: {way_out}")


def _accelerometer(calibration: Calibration) -> Calibration:
    """The calibration of the accelerometer alone."""
    count = base_count(calibration.frame, has_gyroscope=False)
    covariance, names = calibration.covariance, calibration.covariance_names
    known = [k for k, name in enumerate(names) if name in {p.name for p in calibration.parameters[:count]}]
    return replace(
        calibration,
        gyroscope=None,
        effects=(),
        user_effects=(),
        covariance=None if covariance is None else covariance[np.ix_(known, known)],
        covariance_names=tuple(names[k] for k in known),
    )


def _of_frames(before: Calibration, after: Calibration) -> str:
    """A note that the frames or axes differ and that the comparison is in the symmetric frame."""
    first, second = (
        f"in the frame {c.frame}" + (f" with axes={c.axes!r}" if c.axes != UNCHANGED else "")
        for c in (before, after)
    )
    return (
        f"the first calibration is {first}, the second {second}: both are converted to and compared in the "
        "symmetric frame, in which the sensitivity matrix of the accelerometer is symmetric"
    )


def _lacks_std(calibration: Calibration, name: str) -> bool:
    """Whether the calibration has a parameter with this name, but no standard deviation of it."""
    return any(p.name == name and p.std is None for p in calibration.parameters)


def _without_std(before: Calibration, after: Calibration, names: list[str]) -> list[str]:
    """Notes on the parameters without a standard deviation."""
    notes = []
    for place, calibration in (("first", before), ("second", after)):
        missing = [name for name in names if _lacks_std(calibration, name)]
        if missing:
            which = "any parameter" if len(missing) == len(names) else ", ".join(missing)
            notes.append(
                f"the {place} calibration has no standard deviation of {which}: listed, but not tested"
            )
    return notes


def _names(before: Calibration, after: Calibration) -> tuple[list[str], list[str]]:
    """Names and units of all parameters, except time constants of effects that one calibration lacks."""
    both = {values.name for values in before.effects} & {values.name for values in after.effects}
    units: dict[str, str] = {}
    for calibration in (before, after):
        shapes = {
            f"{values.name}_{shape.name}"
            for values in calibration.effects
            if values.name not in both and (shape := calibration.definition(values).shape) is not None
        }
        for parameter in calibration.parameters:
            if parameter.name not in shapes:
                units.setdefault(parameter.name, parameter.unit)
    return list(units), list(units.values())


def _values(calibration: Calibration, names: list[str]) -> list[float]:
    known = {parameter.name: parameter.value for parameter in calibration.parameters}
    return [known.get(name, 0.0) for name in names]


def _covariance(calibration: Calibration, names: list[str]) -> FloatArray:
    """The covariance of the parameters `names`; zero for parameters that the calibration does not have."""
    full = np.zeros((len(names), len(names)))
    if calibration.covariance is None:
        return full
    index = {name: i for i, name in enumerate(calibration.covariance_names)}
    known = [i for i, name in enumerate(names) if name in index]
    places = [index[names[i]] for i in known]
    full[np.ix_(known, known)] = calibration.covariance[np.ix_(places, places)]
    return full


def _joint(change: FloatArray, covariance: FloatArray) -> tuple[float, int]:
    """chi2 of the differences `change`, and its degrees of freedom, which are the rank of `covariance`."""
    std = np.sqrt(np.diag(covariance))
    known = std > 0
    if not known.any():
        return 0.0, 0
    scaled = change[known] / std[known]
    values, vectors = np.linalg.eigh(covariance[np.ix_(known, known)] / np.outer(std[known], std[known]))
    kept = values > len(values) * np.finfo(np.float64).eps * values[-1]
    return float(np.sum((vectors.T @ scaled)[kept] ** 2 / values[kept])), int(kept.sum())


def _notes(before: Calibration, after: Calibration) -> list[str]:
    notes = []
    if before.serial_number != after.serial_number:
        notes.append(f"the serial numbers differ: {before.serial_number} and {after.serial_number}")
    known = "unknown" not in (before.references.gravity_from, after.references.gravity_from)
    if known and before.gravity_mps2 != after.gravity_mps2:
        notes.append(
            f"gravity was {before.gravity_mps2} and {after.gravity_mps2} m/s^2: if both calibrations were "
            "made at the same place, one value is wrong, and so are the accelerometer scales based on it"
        )
    shared = after.provenance.seen_in(before.provenance.files)
    if shared:
        notes.append(
            f"both were made of {', '.join(source.path for source in shared)}: their errors are the same in "
            "part, and the standard deviations given here are too large"
        )
    for name, one, other in (("first", before, after), ("second", after, before)):
        only = {values.name for values in one.effects} - {values.name for values in other.effects}
        notes += [
            f"only the {name} calibration contains {effect}: it counts as zero in the other calibration"
            for effect in sorted(only)
        ]
    return notes
