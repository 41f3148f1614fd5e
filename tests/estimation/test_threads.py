"""What is shared out to all processors: it changes no bit of a result."""

import json
import os
import subprocess
import sys

import pytest

import imucal

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="a process cannot be kept to one processor"),
    pytest.mark.skipif(len(getattr(os, "sched_getaffinity", lambda _: [0])(0)) < 2, reason="one processor"),
    pytest.mark.slow,
]

CALIBRATED = """
def found(recording):
    result = imucal.calibrate(recording, joint={joint})
    assert len(result.moves) == 30
    return [(p.value.hex(), p.std.hex()) for p in result.parameters], result.calibration.covariance.tolist()
"""
# With an effect that needs the attitude, which is known from one move to the next.
WITH_EFFECTS = """
def found(recording):
    result = imucal.calibrate(recording, effects=["gyro_scale_cubic", "earth_rate"])
    return [(p.value.hex(), p.std.hex()) for p in result.parameters], result.calibration.covariance.tolist()
"""
SEARCHED = """
def found(recording):
    document = imucal.find_gap(recording).to_dict()
    assert document["ranking"] and document["verdict"] == "named"
    document["provenance"].pop("date")
    return document
"""


def on_processors(count, folder, function):
    """What a process says that may run on so many processors."""
    program = f"""
import json, os, sys
os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:{count}])
import imucal
{function}
print(json.dumps(found(imucal.read(sys.argv[1])), default=str))
"""
    command = [sys.executable, "-c", program, str(folder / "run.parquet")]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def same_on_all(folder, function):
    one, two = (on_processors(count, folder, function) for count in (1, 2))
    assert one == two


@pytest.mark.parametrize("joint", [True, False])
def test_processors_change_no_bit_of_a_calibration(joint, tmp_path):
    # 600,000 samples in moves; without effects fewer are not shared out.
    program = imucal.Program.random(seed=1, moves=30, hold_s=1.5, move_s=2.0)
    imucal.write(imucal.simulate(program, rate_hz=10_000.0, seed=1).recording, tmp_path / "run.parquet")
    same_on_all(tmp_path, CALIBRATED.format(joint=joint))


@pytest.mark.parametrize("function", [WITH_EFFECTS, SEARCHED], ids=["effects", "search"])
def test_processors_change_no_bit_with_effects(function, tmp_path):
    program = imucal.Program.random(seed=2, moves=30, hold_s=3.0, move_s=2.0)
    effects = {"gyro_scale_cubic": [4e-4, -3e-4, 5e-4]}
    run = imucal.simulate(program, rate_hz=400.0, seed=3, effects=effects)
    imucal.write(run.recording, tmp_path / "run.parquet")
    same_on_all(tmp_path, function)
