"""Memory: reading a file takes what is read, once, and correcting one takes no more for a longer file.

The application object is run in a process whose memory is measured, because the installed command cannot
measure itself.
"""

import os
import subprocess
import sys

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

import imucal

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="the peak is found elsewhere"),
    pytest.mark.slow,
]

NAMES = ["time_s", *(f"accel_{axis}_mps2" for axis in "xyz"), *(f"gyro_{axis}_radps" for axis in "xyz")]
# What the libraries need once is in both.
FEW, MANY = 800_000, 2_400_000
RECORDING_BYTES = 56 * (MANY - FEW)

READ = """
import sys
import imucal
recording = imucal.read(sys.argv[1])
"""
CALIBRATE = """
import sys
import numpy as np
import imucal
force, rate = (np.load(f"{sys.argv[1]}/{name}.npy") for name in ("specific_force", "angular_rate"))
units = {"accel_unit": "lsb", "gyro_unit": "lsb"} if sys.argv[2] else {}
imucal.calibrate(imucal.Recording(np.arange(len(force)) / 2000.0, force, rate, **units))
"""
APPLY = """
from imucal.cli.app import app
try:
    app()
except SystemExit as end:
    assert not end.code
"""
# What getrusage says of a process has the peak of the one that started it in it.
PEAK = """
status = open("/proc/self/status").read()
print(1024 * int(status.split("VmHWM:")[1].split()[0]))
"""


# Arrow's own allocator keeps what was given back, as its threads happen to run: half a recording at times.
SETTINGS = os.environ | {"ARROW_DEFAULT_MEMORY_POOL": "system"}


def peak_bytes(script, *arguments):
    command = [sys.executable, "-c", script + PEAK, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=SETTINGS)
    return int(done.stdout.splitlines()[-1])


@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_a_parquet_file_is_not_in_memory_beside_the_recording(tmp_path, kind):
    def peak(rows):
        generator = np.random.default_rng(1)
        columns = [np.arange(rows) / 8000.0, *(generator.normal(size=rows).astype(kind) for _ in range(6))]
        parquet.write_table(pa.table(columns, names=NAMES), tmp_path / "run.parquet")
        return peak_bytes(READ, tmp_path / "run.parquet")

    # The file's bytes or its table would add 1 each.
    recording_bytes = (8 + 6 * np.dtype(kind).itemsize) * (MANY - FEW)
    assert peak(MANY) - peak(FEW) < 1.5 * recording_bytes


@pytest.mark.parametrize("kind", [np.float64, np.float32, np.int16])
def test_a_calibration_makes_no_copy_of_the_samples(tmp_path, kind):
    def peak(moves):
        program = imucal.Program.random(seed=1, moves=moves, hold_s=8.0, move_s=2.0)
        run = imucal.simulate(program, unit="bmi088", rate_hz=2000.0, seed=1).recording
        scale = {np.int16: 1000.0}.get(kind, 1.0)
        for name in ("specific_force", "angular_rate"):
            np.save(tmp_path / f"{name}.npy", (getattr(run, name) * scale).astype(kind))
        return len(run), peak_bytes(CALIBRATE, tmp_path, "lsb" if scale > 1 else "")

    (few, small), (many, large) = peak(20), peak(80)
    sample_bytes = 8 + 6 * np.dtype(kind).itemsize
    assert large - small < 1.3 * sample_bytes * (many - few)


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_correcting_takes_no_more_memory_for_a_longer_file(tmp_path, ending):
    triad = imucal.Triad(np.eye(3), np.zeros(3))
    imucal.Calibration(triad, triad).save(tmp_path / "unit.json")

    def peak(rows):
        random = np.random.default_rng(2).normal(size=(rows, 6))
        path = tmp_path / f"run{ending}"
        imucal.write(imucal.Recording(np.arange(rows) / 8000.0, random[:, :3], random[:, 3:]), path)
        return peak_bytes(APPLY, "apply", tmp_path / "unit.json", path, "-o", tmp_path / f"out{ending}")

    # The whole would take three times of what is added, and how far ahead a file is read is chance.
    assert peak(MANY) - peak(FEW) < RECORDING_BYTES
