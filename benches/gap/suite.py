"""All hidden cases, and one of them asked and judged."""

from collections.abc import Iterator
from functools import cache

from gap import baselines
from gap.case import Case, seeded, spread
from gap.faults import faults
from gap.judge import Mark, control_figures, judge
from gap.known import cancelling, known_and_random, known_and_unknown, two_sessions
from gap.loop import ask_again
from gap.named import aliases, confounded, left_out, ones_own, other_data, several, single
from gap.noise import clean
from gap.outside import off_form, outside
from gap.said import Said, find_gap, part
from gap.worth import LEVELS, Worth, worth

TOOL = "imucal"
# Seed of the cases of the page.
SEED = 20301
# The textbook ways are asked, too.
WITH_BASELINES = ("single", "data", "pair", "triple", "clean", "outside", "off form")
# The control error is compared with that of a refit with the true effects.
WITH_FIGURES = ("single", "data", "pair", "triple", "known + unknown", "known + random", "cancelling")
# Groups in which the motion that is advised must decide.
WITH_LOOP = ("confounded", "alias")


def every_case() -> Iterator[Case]:
    """At full size."""
    yield from single(10)
    yield from other_data(3)
    yield from several(pairs=100, triples=30)
    yield from confounded(10)
    yield from aliases(10)
    yield from left_out(10)
    yield from ones_own(20)
    yield from outside(25)
    yield from off_form(20)
    yield from clean(white=500, others=50)
    yield from faults(10)
    yield from known_and_unknown(6)
    yield from known_and_random(14)
    yield from two_sessions(50)
    yield from cancelling(40)


@cache
def suite(share: float, seed: int = SEED) -> tuple[Case, ...]:
    """A share of every cell, at least one case of each."""
    with seeded(seed):
        return tuple(spread(list(every_case()), share))


def run(case: Case, with_baselines: bool = True) -> list[Mark]:
    """Pose a case to imucal and to the textbook ways; the answer is opened when all have answered."""
    measured, control, sealed = case.pose()
    said, gap = find_gap(measured, control, case)
    others: dict[str, Said] = {}
    if with_baselines and case.group in WITH_BASELINES:
        others = baselines.ask(measured)
    again = None
    if said.verdict == "ambiguous" or (case.group in WITH_LOOP and not said.verdict.startswith("error")):
        again = ask_again(case, measured, control, said, gap, sealed)
    figures = {}
    truth = sealed.open(said).effects
    if gap is not None and truth and not case.scene.user_effects and case.group in WITH_FIGURES:
        names = tuple(effect.name for effect in truth)
        figures = control_figures(measured, control, part(gap, "calibration"), names)
    claims: Worth = {}
    if case.group == "single" and case.level in LEVELS:
        claims = worth(gap, control, sealed.truth(said, case.control_seed))
    marks = [judge(TOOL, case, said, sealed, figures, again, claims)]
    return marks + [judge(name, case, other, sealed) for name, other in others.items()]
