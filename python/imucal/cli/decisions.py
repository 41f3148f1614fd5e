"""Output of `--verbose`: rest detection, convergence, residuals, and ranking of candidate effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from imucal.cli.output import Output
    from imucal.estimation.fit import Fit
    from imucal.estimation.rests import Move, Rest
    from imucal.noise_analysis.noise import NoiseResult

__all__ = ["show_fit", "show_noise_fits", "show_ranking", "show_rests_and_moves"]

STAGES = {"accelerometer": "start, accelerometer", "gyroscope": "start, gyroscope", "joint": "joint fit"}


def show_fit(out: Output, fit: Fit) -> None:
    """Print the threshold of the rest detection for each recording, and how each fit ended."""
    for number, threshold in enumerate(fit.rest_thresholds, start=1):
        out.line(
            f"recording {number}: rests are windows of {threshold.window_s:.3g} s with a variance below "
            f"{threshold.factor:.3g} times the noise variance; factors from {threshold.stable_from:.3g} "
            f"to {threshold.stable_to:.3g} give the same rests"
        )
    for stage, name in STAGES.items():
        report = getattr(fit, stage)
        if report is not None:
            out.line(
                f"{name}: {report.termination} after {report.iterations} iterations, chi2 "
                f"{report.chi2:.4g} with {report.degrees_of_freedom} degrees of freedom"
            )


def show_rests_and_moves(out: Output, rests: Sequence[Rest], moves: Sequence[Move]) -> None:
    """Print tables of rests and of moves: residual with standard deviation, and use in the fit."""
    are_long = any(rest.epochs > 1 for rest in rests)
    scale = out.scale("norm_error", "m/s^2")
    out.table(
        (
            "rest",
            "from s",
            "to s",
            *(["epochs"] if are_long else []),
            f"|f| - g, {scale.unit}",
            "1 sigma",
            "use",
        ),
        (
            (
                str(index),
                _number(rest.start_s, ".3f"),
                _number(rest.end_s, ".3f"),
                *([str(rest.epochs)] if are_long else []),
                _number(rest.norm_error_mps2, "+.3g", scale.factor),
                _number(rest.norm_sigma_mps2, ".3g", scale.factor),
                _use(rest),
            )
            for index, rest in enumerate(rests)
        ),
    )
    out.table(
        ("move", "duration s", "direction, deg", "1 sigma", "use"),
        (
            (
                f"{move.from_rest} to {move.to_rest}",
                f"{move.duration_s:.3f}",
                _number(move.direction_error_deg, ".4f"),
                _number(move.direction_sigma_deg, ".4f"),
                _use(move),
            )
            for move in moves
        ),
    )


def show_ranking(out: Output, ranking: Sequence[Mapping[str, Any]]) -> None:
    """Print each candidate effect with the log Bayes factor of the models with and without the effect."""
    out.table(
        ("candidate", "log Bayes factor", "chi2", "parameters", "p"),
        (
            (
                score["name"],
                f"{score['log_bayes_factor']:.1f}",
                f"{score['statistic']:.4g}",
                str(score["dof"]),
                f"{score['p_value']:.2g}",
            )
            for score in ranking
        ),
    )


def show_noise_fits(out: Output, found: NoiseResult) -> None:
    """Print, for each axis, the range of periods used in the noise fit, and the misfit of the noise model."""
    out.table(
        ("axis", "periods from s", "to s", "one count", "largest deviation of an octave, sigma"),
        (
            (
                name,
                f"{axis.shortest_period_s:.3g}",
                f"{found.end_s - found.start_s:.4g}",
                f"{axis.lsb:.3g}",
                f"{axis.misfit:.1f}",
            )
            for name, axis in found.axes.items()
        ),
    )


def _number(value: float | None, form: str, factor: float = 1.0) -> str:
    return "-" if value is None else format(factor * value, form)


def _use(item: Rest | Move) -> str:
    return "used" if item.excluded is None else f"excluded: {item.excluded}"
