"""Time of the integration kernels relative to a plain sum: section "Kernels" of docs/results/speed.md."""

import json
import re
import shutil
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
# Largest time relative to a plain sum, by vector width of the processor.
AIMS = {
    ("Avx512", "rotation, even steps"): 1.7,
    ("Avx2", "rotation, even steps"): 2.2,
    ("Avx512", "rotation and 12 sums, even steps"): 2.0,
    ("Avx2", "rotation and 12 sums, even steps"): 4.5,
}
NAMES = {"Avx512": "AVX-512", "Avx2": "AVX2"}
# Numbers of samples of two runs; the difference of their instructions excludes the fixed part.
COUNTED_SAMPLES = (450_000, 900_000)


def rust_program(name: str) -> Path:
    """Build a benchmark program in Rust; returns its path."""
    command = ["cargo", "build", "--release", "--workspace", "--locked", "--bench", name]
    built = subprocess.run(
        [*command, "--message-format=json"], cwd=ROOT, check=True, capture_output=True, text=True
    )
    messages = [json.loads(line) for line in built.stdout.splitlines()]
    return Path(next(m["executable"] for m in messages if m.get("executable")))


def instructions_per_sample(program: Path, kernel: str) -> float | None:
    """Instructions per sample, counted by callgrind independently of other load; None without valgrind."""
    if shutil.which("valgrind") is None:
        return None

    def count(samples: int) -> int:
        tool = ["valgrind", "--tool=callgrind", "--callgrind-out-file=/dev/null"]
        run = subprocess.run(
            [*tool, str(program), "--once", kernel, str(samples)], check=True, capture_output=True, text=True
        )
        found = re.search(r"Collected : (\d+)", run.stderr)
        if found is None:
            raise RuntimeError(f"callgrind counted nothing: {run.stderr}")
        return int(found.group(1))

    fewer, more = COUNTED_SAMPLES
    return (count(more) - count(fewer)) / (more - fewer)


def kernel_lines(machine: str) -> list[str]:
    program = rust_program("kernels")
    pin = ["taskset", "-c", "0"] if shutil.which("taskset") else []
    printed = subprocess.run(
        [*pin, str(program), "--table"], check=True, capture_output=True, text=True
    ).stdout
    rows, met = [], []
    kernels = []
    for line in printed.splitlines():
        vectors, kernel, ns, times = line.split("\t")
        aim = AIMS.get((vectors, kernel))
        verdict = ""
        if aim is not None:
            verdict = f"{aim}: {'met' if float(times) <= aim else 'missed'}"
            met.append(float(times) <= aim)
        rows.append(f"| {NAMES[vectors]} | {kernel} | {float(ns):.2f} | {float(times):.2f} | {verdict} |")
        if kernel not in kernels:
            kernels.append(kernel)
    # The count of the plain sum, which mostly makes the samples, is subtracted from the others.
    counts = {kernel: instructions_per_sample(program, kernel) for kernel in kernels}
    base = counts.get("plain sum")
    counted = [
        f"| {kernel} | {count - base:.1f} |"
        for kernel, count in counts.items()
        if count is not None and base is not None and kernel != "plain sum"
    ]
    return [
        "Ten million gyroscope samples in 45 moves (benches/kernels.rs), on one thread. A rotation kernel",
        "integrates the readings of each move. A kernel with 12 sums also computes the sums from which the",
        "Jacobian with respect to 12 parameters follows. The plain sum of the same array shows the memory",
        "bandwidth. Times are medians of 15 interleaved rounds; each ratio is taken within one round.",
        f"{machine}, one of them used. Steps this short and uniform are summed in blocks of sixteen",
        "([how and how exactly](../decisions/0017-jacobian-sums-by-the-trapezoidal-rule.md)).",
        "",
        "| vectors | | ns per sample | times a plain sum | aim |",
        "|---|---|---:|---:|---|",
        *rows,
        "",
        f"{sum(met)} of {len(met)} aims are met.",
        "",
        "Instructions per sample beyond those of a plain sum, as callgrind counts them with 256-bit vectors,",
        "the widest that it knows; a busy machine does not change them.",
        "",
        *(
            ["| | instructions per sample |", "|---|---:|", *counted]
            if counted
            else ["valgrind is not installed here, so they were not counted."]
        ),
    ]
