"""Altered copies of a recording as its control, and independent control recordings: `make copies`.

A copy has to be refused with `control_not_independent`, in whatever way it was altered. An independent
recording of the same unit has to be accepted, also if the same program ran on the same stand.

`--seeds N` sets the number of seeds of each alteration (20), `--pairs N` the number of independent pairs of
each condition (100). The figures go to docs/results/copies.md.
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.progress import track
from scipy import signal
from scipy.interpolate import interp1d
from scipy.spatial.transform import Rotation

import imucal
import imucal._core as _core
from engine import add_arguments, engine_of

GRAVITY_MPS2 = 9.80665
MIN_REST_S = 1.0
# First seed of the calibration runs.
FIRST_SEED = 1000
# The seeds of the control runs are the seeds of the calibration runs plus this number.
CONTROL_SEEDS = 100_000
PAGE = Path(__file__).parents[1] / "docs/results/copies.md"
# Conditions of the copies, of those in `conditions`.
COPIED = (
    "stand, the same program",
    "hand at 50 Hz",
    "hand",
    "coarse counts",
    "low-pass filter of 5 Hz",
)


@dataclass(frozen=True)
class Columns:
    """Time, s, specific force and angular rate of a recording, and random numbers for the alteration."""

    time_s: np.ndarray
    force: np.ndarray
    rate: np.ndarray
    random: np.random.Generator

    @staticmethod
    def of(recording: imucal.Recording, seed: int) -> "Columns":
        values = (recording.time_s, recording.specific_force, recording.angular_rate)
        return Columns(*(np.array(value, dtype=float) for value in values), np.random.default_rng(seed))

    def at(self, samples) -> tuple:
        return self.time_s[samples], self.force[samples], self.rate[samples]

    def map(self, change) -> tuple:
        return self.time_s, change(self.force), change(self.rate)

    def resampled(self, share: float, kind: str = "linear") -> tuple:
        """The recording at `share` times its rate, interpolated."""
        step = (self.time_s[1] - self.time_s[0]) / share
        time_s = np.arange(self.time_s[0] + 0.3 * step, self.time_s[-1], step)
        return (
            time_s,
            *(interp1d(self.time_s, rows, kind, axis=0)(time_s) for rows in (self.force, self.rate)),
        )

    def filtered(self, filter, every: int) -> tuple:
        coefficients = signal.butter(4, 0.9 / every)
        return tuple(
            rows[::every]
            for rows in (
                self.time_s,
                *(
                    filter(*coefficients, rows - rows[0], axis=0) + rows[0]
                    for rows in (self.force, self.rate)
                ),
            )
        )

    def with_noise(self, share: float) -> tuple:
        def noisy(rows):
            sigma = share * np.median(np.abs(np.diff(rows, axis=0)))
            return rows + self.random.normal(scale=sigma, size=rows.shape)

        return self.map(noisy)


def digits(count: int) -> Callable:
    def rounded(rows):
        power = 10.0 ** (count - 1 - np.floor(np.log10(np.maximum(np.abs(rows), 1e-12))))
        return np.round(rows * power) / power

    return rounded


def half(copy: Columns) -> tuple:
    start = copy.random.integers(len(copy.time_s) // 2)
    return copy.at(slice(start, start + len(copy.time_s) // 2))


def without_some(copy: Columns) -> tuple:
    kept = copy.random.random(len(copy.time_s)) > 0.003
    return copy.at(kept)


ALTERATIONS: dict[str, Callable[[Columns], tuple]] = {
    "half of it": half,
    "a fifth of it": lambda c: c.at(slice(len(c.time_s) // 3, len(c.time_s) // 3 + len(c.time_s) // 5)),
    "every second sample": lambda c: c.at(slice(c.random.integers(2), None, 2)),
    "every third sample": lambda c: c.at(slice(c.random.integers(3), None, 3)),
    "single precision": lambda c: c.map(lambda rows: rows.astype(np.float32).astype(float)),
    "rounded to 3 decimals": lambda c: c.map(lambda rows: np.round(rows, 3)),
    "rounded to 4 decimals": lambda c: c.map(lambda rows: np.round(rows, 4)),
    "rounded to 3 digits": lambda c: c.map(digits(3)),
    "rounded to 4 digits": lambda c: c.map(digits(4)),
    "1e-12 added": lambda c: c.map(lambda rows: rows + 1e-12),
    "another bias": lambda c: (c.time_s, c.force + 0.1, c.rate - 0.01),
    "shifted in time": lambda c: (c.time_s + c.random.uniform(0.1, 30), c.force, c.rate),
    "begins later": lambda c: c.at(slice(c.random.integers(1, 300), None)),
    "0.8 times the rate": lambda c: c.resampled(0.8),
    "0.937 times the rate": lambda c: c.resampled(0.937),
    "half the rate": lambda c: c.resampled(0.5),
    "1.2 times the rate, cubic": lambda c: c.resampled(1.2, "cubic"),
    "twice the rate": lambda c: c.resampled(2.0),
    "a gain of 1.001": lambda c: c.map(lambda rows: 1.001 * rows),
    "g and deg/s": lambda c: (c.time_s, c.force / GRAVITY_MPS2, np.degrees(c.rate)),
    "axes exchanged": lambda c: c.map(lambda rows: rows[:, [1, 2, 0]]),
    "gyroscope axes exchanged": lambda c: (c.time_s, c.force, c.rate[:, [1, 2, 0]]),
    "accelerometer reversed": lambda c: (c.time_s, -c.force, c.rate),
    "turned": lambda c: c.map(Rotation.from_rotvec(c.random.normal(size=3)).apply),
    "noise of a third added": lambda c: c.with_noise(0.3),
    "noise of the same size added": lambda c: c.with_noise(1.0),
    "filtered and decimated": lambda c: c.filtered(signal.lfilter, 2),
    "filtered without delay, decimated": lambda c: c.filtered(signal.filtfilt, 2),
    "samples lost": without_some,
}


def conditions() -> dict[str, Callable[[int], imucal.Recording]]:
    """One unit under each condition; the seed changes the noise, and the motion of a hand."""
    program = imucal.Program.random(seed=5)
    shaking = imucal.Stand(vibration_deg=0.01, vibration_mm=0.02, vibration_hz=21.3)

    def on_stand(seed: int, **arguments) -> imucal.Recording:
        return imucal.simulate(program, seed=seed, rate_hz=100.0, **arguments).recording

    def by_hand(seed: int, unit: str, rate_hz: float) -> imucal.Recording:
        return imucal.simulate("tumble", seed=seed, unit=unit, rate_hz=rate_hz).recording

    return {
        "stand, the same program": on_stand,
        "stand, another program": lambda seed: imucal.simulate("random", seed=seed, rate_hz=100.0).recording,
        "stand that vibrates": lambda seed: on_stand(seed, stand=shaking),
        "stand and hum of 12.5 Hz": lambda seed: with_hum(on_stand(seed)),
        "hand": lambda seed: by_hand(seed, "bmi088", 100.0),
        "hand at 50 Hz": lambda seed: by_hand(seed, "mpu6050", 50.0),
        "coarse counts": lambda seed: rounded(on_stand(seed), 0.05, 0.01),
        "coarser counts": lambda seed: rounded(on_stand(seed), 0.3, 0.05),
        "low-pass filter of 5 Hz": lambda seed: on_stand(seed, unit="mpu6050", filter_hz=5.0),
        "one knock": lambda seed: with_knock(on_stand(seed), seed),
        "single wrong samples": lambda seed: with_wrong_samples(on_stand(seed), seed, 3e-4),
        "frequent wrong samples": lambda seed: with_wrong_samples(on_stand(seed), seed, 1e-3),
    }


def with_hum(recording: imucal.Recording) -> imucal.Recording:
    """A periodic vibration with harmonics, with the same phase in every recording, ten times the noise."""
    columns = Columns.of(recording, 0)
    harmonics = np.arange(1, 6)
    wave = (np.sin(2 * np.pi * 12.5 * np.outer(columns.time_s, harmonics)) / harmonics).sum(axis=1)
    force, rate = np.outer(wave, [0.05, 0.025, 0.015]), np.outer(wave, [0.003, 0.01, 0.005])
    return imucal.Recording(columns.time_s, columns.force + force, columns.rate + rate, name=recording.name)


def with_knock(recording: imucal.Recording, seed: int) -> imucal.Recording:
    """One knock at a random rest: a damped oscillation of 18 Hz, four to sixteen times the noise."""
    columns = Columns.of(recording, seed)
    wave = np.exp(-columns.time_s / 0.1) * np.sin(2 * np.pi * 18.0 * columns.time_s)
    wave[columns.time_s > 1.0] = 0.0
    first, last = columns.random.choice(rests(recording))
    start = columns.random.integers(first, last - np.count_nonzero(columns.time_s <= 1.0))
    wave = columns.random.uniform(4.0, 16.0) * np.roll(wave, start)

    def knocked(rows: np.ndarray, direction: list[float]) -> np.ndarray:
        return rows + noise_of(rows) * np.outer(wave, direction)

    force, rate = knocked(columns.force, [1.0, 0.6, 0.3]), knocked(columns.rate, [0.4, 1.0, 0.7])
    return imucal.Recording(columns.time_s, force, rate, name=recording.name)


def with_wrong_samples(recording: imucal.Recording, seed: int, share: float) -> imucal.Recording:
    """This share of the samples differs by twenty times the noise, as after errors of transmission."""
    columns = Columns.of(recording, seed)

    def wrong(rows: np.ndarray) -> np.ndarray:
        is_wrong = columns.random.random((len(rows), 1)) < share
        return rows + is_wrong * columns.random.normal(scale=20.0 * noise_of(rows), size=rows.shape)

    return imucal.Recording(*columns.map(wrong), name=recording.name)


def noise_of(rows: np.ndarray) -> float:
    """Standard deviation of a sample, from the median difference of successive samples."""
    return float(np.median(np.abs(np.diff(rows, axis=0))) / (0.6745 * np.sqrt(2.0)))


def rounded(recording: imucal.Recording, force_mps2: float, rate_radps: float) -> imucal.Recording:
    columns = Columns.of(recording, 0)
    force, rate = np.round(columns.force / force_mps2), np.round(columns.rate / rate_radps)
    return imucal.Recording(columns.time_s, force * force_mps2, rate * rate_radps, name=recording.name)


def altered(recording: imucal.Recording, alteration: str, seed: int) -> imucal.Recording:
    return imucal.Recording(*ALTERATIONS[alteration](Columns.of(recording, seed)), name="copy")


def common_noise(recording: imucal.Recording, control: imucal.Recording) -> float | None:
    """The correlation of a refused control recording in standard deviations; None if it is accepted."""
    try:
        _core.require_independent([recording], [rests(recording)], [control], [rests(control)])
    except imucal.InputError as error:
        (finding,) = error.findings
        assert finding.code == "control_not_independent", str(finding)
        return float(finding.value)
    return None


def rests(recording: imucal.Recording) -> list[tuple[int, int]]:
    """Rests in units of the altered copy: their first sample, and the sample after the last."""
    found = _core.inspect(recording, GRAVITY_MPS2, MIN_REST_S).rests
    return [
        (int(np.searchsorted(recording.time_s, start)), int(np.searchsorted(recording.time_s, end)) + 1)
        for start, end, _ in found
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--pairs", type=int, default=100)
    add_arguments(parser)
    given = parser.parse_args()
    of_pairs = [(name, FIRST_SEED + run) for name in conditions() for run in range(given.pairs)]
    of_copies = [
        (name, alteration, FIRST_SEED + run)
        for name in COPIED
        for alteration in ALTERATIONS
        for run in range(given.seeds)
    ]
    pairs: dict[str, list[float | None]] = {}
    copies: dict[tuple[str, str], list[float | None]] = {}
    with engine_of(given, "copies") as engine:
        found = engine.map(of_pair, of_pairs, name="pairs")
        for (name, _), sigmas in zip(of_pairs, track(found, "independent pairs", len(of_pairs)), strict=True):
            pairs.setdefault(name, []).append(sigmas)
        found = engine.map(of_copy, of_copies, name="copies")
        for (*key, _), sigmas in zip(of_copies, track(found, "copies", len(of_copies)), strict=True):
            copies.setdefault(tuple(key), []).append(sigmas)
    judged = {name: Refused.among(found) for name, found in pairs.items()}
    of_each = {key: Refused.among(found) for key, found in copies.items()}
    PAGE.write_text(page(judged, of_each), encoding="utf-8")
    engine.publish(PAGE)
    print(f"written to {PAGE}")


def calls() -> dict[str, Callable[..., float | None]]:
    """The functions of independent pairs and of altered copies, which take their names and a seed."""
    return {"pairs": of_pair, "copies": of_copy}


def of_pair(asked: tuple[str, int]) -> float | None:
    """`common_noise` of two independent recordings of a condition."""
    name, seed = asked
    make = conditions()[name]
    return common_noise(make(seed), make(seed + CONTROL_SEEDS))


def of_copy(asked: tuple[str, str, int]) -> float | None:
    """`common_noise` of a recording and its altered copy."""
    name, alteration, seed = asked
    run = conditions()[name](seed)
    return common_noise(run, altered(run, alteration, seed))


@dataclass(frozen=True)
class Refused:
    """Number of refused recordings among all, and the smallest correlation of a refused one."""

    count: int
    of: int
    least_sigmas: float | None

    @staticmethod
    def among(found: list[float | None]) -> "Refused":
        known = [sigmas for sigmas in found if sigmas is not None]
        return Refused(len(known), len(found), min(known, default=None))


def page(pairs: dict[str, Refused], copies: dict[tuple[str, str], Refused]) -> str:
    independent = "\n".join(f"| {name} | {row.count} of {row.of} |" for name, row in pairs.items())
    rows = "\n".join(
        f"| {alteration} | {' | '.join(_cell(copies[name, alteration]) for name in COPIED)} |"
        for alteration in ALTERATIONS
    )
    total = sum(row.of for row in copies.values())
    accepted = total - sum(row.count for row in copies.values())
    return f"""# Copies of a recording as its control

Written by `make copies`. A control recording that is a copy of the calibration recording has to be refused,
in whatever way it was altered, and an independent recording has to be accepted.

## Independent recordings

| condition | refused |
|---|---:|
{independent}

## Altered copies

{accepted} of {total} copies are accepted. Each cell has the smallest correlation of a refused copy with the
recording, in standard deviations, and the number of refused copies if it is not the number of all. Coarse
counts have steps of 0.05 m/s^2 and 0.01 rad/s. Rounding then removes most of the noise by which a copy is
recognised.

| alteration | {" | ".join(COPIED)} |
|---|{"---:|" * len(COPIED)}
{rows}
"""


def _cell(row: Refused) -> str:
    least = "" if row.least_sigmas is None else f"{row.least_sigmas:.0f}"
    return least if row.count == row.of else f"{least} (**{row.count} of {row.of}**)"


if __name__ == "__main__":
    main()
