"""The finding of a search in sentences."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from imucal.units import SHOWN

if TYPE_CHECKING:
    from imucal.gap.result import Gap

__all__ = ["explanation", "for_people", "sentences"]

# Delays are shorter than this, time constants longer.
DELAY_S: Final = 0.1
KINDS: Final = {
    "rest_norm": "length of gravity at rest",
    "rest_rate": "rate at rest about",
    "rest_rate_x": "rate at rest about x",
    "rest_rate_y": "rate at rest about y",
    "rest_rate_z": "rate at rest about z",
    "move_direction": "direction after moves about",
    "move_force": "force in moves along",
    "stand_rest": "attitude at rest against the stand",
    "stand_move": "attitude in moves against the stand",
}
SEEN_AS: Final = {"move_direction": "direction after moves", "move_force": "force in moves"}
# Fewer times noise than this are not worth a word.
WORTH_SAYING: Final = 0.05
MOST_CHANNELS: Final = 4
WORTH_CLAIMING: Final = 1.05
# Unseen rests and moves lead the finding if they gain this share of what the residuals that gain most do.
WORTH_LEADING: Final = 0.1


def for_people(value: float, unit: str) -> tuple[float, str]:
    """A number in the unit that people read, and that unit."""
    if unit == "s":
        return (1e3 * value, "ms") if abs(value) < DELAY_S else (value, "s")
    factor, name = SHOWN.get(unit, (1.0, unit))
    return factor * value, name


def sentences(gap: Gap) -> Iterator[str]:
    """The verdict, what explains the gap, what is left, and what to do next."""
    yield f"verdict: {gap.verdict}"
    if any(effect["parameters"] for effect in gap.effects):
        yield _finding(gap)
    if gap.verdict == "data_fault":
        yield "faults of the data come before any effect: mend them and record again"
    if gap.verdict == "nothing_missing":
        yield _none_of(list(gap.smallest_visible))
    if gap.generic is not None:
        yield gap.generic["description"]
    yield from where_in_words(gap)
    if gap.resembles:
        yield f"it looks a little like {', '.join(gap.resembles)}"
    if gap.ambiguous_with:
        yield f"it may as well be {' or '.join(gap.ambiguous_with)}"
    if gap.next_motion is not None:
        yield f"next: {gap.next_motion['description']}"
    if gap.corrected_error is not None:
        rate, force = (
            gap.corrected_error[name] for name in ("angular_rate_rms_radps", "specific_force_rms_mps2")
        )
        yield (
            f"corrected rate {_change(rate, 'rad/s')}, specific force {_change(force, 'm/s^2')}: "
            "predicted rms error, averaged over 1 s"
        )
    if gap.gap is not None:
        figure = gap.gap
        where = "control recordings" if gap.control_set is not None else "rests and moves held out"
        refitted = (
            "" if figure.get("refitted") is None else f", {figure['refitted']:.4g} refitted without effects"
        )
        yield (
            f"{where}: {figure['metric']} {figure['before']:.4g} before{refitted}, "
            f"{figure['after']:.4g} after, floor {figure['floor']:.3g}: "
            # What adds so little that chance makes up for it is not judged by these figures.
            + (
                "no more than chance between them"
                if figure["closed"] < 0
                else f"{min(100.0, 100 * figure['closed']):.0f} % of the gap closed"
            )
        )
    unseen = gap.control_set or gap.held_out
    if unseen is not None:
        before, after = unseen["before"], unseen["after"]
        known = [
            (words, before[name], after[name], unit)
            for words, name, unit in (
                ("gravity direction per move", "gravity_direction_rms_deg", "deg"),
                ("|f| - g", "gravity_norm_rms_mps2", "m/s^2"),
            )
            if before[name] is not None and after[name] is not None
        ]
        yield ", ".join(f"{words} {a:.3g} -> {b:.3g} {unit} rms" for words, a, b, unit in known)
    if gap.control_set is None and gap.held_out is not None:
        yield (
            f"no control recording was given: one rest and one move in {gap.held_out['folds']} in turn "
            "was left out of a fit and judged it"
        )
    yield from gap.notes


def _none_of(names: Sequence[str]) -> str:
    """That none of the effects that could be seen is there."""
    if not names:
        return "these recordings cannot show any effect that was looked for"
    what = f"{names[0]} is not" if len(names) == 1 else f"none of {len(names)} effects is"
    return f"{what} there at a size that these recordings show"


def _finding(gap: Gap) -> str:
    """What explains the gap, how large it is, and what it changes, in one sentence."""
    names = " and ".join(f"{e['name']}, {_size(e)} at most," for e in gap.effects)
    explain = "explains" if len(gap.effects) == 1 else "explain"
    unseen, set_name = (
        (gap.control_set, "control") if gap.control_set is not None else (gap.held_out, "held-out")
    )
    figure = _by_the_effects(gap.gap)
    row = max(gap.where["channels"], key=_drop) if gap.where else None
    # Where rests and moves are about as good without it, it counts inside the moves or at the stand.
    if (
        figure is not None
        and unseen is not None
        and figure["before"] > 1.1 * figure["floor"]
        and figure["closed"] > 0.1
        and (row is None or _times_noise_less(figure) > WORTH_LEADING * _drop(row))
    ):
        before, after = unseen["before"], unseen["after"]
        name, unit, words = ("gravity_direction_rms_deg", "deg", "gravity direction")
        if _ratio(before, after, "gravity_norm_rms_mps2") > _ratio(before, after, name):
            name, unit, words = ("gravity_norm_rms_mps2", "m/s^2", "|f| - g")
        closed = min(100.0, 100 * figure["closed"])
        return (
            f"{names} {explain} {closed:.0f} % of the gap; {set_name} {words} {before[name]:.2g} -> "
            f"{after[name]:.2g} {unit}"
        )
    if row is None or row["times_noise_after"] is None:
        return f"{names} {explain} what the model misses"
    return (
        f"{names} {explain} the gap; {_channel(row)} {row['times_noise']:.3g} -> "
        f"{row['times_noise_after']:.2g} times noise"
    )


def _by_the_effects(figure: Mapping[str, Any] | None) -> Mapping[str, Any] | None:
    """The figure from the fit without effects on: what that changes of a given calibration is not theirs."""
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
    """By how many times the noise the figure of the unseen rests and moves becomes less."""
    power = 0.5 if figure["metric"] == "chi2_per_dof" else 1.0
    before, after = ((figure[name] / max(figure["floor"], 1e-300)) ** power for name in ("before", "after"))
    return float(before - after)


def _drop(row: Mapping[str, Any]) -> float:
    after = row["times_noise_after"]
    return 0.0 if after is None else float(row["times_noise"] - after)


def _size(effect: Mapping[str, Any]) -> str:
    """The largest parameter with its standard deviation."""
    units = {p["unit"] for p in effect["parameters"]}
    # A time constant is no size.
    sizes = [p for p in effect["parameters"] if p["unit"] != "s" or units == {"s"}]
    largest = max(sizes, key=lambda p: abs(p["value"]))
    value, unit = for_people(abs(largest["value"]), largest["unit"])
    if not largest["std"]:
        return f"{value:.3g} {unit}"
    factor = value / abs(largest["value"]) if largest["value"] else 1.0
    return f"{value:.3g} +- {factor * largest['std']:.1g} {unit}"


def _change(change: Mapping[str, float], unit: str) -> str:
    (before, name), (after, _) = for_people(change["before"], unit), for_people(change["after"], unit)
    words = f"{before:.2g} -> {after:.2g} {name}"
    # Where chance may be all of it there is no more to say.
    if change["factor_low"] < WORTH_CLAIMING:
        return words
    return f"{words} ({change['factor_low']:.2g} to {change['factor_high']:.2g} times less)"


def where_in_words(gap: Gap) -> Iterator[str]:
    """Where measurement and model disagree, the largest first, and what it goes with."""
    if not gap.where:
        return
    rows = [row for row in gap.where["channels"] if row["stands_out"]]
    if not rows:
        yield "where: no kind of residual exceeds what noise explains"
    for row in sorted(rows, key=lambda row: -row["times_noise"])[:MOST_CHANNELS]:
        rms, unit = for_people(row["rms"], row["unit"])
        goes = next(
            (
                f", {100 * d['share']:.0f} % of its squares go with {d['on'].replace('_', ' ')}"
                for d in gap.where["depends"]
                if (d["channel"], d["axis"]) == (row["channel"], row["axis"])
            ),
            "",
        )
        after = (
            ""
            if row["times_noise_after"] is None or not gap.effects
            else f", {row['times_noise_after']:.2g} after"
        )
        times = f"{row['times_noise']:.3g} times noise{after}"
        yield f"where: {_channel(row)}: {rms:.3g} {unit} rms, {times}{goes}"
    if len(rows) > MOST_CHANNELS:
        yield f"where: and {len(rows) - MOST_CHANNELS} more kinds of residuals: the report has them all"
    for kind in ("rest", "move"):
        items = gap.where[f"{kind}s"]
        if items:
            worst = max(items, key=lambda item: item["times_noise"])
            about = gap.where["turns_about"] if kind == "move" else None
            count = f"1 {kind} stands" if len(items) == 1 else f"{len(items)} {kind}s stand"
            yield (
                f"where: {count} out{f', all turns about {about}' if about else ''}, most {kind} "
                f"{worst['index']} of {worst['recording']} with {worst['times_noise']:.3g} times noise"
            )


def _channel(row: Mapping[str, Any]) -> str:
    return f"{KINDS[row['channel']]} {row['axis'] or ''}".strip()


def explanation(gap: Gap, name: str) -> Iterator[str]:
    """What an effect is, how it would look here, whether it could be seen, and how large it may be unseen."""
    from imucal.effects.effect import Effect, find

    own = next((effect for effect in gap.user_effects if effect.name == name), None)
    effect = own or find(name)
    sizes = dict.fromkeys("{:.2g} {}".format(*for_people(p.typical, p.unit)) for p in effect.parameters)
    if isinstance(effect, Effect):
        yield f"{name} ({effect.sensor}): {effect.formula}"
        yield f"typically {', '.join(sizes)}; it is seen in {effect.observable}"
    else:
        yield f"{name} ({effect.sensor}): an effect of your own, typically {', '.join(sizes)}"
    missing = next((item for item in gap.not_observable if item["name"] == name), None)
    trace = gap.traces.get(name)
    if trace is not None and missing is None:
        kinds = sorted(trace["times_noise"].items(), key=lambda kind: -kind[1])
        seen = [
            f"{times:.2g} times noise in the {SEEN_AS.get(kind, KINDS[kind])}"
            for kind, times in kinds
            if times > WORTH_SAYING
        ]
        yield (
            f"at that size it would leave here {', '.join(seen[:MOST_CHANNELS]) or 'next to nothing'}; "
            f"of its squares the 21 parameters take up {100 * trace['taken_up']:.0f} %"
        )
    if missing is not None:
        yield f"these recordings cannot show it: it needs {missing['needs']}; it may be of any size"
    if name in gap.smallest_visible:
        size = gap.smallest_visible[name]
        value, unit = for_people(size["value"], size["unit"])
        yield (
            f"it would have been seen from {value:.2g} {unit} rms per parameter on: a smaller one may be "
            "there unseen"
        )
    joined = next((e for e in gap.effects if e["name"] == name and e["parameters"]), None)
    score = next((score for score in gap.ranking if score["name"] == name), None)
    if joined is not None:
        yield f"here: it joined the model, {_size(joined)} at most, {_evidence(joined)}"
    elif score is not None:
        yield f"here: it did not join; by itself against the model without effects {_evidence(score)}"
    for alias in effect.aliases if isinstance(effect, Effect) else ():
        yield f"{alias.name} looks like it; they are told apart by {alias.told_apart_by}"


def _evidence(score: Mapping[str, Any]) -> str:
    return (
        f"log Bayes factor {score['log_bayes_factor']:.1f}, chi2 {score['statistic']:.1f} with "
        f"{score['dof']} degrees of freedom, p {score['p_value']:.2g}"
    )
