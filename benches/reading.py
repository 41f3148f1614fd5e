"""Time and memory of reading CSV files, beside pyarrow and polars: `make bench`, to docs/results/speed.md."""

import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import csv

from compare import REPORT
from sections import machine_name, write_section

RATE_HZ = 200.0
# Rows of the files: an hour, and a minute.
SIZES = {"1 h": 720_000, "1 min": 12_000}
ROUNDS = {"1 h": 5, "1 min": 15}
NAMES = ("time_s", *(f"accel_{axis}_mps2" for axis in "xyz"), *(f"gyro_{axis}_radps" for axis in "xyz"))
READERS = {
    "pyarrow": "from pyarrow import csv\nread = csv.read_csv",
    "polars": "import polars\nread = polars.read_csv",
    "imucal": "import imucal\nread = imucal.read",
}
# Times of a reader in a process of its own: the first reading, and the median of later ones.
PROGRAM = """
import json, statistics, sys, time
READER
def timed():
    wall, cpu = time.perf_counter(), time.process_time()
    kept = read(sys.argv[1])
    return time.process_time() - cpu, time.perf_counter() - wall
def peak():
    # The peak of resource.getrusage would include that of the program that started this one.
    words = next(line for line in open("/proc/self/status") if line.startswith("VmHWM")).split()
    return int(words[1]) * 1024
read(sys.argv[3])
loaded = peak()
first = timed()
grown = peak() - loaded
later = [timed() for _ in range(int(sys.argv[2]))]
print(json.dumps({"cpu_s": statistics.median(row[0] for row in later),
    "wall_s": statistics.median(row[1] for row in later), "memory": grown}))
"""
COLD = "import sys\nREADER\nread(sys.argv[1])"
AIM, MEMORY_AIM = 1.3, 2.0


def write_file(path: Path, rows: int) -> None:
    """A recording with all digits of its numbers."""
    chance = np.random.default_rng(rows)
    force = np.array([0.4, -0.3, 9.78]) + chance.normal(scale=0.02, size=(rows, 3))
    columns = [np.arange(rows) / RATE_HZ, *force.T, *chance.normal(scale=0.01, size=(3, rows))]
    csv.write_csv(pa.table(columns, names=list(NAMES)), path)


def warm(reader: str, path: Path, small: Path, processors: set[int]) -> dict[str, float]:
    """Times of a later reading in the same process, and the growth of its memory by the first one."""
    program = PROGRAM.replace("READER", READERS[reader])
    return json.loads(_run([sys.executable, "-c", program, str(path), "3", str(small)], processors)[0])


def cold(reader: str, path: Path, processors: set[int]) -> float:
    """Processor time of a whole process that reads a file, s."""
    return _run([sys.executable, "-c", COLD.replace("READER", READERS[reader]), str(path)], processors)[1]


def _run(command: list[str], processors: set[int]) -> tuple[str, float]:
    """The output of a command, and its processor time, s."""
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, preexec_fn=lambda: os.sched_setaffinity(0, processors)
    )
    assert process.stdout is not None
    output = process.stdout.read().decode()
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(f"{command[2][:100]} ended with {status}")
    return output, usage.ru_utime + usage.ru_stime


def measure(path: Path, small: Path, rounds: int, processors: set[int]) -> dict[str, dict[str, float]]:
    """Medians over interleaved rounds, and medians of the ratio to pyarrow within a round, by reader."""
    rows: dict[str, list[dict[str, float]]] = {reader: [] for reader in READERS}
    for turn in range(rounds + 1):
        for reader in READERS:
            row = warm(reader, path, small, processors) | {"cold_s": cold(reader, path, processors)}
            if turn > 0:  # the first round fills the file cache
                rows[reader].append(row)
    found = {}
    for reader, measured in rows.items():
        found[reader] = {key: statistics.median(row[key] for row in measured) for key in measured[0]}
        for key in ("cpu_s", "wall_s", "cold_s"):
            ratios = [row[key] / other[key] for row, other in zip(measured, rows["pyarrow"], strict=True)]
            found[reader][f"{key} ratio"] = statistics.median(ratios)
    return found


def main() -> None:
    cores = sorted(os.sched_getaffinity(0))[:2]
    lines, verdicts = [], []
    with tempfile.TemporaryDirectory() as folder:
        paths = {name: Path(folder) / f"{rows}.csv" for name, rows in SIZES.items()}
        for name, rows in SIZES.items():
            write_file(paths[name], rows)
        small = paths["1 min"]
        for name, path in paths.items():
            for count in sorted({1, len(cores)}):
                runs = [measure(path, small, ROUNDS[name], set(cores[:count])) for _ in range(2)]
                for reader in READERS:
                    first, second = (run[reader] for run in runs)
                    data = SIZES[name] * len(NAMES) * 8
                    memory = f"{first['memory'] / data:.2f}" if name == "1 h" else ""
                    lines.append(
                        f"| {name}, {path.stat().st_size / 1e6:.1f} MB | {count} | {reader} | "
                        f"{1e3 * first['cpu_s']:.1f} | {first['cpu_s ratio']:.2f} | "
                        f"{second['cpu_s ratio']:.2f} | {first['wall_s ratio']:.2f} | "
                        f"{second['wall_s ratio']:.2f} | "
                        f"{1e3 * first['cold_s']:.0f} | {first['cold_s ratio']:.2f} | {memory} |"
                    )
                ours = runs[0]["imucal"]
                is_met = max(ours["cpu_s ratio"], ours["wall_s ratio"]) <= AIM
                is_small = name != "1 h" or ours["memory"] <= MEMORY_AIM * SIZES[name] * len(NAMES) * 8
                verdicts.append(f"{name}, {count}: {'met' if is_met and is_small else 'missed'}")
    table = "\n".join(lines)
    body = f"""
{machine_name()}. CSV files with seven columns of up to 17 digits at {RATE_HZ:g} Hz. pyarrow and polars give a
table; `imucal.read` gives a recording and the SHA-256 of the file. Each row is a median over interleaved
rounds, each in new processes; ratios are taken within a round, for two runs of the benchmark. Warm: later
readings in a process. Cold: a whole process with its imports. Memory: growth of the peak by the first
reading, times the size of the recording in memory.

| file | processors | reader | warm, ms of processor | times pyarrow | again | elapsed, times pyarrow \
| again | cold, ms of processor | times pyarrow | memory |
|---|---:|---|---:|---:|---:|---:|---:|---:|---:|---:|
{table}

The aim is at most {AIM:g} times the warm time of pyarrow and {MEMORY_AIM:g} times the memory of the data.
{"; ".join(verdicts)}.
"""
    write_section(REPORT, "Speed", "Reading", body)


if __name__ == "__main__":
    main()
