"""Checks of three sections of a calibration file: figures of merit, report on the fits, and origin."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import fields
from datetime import datetime
from typing import Any, Final

import numpy as np

import imucal._core as _core
from imucal.arrays import FloatArray
from imucal.calibration.figures import Figures
from imucal.document.agreement import agree
from imucal.document.json_document import Node
from imucal.errors import FormatError

__all__ = ["require_date", "require_figures", "require_fit", "require_sha256", "require_version"]

AGAIN: Final = "correct one of them, or calibrate again"
# Largest accepted figures of merit by name. The limits are a residual as large as gravity, an angle of half a
# revolution, and the chi2 of residuals that are a million times as large as the noise.
LARGEST: Final = {"gravity_norm_rms_mps2": 9.9, "gravity_direction_rms_deg": 180.0, "chi2_per_dof": 1e12}
COUNTS: Final = ("rests", "moves")
FITS: Final = ("accelerometer", "gyroscope", "joint")
# Groups of fields of the section `fit`. If one field of a group occurs, all fields of the group must occur.
# A calibration that was estimated from recordings has the fields of the first group. A calibration from a
# joint fit also has the fields of the second group.
TOGETHER: Final = (
    ("accelerometer", "gyroscope", "rest_thresholds"),
    ("joint", "noise_alone", "bias_instability_radps", "tremor_deg", "effects"),
)
SCALES: Final = ("norms", "moves", "inside", "stand")
# Number of noise floors of a recording: one per axis of both sensors. A noise floor is the standard deviation
# of a sample at rest.
NOISE_FLOORS: Final = 6
MODELS: Final = ("full", "orthogonal", "bias")
PRIOR_SOURCES: Final = ("given", "unit", "default")
TERMINATIONS: Final = (
    "converged",
    "stalled",
    "iteration_limit",
    "not_finite",
    "weights_not_settled",
    "fields_not_settled",
)
# A version of Python packages (PEP 440) or of Rust crates.
VERSION: Final = (
    r"[0-9]+(\.[0-9]+)*((a|b|rc)[0-9]+)?(\.post[0-9]+)?(\.dev[0-9]+)?(-[0-9A-Za-z.]+)?(\+[0-9A-Za-z.]+)?"
)
# Accepted difference between a p-value in the file and the p-value that follows from its chi2, because
# numbers in the file may be rounded. The test statistic of an effect is recomputed only if the condition
# number of the correlation matrix is at most 1 / STATISTIC_ROUNDING, because a larger condition number
# amplifies the rounding too much.
STATISTIC_ROUNDING: Final = 1e-4


def require_figures(node: Node) -> dict[str, Any] | None:
    """The figures of merit on a set of recordings. FormatError if one is missing, unknown or impossible."""
    if node.value is None:
        return None
    known = [field.name for field in fields(Figures)]
    for name in node.mapping():
        if name not in known:
            raise FormatError(f"{node.file}: {node.path}.{name} is no figure: there are {', '.join(known)}")
    for name in known:
        figure = node.get(name)
        if name in COUNTS:
            figure.whole()
        elif figure.value is not None:
            _require_range(figure, 0.0, LARGEST.get(name, np.inf))
    return node.mapping()


def require_fit(
    node: Node,
    effects: Mapping[str, Mapping[str, float]],
    names: Sequence[str],
    covariance: FloatArray | None,
) -> None:
    """Raise FormatError if a number of the section `fit` contradicts another number or the covariance.

    effects             {effect name: {full parameter name: value}} for the linear parameters, which are all
                        parameters except time constants
    names, covariance   the covariance, and the names of its parameters
    """
    fit = node.mapping()
    for group in TOGETHER:
        if any(name in fit for name in group):
            for name in group:
                node.get(name)
    for name in FITS:
        if fit.get(name) is not None:
            _require_report(node.get(name))
            if name == "joint":
                _require_scales(node.get(name))
    if fit.get("noise_alone") is not None:
        _require_p_value(node.get("noise_alone"))
    if "priors" in fit:
        _require_priors(node.get("priors"), names)
    if "effects" in fit:
        tested = [item.get("name").text() for item in node.get("effects").items()]
        if sorted(tested) != sorted(effects):
            raise FormatError(
                f"{node.file}: {node.path}.effects is of {', '.join(tested) or 'no effect'}, but $.effects "
                f"has {', '.join(effects) or 'none'}: {AGAIN}"
            )
        for item in node.get("effects").items():
            _require_statistic(item, effects, names, covariance)
    if "tremor_deg" in fit and "rest_thresholds" in fit:
        counts = [len(node.get(name).items()) for name in ("tremor_deg", "rest_thresholds")]
        if counts[0] != counts[1]:
            raise FormatError(
                f"{node.file}: {node.path}.tremor_deg has {counts[0]} items, but {node.path}.rest_thresholds "
                f"has {counts[1]}: both need one item per recording: {AGAIN}"
            )
    for name in ("tremor_deg", "bias_instability_radps"):
        for item in node.get(name).items() if isinstance(fit.get(name), list) else ():
            if item.value is not None:
                _require_range(item, 0.0, np.inf)
    for item in node.get("rest_thresholds").items() if "rest_thresholds" in fit else ():
        _require_threshold(item)


def _require_report(node: Node) -> None:
    """Raise FormatError if the report of one fit contains an impossible value."""
    for name in ("degrees_of_freedom", "iterations"):
        node.get(name).whole()
    node.get("termination").text(TERMINATIONS)
    for name, low in (("chi2", 0.0), ("inflation", 1.0)):
        if node.get(name).value is not None:
            _require_range(node.get(name), low, np.inf)


def _require_scales(node: Node) -> None:
    """Raise FormatError if the report of the joint fit contains contradictory inflation factors.

    `scales` has one factor per kind of residual, and `inflation` must be the largest of them.
    """
    scales = node.get("scales")
    known = [scales.get(name) for name in SCALES if scales.get(name).value is not None]
    for scale in known:
        _require_range(scale, 1.0, np.inf)
    largest = max((scale.number() for scale in known), default=1.0)
    if node.get("inflation").value is not None and not agree(node.get("inflation").number(), largest):
        raise FormatError(
            f"{node.file}: {node.path}.inflation is {node.get('inflation').value}, but the largest of "
            f"{scales.path} is {largest}: {AGAIN}"
        )


def _require_priors(node: Node, names: Sequence[str]) -> None:
    """Raise FormatError if the report on the parameters with a prior contains an impossible value."""
    node.get("model").text(MODELS)
    for held in node.get("held").items():
        for name in ("name", "unit"):
            held.get(name).text()
        held.get("prior_source").text(PRIOR_SOURCES)
        for name in ("prior_value", "estimate"):
            held.get(name).number()
        for name in ("prior_sigma", "sigma"):
            _require_range(held.get(name), 0.0, np.inf)
        _require_range(held.get("prior_share"), 0.0, 1.0)
        if held.get("contradiction").value is not None:
            held.get("contradiction").number()
    shares = node.get("shares")
    found = [item.get("name").text() for item in shares.items()]
    if names and found != list(names):
        raise FormatError(
            f"{node.file}: {shares.path} has other parameters than $.covariance: both have all of them in "
            f"one order: {AGAIN}"
        )
    for item in shares.items():
        _require_range(item.get("share"), 0.0, 1.0)
    _require_range(node.get("gravity_direction_deg"), 0.0, np.inf)
    # The field is null for an accelerometer alone, which does not measure rotations.
    if node.get("rotation_deg").value is not None:
        _require_range(node.get("rotation_deg"), 0.0, np.inf)


def _require_p_value(node: Node) -> None:
    chi2, p_value = node.get("chi2"), node.get("p_value")
    dof = node.get("degrees_of_freedom")
    if chi2.value is p_value.value is dof.value is None:
        return
    _require_range(chi2, 0.0, np.inf)
    expected = _core.chi2_p_value(chi2.number(), dof.whole()) if dof.whole() else 1.0
    if not agree(_require_range(p_value, 0.0, 1.0), expected, absolute=STATISTIC_ROUNDING):
        raise FormatError(
            f"{node.file}: {p_value.path} is {p_value.value}, but {chi2.path} of {chi2.value} with "
            f"{dof.path} of {dof.value} gives {expected:.6g}: {AGAIN}"
        )


def _require_statistic(
    node: Node,
    effects: Mapping[str, Mapping[str, float]],
    names: Sequence[str],
    covariance: FloatArray | None,
) -> None:
    """Raise FormatError if the test statistic of an effect contradicts the effect's values and covariance."""
    name, statistic = node.get("name").text(), node.get("statistic")
    dof, own = node.get("dof").whole(), effects.get(name, {})
    if len(own) != dof:
        raise FormatError(
            f"{node.file}: {node.path} is of {name} with {dof} parameters, but $.effects has {len(own)} of "
            f"them: {AGAIN}"
        )
    _require_range(statistic, 0.0, np.inf)
    if covariance is None or not own.keys() <= set(names):
        return
    rows = [names.index(full) for full in own]
    block, numbers = covariance[np.ix_(rows, rows)], np.array(list(own.values()))
    sigma = np.sqrt(np.diag(block))
    if not (sigma > 0).all():
        return
    correlation = block / sigma[:, None] / sigma
    if np.linalg.cond(correlation) > 1.0 / STATISTIC_ROUNDING:
        return
    scaled = numbers / sigma
    expected = float(scaled @ np.linalg.solve(correlation, scaled))
    if not agree(statistic.number(), expected, relative=1e-2, absolute=1e-2):
        raise FormatError(
            f"{node.file}: {statistic.path} is {statistic.value}, but the values and the covariance of "
            f"{name} give {expected:.6g}: {AGAIN}"
        )


def _require_threshold(node: Node) -> None:
    """Raise FormatError unless the threshold of the rest detection is from `stable_from` to `stable_to`.

    All thresholds in this range give the same number of rests.
    """
    numbers = {}
    for name in ("factor", "stable_from", "stable_to", "window_s"):
        item = node.get(name)
        numbers[name] = None if item.value is None else _require_range(item, 0.0, np.inf)
    floors = node.get("noise_floor").items()
    if len(floors) != NOISE_FLOORS:
        raise FormatError(
            f"{node.file}: {node.path}.noise_floor has {len(floors)} items, but there are {NOISE_FLOORS} "
            "axes of gyroscope and accelerometer: calibrate again"
        )
    for item in floors:
        if item.value is not None:
            _require_range(item, 0.0, np.inf)
    factor, low, high = numbers["factor"], numbers["stable_from"], numbers["stable_to"]
    if low is not None and high is not None and low > high:
        raise FormatError(
            f"{node.file}: {node.path}.stable_from is {low}, but {node.path}.stable_to is {high}: {AGAIN}"
        )
    if None not in (factor, low, high) and not low <= factor <= high:  # type: ignore[operator]
        raise FormatError(
            f"{node.file}: {node.path}.factor is {factor}, outside {node.path}.stable_from and stable_to, "
            f"{low} to {high}: {AGAIN}"
        )


def _require_range(node: Node, low: float, high: float) -> float:
    number = node.number()
    if not low <= number <= high:
        limits = f"{low:g} or more" if high == np.inf else f"{low:g} to {high:g}"
        raise FormatError(
            f"{node.file}: {node.path} is {node.value}, but it can only be {limits}: correct it, or "
            "calibrate again"
        )
    return number


def require_sha256(node: Node) -> str:
    """Read a SHA-256 of 64 hexadecimal digits. Raises FormatError for any other text."""
    text = node.text()
    if not re.fullmatch("[0-9a-f]{64}", text):
        raise FormatError(
            f"{node.file}: {node.path} is {text!r}, but a SHA-256 has 64 digits 0 to 9 and a to f: calibrate "
            "again"
        )
    return text


def require_date(node: Node) -> str:
    """A date in ISO 8601 form, or an empty text for an unknown date. Raises FormatError for other texts."""
    text = node.text()
    try:
        # Python 3.10 does not parse Z for UTC.
        if text and datetime.fromisoformat(re.sub("Z$", "+00:00", text)).year < 1980:
            raise ValueError(text)
    except ValueError:
        raise FormatError(
            f"{node.file}: {node.path} is {text!r}: give a date such as 2026-02-03T04:05:06+00:00"
        ) from None
    return text


def require_version(node: Node) -> str:
    """A version number, or an empty text for an unknown version. Raises FormatError for other texts."""
    text = node.text()
    if text and not re.fullmatch(VERSION, text):
        raise FormatError(
            f"{node.file}: {node.path} is {text!r}: give a version such as 0.1.0, or an empty text"
        )
    return text
