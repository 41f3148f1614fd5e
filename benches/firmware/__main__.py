"""The C header, the loader and the Rust module on microcontrollers under QEMU, against `imucal apply`.

Writes docs/results/firmware.md. Needs gcc-arm-none-eabi, gcc-riscv64-unknown-elf and QEMU; the Rust module is
measured if the toolchain has the target (RUSTC_THUMB may name a compiler that has it).

    PYTHONPATH=benches python -m firmware [--samples 1000000]
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import imucal
from imucal.units import STANDARD_GRAVITY_MPS2

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
SEED = 41
WARNINGS = ("-Wall", "-Wextra", "-Wdouble-promotion", "-Wconversion", "-Werror")
# Counts per m/s^2 and per rad/s of a 16-bit sensor with 16 g and 2000 deg/s.
ACCEL_LSB = 2048 / STANDARD_GRAVITY_MPS2
GYRO_LSB = 16.4 * 180 / np.pi
TRIADS = (
    imucal.Triad(
        np.array([[0.9804, 0.0012, 0.0055], [0.0012, 0.9727, 0.0043], [0.0055, 0.0043, 0.9921]]) * ACCEL_LSB,
        [-86.0, 49.0, 81.0],
    ),
    imucal.Triad(
        np.array([[0.9771, 0.0097, -0.006], [-0.0084, 1.0309, -0.0031], [0.0087, 0.0036, 1.003]]) * GYRO_LSB,
        [-32.0, 4.0, 1.0],
    ),
)
EFFECTS = {
    "no effects": (),
    "g-sensitivity": (imucal.EffectValues("gyro_g_sensitivity", 1.7e-4 * np.linspace(1, -0.8, 9)),),
    "g-sensitivity, temperature of both biases, cubic scale": (
        imucal.EffectValues("gyro_g_sensitivity", 1.7e-4 * np.linspace(1, -0.8, 9)),
        imucal.EffectValues("gyro_bias_temperature", [2.6e-4, -2e-4, 1e-4]),
        imucal.EffectValues("accel_bias_temperature", [2e-3, -1e-3, 1.5e-3]),
        imucal.EffectValues("accel_scale_cubic", [2e-5, -1e-5, 1.5e-5]),
    ),
}


@dataclass(frozen=True)
class Target:
    """A processor under QEMU. per_tick: instructions in a tick of its counter, at 1 ns an instruction."""

    name: str
    compiler: str
    options: tuple[str, ...]
    script: str
    qemu: tuple[str, ...]
    per_tick: float
    mask: str
    rust: str | None = None


TARGETS = (
    Target(
        "Cortex-M4F",
        "arm-none-eabi",
        ("-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard"),
        "cortex-m4.ld",
        ("qemu-system-arm", "-M", "mps2-an386"),
        40.0,
        "0xFFFFFFul",
        "thumbv7em-none-eabihf",
    ),
    Target(
        "Cortex-M0+",
        "arm-none-eabi",
        ("-mcpu=cortex-m0plus", "-mthumb"),
        "cortex-m0.ld",
        ("qemu-system-arm", "-M", "microbit"),
        62.5,
        "0xFFFFFFul",
    ),
    Target(
        "RV32IMAFC",
        "riscv64-unknown-elf",
        (
            "-march=rv32imafc_zicsr",
            "-mabi=ilp32f",
            "-mcmodel=medany",
            "--specs=picolibc.specs",
            "-Wl,--no-relax",
        ),
        "rv32.ld",
        ("qemu-system-riscv32", "-M", "virt", "-bios", "none"),
        1.0,
        "0xFFFFFFFFul",
    ),
)


def samples(count: int) -> np.ndarray:
    """Rates and forces of a thrown unit, counts of 16 bits."""
    random = np.random.default_rng(SEED)
    rate, force = random.normal(0, 3, (count, 3)), random.normal(0, 12, (count, 3))
    return np.clip(np.rint(np.hstack((rate * GYRO_LSB, force * ACCEL_LSB))), -32768, 32767).astype("<i2")


def run(*command: object, folder: Path, **options: object) -> str:
    done = subprocess.run([str(c) for c in command], cwd=folder, capture_output=True, text=True, **options)
    if done.returncode != 0:
        sys.exit(f"{' '.join(map(str, command))}\n{done.stdout}{done.stderr}")
    return done.stdout


def text_bytes(target: Target, program: Path) -> int:
    table = run(f"{target.compiler}-size", program, folder=program.parent)
    return int(table.splitlines()[1].split()[0])


def rust_library(target: Target, folder: Path) -> Path | None:
    """The exported module as a static library; None without a compiler for the target."""
    if target.rust is None:
        return None
    rustc = os.environ.get("RUSTC_THUMB", "rustc")
    command = ["cargo", "build", "--quiet", "--release", "--target", target.rust]
    command += ["--manifest-path", str(HERE / "rust/Cargo.toml")]
    build = ROOT / "target/firmware"
    environment = {**os.environ, "RUSTC": rustc, "IMUCAL_EXPORT": str(folder / "unit.rs")}
    done = subprocess.run(
        [*command, "--target-dir", str(build)], env=environment, capture_output=True, text=True
    )
    if done.returncode != 0:
        print(f"{target.rust}: not built: {done.stderr.strip().splitlines()[-1:]}", file=sys.stderr)
        return None
    return build / target.rust / "release/libimucal_firmware.a"


def measure(
    target: Target, code: str, folder: Path, needs_temperature: bool, library: Path | None
) -> dict[str, float]:
    """Bytes, stack and instructions of one variant; the corrected samples are in folder/out."""
    common = [*target.options, "-Os", "-fno-tree-loop-distribute-patterns"]
    common += ["-ffunction-sections", "-fdata-sections", f"-I{folder}", f"-I{HERE}"]
    arguments = "40.0f," if needs_temperature else ""
    sizes = {}
    (folder / "empty.h").write_text(
        "static int start_correction(void) { return 0; }\n"
        "static void correct(float *rate, float *force) { (void)rate; (void)force; }\n"
    )
    for name in ("empty", code):
        for source in ("run", "bare_metal"):
            run(
                f"{target.compiler}-gcc", *common, "-std=gnu99", *(WARNINGS if source == "run" else ()),
                "-fstack-usage", f'-DCORRECT="{name}.h"', f"-DARGUMENTS={arguments}",
                f"-DTICKS={target.mask}",
                "-c", HERE / f"{source}.c", "-o", folder / f"{source}.o", folder=folder,
            )  # fmt: skip
        extra = [library] if name == "rust" else []
        run(
            f"{target.compiler}-gcc", *target.options, "-nostdlib", "-Wl,--gc-sections",
            "-T", HERE / target.script, folder / "run.o", folder / "bare_metal.o", *extra,
            "-lm", "-lc", "-lgcc",
            "-o", folder / f"{name}.elf", folder=folder,
        )  # fmt: skip
        sizes[name] = text_bytes(target, folder / f"{name}.elf")
    frames = [
        int(line.split("\t")[1])
        for line in (folder / "run.su").read_text().splitlines()
        if not re.search(r":(main|start_correction|imucal_calibration_load)\t", line)
    ]
    for name in ("out", "ticks"):
        (folder / name).unlink(missing_ok=True)
    run(
        *target.qemu, "-nographic", "-semihosting", "-icount", "shift=0", "-kernel", folder / f"{code}.elf",
        folder=folder, stdin=subprocess.DEVNULL, timeout=3600,
    )  # fmt: skip
    corrected, empty = np.fromfile(folder / "ticks", "<u8")
    count = (folder / "in").stat().st_size // 12
    return {
        "bytes": sizes[code] - sizes["empty"],
        "stack": sum(frames) if code != "rust" else float("nan"),
        "instructions": (float(corrected) - float(empty)) * target.per_tick / count,
    }


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--samples", type=int, default=1_000_000)
    parser.add_argument("--output", type=Path, default=ROOT / "docs/results/firmware.md")
    options = parser.parse_args()
    count = options.samples // 32 * 32
    missing = [
        t for target in TARGETS for t in (f"{target.compiler}-gcc", target.qemu[0]) if not shutil.which(t)
    ]
    if missing:
        sys.exit(f"not on PATH: {', '.join(sorted(set(missing)))}")
    raw = samples(count)
    rows = []
    for label, effects in EFFECTS.items():
        unit = imucal.Calibration(*TRIADS, accel_unit="lsb", gyro_unit="lsb", effects=effects)
        rec = imucal.Recording(
            np.arange(count) * 1e-3, raw[:, 3:], raw[:, :3], temperature_degc=np.full(count, 40.0),
            accel_unit="lsb", gyro_unit="lsb",
        )  # fmt: skip
        wanted = unit.apply_recording(rec)
        expected = np.hstack((wanted.angular_rate * GYRO_LSB, wanted.specific_force * ACCEL_LSB))
        needs = any("temperature" in values.name for values in effects)
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            raw.tofile(folder / "in")
            for form, file in (("c-header", "unit.h"), ("c-loader", "loader.h"), ("rust", "unit.rs")):
                imucal.export(unit, form).save(folder / file)
            blob = imucal.export(unit, "blob").binary
            numbers = ", ".join(map(str, blob))
            (folder / "blob.h").write_text(f"static const unsigned char blob[{len(blob)}] = {{{numbers}}};\n")
            for target in TARGETS:
                library = rust_library(target, folder)
                for code in ("header", "loaded", *(["rust"] if library else [])):
                    figures = measure(target, code, folder, needs, library)
                    out = np.fromfile(folder / "out", "<f4").reshape(-1, 6)
                    out = out * np.repeat([GYRO_LSB, ACCEL_LSB], 3)
                    figures["error"] = float(np.abs(out - expected).max())
                    figures["blob"] = len(blob)
                    rows.append((target.name, label, code, figures))
                    print(*rows[-1], flush=True)
    options.output.write_text(page(rows, count))


def page(rows: list[tuple[str, str, str, dict[str, float]]], count: int) -> str:
    names = {"header": "C header", "loaded": "C loader with blob", "rust": 'Rust, `opt-level = "z"`'}
    of_header = {(t, e): f["instructions"] for t, e, code, f in rows if code == "header"}
    head = (
        "processor", "effects", "code", "bytes", "stack, bytes", "instructions", "of the C header's",
        "error, lsb",
    )  # fmt: skip
    lines = [
        "# Firmware",
        "",
        f"`make firmware` corrects {count} samples of 16-bit counts (16 g, 2000 deg/s, seed {SEED}) on",
        "each processor under QEMU and compares them with `imucal apply`. The C code is compiled with `-Os`,",
        "without a warning of `-Wall -Wextra -Wdouble-promotion -Wconversion`. Bytes are code and constants,",
        "with the functions of the compiler's library that they need, less those of a program that corrects",
        "nothing. Stack is the sum of the frames of all functions of the correction (`-fstack-usage`), an",
        "upper bound. Instructions are per sample, counted by QEMU. The error is the largest difference of",
        "any component, in counts of the sensor.",
        "",
        f"| {' | '.join(head)} |",
        "|---" * len(head) + "|",
    ]
    for target, effects, code, f in rows:
        stack = "" if np.isnan(f["stack"]) else f"{f['stack']:.0f}"
        ratio = f["instructions"] / of_header[target, effects]
        lines.append(
            f"| {target} | {effects} | {names[code]} | {f['bytes']:.0f} | {stack} "
            f"| {f['instructions']:.0f} | {ratio:.2f} | {f['error']:.2g} |"
        )
    blobs = {effects: f["blob"] for _, effects, _, f in rows}
    lines += ["", "| effects | blob, bytes |", "|---|---|"]
    lines += [f"| {effects} | {size:.0f} |" for effects, size in blobs.items()]
    if not any(code == "rust" for _, _, code, _ in rows):
        lines += ["", "The Rust module was not measured: its target is not installed."]
    return "\n".join([*lines, ""])


if __name__ == "__main__":
    main()
