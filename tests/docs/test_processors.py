"""What commands print is the same with AVX2 and with AVX-512, in every digit.

The library chooses its vector instructions by the processor, so an emulator of a processor without AVX-512
runs the same commands.
"""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import imucal

pytestmark = pytest.mark.slow

EMULATOR = shutil.which("qemu-x86_64")
# A processor with AVX2 and without AVX-512.
WITHOUT_AVX512 = "Haswell"


def has_avx512():
    return "avx512f" in Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else False


@pytest.mark.skipif(EMULATOR is None, reason="qemu-x86_64 is not installed")
@pytest.mark.skipif(not has_avx512(), reason="this processor has no AVX-512, so there is one path only")
def test_the_digits_shown_do_not_depend_on_the_vector_instructions(tmp_path):
    for name, seed in (("run", 1), ("control", 2)):
        recording = imucal.simulate("random", seed=seed, rate_hz=50.0).recording
        imucal.write(recording, tmp_path / f"{name}.csv")
    command = [sys.executable, "-m", "imucal", "calibrate", "run.csv", "--control", "control.csv"]
    natively = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    emulated = subprocess.run(
        [EMULATOR, "-cpu", WITHOUT_AVX512, *command], cwd=tmp_path, capture_output=True, text=True
    )
    assert natively.returncode == emulated.returncode == 0, emulated.stderr
    assert emulated.stdout == natively.stdout
    assert natively.stdout.count("\n") > 25
