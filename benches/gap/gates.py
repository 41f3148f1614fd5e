"""What has to be reached, and whether it was.

A gate counts an answer only if its label says so. Where a weaker answer is right, too, a second gate counts
it and says what it counts.
"""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from gap.judge import INTERVAL_95, Mark
from gap.rates import Rate
from gap.sizes import SIZES, typical
from gap.worth import is_held, is_near, judged
from gate import Gate

CANCELLING = {"gyro_scale_quadratic", "gyro_scale_asymmetry"}
# A hand's tremor is a part of the model: where the model takes it up, it is no fault.
TREMOR = "rest_not_still"
EVEN_STAMPS = "clock_irregular, even stamps"


def gates(marks: Sequence[Mark]) -> list[Gate]:
    """All gates of one tool; those without a case are not met."""
    singles = [m for m in marks if m.group == "single"]
    pairs, own, outside, left_out, off_form, faults = (
        [m for m in marks if m.group == group]
        for group in ("pair", "own", "outside", "left out", "off form", "fault")
    )
    found = [
        *_first_names(singles),
        _most("wrong name (of equals, no right one), one effect hidden", 0.01, map(has_wrong_name, singles)),
        _most(
            "wrong name (of equals, no right one), anything hidden",
            0.01,
            [has_wrong_name(m) for m in marks if m.group != "clean"],
        ),
        _most("false alarm on clean runs, white noise", 0.01, alarms(marks, lambda label: label == "white")),
        _most("false alarm on clean runs, other noise", 0.01, alarms(marks, lambda label: label != "white")),
        _least("unknown or stochastic outside the catalogue", 0.95, verdicts(marks, "outside")),
        _least("the same in the right part of the model", 0.95, map(is_in_part, outside)),
        _least(
            "unknown or stochastic in the right part, effect left out, no other can be equal to it",
            0.90,
            [is_in_part(m) for m in left_out if not m.truth],
        ),
        _least(
            "the same of all effects, or named as an effect that can be equal to it",
            0.90,
            [is_in_part(m) or is_by_family(m) for m in left_out],
        ),
        _least(
            "off-form effects by family alone, or unknown",
            0.95,
            [is_by_family(m) or (m.verdict_ok and not m.said["names"]) for m in off_form],
        ),
        _least(
            "off-form effects by family, also with other names, or unknown", 0.95, verdicts(marks, "off form")
        ),
        _least("pairs exact", 0.90, [m.exact and is_alone(m) for m in pairs]),
        _least("pairs exact, or with equals beside them", 0.90, [m.exact for m in pairs]),
        _least(
            "data faults said, but for tremor and for uneven sampling with even stamps",
            0.95,
            [m.verdict_ok and is_said(m) for m in faults if m.label not in (TREMOR, EVEN_STAMPS)],
        ),
        _least(
            "uneven sampling with even stamps said",
            0.95,
            [m.verdict_ok and is_said(m) for m in faults if m.label == EVEN_STAMPS],
        ),
        _least("all data faults said, or taken up by the model", 0.95, verdicts(marks, "fault")),
        _least("one's own effect named", 0.95, [m.exact and is_alone(m) for m in own]),
        _least("confounded: truth named or among rivals", 0.95, verdicts(marks, "confounded")),
        _least("aliases: as the data allow", 0.95, verdicts(marks, "alias")),
        _least("solved by the advised motion", 0.95, map(is_solved, marks)),
        _least(
            "truth named after the advised motion, alone or before its equals",
            0.95,
            [m.solved_by_advice for m in marks],
        ),
    ]
    return [*found, *_known(marks), *_closed(marks), _coverage(marks), _squares(marks), *_worth(marks)]


def _first_names(singles: Sequence[Mark]) -> list[Gate]:
    """Of single effects by their size: named alone, and as the first of equals."""
    visible = {name for name, size in SIZES.items() if typical(name) >= 2.0 * size.here}
    usual = [m for m in singles if m.level == "typical" and m.label in visible]
    sizes: list[tuple[str, float, list[Mark]]] = [
        (f"{level[:-1]} times the limit", aim, [m for m in singles if m.level == level])
        for level, aim in (("2x", 0.95), ("5x", 0.99), ("10x", 0.99))
    ]
    sizes.append(("usual sizes of twice the limit or more", 0.99, usual))
    return [
        *(
            _least(f"first name right at {size}", aim, [m.first and is_alone(m) for m in of])
            for size, aim, of in sizes
        ),
        *(
            _least(f"first name right, alone or before its equals, at {size}", aim, [m.first for m in of])
            for size, aim, of in sizes
        ),
    ]


def is_alone(mark: Mark) -> bool:
    """Whether the names are certain: none has equals."""
    return bool(mark.said["verdict"] == "named")


def is_said(mark: Mark) -> bool:
    """Whether the answer is that the data have a fault."""
    return bool(mark.said["verdict"] == "data_fault")


def is_in_part(mark: Mark) -> bool:
    """Whether the answer is that something is unknown or random, in the right part of the model."""
    is_unknown = mark.said["verdict"] in ("unknown", "stochastic")
    return is_unknown and mark.verdict_ok and mark.block_ok is True


def is_by_family(mark: Mark) -> bool:
    """Whether all names are right, alone or before equals."""
    names = set(mark.said["names"])
    return mark.verdict_ok and bool(names) and names <= set(mark.truth)


def is_solved(mark: Mark) -> bool | None:
    """Whether the truth is named alone after the advised motion; None if nothing was recorded again."""
    if mark.advised is None:
        return None
    return bool(mark.solved_by_advice) and mark.advised["verdict"] == "named"


def has_wrong_name(mark: Mark) -> bool:
    """Whether a name is not hidden; of equals one has to be."""
    if mark.said["verdict"] != "ambiguous":
        return mark.wrong
    truth = set(mark.truth)
    return len(set(mark.said["names"]) - truth) > len(set(mark.said["ambiguous_with"]) & truth)


def alarms(marks: Sequence[Mark], chosen: Callable[[str], bool]) -> list[bool | None]:
    return [m.false_alarm for m in marks if m.group == "clean" and chosen(m.label)]


def verdicts(marks: Sequence[Mark], group: str) -> list[bool | None]:
    return [m.verdict_ok for m in marks if m.group == group]


def scores(marks: Sequence[Mark]) -> np.ndarray:
    return np.array([score for m in marks for score in m.scores])


def closed(marks: Sequence[Mark]) -> np.ndarray:
    """Shares of the gap on control, of what the true effects close, where there is a gap."""
    return np.array([m.closed for m in marks if m.closed is not None])


def _known(marks: Sequence[Mark]) -> list[Gate]:
    """Of known effects beside unknown and random ones, of two sessions, and of effects that cancel."""
    beside = {
        group: [m for m in marks if m.group == group] for group in ("known + unknown", "known + random")
    }
    sessions = [m for m in marks if m.group == "two sessions"]
    return [
        *(
            _least(f"{group}: named, and nothing else", 0.95, [m.exact and is_alone(m) for m in of])
            for group, of in beside.items()
        ),
        *(
            _least(
                f"{group}: control chi2 within 10 % of the refit with the truth", 0.95, map(is_taken_away, of)
            )
            for group, of in beside.items()
        ),
        _least(
            "known + unknown: the rest said to be unknown or random, in the right part of the model",
            0.95,
            [m.block_ok is True for m in beside["known + unknown"]],
        ),
        _least(
            "known + random: the rest said to be random",
            0.95,
            ["random walk" in m.said["generic"].replace("_", " ") for m in beside["known + random"]],
        ),
        _most(
            "two sessions: nothing missing", 0.0, [m.said["verdict"] == "nothing_missing" for m in sessions]
        ),
        _least(
            "two sessions: said to be that",
            0.95,
            [m.verdict_ok and "between" in m.said["generic"] for m in sessions],
        ),
        _most(
            "two effects that cancel: a false name",
            0.05,
            [bool(set(m.said["names"]) - CANCELLING) for m in marks if m.group == "cancelling"],
        ),
    ]


def is_taken_away(mark: Mark) -> bool:
    """Whether chi2 of the control recording is within 10 % of that of the refit with the true effects."""
    after, floor = mark.figures.get("after"), mark.figures.get("floor")
    return after is not None and floor is not None and after <= 1.1 * floor


def _least(what: str, aim: float, flags: Iterable[bool | None]) -> Gate:
    rate = Rate.count(flags)
    return Gate(what, f"at least {100 * aim:.0f} %", str(rate), bool(rate.of) and rate.value >= aim, rate.of)


def _most(what: str, aim: float, flags: Iterable[bool | None]) -> Gate:
    rate = Rate.count(flags)
    return Gate(what, f"at most {100 * aim:.0f} %", str(rate), bool(rate.of) and rate.value <= aim, rate.of)


def _closed(marks: Sequence[Mark]) -> list[Gate]:
    shares = closed(marks)
    if not len(shares):
        return [Gate("gap closed on control", "median at least 0.98, never negative", "-", False, 0)]
    median, least = float(np.median(shares)), float(shares.min())
    return [
        Gate("gap closed on control, median", "at least 0.98", f"{median:.3f}", median >= 0.98, len(shares)),
        Gate("gap closed on control, least", "not negative", f"{least:.3f}", least >= 0.0, len(shares)),
    ]


def _coverage(marks: Sequence[Mark]) -> Gate:
    rate = Rate.count(bool(abs(score) <= INTERVAL_95) for score in scores(marks))
    met = bool(rate.of) and 0.92 <= rate.value <= 0.98
    return Gate(
        "95 % intervals of effects named alone or before their equals hold the truth",
        "92 to 98 %",
        str(rate),
        met,
        rate.of,
    )


def _squares(marks: Sequence[Mark]) -> Gate:
    errors = scores(marks)
    name, aim = "mean of (error / stated σ)² of these effects", "0.95 to 1.05"
    if not len(errors):
        return Gate(name, aim, "-", False)
    square = float(np.mean(errors**2))
    return Gate(name, aim, f"{square:.3f}", 0.95 <= square <= 1.05, len(errors))


def _worth(marks: Sequence[Mark]) -> list[Gate]:
    """Of the corrected signal that the hidden effect disturbs."""
    claims = [figures for _, figures in judged(marks)]
    held = Rate.count(map(is_held, claims))
    return [
        _least("claimed factor within 10 % of the true one", 0.95, [is_near(figures) for figures in claims]),
        Gate(
            "95 % intervals of the claimed factor hold the true one",
            "92 to 98 %",
            str(held),
            bool(held.of) and 0.92 <= held.value <= 0.98,
            held.of,
        ),
    ]
