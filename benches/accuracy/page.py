"""The tables."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from accuracy.band import BESIDE, root_mean_square_error, two_sided
from accuracy.bound import PARAMETERS
from accuracy.contaminated import Contamination
from accuracy.figures import LEVELS, Figures, SceneFigures
from gate import Gate

INTRODUCTION = """# Accuracy

Written by `make accuracy`. The runs are simulated with the paper's unit, the white noise and the counts
of its datasheets. Each run has its own moves and its own noise, and each condition its own seeds.

* paper: the paper's gyroscope program with 45 moves of 2 s, rests of 5 s, at 200 Hz. hand-held: 40 poses
  of 4 s and moves of 2 s within a cube of 30 cm, with a tremor of 0.05 deg about each axis throughout.
  Each of the other conditions changes one property of the paper run.
* bound: standard deviation at the Cramér-Rao bound of the same runs, [computed from the
  truth](../../benches/accuracy/bound.py). In the hand-held run neither the tremor nor the path between
  poses is assumed to be known.
* RMSE and σ are root mean squares over the runs; ± is one standard deviation of their sampling error.
* 68 %, 95 %, 99.7 %: share of the runs in which the reported interval contains the truth. If the bias
  wanders (flicker), the truth is its mean over the record, and there is no bound.
* bold: outside the range of 99 of 100 perfect estimators. The gates use the range of 999 of 1000, for all
  figures of a table together (Bonferroni): "1.05 and chance" is the limit that 1 of 1000 estimators misses
  whose true figure is 1.05.
"""
CONDITIONS = """Efficiency: squared bound divided by mean square error, over all parameters.
(error / σ)²: mean over all parameters; 1 if the reported σ are correct. Reduced chi2: with the noise as
predicted, without widening.
Coverages: lowest and highest of all parameters. Outside: number of the {figures} coverages outside the 99
% band of a single coverage; {expected:.1f} are expected for a perfect estimator. In brackets: number
outside the joint band of all coverages. Named: rests and moves that were excluded or down-weighted
although they were correct.
"""
CONTAMINATED = """RMSE divided by the bound of the rests and moves that remain: of all parameters,
and of the worst parameter. Worst run: largest root mean square of error / bound over the parameters of
one run.
[faults.py](../../benches/accuracy/faults.py) defines the faults, and
[naming.py](../../benches/accuracy/naming.py) defines when a fault counts as named.
"""


def page(scenes: Sequence[SceneFigures], contaminations: Sequence[Contamination], seconds: float) -> str:
    gates = [gate for one in (*scenes, *contaminations) for gate in one.gates()]
    missed = sum(not gate.met for gate in gates)
    sections = [INTRODUCTION]
    if scenes:
        sections += ["## Conditions\n", conditions_table(scenes)]
    if contaminations:
        sections += ["## Contaminated runs\n", contaminated_table(contaminations), CONTAMINATED]
    sections += [f"## Gates\n\n{missed} of {len(gates)} gates are missed.\n", gates_table(gates)]
    for one in scenes:
        if one.scene.is_main:
            sections += [f"## Parameter by parameter: {one.scene.name}\n", parameters_table(one)]
    return "\n".join([*sections, f"The whole benchmark took {seconds / 60.0:.0f} min.\n"])


def table(heading: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    rule = ["---", *["---:"] * (len(heading) - 1)]
    return "\n".join("| " + " | ".join(map(str, row)) + " |" for row in (heading, rule, *rows)) + "\n"


def gates_table(gates: Sequence[Gate]) -> str:
    rows = [(g.what, g.aim, g.found, "met" if g.met else "**missed**") for g in gates]
    return table(("", "aim", "found", ""), rows)


def conditions_table(scenes: Sequence[SceneFigures]) -> str:
    """One row for each scene: the worst figures of all parameters."""
    names = _names(scenes)
    rows = []
    for one in scenes:
        joint, (of_one, of_all) = one.joint, one.coverage_outside
        worst = int(np.argmax(joint.ratio))
        farthest = int(np.argmax(np.abs(joint.bias)))
        chi2_off = abs(one.chi2 - 1.0) > two_sided(BESIDE) * one.chi2_error
        rows.append(
            (
                one.scene.name,
                joint.runs,
                _ratio(joint, worst) + f" {names[worst]}" if one.scene.has_bound else "-",
                "{:.3f} ± {:.3f}".format(*one.efficiency) if one.scene.has_bound else "-",
                f"{_bias(joint, farthest)} {names[farthest]}",
                _mean_square(one),
                *(_range(100.0 * joint.inside[level]) for level in LEVELS),
                f"{of_one} ({of_all})",
                _bold(f"{one.chi2:.4f} ± {one.chi2_error:.4f}", chi2_off),
                sum(trial.named for trial in one.trials),
            )
        )
    heading = (
        "", "runs", "worst RMSE / bound", "efficiency", "worst bias / σ", "(error / σ)²", *LEVELS, "outside",
        "reduced chi2", "named",
    )  # fmt: skip
    figures = len(LEVELS) * PARAMETERS
    return table(heading, rows) + "\n" + CONDITIONS.format(figures=figures, expected=BESIDE * figures)


def parameters_table(one: SceneFigures) -> str:
    """One row for each parameter: the joint fit beside the two-stage one."""
    joint, two_stage = one.joint, one.two_stage
    rows = []
    for i, name in enumerate(_names([one])):
        rows.append(
            (
                name,
                f"{joint.bound[i]:.2e}",
                f"{joint.rmse[i]:.2e}",
                f"{joint.stated[i]:.2e}",
                _ratio(joint, i),
                f"{joint.rmse[i] / joint.stated[i]:.3f}",
                _bias(joint, i),
                *(_coverage(joint, level, i) for level in LEVELS),
                f"{two_stage.rmse[i]:.2e}",
                f"{two_stage.stated[i]:.2e}",
                _ratio(two_stage, i),
                f"{two_stage.rmse[i] / joint.rmse[i]:.3f}",
            )
        )
    heading = (
        "SI units", "bound", "RMSE", "stated σ", "RMSE / bound", "RMSE / σ", "bias / σ", *LEVELS,
        "two-stage: RMSE", "stated σ", "RMSE / bound", "RMSE, two-stage / joint",
    )  # fmt: skip
    bands = [(level, joint.band(level, BESIDE)) for level in LEVELS]
    words = ", ".join(f"{level} {100 * low:.1f} to {100 * high:.1f}" for level, (low, high) in bands)
    return table(heading, rows) + (
        f"\n{joint.runs} runs: RMSE is uncertain by {100 * root_mean_square_error(joint.runs):.1f} %, "
        f"bias by {1 / np.sqrt(joint.runs):.3f} σ. Bands of one coverage: {words}.\n"
    )


def contaminated_table(contaminations: Sequence[Contamination]) -> str:
    rows = []
    for one in contaminations:
        named = one.named
        rows.append(
            (
                one.name,
                one.runs,
                len(one.refused),
                f"{one.pooled:.3f} ± {one.pooled_error:.3f}",
                f"{one.ratio.max():.3f} ± {one.ratio_error:.3f}",
                f"{one.worst_run:.1f}",
                f"{100 * one.recall:.1f} % ({named.found}/{named.bad})" if named.bad else "-",
                f"{100 * one.false:.2f} % ({named.false}/{named.good})",
            )
        )
    heading = (
        "fault", "runs", "no result", "RMSE / bound", "worst parameter", "worst run", "bad ones named",
        "good ones named",
    )  # fmt: skip
    return table(heading, rows)


def _names(scenes: Sequence[SceneFigures]) -> tuple[str, ...]:
    return scenes[0].trials[0].names


def _bold(text: str, wrong: bool) -> str:
    return f"**{text}**" if wrong else text


def _mean_square(one: SceneFigures) -> str:
    square, error = one.mean_square_score
    return _bold(f"{square:.3f} ± {error:.3f}", abs(square - 1.0) > two_sided(BESIDE) * error)


def _range(values: np.ndarray) -> str:
    return f"{values.min():.1f} to {values.max():.1f}"


def _ratio(figures: Figures, i: int) -> str:
    return _bold(f"{figures.ratio[i]:.3f}", bool(figures.ratio[i] > figures.ratio_limit(BESIDE)))


def _bias(figures: Figures, i: int) -> str:
    return _bold(f"{figures.bias[i]:+.3f}", bool(abs(figures.bias[i]) > figures.bias_limit(BESIDE)))


def _coverage(figures: Figures, level: str, i: int) -> str:
    return _bold(f"{100 * figures.inside[level][i]:.1f}", bool(figures.outside(level, BESIDE)[i]))
