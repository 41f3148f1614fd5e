"""Time and memory from 1e5 to 1e8 samples, and for an hour at 8 kHz from a file: to docs/results/speed.md.

Every figure is measured in a new process, so that its peak memory is known: the maximum resident memory minus
the resident memory before the data are loaded.

    --most 1e7   largest number of samples; 1e8 samples need 5.6 GB, and twice that for their simulation
"""

import argparse
import json
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from compare import REPORT
from peak_memory import peak_bytes, reset_peak
from sections import machine_name, write_section

# Samples, rate in Hz, moves: each row has ten times the motion, the last one the same motion at a higher
# rate.
SIZES = ((1e5, 1000.0, 18), (1e6, 1000.0, 180), (1e7, 1000.0, 1800), (1e8, 10_000.0, 1800))
# A recording so small that its calibration needs little more memory than the library itself.
SMALL = (1e4, 100.0, 18)
# Smaller sample types, and counts per SI unit for integer types.
TYPES = {"float32": None, "int16": 1000.0}
OF_TYPES = (1e7, 1000.0, 1800)
HOUR = (28_800_000, 8000.0, 650)
MOST_TIMES, MOST_MEMORY = 10.5, 1.2
MOST_READ, MOST_READ_MEMORY = 3.0, 2.0
COLUMNS = ("time_s", "specific_force", "angular_rate")
MOVE_S = 2.0
ROUNDS = 3


def now_bytes() -> int:
    """Current resident memory, bytes."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


# --- work of the processes ---


def simulate(
    folder: Path, samples: int, rate_hz: float, moves: int, parquet: bool, kind: str = "float64"
) -> dict[str, float]:
    """A simulated run as a Parquet file, or as NumPy files, with force and rate in a given type."""
    import imucal

    # The number of samples exceeds the number of intervals by one, and a program has a maximum length.
    hold_s = ((samples - 1) / rate_hz - MOVE_S * moves) / (moves + 1)
    program = imucal.Program.random(seed=1, moves=moves, max_rate_dps=60.0, move_s=MOVE_S, hold_s=hold_s)
    recording = imucal.simulate(program, rate_hz=rate_hz, seed=1).recording
    if parquet:
        imucal.write(recording, folder / "hour.parquet")
    else:
        np.save(folder / "time_s.npy", recording.time_s[:samples])
        per_si = TYPES.get(kind)
        for name in COLUMNS[1:]:
            values = getattr(recording, name)[:samples]
            np.save(folder / f"{name}.npy", (values if per_si is None else values * per_si).astype(kind))
        units = {} if per_si is None else {"accel_unit": "lsb", "gyro_unit": "lsb"}
        (folder / "units.json").write_text(json.dumps(units))
    return {"samples": min(len(recording), samples)}


def calibrate_arrays(folder: Path, small: str | None = None) -> dict[str, float]:
    """The first calibration in a process, or a later one after that of a small recording."""
    import imucal

    def recording_in(place: Path) -> imucal.Recording:
        arrays = [np.load(place / f"{name}.npy") for name in COLUMNS]
        return imucal.Recording(*arrays, **json.loads((place / "units.json").read_text()))

    if small is not None:
        imucal.calibrate(recording_in(Path(small)), joint=False)
    recording = recording_in(folder)
    size = sum(np.asarray(getattr(recording, name)).nbytes for name in COLUMNS)
    reset_peak()
    before = now_bytes() - size
    start = time.perf_counter()
    result = imucal.calibrate(recording, joint=False)
    took_s, peak = time.perf_counter() - start, peak_bytes() - before
    return {"s": took_s, "memory": peak / size, "beyond_mb": (peak - size) / 1e6, "moves": len(result.moves)}


def calibrate_file(folder: Path) -> dict[str, float]:
    import imucal

    _ = imucal.calibrate, imucal.read
    before, start = now_bytes(), time.perf_counter()
    recording = imucal.read(folder / "hour.parquet")
    read_s = time.perf_counter() - start
    imucal.calibrate(recording)
    size = 56 * len(recording)
    return {"s": time.perf_counter() - start, "read_s": read_s, "memory": (peak_bytes() - before) / size}


def read_file(folder: Path) -> dict[str, float]:
    from pyarrow import parquet

    before, start = now_bytes(), time.perf_counter()
    table = parquet.read_table(folder / "hour.parquet")
    arrays = [column.to_numpy() for column in table.columns]
    size = sum(array.nbytes for array in arrays)
    return {"s": time.perf_counter() - start, "memory": (peak_bytes() - before) / size}


WORK = {
    "simulate": simulate,
    "calibrate_arrays": calibrate_arrays,
    "calibrate_file": calibrate_file,
    "read_file": read_file,
}


# --- report ---


def in_process(work: str, *arguments: object) -> dict[str, float]:
    """The result of a function of `WORK` in a new process."""
    command = [sys.executable, __file__, "--work", work, json.dumps([str(arguments[0]), *arguments[1:]])]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return json.loads(done.stdout.splitlines()[-1])


def median_of(found: list[dict[str, float]], key: str) -> float:
    return statistics.median(each[key] for each in found)


def verdict(value: float, most: float) -> str:
    return "met" if value <= most else "missed"


def calibrations(
    samples: float, rate_hz: float, moves: int, kind: str = "float64"
) -> tuple[list[dict[str, float]], list[dict[str, float]]]:
    """Results of `calibrate_arrays` in several processes, for the first calibration and for a later one."""
    with tempfile.TemporaryDirectory() as name:
        folder, small = Path(name) / "own", Path(name) / "small"
        folder.mkdir()
        small.mkdir()
        in_process("simulate", folder, int(samples), rate_hz, moves, False, kind)
        in_process("simulate", small, int(SMALL[0]), *SMALL[1:], False)
        first = [in_process("calibrate_arrays", folder) for _ in range(ROUNDS)]
        return first, [in_process("calibrate_arrays", folder, str(small)) for _ in range(ROUNDS)]


def most_of(found: list[dict[str, float]], key: str) -> float:
    return max(each[key] for each in found)


def growth(most: float) -> str:
    rows, before = [], None
    for wanted, rate_hz, moves in SIZES:
        if wanted > most:
            rows.append(f"| {wanted:.0e} | {rate_hz:.0f} | | | | | | | not run |")
            continue
        found, later = calibrations(wanted, rate_hz, moves)
        took, memory = median_of(found, "s"), most_of(later, "memory")
        times = "" if before is None else f"{took / before:.1f}"
        fine = memory <= MOST_MEMORY and (before is None or took / before <= MOST_TIMES)
        rows.append(
            f"| {wanted:.0e} | {rate_hz:.0f} | {found[0]['moves']:.0f} | {1e3 * took:.1f} | {times} "
            f"| {most_of(found, 'memory'):.2f} | {memory:.2f} | {most_of(later, 'beyond_mb'):.1f} "
            f"| {'met' if fine else 'missed'} |"
        )
        before = took
    return "\n".join(rows)


def types() -> str:
    """Rows for recordings with sample types other than float64."""
    rows = []
    for kind in TYPES:
        found, later = calibrations(*OF_TYPES, kind)
        memory, beyond_mb = (most_of(later, key) for key in ("memory", "beyond_mb"))
        rows.append(f"| {kind} | {1e3 * median_of(found, 's'):.1f} | {memory:.2f} | {beyond_mb:.1f} |")
    return "\n".join(rows)


def hour() -> str:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        in_process("simulate", folder, *HOUR, True)
        megabytes = (folder / "hour.parquet").stat().st_size / 1e6
        rounds = [
            (in_process("read_file", folder), in_process("calibrate_file", folder)) for _ in range(ROUNDS)
        ]
    peer, ours = [each for each, _ in rounds], [each for _, each in rounds]
    arrow_s, read_s, took = median_of(peer, "s"), median_of(ours, "read_s"), median_of(ours, "s")
    memory = most_of(ours, "memory")
    return f"""
The last table is for one hour at 8 kHz ({HOUR[0]:,} samples) from a Parquet file of {megabytes:.0f}
MB, on all processors.

| | s | times pyarrow | peak, times the data |
|---|---:|---:|---:|
| pyarrow: the file into NumPy arrays | {arrow_s:.2f} | 1.0 | {most_of(peer, "memory"):.2f} |
| `imucal.read`, with the file's hash | {read_s:.2f} | {read_s / arrow_s:.1f} | |
| `imucal.calibrate(imucal.read(...))`, jointly | {took:.2f} | {took / arrow_s:.1f} | {memory:.2f} |

The aim of at most {MOST_READ:g} times the time is {verdict(took / arrow_s, MOST_READ)}. The aim of at
most {MOST_READ_MEMORY:g} times the memory is {verdict(memory, MOST_READ_MEMORY)}.
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--most", type=float, default=1e7)
    parser.add_argument("--work", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.work:
        work, arguments = options.work
        folder, *others = json.loads(arguments)
        print(json.dumps(WORK[work](Path(folder), *others)))
        return
    first, _ = calibrations(*SMALL)
    once_mb = most_of(first, "beyond_mb")
    body = f"""
{machine_name()}. The times are those from arrays in memory to 21 parameters with standard deviations,
by the two-stage fit. Each row has ten times the samples of the previous one: more moves, and in the
last row a higher sampling rate. Times are medians over {ROUNDS} processes, for the first calibration of a
process. Peak memory is the maximum over {ROUNDS} processes, for the first calibration, and for a later one
after a small calibration has loaded the code of the library.

| samples | Hz | moves | ms | times above | peak, times the data | of a later one | beyond the data, MB | |
|---:|---:|---:|---:|---:|---:|---:|---:|---|
{growth(options.most)}

The aims are at most {MOST_TIMES:g} times the time for ten times the samples, and a peak of a later
calibration of at most {MOST_MEMORY:g} times the data. The peak of the first calibration includes memory
that each process needs once, mostly for the code of the library: a calibration of {SMALL[0]:.0e} samples,
{56e-6 * SMALL[0]:.1f} MB, needs {once_mb:.1f} MB beyond the data.

The next table is for {OF_TYPES[0]:.0e} samples with force and rate in a smaller type. No float64 copy is
made. The memory beyond the data is for the statistics of the 50 ms blocks of rest detection.

| type | ms | peak, times the data | beyond the data, MB |
|---|---:|---:|---:|
{types()}
{hour()}"""
    write_section(REPORT, "Speed", "Growth", body)


if __name__ == "__main__":
    main()
