"""A fault, the advice of its finding, and what a user does who follows the advice to the letter."""

import functools
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import imucal
from imucal import Program, Recording

# Largest accepted error of a parameter after the advice was followed, in its stated standard deviations.
WITHIN_SIGMAS = 5.0


@dataclass(frozen=True)
class Advised:
    """One finding and its advice.

    code     code of the finding
    name     what distinguishes the case among those with this code
    spoil    the fault: the recordings of a user, from a good one
    says     pattern of the advice
    follow   what the advice says to do: the recordings and the options of the next attempt
    counts   raw units of accelerometer and gyroscope per SI unit in the next attempt
    """

    code: str
    name: str
    spoil: Callable[[Recording], Any]
    says: str
    follow: Callable[[Any, str], Any]
    counts: tuple[float, float] = (1.0, 1.0)

    def __str__(self) -> str:
        return f"{self.code}: {self.name}"


@functools.cache
def run(seed: int = 1) -> Any:
    """A simulated run on a stand: 18 random moves between rests of 1.5 s, at 100 Hz."""
    program = Program.random(seed=seed, moves=18, hold_s=1.5)
    return imucal.simulate(program, unit="paper", rate_hz=100, seed=seed)


def findings_of(recordings: Any, **options: Any) -> Sequence[imucal.Finding]:
    """The findings of a calibration, whether it is refused or not."""
    try:
        return imucal.calibrate(recordings, **options).findings
    except imucal.ImucalError as error:
        return error.findings


def advice_about(code: str, recordings: Any, **options: Any) -> str:
    """The advice of the only finding with this code, or all that have it."""
    advice = [finding.way_out for finding in findings_of(recordings, **options) if finding.code == code]
    assert advice, (code, findings_of(recordings, **options))
    return "; ".join(advice)


def option_in(advice: str, name: str) -> str:
    """The value of an option in an advice, `rate_hz=100` or `axes='frd'`."""
    found = re.search(rf"{name}=('[^']*'|[\w.+-]+)", advice)
    assert found, (name, advice)
    return found.group(1).strip("'")


def outcome_of(recordings: Any, truth: Any, **options: Any) -> str:
    """`truth`, `refused: ...`, or `wrong: ...` with the parameter that is farthest from the truth."""
    try:
        result = imucal.calibrate(recordings, **options)
    except imucal.ImucalError as error:
        return f"refused: {error}"
    if result.verdict == "poor":
        return f"refused: poor, {result.reasons}"
    errors = {
        parameter.name: abs(parameter.value - truth[parameter.name]) / parameter.std
        for parameter in result.parameters
        if parameter.name in truth
    }
    worst = max(errors, key=errors.__getitem__)
    return "truth" if errors[worst] < WITHIN_SIGMAS else f"wrong: {worst} by {errors[worst]:.1f} sigma"


def of_code(code: str) -> str:
    """The code, for the list of codes that have a test (`codes.py`)."""
    return code


def without(recording: Recording, rows: Any) -> Recording:
    """The recording without these rows."""
    keep = np.ones(len(recording), dtype=bool)
    keep[rows] = False
    return recording.rows(keep)
