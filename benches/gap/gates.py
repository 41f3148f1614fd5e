"""What has to be reached, and whether it was."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from gap.judge import INTERVAL_95, Mark
from gap.rates import Rate
from gap.sizes import SIZES, typical
from gap.worth import is_held, is_near, judged
from gate import Gate

CANCELLING = {"gyro_scale_quadratic", "gyro_scale_asymmetry"}


def gates(marks: Sequence[Mark]) -> list[Gate]:
    """All gates of one tool; those without a case are not met."""
    singles = [m for m in marks if m.group == "single"]
    found = [
        _least("first name right at 2 times the limit", 0.95, [m.first for m in singles if m.level == "2x"]),
        _least("first name right at 5 times the limit", 0.99, [m.first for m in singles if m.level == "5x"]),
        _least(
            "first name right at 10 times the limit", 0.99, [m.first for m in singles if m.level == "10x"]
        ),
        _least("first name right at usual sizes of twice the limit or more", 0.99, usual(marks)),
        _most("wrong name, one effect hidden", 0.01, [m.wrong for m in singles]),
        _most("wrong name, anything hidden", 0.01, [m.wrong for m in marks if m.group != "clean"]),
        _most("false alarm on clean runs, white noise", 0.01, alarms(marks, lambda label: label == "white")),
        _most("false alarm on clean runs, other noise", 0.01, alarms(marks, lambda label: label != "white")),
        _least("unknown or stochastic outside the catalogue", 0.95, verdicts(marks, "outside")),
        _least("the same in the right part of the model", 0.95, blocks(marks, "outside")),
        _least("unknown in the right part, effect left out", 0.90, blocks(marks, "left out")),
        _least("off-form effects by family or unknown", 0.95, verdicts(marks, "off form")),
        _least("pairs exact", 0.90, [m.exact for m in marks if m.group == "pair"]),
        _least("data faults said", 0.95, verdicts(marks, "fault")),
        _least("one's own effect named", 0.95, [m.exact for m in marks if m.group == "own"]),
        _least("confounded: truth named or among rivals", 0.95, verdicts(marks, "confounded")),
        _least("aliases: as the data allow", 0.95, verdicts(marks, "alias")),
        _least("solved by the advised motion", 0.95, [m.solved_by_advice for m in marks]),
    ]
    return [*found, *_known(marks), *_closed(marks), _coverage(marks), _squares(marks), *_worth(marks)]


def usual(marks: Sequence[Mark]) -> list[bool | None]:
    """First names at usual sizes, of effects whose usual size can be seen."""
    visible = {name for name, size in SIZES.items() if typical(name) >= 2.0 * size.here}
    return [m.first for m in marks if m.group == "single" and m.level == "typical" and m.label in visible]


def alarms(marks: Sequence[Mark], chosen: Callable[[str], bool]) -> list[bool | None]:
    return [m.false_alarm for m in marks if m.group == "clean" and chosen(m.label)]


def verdicts(marks: Sequence[Mark], group: str) -> list[bool | None]:
    return [m.verdict_ok for m in marks if m.group == group]


def blocks(marks: Sequence[Mark], group: str) -> list[bool | None]:
    """Right verdict and, if it is that something is unknown, in the right part of the model."""
    return [m.verdict_ok and m.block_ok is not False for m in marks if m.group == group]


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
            _least(f"{group}: named, and nothing else", 0.95, [m.exact for m in of])
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
    return Gate("95 % intervals of named effects hold the truth", "92 to 98 %", str(rate), met, rate.of)


def _squares(marks: Sequence[Mark]) -> Gate:
    errors = scores(marks)
    name, aim = "mean of (error / stated σ)² of named effects", "0.95 to 1.05"
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
