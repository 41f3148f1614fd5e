"""What `--verbose` adds: each decision on the way to a result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from imucal.cli.output import Output
    from imucal.noise_analysis.noise import NoiseResult

__all__ = ["show_fit", "show_noise_fits", "show_ranking", "show_rests_and_moves"]

STAGES = {"accelerometer": "start, accelerometer", "gyroscope": "start, gyroscope", "joint": "joint fit"}


def show_fit(out: Output, fit: Mapping[str, Any]) -> None:
    """How rests were found in each recording, and how each fit came to its end."""
    for number, threshold in enumerate(fit.get("rest_thresholds", ()), start=1):
        out.line(
            f"recording {number}: at rest is where a window of {threshold['window_s']:.3g} s is below "
            f"{threshold['factor']:.3g} times the noise floor; from {threshold['stable_from']:.3g} to "
            f"{threshold['stable_to']:.3g} times the rests are the same"
        )
    for stage, name in STAGES.items():
        if stage in fit:
            report = fit[stage]
            out.line(
                f"{name}: {report['termination']} after {report['iterations']} iterations, chi2 "
                f"{report['chi2']:.4g} with {report['degrees_of_freedom']} degrees of freedom"
            )


def show_rests_and_moves(
    out: Output, rests: Sequence[Mapping[str, Any]], moves: Sequence[Mapping[str, Any]]
) -> None:
    """Every rest and every move: its residual, what noise leaves of it, and whether it is used."""
    out.table(
        ("rest", "from s", "to s", "|f| - g, m/s^2", "1 sigma", "use"),
        (
            (
                str(index),
                f"{rest['start_s']:.3f}",
                f"{rest['end_s']:.3f}",
                _number(rest["norm_error_mps2"], "+.2e"),
                _number(rest["norm_sigma_mps2"], ".2e"),
                _use(rest),
            )
            for index, rest in enumerate(rests)
        ),
    )
    out.table(
        ("move", "takes s", "direction, deg", "1 sigma", "use"),
        (
            (
                f"{move['from_rest']} to {move['to_rest']}",
                f"{move['duration_s']:.3f}",
                _number(move["direction_error_deg"], ".4f"),
                _number(move["direction_sigma_deg"], ".4f"),
                _use(move),
            )
            for move in moves
        ),
    )


def show_ranking(out: Output, ranking: Sequence[Mapping[str, Any]]) -> None:
    """Every effect that was looked for, with its evidence against the model without it."""
    out.table(
        ("looked for", "log Bayes factor", "chi2", "parameters", "p"),
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
    """What was fitted of each axis, and how well the kinds of noise describe it."""
    out.table(
        ("axis", "periods from s", "to s", "one count", "worst octave off by, sigma"),
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


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def _use(item: Mapping[str, Any]) -> str:
    return "used" if item["excluded"] is None else f"left out: {item['excluded']}"
