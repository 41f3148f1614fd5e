"""Identifies the noise of a unit from a recording at rest: Allan deviations and noise figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import imucal._core as _core
from imucal.arrays import FloatArray
from imucal.document.plain import without_nan
from imucal.document.whole import check_threads
from imucal.errors import InputError
from imucal.finding import Finding
from imucal.notebook import html_of
from imucal.recording.recording import Recording, as_recording

__all__ = ["AxisNoise", "Departure", "Drift", "NoiseFigure", "NoiseResult", "Step", "noise"]

SCHEMA: Final = "imucal.noise/1"
# Units of the noise figures, in which {} is replaced by the unit of the sensor's samples.
FIGURES: Final = {
    "noise_density": "{}/sqrt(Hz)",
    "bias_instability": "{}",
    "random_walk": "{}/s/sqrt(Hz)",
    "quantisation": "{} s",
}
# Codes of findings that make the verdict poor, because the figures are then not reliable.
POOR: Final = ("noise_below_lsb", "noise_model", "step")
AXES: Final = tuple(f"{sensor}_{axis}" for sensor in ("accel", "gyro") for axis in "xyz")


@dataclass(frozen=True)
class NoiseFigure:
    """A noise figure: maximum-likelihood estimate, standard deviation and 95 % band.

    If the noise process is not detected, `value` and `std` are None, `low` is 0, and `high` is the upper
    bound of the figure. The upper bound is infinite for an axis with constant samples.
    """

    value: float | None
    std: float | None
    low: float
    high: float
    unit: str

    def __str__(self) -> str:
        if self.value is None and self.high == float("inf"):
            return "not known"
        if self.value is None:
            return f"below {self.high:.3g} {self.unit}"
        return f"{self.value:.4g} +- {self.std:.2g} {self.unit}"


@dataclass(frozen=True, eq=False)
class AxisNoise:
    """The noise of one axis; v is the unit of its samples, m/s^2, rad/s or lsb.

    noise_density     white noise N, v/sqrt(Hz); for a gyroscope also called angle random walk
    bias_instability  flicker coefficient B, v: the Allan deviation is flat at 0.664 B
    random_walk       rate random walk K, v/s/sqrt(Hz)
    quantisation      quantisation Q of an integrated output, v s; rounding to counts is not part of Q or N
    lsb               one count: the smallest step between samples, v
    is_below_lsb      whether white noise is less than half a count, so that no figure has a value
    shortest_period_s shortest period used in the fit, s; a filter in the sensor affects shorter periods
    misfit            largest deviation of the spectrum in one octave from the model, in standard deviations
    taus_s            (K,) averaging times, s
    deviations        (K,) overlapping Allan deviations, v
    low, high         (K,) 95 % bands of the deviations
    dof               (K,) equivalent degrees of freedom of the deviations
    model             (K,) Allan deviations computed from the figures
    """

    noise_density: NoiseFigure
    bias_instability: NoiseFigure
    random_walk: NoiseFigure
    quantisation: NoiseFigure
    lsb: float
    is_below_lsb: bool
    shortest_period_s: float
    misfit: float
    taus_s: FloatArray
    deviations: FloatArray
    low: FloatArray
    high: FloatArray
    dof: FloatArray
    model: FloatArray

    @property
    def figures(self) -> dict[str, NoiseFigure]:
        """The four noise figures by name."""
        return {name: getattr(self, name) for name in FIGURES}


@dataclass(frozen=True)
class Departure:
    """Change of the mean of one axis: size and standard deviation of the change, m/s^2, rad/s or lsb.

    gain  twice the increase of the log-likelihood when this change is added to a model with random noise only
    """

    size: float
    std: float
    gain: float


@dataclass(frozen=True)
class Step:
    """A step of the mean of a unit at rest, for example after a bump of the table.

    time_s  time of the first sample after the step
    sample  index of the first sample after the step in the recording
    sizes   size of the step in each axis in which it was detected
    """

    time_s: float
    sample: int
    sizes: Mapping[str, Departure]


@dataclass(frozen=True)
class Drift:
    """A slow change of the mean of one axis of a unit at rest, for example during warm-up.

    start_s, end_s   start and end of the change, s
    time_constant_s  time constant of an exponential change, s; None for a change at a constant rate
    """

    axis: str
    start_s: float
    end_s: float
    time_constant_s: float | None
    size: Departure


@dataclass(frozen=True, eq=False)
class NoiseResult:
    """The noise of the recorded sensors of a unit.

    axes              accel_x, accel_y, accel_z, gyro_x, gyro_y, gyro_z; without those of a sensor that the
                      recording does not have
    accel_unit, gyro_unit   units of the samples; None for a sensor that the recording does not have
    start_s, end_s    start and end of the rest that was used, s
    steps             steps of the means in the used part of the rest; they increase the noise figures
    cut_steps         steps of the means in the part of the rest that was not used
    drifts            drifts of the means in the used part of the rest; they increase the noise figures
    findings          findings about the recording
    """

    name: str
    axes: Mapping[str, AxisNoise]
    start_s: float
    end_s: float
    samples: int
    rate_hz: float
    accel_unit: str | None
    gyro_unit: str | None
    steps: tuple[Step, ...]
    cut_steps: tuple[Step, ...]
    drifts: tuple[Drift, ...]
    findings: tuple[Finding, ...]

    def triad(self, sensor: str) -> tuple[AxisNoise, ...]:
        """The axes of "accel" or "gyro"; InputError `sensor_missing` if the recording lacks this sensor."""
        if not self.has(sensor):
            name = {"accel": "accelerometer", "gyro": "gyroscope"}[sensor]
            raise InputError(
                f"{self.name}: there is no {name} in this recording, but its noise is needed "
                "[sensor_missing]: record both sensors at rest"
            )
        return tuple(self.axes[f"{sensor}_{axis}"] for axis in "xyz")

    def has(self, sensor: str) -> bool:
        """Whether there are noise figures of the sensor "accel" or "gyro"."""
        return f"{sensor}_x" in self.axes

    @property
    def duration_s(self) -> float:
        """Duration of the rest that was used, s."""
        return self.end_s - self.start_s

    @property
    def reasons(self) -> tuple[str, ...]:
        """The reasons for the verdict poor; empty for the verdict good."""
        return tuple(f"{', '.join(f.columns)}: {f.code}" for f in self.findings if f.code in POOR)

    @property
    def verdict(self) -> str:
        """`good` or `poor`."""
        return "poor" if self.reasons else "good"

    def heading(self) -> str:
        """One line that names the samples from which the noise figures were computed."""
        return (
            f"{self.name}: {self.samples} samples at rest, {self.start_s:.2f} s to {self.end_s:.2f} s, "
            f"{self.rate_hz:.6g} Hz"
        )

    def summary(self) -> str:
        """One line for each noise figure of each axis, then one line for each finding."""
        lines = [self.heading()]
        for name, axis in self.axes.items():
            for figure, estimate in axis.figures.items():
                if figure != "quantisation" or estimate.value is not None:
                    lines.append(f"{name} {figure} {estimate}")
        return "\n".join([*lines, *(finding.line for finding in self.findings)])

    def _repr_html_(self) -> str | None:
        """The HTML that a notebook displays for this object."""
        return html_of(self)

    def to_dict(self) -> dict[str, Any]:
        """The document of `imucal noise --json`."""
        document: dict[str, Any] = without_nan(self)
        return {"schema": SCHEMA, "verdict": self.verdict, "reasons": list(self.reasons), **document}


def noise(
    recording: Recording,
    *,
    min_rest_s: float = _core.MIN_REST_S,
    cut_steps: bool = False,
    threads: int | None = None,
) -> NoiseResult:
    """Identify white noise, bias instability, random walk and quantisation of a unit at rest.

    The longest rest of the recording is used; several hours at a constant temperature are best. Figures are
    in the units of the recording, with the definitions of the simulation and of unit files, docs/model.md
    (22). If samples are lost or repeated, the longest interval is used in which almost none are lost or
    repeated (fewer than 1 in 10 000), and a finding reports it.

    cut_steps  use only the longest part of the rest without a step of a mean, which a bump of the table may
               cause. If False, steps are reported, and they make the verdict poor
    threads    None uses all processors; the result does not depend on it

    Raises InputError for faults and for a rest of fewer than 1000 samples; NotEnoughMotionError if the unit
    is never at rest.
    """
    recording = as_recording(recording).without_copies()
    check_threads(threads)
    found = _core.identify_noise(recording, min_rest_s, cut_steps, threads)
    axes = {
        f"{sensor}_{axis}": _axis(of_axis, unit)
        for sensor, triad, unit in (
            ("accel", found.accelerometer, recording.accel_unit),
            ("gyro", found.gyroscope, recording.gyro_unit),
        )
        for axis, of_axis in zip("xyz", triad or (), strict=triad is not None)
    }
    return NoiseResult(
        name=recording.name,
        axes=axes,
        start_s=found.start_s,
        end_s=found.end_s,
        samples=found.samples,
        rate_hz=found.rate_hz,
        accel_unit=None if found.accelerometer is None else recording.accel_unit,
        gyro_unit=None if found.gyroscope is None else recording.gyro_unit,
        steps=_steps(found.steps),
        cut_steps=_steps(found.cut_steps),
        drifts=tuple(
            Drift(AXES[channel], start_s, end_s, constant_s, Departure(*size))
            for start_s, end_s, constant_s, (channel, *size) in found.drifts
        ),
        findings=(*recording.findings, *found.findings),
    )


def _steps(
    found: Sequence[tuple[float, int, Sequence[tuple[int, float, float, float]]]],
) -> tuple[Step, ...]:
    return tuple(
        Step(time_s, sample, {AXES[channel]: Departure(*size) for channel, *size in sizes})
        for time_s, sample, sizes in found
    )


def _axis(axis: _core.AxisNoise, unit: str) -> AxisNoise:
    def figure(name: str) -> NoiseFigure:
        e = getattr(axis, name)
        return NoiseFigure(e.value, e.std, e.low, e.high, FIGURES[name].format(unit))

    return AxisNoise(
        **{name: figure(name) for name in FIGURES},
        lsb=axis.lsb,
        is_below_lsb=axis.is_below_lsb,
        shortest_period_s=axis.shortest_period_s,
        misfit=axis.misfit,
        taus_s=axis.tau_s,
        deviations=axis.deviation,
        low=axis.low,
        high=axis.high,
        dof=axis.dof,
        model=axis.model,
    )
