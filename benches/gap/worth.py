"""What the tool claims that its correction is worth, beside the truth of the simulated control run.

Slow errors: means over 1 s of corrected rate and force less what the unit truly underwent, rms over the run.
"""

from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np

import imucal
from gap.rates import Rate
from gap.scene import RATE_HZ
from gap.sizes import SIZES

RATE, FORCE = "angular_rate_rms_radps", "specific_force_rms_mps2"
# Claimed and true are near each other within this factor.
NEAR: Final = 1.1
LEVELS: Final = ("5x", "10x")

# By signal: what was claimed, and true_before and true_after.
Worth = dict[str, dict[str, float]]


def worth(gap: Any, control: imucal.Recording, truth: imucal.Truth) -> Worth:
    """Claimed and true errors of the corrected control recording; empty if nothing is claimed."""
    if gap is None or gap.corrected_error is None:
        return {}
    before, after = (
        _slow_errors(calibration.apply_recording(control), truth)
        for calibration in (gap.fits["before"].calibration, gap.calibration)
    )
    return {
        signal: {**claimed, "true_before": before[signal], "true_after": after[signal]}
        for signal, claimed in gap.corrected_error.items()
    }


def _slow_errors(recording: imucal.Recording, truth: imucal.Truth) -> dict[str, float]:
    width = round(RATE_HZ)

    def rms(corrected: np.ndarray, true: np.ndarray) -> float:
        errors = (corrected - true)[: len(true) // width * width]
        return float(np.sqrt(np.mean(errors.reshape(-1, width, 3).mean(axis=1) ** 2)))

    return {
        RATE: rms(recording.angular_rate, truth.angular_rate),
        FORCE: rms(recording.specific_force, truth.specific_force),
    }


def own_signal(name: str) -> str | None:
    """The signal that an effect disturbs; None for those of the stand, which is not corrected."""
    sensor = imucal.effects.find(name).sensor
    return {"gyroscope": RATE, "accelerometer": FORCE}.get(sensor)


def judged(marks: Sequence[Any], is_own: bool = True) -> Iterator[tuple[str, dict[str, float]]]:
    """Claims about the signal that the hidden effect disturbs, or about others: effect and figures."""
    for mark in marks:
        if mark.group == "single" and mark.level in LEVELS:
            for signal, figures in mark.worth.items():
                if (signal == own_signal(mark.label)) == is_own:
                    yield mark.label, figures


def ratio(figures: dict[str, float]) -> float:
    """Claimed factor over the true one."""
    return figures["factor"] * figures["true_after"] / figures["true_before"]


def is_near(figures: dict[str, float]) -> bool:
    return 1.0 / NEAR <= ratio(figures) <= NEAR


def is_held(figures: dict[str, float]) -> bool:
    """Whether the interval holds the true factor."""
    true = figures["true_before"] / figures["true_after"]
    return figures["factor_low"] <= true <= figures["factor_high"]


def rows(marks: Sequence[Any]) -> list[tuple[object, ...]]:
    """Effect by effect, and what is claimed of signals that no effect disturbs."""
    own, others = list(judged(marks)), [figures for _, figures in judged(marks, is_own=False)]
    of = [
        (f"`{name}`", [figures for label, figures in own if label == name])
        for name in SIZES
        if own_signal(name)
    ]
    of += [("all of these", [figures for _, figures in own]), ("signals without an effect", others)]
    return [(name, *_row(figures)) for name, figures in of if figures]


def _row(of: Sequence[dict[str, float]]) -> tuple[object, ...]:
    ratios = np.array([ratio(figures) for figures in of])
    low, high = np.quantile(ratios, (0.05, 0.95))
    errors = " → ".join(
        f"{np.median([figures[name] for figures in of]):.2g}" for name in ("true_before", "true_after")
    )
    true = np.median([figures["true_before"] / figures["true_after"] for figures in of])
    near, held = Rate.count(map(is_near, of)), Rate.count(map(is_held, of))
    return (
        len(of),
        errors,
        f"{true:.2f}",
        f"{np.median(ratios):.3f}",
        f"{low:.2f} to {high:.2f}",
        f"{near.hits}/{near.of}",
        f"{held.hits}/{held.of}",
    )
