"""Computing time of Allan deviations compared with allantools: `make bench`, to docs/results/noise.md."""

import os

# Set before NumPy is imported, because its linear algebra reads these variables at import.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import platform
from importlib.metadata import version

import allantools
import numpy as np

import imucal
from compare import ROOT, medians_ms
from sections import machine_name, write_section

REPORT = ROOT / "docs" / "results" / "noise.md"
SECTION = "Speed of the Allan deviation"
SAMPLES = 10_000_000
TAUS = 30
ROUNDS = 3
AIM = 8.0


def main() -> None:
    rate_hz = 200.0
    values = 9.80665 + 1e-2 * np.random.default_rng(1).standard_normal(SAMPLES)
    factors = np.unique(np.round(np.geomspace(1, SAMPLES / 3, TAUS + 2)))[:TAUS]
    taus_s = factors / rate_hz

    def peer() -> tuple[np.ndarray, np.ndarray]:
        return allantools.oadev(values, rate=rate_hz, data_type="freq", taus=taus_s)[:2]

    functions = {
        "allantools.oadev": peer,
        "imucal.allan_deviation, one thread": lambda: imucal.allan_deviation(
            values, rate_hz, taus_s, threads=1
        ),
        "imucal.allan_deviation, two threads": lambda: imucal.allan_deviation(
            values, rate_hz, taus_s, threads=2
        ),
    }
    expected = peer()[1]
    apart = max(np.max(np.abs(function()[1] / expected - 1)) for function in functions.values())
    ms = medians_ms(functions, ROUNDS)
    slowest = ms["allantools.oadev"]
    rows = [f"| {name} | {value:.0f} | {slowest / value:.1f} |" for name, value in ms.items()]
    single = slowest / ms["imucal.allan_deviation, one thread"]
    programs = f"NumPy {np.__version__}, allantools {version('allantools')}, imucal {imucal.__version__}"
    body = f"""
Written by `make bench`. {machine_name()}. {platform.system()}, Python {platform.python_version()},
{programs}. Overlapping Allan deviations of {SAMPLES:,}
samples at the same {len(factors)} averaging times, medians of {ROUNDS} interleaved rounds in one process.

| | ms | times as fast as allantools |
|---|---:|---:|
{chr(10).join(rows)}

The largest relative difference of any deviation is {apart:.0e}. The aim on one thread,
{AIM:.0f} times as fast, is {"met" if single >= AIM else "missed"}.
"""
    write_section(REPORT, "Noise", SECTION, body)


if __name__ == "__main__":
    main()
