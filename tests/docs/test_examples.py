"""The examples run, and print what they promise."""

import re
import subprocess
from pathlib import Path

import pytest

from children import HANGS_S

pytestmark = pytest.mark.slow

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
PROMISED = {
    "calibrate_arrays.py": ["verdict: good", "gyro_sensitivity_zz"],
    "find_the_missing_effect.py": [
        r"gyro_g_sensitivity \(largest parameter 0\.10\d ± 0\.00\d deg/s per g\)",
        r"rest_rate x: 1[23]\.\d -> 1\.\d x noise",
        r"claimed: 5\.\d times smaller",
        "detection limit in these recordings",
    ],
    "judge_and_apply.py": ["verdict: good", r"calibrated:   0\.0\d\d deg", r"\|f\| at rest: 9\.80\d\d"],
    "openhtf_station.py": ["0007 PASS", "gyro_bias_y PASS -0.016", "verdict PASS", r"\['0007.json'\]"],
    "own_effect.py": [r"after: 0\.03\d deg", r"gyro_bias_supply_x: 0\.0(19|20)\d+ \+- 0\.0002"],
    "simulate_your_program.py": ["on the stand, 25 rests", "accel_bias_x"],
}


def test_every_example_is_tested():
    assert {path.name for path in EXAMPLES.glob("*.py")} == set(PROMISED)


@pytest.mark.parametrize("name", PROMISED)
def test_example(name, programs, tmp_path):
    done = subprocess.run(
        [programs / "python", str(EXAMPLES / name)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=HANGS_S,
    )
    assert done.returncode == 0, done.stderr
    for promised in PROMISED[name]:
        assert re.search(promised, done.stdout), done.stdout
