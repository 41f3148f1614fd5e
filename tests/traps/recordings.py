"""Simulated recordings for traps, changes of recordings, and traps that calibrate a changed recording."""

import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

import imucal
from imucal import Program, Recording
from trap import Options, Question, Right, Trap

Change = Callable[[Recording], Any]


@functools.cache
def stand_run(seed: int = 1, unit: str = "paper") -> Any:
    """Thirty random moves between rests of two seconds, 122 s at 100 Hz."""
    program = Program.random(seed=seed, moves=30, hold_s=2.0)
    return imucal.simulate(program, unit=unit, rate_hz=100, seed=seed)


def truth_of(run: Any) -> dict[str, float]:
    """The true parameters of a simulated unit by name."""
    return {parameter.name: parameter.value for parameter in run.truth.calibration.parameters}


def changed(recording: Recording, **fields: Any) -> Recording:
    """A copy with other columns; stand angles are left out unless they are given."""
    old = {name: getattr(recording, name) for name in ("time_s", "specific_force", "angular_rate")}
    units = {"accel_unit": recording.accel_unit, "gyro_unit": recording.gyro_unit}
    return Recording(**{**old, **units, "name": "run", **fields})


def same(recording: Recording) -> Recording:
    """The recording without a change."""
    return changed(recording)


def time(change: Callable[[np.ndarray], np.ndarray]) -> Change:
    """A change of the time stamps."""
    return lambda r: changed(r, time_s=change(r.time_s.copy()))


def force(change: Callable[[np.ndarray], np.ndarray]) -> Change:
    """A change of the accelerometer's samples, (N, 3)."""
    return lambda r: changed(r, specific_force=change(r.specific_force.copy()))


def rate(change: Callable[[np.ndarray], np.ndarray]) -> Change:
    """A change of the gyroscope's samples, (N, 3)."""
    return lambda r: changed(r, angular_rate=change(r.angular_rate.copy()))


def rows(index: Callable[[int], np.ndarray]) -> Change:
    """Only the samples with these indices of n, with their time stamps."""

    def change(r: Recording) -> Recording:
        keep = index(len(r))
        return changed(
            r, time_s=r.time_s[keep], specific_force=r.specific_force[keep], angular_rate=r.angular_rate[keep]
        )

    return change


def with_new_time(change: Change, rate_hz: float = 100.0) -> Change:
    """The changed recording with time stamps made of sample number and rate."""

    def stamped(r: Recording) -> Recording:
        other = change(r)
        return changed(other, time_s=np.arange(len(other)) / rate_hz)

    return stamped


def calibrating(
    kind: str,
    name: str,
    change: Change,
    *right: Right,
    run: Callable[[], Any] = stand_run,
    control: Change | None = None,
    truth: Mapping[str, float] | None = None,
    changing: tuple[str, ...] = (),
    ending: str = "parquet",
    **options: Any,
) -> Trap:
    """A trap that calibrates a changed simulated recording.

    change    returns a recording or several
    control   makes the control recording of the unchanged one; without it there is none
    truth     true parameters by name; those of the simulated unit if None
    changing  beginnings of the names of parameters that change during the run, and have no one truth
    options   of `imucal.calibrate`, passed to the command, too
    """

    def make(folder: Path) -> Question:
        simulated = run()
        given = change(simulated.recording)
        given = given if isinstance(given, list) else [given]
        paths = [folder / f"run-{number}.{ending}" for number in range(len(given))]
        for recording, path in zip(given, paths, strict=True):
            imucal.write(recording, path)
        asked = Options(options)
        words = ["calibrate", *map(str, paths), *asked.words()]
        if control is not None:
            imucal.write(control(simulated.recording), folder / f"control.{ending}")
            words += ["--control", str(folder / f"control.{ending}")]

        def call() -> Any:
            recordings = [imucal.read(path) for path in paths]
            judge = None if control is None else imucal.read(folder / f"control.{ending}")
            return imucal.calibrate(recordings, control=judge, **options)

        known = truth_of(simulated) if truth is None else truth
        constant = {n: value for n, value in known.items() if not n.startswith(changing)}
        return Question(words, call, constant)

    return Trap(kind, name, make, right)
