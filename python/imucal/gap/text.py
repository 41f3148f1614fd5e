"""Text of the result of a search for missing effects."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

from imucal.calibration.figures import FIGURE_TEXT
from imucal.estimation.result import CalibrationResult
from imucal.gap.fields import GapFields
from imucal.gap.remainder import SIGNIFICANT
from imucal.gap.sizes import for_people, p_text
from imucal.units import SHOWN

__all__ = ["explanation", "nothing_in_words", "sentences"]

# Code of a finding that the summary prints before the effects: the noise is below one count of the converter.
BEFORE_EFFECTS: Final = "noise_below_lsb"
# Names of the kinds of residuals for users.
KINDS: Final = {
    "rest_norm": "|f| - g at rest",
    "rest_rate": "rate at rest about",
    "rest_rate_x": "rate at rest about x",
    "rest_rate_y": "rate at rest about y",
    "rest_rate_z": "rate at rest about z",
    "move_direction": "direction after moves about",
    "move_force": "force during moves along",
    "stand_rest": "attitude at rest relative to the stand",
    "stand_move": "attitude in moves relative to the stand",
}
# Names of kinds of residuals in texts that do not state an axis. Kinds that are not listed have the name in
# `KINDS`.
WITHOUT_AXIS: Final = {"move_direction": "direction after moves", "move_force": "force during moves"}
# Residuals that an effect is expected to cause are printed if they exceed this multiple of their noise.
LEAST_TIMES_NOISE: Final = 0.05
# How texts name the variables that explain residuals, if these names differ from those in JSON documents.
EXPLAINED_BY: Final = {"gravity": "gravity direction"}
# Figures of merit on control or held-out data that texts state: name of the figure in texts, factor that
# converts the value to the unit in texts, and the unit in texts.
VERIFIED: Final = {
    "gravity_direction_rms_deg": (FIGURE_TEXT["gravity_direction_rms_deg"][0], 1.0, "deg"),
    "gravity_norm_rms_mps2": (FIGURE_TEXT["gravity_norm_rms_mps2"][0], *SHOWN["m/s^2"]),
}
# Maximum number of kinds of residuals that are printed.
MOST_CHANNELS: Final = 4
# An improvement factor is printed if the lower end of its 95 % interval is at least this value.
LEAST_IMPROVEMENT: Final = 1.05
# The summary states only one improvement, either of the figure of merit on control or held-out data, or of
# the kind of residual that improves most. Both improvements are measured in multiples of the noise. The
# figure of merit is chosen if its improvement exceeds this share of the improvement of the residual.
LEAST_SHARE_OF_CONTROL: Final = 0.1


def sentences(gap: GapFields) -> Iterator[str]:
    """The lines of the summary of a search for effects, in the order of the output.

    The first line is the verdict. The lines after it describe the effects, the residuals that they do not
    explain, and the recommended next motion. The last lines compare errors and residuals without and with the
    effects.
    """
    faults = ", ".join(str(effect["name"]) for effect in gap.effects) if gap.verdict == "data_fault" else ""
    yield f"verdict: {gap.verdict}{f' ({faults})' if faults else ''}"
    # The finding on coarse rounding is reported before the effects, because rounding may hide effects.
    yield from (finding.line for finding in gap.findings if finding.code == BEFORE_EFFECTS)
    if any(effect["parameters"] for effect in gap.effects):
        yield _finding(gap)
    if gap.verdict == "data_fault":
        yield "the data have faults that prevent conclusions about effects: fix them and record again"
    if gap.verdict == "nothing_missing":
        yield _none_of(list(gap.smallest_visible))
    yield from _laws(gap)
    yield from _remainder(gap)
    yield from where_in_words(gap)
    if gap.resembles:
        yield f"weakly resembles {', '.join(gap.resembles)}"
    if gap.ambiguous_with:
        yield f"equally plausible: {' or '.join(gap.ambiguous_with)}"
    if gap.next_motion is not None:
        yield f"next motion: {gap.next_motion['description']}"
    if gap.corrected_error is not None:
        rate, force = (
            gap.corrected_error[name] for name in ("angular_rate_rms_radps", "specific_force_rms_mps2")
        )
        yield (
            "predicted rms error of the corrected signals, averaged over 1 s: "
            f"rate {_change(rate, 'rad/s')}, specific force {_change(force, 'm/s^2')}"
        )
    if gap.gap is not None:
        figure = gap.gap
        where = "control recordings" if gap.control_set is not None else "held-out rests and moves"
        words, factor, unit = ("chi2 per degree of freedom", 1.0, "")
        if figure["metric"] != "chi2_per_dof":
            words, factor, unit = VERIFIED[figure["metric"].removeprefix("held_out_")]
        before, after, floor = (factor * figure[name] for name in ("before", "after", "floor"))
        refitted = (
            ""
            if figure.get("refitted") is None
            else f", {factor * figure['refitted']:.4g} refitted without effects"
        )
        yield (
            f"{where}: {words} {before:.4g} before{refitted}, {after:.4g} after, "
            f"noise floor {floor:.3g}{f' {unit} rms' if unit else ''}: "
            # If the figure of merit is worse with the effects, the closed share of the gap is negative. Such
            # a difference is within the scatter of the two values, because effects that make the prediction
            # significantly worse are rejected.
            + (
                "the difference is not significant"
                if figure["closed"] < 0
                else f"{min(100.0, 100 * figure['closed']):.0f} % of the gap closed"
            )
        )
    verified = gap.control_set or gap.held_out
    if verified is not None:
        before, after = verified["before"], verified["after"]
        known = [
            (words, factor * before[name], factor * after[name], unit)
            for name, (words, factor, unit) in VERIFIED.items()
            if before[name] is not None and after[name] is not None
        ]
        yield ", ".join(f"{words} {a:.3g} -> {b:.3g} {unit} rms" for words, a, b, unit in known)
    if gap.control_set is None and gap.held_out is not None:
        yield (
            "no control recording was given: these figures of merit are from cross-validation, in which "
            f"each of {gap.held_out['folds']} fits predicts rests and moves that it has not used"
        )
    if "after" in gap.fits:
        yield _remaining(gap.fits["after"])
    first = {finding.line for finding in gap.findings if finding.code == BEFORE_EFFECTS}
    yield from (note for note in gap.notes if note not in first)


def _laws(gap: GapFields) -> Iterator[str]:
    """A sentence on each law: formula, parameters, removed share of the excess chi2, and similar effects."""
    for law in gap.laws:
        values = ", ".join(map(_parameter_of_law, law.parameters))
        shares = [share for share in law.closed.values() if share is not None]
        closes = f"; closes {100 * min(max(shares), 1.0):.0f} % of the gap" if shares else ""
        similar = f"; similar to {', '.join(law.nearest)}" if law.nearest else ""
        yield f"law: {law.formula} with {values}{closes}{similar}"


def _parameter_of_law(parameter: Mapping[str, Any]) -> str:
    value, unit = for_people(parameter["value"], parameter["unit"])
    std, _ = for_people(parameter["std"] or 0.0, parameter["unit"])
    return f"{parameter['name']} = {value:.3g} ± {std:.1g} {unit}"


def _remainder(gap: GapFields) -> Iterator[str]:
    """Sentences on the residuals that the effects do not explain."""
    remainder = gap.remainder
    if remainder is None:
        return
    if remainder.kind == "nothing" and gap.has_effects:
        yield f"remainder: nothing; {nothing_in_words(gap, remainder.p_value)}"
    elif remainder.description is not None:
        prefix = f"remainder: {remainder.kind}: " if gap.has_effects else ""
        yield f"{prefix}{remainder.description}"


def nothing_in_words(gap: GapFields, p_value: float) -> str:
    """Text on the residuals of unseen data and their p-value, for a remainder of the kind `nothing`.

    If there are many residuals, they may exceed their noise significantly although their ratio to the noise
    is below two.
    """
    of = f"residuals of {'control recordings' if gap.control_set is not None else 'held-out rests and moves'}"
    if p_value >= SIGNIFICANT:
        return f"{of}: {p_text(p_value)}"
    words = f"{of} exceed their noise significantly ({p_text(p_value)})"
    fit = gap.fits.get("after")
    control = None if fit is None else fit.control
    compared = control or fit
    if compared is not None and any(own.exceeds_noise for own in compared.residuals):
        return words
    # Without control recordings, the residuals of the calibration recordings are compared with their noise.
    whose = "" if gap.control_set is not None else "those of the calibration recordings "
    return f"{words}, but {whose}by less than a factor of 2"


def _remaining(fit: CalibrationResult) -> str:
    """A sentence with the verdict on the calibration and the residuals that still exceed their noise."""
    of = "with the effects" if fit.calibration.effects else "without effects"
    sets = {"calibration set": fit.residuals, "control set": fit.control.residuals if fit.control else ()}
    remaining = [
        f"{name}: {', '.join(own.text for own in residuals if own.exceeds_noise)}"
        for name, residuals in sets.items()
        if any(own.exceeds_noise for own in residuals)
    ]
    above = f"; residuals still exceed their noise: {'; '.join(remaining)}" if remaining else ""
    return f"calibration {of}: {fit.verdict}{above}"


def _none_of(names: Sequence[str]) -> str:
    """A sentence for the case that no effect was found; `names` are the observable effects."""
    if not names:
        return "none of the tested effects is observable in these recordings"
    if len(names) == 1:
        return f"{names[0]} is not present above its detection limit"
    return f"none of {len(names)} effects is present above its detection limit"


def _finding(gap: GapFields) -> str:
    """A sentence with the found effects, their sizes, and the improvement of the residuals."""
    names = " and ".join(f"{e['name']} ({_size(e)})" for e in gap.effects)
    explain = "explains" if len(gap.effects) == 1 else "explain"
    verified, set_name = (
        (gap.control_set, "control") if gap.control_set is not None else (gap.held_out, "held-out")
    )
    figure = _by_the_effects(gap.gap)
    row = max(gap.where["channels"], key=_drop) if gap.where else None
    # Effects that act during moves or on the stand hardly improve the figures of merit on control data. The
    # improvement of a kind of residual is then printed instead.
    if (
        figure is not None
        and verified is not None
        and figure["before"] > 1.1 * figure["floor"]
        and figure["closed"] > 0.1
        and (row is None or _times_noise_less(figure) > LEAST_SHARE_OF_CONTROL * _drop(row))
    ):
        before, after = verified["before"], verified["after"]
        name = max(VERIFIED, key=lambda each: _ratio(before, after, each))
        words, factor, unit = VERIFIED[name]
        closed = min(100.0, 100 * figure["closed"])
        change = f"{factor * before[name]:.2g} -> {factor * after[name]:.2g} {unit} rms"
        return f"{names} {explain} {closed:.0f} % of the gap; {set_name} {words}: {change}"
    # If the residuals with the effects are not known, the sentence does not claim an improvement.
    if row is None or row["times_noise_after"] is None:
        return f"{names} {'is' if len(gap.effects) == 1 else 'are'} part of the model"
    excess, left = (max(0.0, row[name] ** 2 - 1.0) for name in ("times_noise", "times_noise_after"))
    share = f"{100 * (1.0 - left / excess):.0f} % of" if excess > left else "hardly any of"
    return (
        f"{names} {explain} {share} the excess of {_channel(row)} over noise: "
        f"{row['times_noise']:.3g} -> {row['times_noise_after']:.2g} x noise"
    )


def _by_the_effects(figure: Mapping[str, Any] | None) -> Mapping[str, Any] | None:
    """`figure` with the value of the fit without effects as `before`, even if a calibration was given."""
    if figure is None or figure.get("refitted") is None:
        return figure
    before, after, floor = figure["refitted"], figure["after"], figure["floor"]
    closed = (before - after) / (before - floor) if before > floor else 0.0
    return {**figure, "before": before, "closed": closed}


def _ratio(before: Mapping[str, Any], after: Mapping[str, Any], name: str) -> float:
    if not before[name] or not after[name]:
        return 0.0
    return float(before[name] / after[name])


def _times_noise_less(figure: Mapping[str, Any]) -> float:
    """Decrease of the figure of merit from `before` to `after`, in multiples of `floor`, its noise."""
    power = 0.5 if figure["metric"] == "chi2_per_dof" else 1.0
    before, after = ((figure[name] / max(figure["floor"], 1e-300)) ** power for name in ("before", "after"))
    return float(before - after)


def _drop(row: Mapping[str, Any]) -> float:
    after = row["times_noise_after"]
    return 0.0 if after is None else float(row["times_noise"] - after)


def _size(effect: Mapping[str, Any]) -> str:
    """Text on the largest parameter of an effect, such as "largest parameter 0.12 ± 0.01 mg"."""
    units = {p["unit"] for p in effect["parameters"]}
    # Time constants are left out, because a time constant is not the size of an effect.
    sizes = [p for p in effect["parameters"] if p["unit"] != "s" or units == {"s"}]
    largest = max(sizes, key=lambda p: abs(p["value"]))
    value, unit = for_people(abs(largest["value"]), largest["unit"])
    if not largest["std"]:
        return f"largest parameter {value:.3g} {unit}"
    factor = value / abs(largest["value"]) if largest["value"] else 1.0
    return f"largest parameter {value:.3g} ± {factor * largest['std']:.1g} {unit}"


def _change(change: Mapping[str, float], unit: str) -> str:
    (before, name), (after, _) = for_people(change["before"], unit), for_people(change["after"], unit)
    words = f"{before:.2g} -> {after:.2g} {name}"
    # The improvement factor is omitted if the improvement is not significant.
    if change["factor_low"] < LEAST_IMPROVEMENT:
        return words
    return f"{words} (by a factor of {change['factor_low']:.2g} to {change['factor_high']:.2g})"


def where_in_words(gap: GapFields) -> Iterator[str]:
    """Lines on the significant residuals, the largest first, with the variables that explain them."""
    if not gap.where:
        return
    rows = [row for row in gap.where["channels"] if row["stands_out"]]
    if not rows:
        yield "residuals: noise explains all kinds of residuals of the calibration recordings"
    for row in sorted(rows, key=lambda row: -row["times_noise"])[:MOST_CHANNELS]:
        rms, unit = for_people(row["rms"], row["unit"])
        explained = next(
            (
                f", {EXPLAINED_BY.get(d['on'], d['on'].replace('_', ' '))} explains "
                f"{100 * d['share']:.0f} % of the variance"
                for d in gap.where["depends"]
                if (d["channel"], d["axis"]) == (row["channel"], row["axis"])
            ),
            "",
        )
        after = (
            ""
            if row["times_noise_after"] is None or not gap.has_effects
            else f" ({row['times_noise_after']:.2g} x with the effects)"
        )
        times = f"{row['times_noise']:.3g} x noise{after}"
        yield f"residuals: {_channel(row)}: {rms:.3g} {unit} rms, {times}{explained}"
    if len(rows) > MOST_CHANNELS:
        yield f"residuals: {len(rows) - MOST_CHANNELS} more kinds are significant, see --report"
    for kind in ("rest", "move"):
        items = gap.where[f"{kind}s"]
        if items:
            worst = max(items, key=lambda item: item["times_noise"])
            about = gap.where["turns_about"] if kind == "move" else None
            count = f"1 {kind} has a" if len(items) == 1 else f"{len(items)} {kind}s have a"
            yield (
                f"residuals: {count} significant "
                f"residual{f', all rotations about {about}' if about else ''}; worst: {kind} "
                f"{worst['index']} of {worst['recording']} ({worst['times_noise']:.3g} x noise)"
            )


def _channel(row: Mapping[str, Any]) -> str:
    return f"{KINDS[row['channel']]} {row['axis'] or ''}".strip()


def explanation(gap: GapFields, name: str) -> Iterator[str]:
    """Lines on one effect: formula, predicted residuals, detection limit, and result in these recordings."""
    from imucal.effects.effect import Effect
    from imucal.effects.table import find

    own = next((effect for effect in gap.user_effects if effect.name == name), None)
    effect = own or find(name)
    sizes = dict.fromkeys("{:.2g} {}".format(*for_people(p.typical, p.unit)) for p in effect.parameters)
    if isinstance(effect, Effect):
        yield f"{name} ({effect.sensor}): {effect.formula}"
        yield f"typical size {', '.join(sizes)}; observable in: {effect.observable}"
    else:
        yield f"{name} ({effect.sensor}): a user-defined effect, typical size {', '.join(sizes)}"
    missing = next((item for item in gap.not_observable if item["name"] == name), None)
    trace = gap.traces.get(name)
    if trace is not None and missing is None:
        kinds = sorted(trace["times_noise"].items(), key=lambda kind: -kind[1])
        seen = [
            f"{WITHOUT_AXIS.get(kind, KINDS[kind])} {times:.2g} x noise"
            for kind, times in kinds
            if times > LEAST_TIMES_NOISE
        ]
        yield (
            f"expected residuals at this size: {', '.join(seen[:MOST_CHANNELS]) or 'negligible'}; "
            f"the 21 parameters absorb {100 * trace['taken_up']:.0f} % of their variance"
        )
    if missing is not None:
        yield f"not observable in these recordings: it needs {missing['needs']}; its size is unknown"
    if name in gap.smallest_visible:
        size = gap.smallest_visible[name]
        value, unit = for_people(size["value"], size["unit"])
        yield (
            f"detection limit in these recordings: {value:.2g} {unit} rms per parameter; an effect of this "
            f"size is named, possibly with similar effects, with a probability of about "
            f"{100 * size['chance']:.0f} %"
        )
    added = next((e for e in gap.effects if e["name"] == name and e["parameters"]), None)
    score = next((score for score in gap.ranking if score["name"] == name), None)
    if added is not None:
        yield f"result: added to the model, {_size(added)}, {_evidence(added)}"
    elif score is not None:
        yield (
            "result: not added to the model; as the only effect, compared with the model without effects: "
            f"{_evidence(score)}"
        )
    for alias in effect.aliases if isinstance(effect, Effect) else ():
        yield f"similar to {alias.name}; distinguished by {alias.told_apart_by}"


def _evidence(score: Mapping[str, Any]) -> str:
    return (
        f"log Bayes factor {score['log_bayes_factor']:.1f}, chi2 {score['statistic']:.1f} with "
        f"{score['dof']} degrees of freedom, {p_text(score['p_value'])}"
    )
