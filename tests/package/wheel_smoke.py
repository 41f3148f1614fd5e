"""Test of the wheel for other machines, run by `make wheel-manylinux` in an environment with nothing else.

The test is plain Python because pytest is not installed there. It calibrates a simulated run through the
Python interface and by the command, and compares the parameters with the truth.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import imucal

run = imucal.simulate(imucal.Program.random(seed=1, moves=20), unit="paper", rate_hz=50, seed=1)
result = imucal.calibrate(run.recording)
truth = {parameter.name: parameter.value for parameter in run.truth.calibration.parameters}
errors = [abs(p.value - truth[p.name]) / p.std for p in result.parameters if p.std and p.name in truth]
assert len(errors) == 21 and max(errors) < 5.0, errors

with tempfile.TemporaryDirectory() as folder:
    recording, saved = Path(folder, "run.csv"), Path(folder, "run.json")
    imucal.write(run.recording, recording)
    command = Path(sys.executable).with_name("imucal")
    words = [command, "calibrate", recording, "-o", saved, "--json", Path(folder, "doc")]
    subprocess.run(list(map(str, words)), check=True, stdout=subprocess.DEVNULL)
    document = json.loads(Path(folder, "doc").read_text())
    assert [p["value"] for p in document["parameters"]] == [p.value for p in result.parameters]
print(f"calibrated with Python {sys.version.split()[0]}: {imucal.__file__}")
