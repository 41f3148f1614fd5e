"""Convergence of the attitude integration: `make docs-figures`, to docs/results/convergence.md and .svg.

The attitude and rate of the simulated motion are closed-form functions of time. The attitude integrated from
the rate of a perfect unit must converge to the exact attitude with the order of the integrator.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import imucal
import imucal._core as _core

RESULTS = Path(__file__).resolve().parent.parent / "docs" / "results"
RATES_HZ = (50, 100, 200, 400, 800, 1600, 3200, 8000)
# The order is the slope of the error between this sampling rate, Hz, and the highest.
ASYMPTOTIC_HZ = 200
MOVES = 10
SEED = 1


def motions() -> dict[str, imucal.Program | imucal.Tumble]:
    program = imucal.Program.random(seed=SEED, moves=MOVES, hold_s=1.0)
    stand = imucal.Stand(
        mount_rotation_deg=(1.0, -2.0, 0.5), base_tilt_deg=(0.5, -0.3), non_orthogonality_deg=(0.5, -0.4),
        flexure_deg=0.1, vibration_deg=0.02, vibration_mm=0.05, vibration_hz=20.0,
    )  # fmt: skip
    return {
        "random program, perfect stand": program,
        "random program, bad stand": imucal.Program(program.steps, stand),
        "tumble by hand": imucal.Tumble(SEED, poses=MOVES + 1, hold_s=1.0),
    }


@dataclass(frozen=True)
class Convergence:
    """Largest error of the attitude integrated from the start of the run, rad, at each sampling rate."""

    error_rad: np.ndarray
    # The same error without the coning term between two samples.
    midpoint_error_rad: np.ndarray

    @property
    def order(self) -> float:
        """Order of convergence: exponent of the sampling interval in the error."""
        rates = np.array(RATES_HZ, dtype=float)
        far = rates >= ASYMPTOTIC_HZ
        return -float(np.polyfit(np.log(rates[far]), np.log(self.error_rad[far]), 1)[0])


def converge(motion: imucal.Program | imucal.Tumble) -> Convergence:
    errors = np.array([worst_errors_rad(motion, rate_hz) for rate_hz in RATES_HZ])
    return Convergence(errors[:, 0], errors[:, 1])


def worst_errors_rad(motion: imucal.Program | imucal.Tumble, rate_hz: float) -> tuple[float, float]:
    """Attitude errors of the fourth-order and of the midpoint integrator."""
    run = imucal.simulate(motion, unit="ideal", rate_hz=rate_hz, seed=SEED)
    time_s, rate = run.recording.time_s, run.recording.angular_rate
    attitude = run.truth.rotation_wxyz
    errors = []
    for start_s, end_s in run.truth.rests[1:]:
        end = int(np.searchsorted(time_s, (start_s + end_s) / 2))
        both = [_core.integrate(time_s[: end + 1], rate[: end + 1], midpoint) for midpoint in (False, True)]
        errors.append([angle_rad(product(attitude[0], turned), attitude[end]) for turned in both])
    fourth, midpoint = np.max(errors, axis=0)
    return float(fourth), float(midpoint)


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Hamilton product of two quaternions [w, x, y, z]."""
    vector = a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])
    return np.concatenate([[a[0] * b[0] - a[1:] @ b[1:]], vector])


def angle_rad(a: np.ndarray, b: np.ndarray) -> float:
    """Angle between two attitudes, from the vector part, which is accurate for small angles."""
    return 2.0 * math.asin(min(1.0, float(np.linalg.norm(product(a, b * [1, -1, -1, -1])[1:]))))


def page(found: dict[str, Convergence]) -> str:
    heading = " | ".join(found)
    rows = "\n".join(
        f"| {rate_hz} | " + " | ".join(f"{c.error_rad[i]:.2e}" for c in found.values()) + " |"
        for i, rate_hz in enumerate(RATES_HZ)
    )
    orders = " | ".join(f"{c.order:.2f}" for c in found.values())
    cheap = "\n".join(
        f"| {rate_hz} | " + " | ".join(f"{c.midpoint_error_rad[i]:.2e}" for c in found.values()) + " |"
        for i, rate_hz in enumerate(RATES_HZ)
    )
    return f"""# Integrated and analytic attitude

Written by `make docs-figures`. The simulated motion is an exact function of time: its attitude, rate and
angular acceleration have closed forms and are not integrated numerically. This page integrates the
rate of a perfect unit with `imucal_core::integrate` at several sampling rates and
compares the result with the exact attitude. The
tables give the largest attitude error, in rad, at the {MOVES} rests after the first, integrated from the
start of the run.

The integrator assumes that the rate is linear between samples. Its error is of third order in a step and
therefore of second order over a run: it falls by a factor of 4 if the sampling rate doubles.

| rate, Hz | {heading} |
|---:|{"---:|" * len(found)}
{rows}
| **order** | {orders} |

The order is the slope from {ASYMPTOTIC_HZ} Hz upwards. The bad stand vibrates at 20 Hz, which is close to
the Nyquist frequency of 50 Hz sampling.

![Largest error over sample rate: straight lines of slope -2](convergence.svg)

## Midpoint

`Order::Midpoint` omits the coning term between two samples, `h^2/12 (w0 x w1)`, and saves a cross product:

| rate, Hz, midpoint | {heading} |
|---:|{"---:|" * len(found)}
{cheap}

The dashed lines in the figure belong to the midpoint rule. Both methods are of second order if the rate
is not linear between samples. If it is linear, `Order::Magnus4` is of fourth order and the midpoint rule
of second order.
"""


WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM = 640, 400, 70, 20, 20, 50
COLOURS = ("#0072b2", "#d55e00", "#009e73")


def figure(found: dict[str, Convergence]) -> str:
    """A plot with two logarithmic axes, as SVG."""
    errors = [e for c in found.values() for e in (c.error_rad, c.midpoint_error_rad)]
    lowest = math.floor(math.log10(min(e.min() for e in errors)))
    highest = math.ceil(math.log10(max(e.max() for e in errors)))
    first, last = math.log10(RATES_HZ[0]), math.log10(RATES_HZ[-1])

    def x(rate_hz: float) -> float:
        return LEFT + (math.log10(rate_hz) - first) / (last - first) * (WIDTH - LEFT - RIGHT)

    def y(error_rad: float) -> float:
        share = (highest - math.log10(error_rad)) / (highest - lowest)
        return TOP + share * (HEIGHT - TOP - BOTTOM)

    parts = []
    for rate_hz in RATES_HZ:
        at = f"{x(rate_hz):.1f}"
        parts.append(f'<line x1="{at}" x2="{at}" y1="{TOP}" y2="{HEIGHT - BOTTOM}" stroke="#ddd"/>')
        parts.append(f'<text x="{at}" y="{HEIGHT - BOTTOM + 18}" text-anchor="middle">{rate_hz}</text>')
    for power in range(lowest, highest + 1):
        at = f"{y(10.0**power):.1f}"
        parts.append(f'<line x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{at}" y2="{at}" stroke="#ddd"/>')
        parts.append(f'<text x="{LEFT - 8}" y="{at}" dy="4" text-anchor="end">1e{power}</text>')
    for i, ((name, convergence), colour) in enumerate(zip(found.items(), COLOURS, strict=True)):
        points = [(x(r), y(e)) for r, e in zip(RATES_HZ, convergence.error_rad, strict=True)]
        line = " ".join(f"{px:.1f},{py:.1f}" for px, py in points)
        cheap = " ".join(
            f"{x(r):.1f},{y(e):.1f}" for r, e in zip(RATES_HZ, convergence.midpoint_error_rad, strict=True)
        )
        parts.append(f'<path d="M {cheap}" fill="none" stroke="{colour}" stroke-dasharray="5 4"/>')
        parts.append(f'<polyline points="{line}" fill="none" stroke="{colour}" stroke-width="2"/>')
        parts += [f'<circle cx="{px:.1f}" cy="{py:.1f}" r="3" fill="{colour}"/>' for px, py in points]
        label = f"{name}, order {convergence.order:.2f}"
        parts.append(
            f'<text x="{LEFT + 20}" y="{HEIGHT - BOTTOM - 60 + 18 * i}" fill="{colour}">{label}</text>'
        )
    parts.append(
        f'<text x="{(LEFT + WIDTH - RIGHT) / 2}" y="{HEIGHT - 10}" text-anchor="middle">rate, Hz</text>'
    )
    middle = (TOP + HEIGHT - BOTTOM) / 2
    parts.append(
        f'<text x="16" y="{middle}" text-anchor="middle" transform="rotate(-90 16 {middle})">rad</text>'
    )
    body = "\n".join(parts)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="sans-serif" '
        f'font-size="13">\n<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>\n{body}\n</svg>\n'
    )


def main() -> None:
    found = {name: converge(motion) for name, motion in motions().items()}
    (RESULTS / "convergence.md").write_text(page(found), encoding="utf-8")
    (RESULTS / "convergence.svg").write_text(figure(found), encoding="utf-8")
    for name, convergence in found.items():
        print(
            f"{name}: order {convergence.order:.3f}, {convergence.error_rad[-1]:.1e} rad at {RATES_HZ[-1]} Hz"
        )


if __name__ == "__main__":
    main()
