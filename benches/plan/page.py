"""docs/results/plan.md and plan.svg."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import NormalDist

import numpy as np

from imucal.effects import catalogue
from imucal.planning.groups import GROUPS
from plan.agreement import HAND_TREMOR_DEG, RATE_HZ, Agreement
from plan.duration import PROPOSALS, Duration, Point

# A little less than the paper's two programs take: the gates are shares of it.
PAPER_MINUTES = 22.5
WITHIN = 0.10
CHANCE = 1e-3
COARSE_SHARE, FINE_SHARE = 1 / 7, 0.75
# Factor and unit in which people say these.
SHOWN = {
    "accel_sensitivity": (1e6, "ppm"),
    "accel_bias": (1e6 / 9.80665, "ug"),
    "gyro_sensitivity": (1e6, "ppm"),
    "gyro_bias": (1e6, "urad/s"),
}
COLOURS = {"grid": "#6f7780", "random": "#d55e00", "optimal": "#0072b2"}


def gates(agreements: Sequence[Agreement], durations: Sequence[Duration]) -> list[tuple[str, str, str, bool]]:
    """What is aimed at, the aim, what was found, and whether it is met."""
    # What 999 of 1000 perfect predictions keep in all figures together.
    tail = CHANCE / (2 * sum(len(a.ratio) for a in agreements))
    chances = -NormalDist().inv_cdf(tail)
    rows = []
    for a in agreements:
        limit = WITHIN + chances * a.chance
        aim = f"1 ± {limit:.3f} ({WITHIN} and chance)"
        found = f"worst {a.worst:.3f} ± {a.chance:.3f}"
        name = f"{a.name}: rms error / predicted, each parameter"
        rows.append((name, aim, found, abs(a.worst - 1.0) <= limit))
        stated = float(a.stated[np.argmax(np.abs(a.stated - 1.0))])
        name = f"{a.name}: stated / predicted, each parameter"
        rows.append((name, f"1 ± {WITHIN}", f"worst {stated:.3f}", abs(stated - 1.0) <= WITHIN))
    for name, share in (("coarse", COARSE_SHARE), ("fine", FINE_SHARE)):
        slowest = max(next(d for d in durations if d.name == name).minutes)
        aim = f"at most {share * PAPER_MINUTES:.1f} min"
        rows.append(
            (f"{name} targets, every seed", aim, f"{slowest:.2f} min", slowest <= share * PAPER_MINUTES)
        )
    return rows


def page(
    agreements: Sequence[Agreement],
    durations: Sequence[Duration],
    points: Sequence[Point],
    visible: dict[str, dict[str, float]],
) -> str:
    checked = gates(agreements, durations)
    missed = sum(not met for *_, met in checked)
    return f"""# Planned and achieved accuracy

Written by `make plan`. The unit is that of the paper, with the white noise of its datasheets. The
predictions use only the model and the noise ([how](../plan.md)) and are not fitted to the runs below.

## Gates

{"None" if missed == 0 else missed} of {len(checked)} gates are missed.

| | aim | found | |
| --- | ---: | ---: | ---: |
{_rows(checked, lambda row: (*row[:3], "met" if row[3] else "**missed**"))}

"0.1 and chance": a ratio may deviate by 0.1 and by its sampling error, for which 999 of 1000 perfect
predictions keep the allowance in all ratios of the table together. The standard deviations reported by
calibrations hardly scatter and have no such allowance.

The aims for the duration are a seventh and three quarters of {PAPER_MINUTES} min. The paper's two
programs take {_both(visible)} here. Together they are predicted to be more accurate than the fine
targets.

## Predicted and achieved standard deviations

Each program is simulated with different seeds for the noise, at {RATE_HZ:.0f} Hz, and calibrated.
Hand-held runs also have different tremor and poses. Ratio: root mean square error over the runs divided
by the predicted standard deviation, lowest and highest of the 21 parameters; ± is one standard deviation
of its sampling error. Stated: root mean square of the standard deviations reported by the calibrations,
divided by the predicted one. Rests: share of the runs in which every rest of the program was found. The
grid alone does not determine the gyroscope, so it is calibrated together with the random program. The
hand trembles by {HAND_TREMOR_DEG} deg about each axis. The prediction neglects that the mean rate of a
tremor is zero, which gives additional information about the gyroscope bias.

| program | minutes | runs | ratio | ± | mean ratio | stated | rests |
| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |
{_rows(agreements, _agreement)}

## Duration

The table gives the shortest programs found for the paper's three motors with a mean rate of 120 deg/s and
480 deg/s^2, with {PROPOSALS} proposals and {len(durations[0].plans)} seeds. The coarse targets are 50 ppm
and 50 ug for the accelerometer and 200 ppm and 50 urad/s for the gyroscope, 1 sigma of the worst
parameter. The fine targets are 11 ppm, 10 ug, 130 ppm and 28 urad/s.

| targets | minutes: best | middle | worst | best / {PAPER_MINUTES} min | moves | rests |
| --- | ---: | ---: | ---: | ---: | ---: | ---: |
{_rows(durations, _duration)}

## Worst standard deviation by duration

Grid is the paper's grid with steps of 60 to 20 deg. Random is the paper's random program with 8 to 160
moves. Optimal has the most information for its duration (D-optimal), on the same motors. The values are 1
sigma of the worst parameter of each group.

![Worst standard deviation of four groups over minutes, for the three kinds of program](plan.svg)

| program | minutes | accel sensitivity, ppm | accel bias, ug | gyro sensitivity, ppm | gyro bias, urad/s |
| --- | ---: | ---: | ---: | ---: | ---: |
{_rows(points, _point)}

## Detection limits

The table gives the smallest size of each effect that `imucal gap` would find with 90 % probability: the
root mean square over its parameters, in SI units. A dash means that such a run, or two such recordings
together, do not show the effect. Temperature was not recorded, so temperature effects are not listed.
Longer runs have lower limits for drifts and encoder effects.

| effect | {" | ".join(visible)} | unit |
| --- |{" ---: |" * (len(visible) + 1)}
{_limits(visible)}
"""


def _both(visible: dict[str, dict[str, float]]) -> str:
    return next(name for name in visible if name.startswith("grid and random")).rpartition(", ")[2]


def _rows(items, cells) -> str:
    return "\n".join(f"| {' | '.join(cells(item))} |" for item in items)


def _agreement(a: Agreement) -> tuple[str, ...]:
    mean = math.sqrt(float((a.ratio**2).mean()))
    return (
        a.name,
        f"{a.minutes:.2f}",
        str(a.runs),
        f"{a.ratio.min():.3f} to {a.ratio.max():.3f}",
        f"{a.chance:.3f}",
        f"{mean:.3f}",
        f"{a.stated.min():.3f} to {a.stated.max():.3f}",
        f"{100 * a.complete / a.runs:.1f} %",
    )


def _duration(d: Duration) -> tuple[str, ...]:
    low, middle, high = d.minutes[0], d.minutes[len(d.minutes) // 2], d.minutes[-1]
    reached = "" if all(plan.reached for plan in d.plans) else " (not reached)"
    shown = (f"{low:.2f}", f"{middle:.2f}", f"{high:.2f}", f"{low / PAPER_MINUTES:.3f}")
    return (d.name + reached, *shown, str(d.best.moves), str(d.best.rests))


def _point(point: Point) -> tuple[str, ...]:
    sizes = (point.worst[group] for group in GROUPS)
    shown = ("-" if v is None else f"{v * SHOWN[g][0]:.3g}" for g, v in zip(GROUPS, sizes, strict=True))
    return (point.family, f"{point.minutes:.2f}", *shown)


def _limits(visible: dict[str, dict[str, float]]) -> str:
    units = {effect.name: effect.parameters[0].unit for effect in catalogue()}
    names = [name for name in units if any(name in limits for limits in visible.values())]
    return _rows(
        names,
        lambda name: (
            f"`{name}`",
            *(f"{limits[name]:.2e}" if name in limits else "-" for limits in visible.values()),
            units[name],
        ),
    )


WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM = 400, 280, 56, 12, 28, 40


def figure(points: Sequence[Point]) -> str:
    """Four panels with logarithmic axes, as SVG."""
    panels = "\n".join(
        f'<g transform="translate({WIDTH * (k % 2)},{HEIGHT * (k // 2)})">{_panel(group, points)}</g>'
        for k, group in enumerate(GROUPS)
    )
    box = f'width="{2 * WIDTH}" height="{2 * HEIGHT}" fill="white"'
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {2 * WIDTH} {2 * HEIGHT}" '
        f'font-family="sans-serif" font-size="12">\n<rect {box}/>\n{panels}\n</svg>\n'
    )


def _panel(group: str, points: Sequence[Point]) -> str:
    factor, unit = SHOWN[group]
    sizes = {(p.family, p.minutes): p.worst[group] * factor for p in points if p.worst[group] is not None}
    span_x = _span(minutes for _, minutes in sizes)
    span_y = _span(sizes.values())

    def place(value: float, span: tuple[float, float], low: float, high: float) -> float:
        return low + (math.log10(value) - span[0]) / (span[1] - span[0]) * (high - low)

    def x(minutes: float) -> float:
        return place(minutes, span_x, LEFT, WIDTH - RIGHT)

    def y(size: float) -> float:
        return place(size, span_y, HEIGHT - BOTTOM, TOP)

    parts = [f'<text x="{LEFT}" y="16" font-weight="bold">{group.replace("_", " ")}, {unit}</text>']
    for minutes in _ticks(span_x):
        at = f"{x(minutes):.1f}"
        parts.append(f'<line x1="{at}" x2="{at}" y1="{TOP}" y2="{HEIGHT - BOTTOM}" stroke="#ddd"/>')
        parts.append(f'<text x="{at}" y="{HEIGHT - BOTTOM + 15}" text-anchor="middle">{minutes:g}</text>')
    for size in _ticks(span_y):
        at = f"{y(size):.1f}"
        parts.append(f'<line x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{at}" y2="{at}" stroke="#ddd"/>')
        parts.append(f'<text x="{LEFT - 6}" y="{at}" dy="4" text-anchor="end">{size:g}</text>')
    middle = (LEFT + WIDTH - RIGHT) / 2
    parts.append(f'<text x="{middle}" y="{HEIGHT - 8}" text-anchor="middle">minutes on the stand</text>')
    for row, (family, colour) in enumerate(COLOURS.items()):
        own = [(x(minutes), y(size)) for (name, minutes), size in sizes.items() if name == family]
        line = " ".join(f"{px:.1f},{py:.1f}" for px, py in own)
        parts.append(f'<polyline points="{line}" fill="none" stroke="{colour}" stroke-width="2"/>')
        parts += [f'<circle cx="{px:.1f}" cy="{py:.1f}" r="3" fill="{colour}"/>' for px, py in own]
        label = f'x="{WIDTH - RIGHT - 6}" y="{TOP + 16 + 15 * row}" text-anchor="end" fill="{colour}"'
        parts.append(f"<text {label}>{family}</text>")
    return "\n".join(parts)


def _span(values) -> tuple[float, float]:
    logs = [math.log10(value) for value in values]
    return min(logs) - 0.08, max(logs) + 0.08


def _ticks(span: tuple[float, float]) -> list[float]:
    every = [m * 10.0**power for power in range(-2, 8) for m in (1, 2, 5)]
    return [tick for tick in every if span[0] <= math.log10(tick) <= span[1]]
