"""The finding of a search in sentences."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from imucal.gap import Gap

__all__ = ["explanation", "sentences"]


def sentences(gap: Gap) -> Iterator[str]:
    """The verdict, what explains the gap, what is left, and what to do next."""
    yield f"verdict: {gap.verdict}"
    for effect in gap.effects:
        if effect["parameters"]:
            yield _named(effect)
    if gap.verdict == "data_fault":
        yield "faults of the data explain a disagreement before any effect does: mend them and record again"
    if gap.verdict == "nothing_missing":
        yield f"none of {len(gap.smallest_visible)} effects is there at a size that these recordings show"
    if gap.generic is not None:
        yield gap.generic["description"]
    if gap.resembles:
        yield f"not in the catalogue; it looks a little like {', '.join(gap.resembles)}"
    if gap.ambiguous_with:
        yield f"it may as well be {' or '.join(gap.ambiguous_with)}"
    if gap.next_motion is not None:
        yield f"next: {gap.next_motion['description']}"
    if gap.gap is not None:
        figure = gap.gap
        where = "control recordings" if gap.control_set is not None else "moves held out"
        yield (
            f"{where}: {figure['metric']} {figure['before']:.4g} before, {figure['after']:.4g} after, "
            f"floor {figure['floor']:.3g}: {100 * figure['closed']:.0f} % of the gap closed"
        )
    if gap.control_set is not None:
        before, after = gap.control_set["before"], gap.control_set["after"]
        yield (
            f"gravity direction per move {before['gravity_direction_rms_deg']:.3g} -> "
            f"{after['gravity_direction_rms_deg']:.3g} deg rms, |f| - g "
            f"{before['gravity_norm_rms_mps2']:.3g} -> {after['gravity_norm_rms_mps2']:.3g} m/s^2 rms"
        )
    yield from gap.notes


def _named(effect: Mapping[str, Any]) -> str:
    largest = max(effect["parameters"], key=lambda p: abs(p["value"]))
    std = "" if largest["std"] is None else f" +- {largest['std']:.1g}"
    return (
        f"{effect['name']}: at most {abs(largest['value']):.3g}{std} {largest['unit']} ({largest['name']}), "
        f"log Bayes factor {effect['log_bayes_factor']:.1f}, chi2 {effect['statistic']:.0f} with "
        f"{effect['dof']} degrees of freedom"
    )


def explanation(gap: Gap, name: str) -> Iterator[str]:
    """What an effect is, and what these recordings show or could have shown of it."""
    from imucal.effects import find

    effect = find(name)
    units = ", ".join(dict.fromkeys(p.unit for p in effect.parameters))
    typical = effect.parameters[0].typical
    yield f"{name} ({effect.sensor}): {effect.formula}; parameters in {units}, typically {typical:.2g}"
    yield f"it is seen in {effect.observable}"
    scored = {score["name"]: score for score in gap.ranking}
    if name in scored:
        score = scored[name]
        yield (
            f"here: log Bayes factor {score['log_bayes_factor']:.1f}, chi2 {score['statistic']:.1f} with "
            f"{score['dof']} degrees of freedom, p {score['p_value']:.2g}"
        )
    if name in gap.smallest_visible:
        size = gap.smallest_visible[name]
        yield f"it would have been seen from {size['value']:.2g} {size['unit']} rms per parameter on"
    for item in gap.not_observable:
        if item["name"] == name:
            yield f"these recordings cannot show it: it needs {item['needs']}"
