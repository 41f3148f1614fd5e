"""The device code of `imucal-core` cannot panic: correction, integration and rest detection.

`no_std/src/no_panic.rs` has a panic handler that calls a function that does not exist. The linker drops what
is unreachable from the functions of that file, and reports the missing function if a panic is left.
"""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

# Each build overwrites the library of the one before.
pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("tests/no_std")]

ROOT = Path(__file__).resolve().parents[2]
PROOF = ROOT / "tests/no_std"
# What the compiler itself calls, and the C library of the device has.
MEMORY_ROUTINES = ("memcpy", "memmove", "memset", "memcmp", "bcmp")
CORTEX_M4F = "thumbv7em-none-eabihf"
LEVELS = ("0", "1", "2", "3", "s", "z")


def need(tool):
    path = shutil.which(tool)
    if path is None:
        pytest.fail(f"{tool} is not on PATH: this test needs cargo and binutils")
    return path


def installed(target):
    """Whether the toolchain has the core library of a target."""
    root = subprocess.run(["rustc", "--print", "sysroot"], capture_output=True, text=True, check=True).stdout
    return any((Path(root.strip()) / "lib/rustlib" / target / "lib").glob("libcore-*"))


def functions(level):
    """The functions of the proof that must not panic."""
    names = sorted(set(re.findall(r"no_panic_\w+_f(?:32|64)", (PROOF / "src/no_panic.rs").read_text())))
    # Without any optimisation, slices keep the code of checks that cannot fail; reading bytes needs slices.
    return [name for name in names if level != "0" or "_load_" not in name]


def archive(level, target=None, proof=PROOF):
    """The static library of the proof; its generic code is compiled at the given optimisation level."""
    command = [need("cargo"), "rustc", "--quiet", "--profile", "no-panic", "--locked"]
    command += ["--features", "undefined_panic", "--manifest-path", proof / "Cargo.toml"]
    command += [] if target is None else ["--target", target]
    folder = PROOF / "target"
    done = subprocess.run(
        [*command, "--", "-C", f"opt-level={level}"],
        capture_output=True,
        text=True,
        env={**os.environ, "CARGO_TARGET_DIR": str(folder)},
    )
    assert done.returncode == 0, done.stderr
    return folder / (target or "") / "no-panic" / "libimucal_no_std.a"


def link(library, level, linker="ld"):
    """What the linker says of a program of the functions alone; empty if nothing is missing."""
    roots = [f"--undefined={name}" for name in functions(level)]
    # The addresses do not matter, as the program is not run.
    stubs = [f"--defsym={name}=0" for name in MEMORY_ROUTINES]
    entry = f"--entry={functions(level)[0]}"
    command = [need(linker), "-static", "-nostdlib", "--gc-sections", *roots, entry, *stubs, library]
    done = subprocess.run([*command, "-o", os.devnull], capture_output=True, text=True)
    return "" if done.returncode == 0 else done.stderr


@pytest.mark.parametrize("level", LEVELS)
def test_the_device_code_has_no_panic(level):
    assert link(archive(level), level) == ""


@pytest.mark.parametrize("level", LEVELS)
def test_the_device_code_has_no_panic_on_a_cortex_m4f(level):
    if not installed(CORTEX_M4F):
        pytest.skip(f"rustup target add {CORTEX_M4F}")
    if shutil.which("arm-none-eabi-ld") is None:
        pytest.skip("arm-none-eabi-ld is not on PATH: install gcc-arm-none-eabi")
    assert link(archive(level, CORTEX_M4F), level, "arm-none-eabi-ld") == ""


def test_a_panic_is_found(tmp_path):
    for part in ("rust", "tests/no_std"):
        shutil.copytree(ROOT / part, tmp_path / part, ignore=shutil.ignore_patterns("target"))
    for part in ("Cargo.toml", "Cargo.lock"):
        shutil.copy(ROOT / part, tmp_path / part)
    source = tmp_path / "rust/imucal-core/src/integrate.rs"
    change = "if dt_s < F::zero() { panic!() }\n        if let Some(last_rate) = self.last_rate {"
    source.write_text(source.read_text().replace("if let Some(last_rate) = self.last_rate {", change))
    said = link(archive("z", proof=tmp_path / "tests/no_std"), "z")
    assert "imucal_panic_is_reachable" in said
