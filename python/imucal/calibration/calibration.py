"""A calibration: the sensor model of one unit, its uncertainty, and its origin.

    measured = T (true + effects(true)) + bias
    corrected = T^-1 (measured - bias) - effects(corrected)

Both equations hold for the accelerometer and for the gyroscope. T is `sensitivity`, the product of scale
factors and misalignment. Without effects (`imucal.effects`), corrected = T^-1 (measured - bias).
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import ArrayLike

from imucal.arrays import FloatArray, as_matrix
from imucal.calibration.correction import correct, correct_recording, left_in_data, takes_pieces
from imucal.calibration.figures import figures_text
from imucal.calibration.model import SensorModel
from imucal.calibration.provenance import Provenance, require_serial_number
from imucal.calibration.references import References
from imucal.calibration.triad import Parameter
from imucal.calibration.verdict import Verdict, saved_verdict
from imucal.document.plain import plain
from imucal.errors import FormatError, InputError
from imucal.notebook import html_of
from imucal.recording.recording import Recording, as_recording

if TYPE_CHECKING:
    from imucal.document.json_document import Node
    from imucal.effects.definition import UserEffect

__all__ = ["Calibration", "require_calibration"]


@dataclass(frozen=True, eq=False, repr=False)
class Calibration(SensorModel):
    """The sensor model of one unit, its uncertainty and its origin.

    accelerometer, gyroscope  sensitivity and bias of the three axes of each sensor; gyroscope is None for an
                              accelerometer alone
    frame                     the body frame, see `imucal.calibration.triad`: "symmetric", "triangular", or
                              "given" by another program or by the composition of two calibrations
    accel_unit, gyro_unit     raw units of the recordings: SI units or "lsb"
    gravity_mps2              local gravity that the calibration assumed, m/s^2
    effects                   effects from the catalogue and user-defined effects, with their values
    user_effects              definitions of the user-defined effects
    axes                      axis remapping of the recordings, the argument `axes` of `imucal.read`
    references                sources and standard deviations of local gravity and of the clock
    covariance                (P, P) covariance of the P parameters in `covariance_names`, or None
    noise                     noise figures by name, such as noise densities; each name ends with the unit
    temperature_range_degc    lowest and highest temperature of the recordings, or None
    fit                       report on the estimation: rest detection, convergence, tests of the residuals
    calibration_set, control_set   figures of merit on the calibration recordings and on the control
                                   recordings
    verdict          `good`, `incomplete` or `poor`; None if it is not known. Acceptance limits of a user do
                     not change this verdict
    reasons          why the verdict is not good
    """

    references: References = field(default_factory=References)
    covariance: FloatArray | None = None
    covariance_names: tuple[str, ...] = ()
    noise: Mapping[str, float] = field(default_factory=dict)
    temperature_range_degc: tuple[float, float] | None = None
    fit: Mapping[str, Any] = field(default_factory=dict)
    calibration_set: Mapping[str, Any] | None = None
    control_set: Mapping[str, Any] | None = None
    verdict: Verdict | None = None
    reasons: tuple[str, ...] = ()
    provenance: Provenance = field(default_factory=Provenance)
    serial_number: str | None = None

    def __post_init__(self) -> None:
        require_serial_number(self.serial_number)
        if self.covariance is not None:
            size = len(self.covariance_names)
            covariance = as_matrix(self.covariance, "covariance", (size, size))
            if (np.diag(covariance) < 0).any():
                raise InputError("covariance has a negative variance on its diagonal")
            object.__setattr__(self, "covariance", covariance)
        super().__post_init__()

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters, with their standard deviations from the covariance.

        The 21 biases and sensitivities come first, in a fixed order (nine for an accelerometer alone). The
        parameters of each effect follow, named <effect>_<parameter>; the shape of an effect (a time constant)
        is its last parameter.
        """
        if self.covariance is None:
            return super().parameters
        variance = dict(zip(self.covariance_names, np.diag(self.covariance).tolist(), strict=True))
        return tuple(
            replace(p, std=variance[p.name] ** 0.5) if p.name in variance else p for p in super().parameters
        )

    @property
    def judged(self) -> tuple[Verdict, tuple[str, ...]]:
        """The verdict with its reasons.

        The verdict is poor if the figures of merit (chi2, numbers of rests and moves) fail the criterion of
        `imucal.calibration.figures.poor_figures`, even if the file states a better verdict or no verdict.
        Files of older versions state no verdict.
        """
        sets = (self.calibration_set, self.control_set)
        return saved_verdict(self.verdict, self.reasons, *sets, has_gyroscope=self.gyroscope is not None)

    @property
    def left_in_data(self) -> tuple[str, ...]:
        """Names of the effects that no correction removes.

        These are errors of the stand, and effects that depend on the attitude of the unit. For example, the
        Earth's rate stays in the data, because it is a true angular rate and not an error of the gyroscope.
        """
        return left_in_data(self)

    @property
    def temperature_effects(self) -> tuple[str, ...]:
        """Names of the effects of the catalogue that depend on the temperature."""
        return tuple(effect.name for effect in self.catalogue_effects() if "temperature" in effect.needs)

    @property
    def takes_pieces(self) -> bool:
        """Whether a recording can be corrected piece by piece.

        Piecewise correction is impossible if an effect depends on the angular acceleration or on the
        temperature history, because both need samples beyond the ends of a piece. It is also impossible with
        a user-defined effect, because the function that computes the effect needs whole columns.
        """
        return takes_pieces(self)

    @overload
    def apply(self, angular_rate: ArrayLike, specific_force: ArrayLike) -> tuple[FloatArray, FloatArray]: ...

    @overload
    def apply(self, angular_rate: None, specific_force: ArrayLike) -> tuple[None, FloatArray]: ...

    @overload
    def apply(self, angular_rate: ArrayLike, specific_force: None) -> tuple[FloatArray, None]: ...

    @overload
    def apply(
        self, angular_rate: ArrayLike | None, specific_force: ArrayLike | None
    ) -> tuple[FloatArray | None, FloatArray | None]: ...

    def apply(
        self, angular_rate: ArrayLike | None, specific_force: ArrayLike | None
    ) -> tuple[FloatArray | None, FloatArray | None]:
        """Correct raw samples of both sensors, or of one sensor if None is given for the other.

        angular_rate    (N, 3) in `gyro_unit`
        specific_force  (N, 3) in `accel_unit`

        Returns (angular_rate, specific_force), (N, 3) each, rad/s and m/s^2 in the body frame. NaN stays NaN.
        A sample is NaN if its effects are too large to be removed. A sensor that is None stays None.
        Raises InputError for arrays of another shape and for a sensor that the calibration does not have.
        Also raises InputError if there are effects and a sensor is None, or if an effect depends on more than
        rate and force. Such an effect needs `apply_recording`.
        """
        return correct(self, angular_rate, specific_force)

    def apply_recording(self, recording: Recording, *, start_s: float | None = None) -> Recording:
        """The recording in SI units and the body frame, without the effects that a correction can remove.

        start_s  time of the first sample of the whole recording, if `recording` is a piece of it; see
                 `takes_pieces`

        A recording of one sensor alone can be corrected only if there are no effects. If the calibration has
        no gyroscope, the result contains no angular rate. Effects use the time since the recording's first
        sample, or since `start_s`, and the temperature minus 25 degC. The angular acceleration is the
        derivative of the rate. NaN stays NaN. A sample is NaN if its effects are too large to be removed.
        The effects in `left_in_data` remain.

        Raises InputError for a recording in raw units other than `accel_unit` and `gyro_unit`, and for
        negative counts that were read as unsigned numbers. Also raises InputError if a column on which an
        effect depends is missing, if the definition of a user-defined effect is missing, or if a piece is
        given although the whole recording is needed.
        """
        return correct_recording(self, as_recording(recording), start_s=start_s)

    def __repr__(self) -> str:
        """A line with serial number, raw units, number of effects, and figures of merit."""
        count = len(self.effects)
        parts = [
            f"accelerometer in {self.accel_unit}" + (" alone" if self.gyroscope is None else ""),
            *([] if self.gyroscope is None else [f"gyroscope in {self.gyro_unit}"]),
            f"{count or 'no'} effect{'s' if count != 1 else ''}",
        ]
        # In a file that another program has written, the value of a figure of merit may not be a number.
        for name, figures in (("control set", self.control_set), ("calibration set", self.calibration_set)):
            known = {key: value for key, value in (figures or {}).items() if isinstance(value, (int, float))}
            if text := figures_text(known):
                parts.append(f"{name}: {text}")
                break
        unit = "unit without a number" if self.serial_number is None else f"unit {self.serial_number!r}"
        return f"Calibration({unit}, {', '.join(parts)})"

    def _repr_html_(self) -> str | None:
        """The HTML that a notebook displays for this object."""
        return html_of(self)

    def to_dict(self) -> dict[str, Any]:
        """The fields of the calibration file."""
        from imucal.calibration.file import document_of

        return document_of(self, self.parameters, {f.name: getattr(self, f.name) for f in fields(self)})

    @staticmethod
    def from_dict(
        document: Mapping[str, Any], name: str = "calibration", *, user_effects: Sequence[UserEffect] = ()
    ) -> Calibration:
        """The calibration that a document from `to_dict` describes.

        Raises FormatError, whose message names the invalid field, for an invalid document.
        """
        from imucal.document.json_document import Node

        return _calibration_of(Node(plain(document), "$", name), user_effects)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the calibration file atomically.

        Raises InputError if the file cannot be written, if a number is not finite, and for a calibration that
        `load` would refuse because it contradicts itself.
        """
        from imucal.document.atomic import write_text
        from imucal.document.json_document import Node, to_json

        document = self.to_dict()
        text = to_json(document)
        try:
            _calibration_of(Node(document, "$", "this calibration"), self.user_effects)
        except FormatError as error:
            raise InputError(str(error)) from None
        write_text(path, text + "\n")

    @staticmethod
    def load(path: str | os.PathLike[str], *, user_effects: Sequence[UserEffect] = ()) -> Calibration:
        """Read a calibration file.

        user_effects  definitions of the user-defined effects in the file; without these definitions the
                      calibration can be inspected but not applied

        Raises InputError if the file cannot be read. Raises FormatError, whose message names the wrong field,
        if the file is not a calibration.
        """
        from imucal.document.json_document import read_json

        return _calibration_of(read_json(path), user_effects)


def _calibration_of(node: Node, user_effects: Sequence[UserEffect]) -> Calibration:
    from imucal.calibration.file import fields_of, require_consistent
    from imucal.effects.definition import by_name

    own = by_name(user_effects)
    # An InputError about contradictory values is converted to a FormatError that names the file.
    try:
        calibration = Calibration(**fields_of(node, own))
    except InputError as error:
        raise FormatError(f"{node.file}: {error}") from None
    require_consistent(node, calibration, calibration.to_dict())
    return calibration


def require_calibration(given: Calibration) -> None:
    """Raise InputError if `given` is not a Calibration. The message names the argument to pass instead."""
    if isinstance(given, Calibration):
        return
    if isinstance(given, (str, os.PathLike)):
        path = os.fspath(given)
        raise InputError(
            f"{path!r} is the path of a file: give a Calibration, imucal.Calibration.load({path!r})"
        )
    hint = "imucal.calibrate returns a Calibration, imucal.Calibration.load reads one from a file"
    if isinstance(given, Recording):
        hint = "give the calibration first and the recordings after it"
    elif isinstance(getattr(given, "calibration", None), Calibration):
        hint = "give its `calibration`"
    raise InputError(f"a {type(given).__name__} is given where a Calibration is needed: {hint}")
