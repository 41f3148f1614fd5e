"""Memory that reading a file takes, as a multiple of what is read."""

import subprocess
import sys

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

NAMES = ["time_s", *(f"accel_{axis}_mps2" for axis in "xyz"), *(f"gyro_{axis}_radps" for axis in "xyz")]
ROWS = 2_000_000

SCRIPT = """
import resource, sys
import pyarrow.parquet
import imucal
_ = imucal.read
def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
before = peak()
recording = imucal.read(sys.argv[1])
print((peak() - before) / (56 * len(recording)))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the peak is in other units elsewhere")
@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_a_parquet_file_is_not_in_memory_beside_the_recording(tmp_path, kind):
    generator = np.random.default_rng(1)
    columns = [np.arange(ROWS) / 8000.0, *(generator.standard_normal(ROWS).astype(kind) for _ in range(6))]
    path = tmp_path / "run.parquet"
    parquet.write_table(pa.table(columns, names=NAMES), path)
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(path)], capture_output=True, text=True, check=True
    )
    # 1 is the recording itself; the file's bytes or its table would add 1 each.
    assert float(done.stdout) < 1.7
