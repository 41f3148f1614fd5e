"""Exit code of `imucal gap` for each verdict."""

import json

import pytest

import imucal
from gap_runs import RUN_SEED, simulated
from imucal.cli import main

pytestmark = pytest.mark.slow

G_SENSITIVITY = ("--effect", "gyro_g_sensitivity")


@pytest.mark.parametrize(
    ("effects", "options", "verdict", "code"),
    [
        ({}, G_SENSITIVITY, "nothing_missing", 0),
        ({"gyro_g_sensitivity": "typical"}, G_SENSITIVITY, "named", 0),
        ({"accel_bias_drift": 5e-4}, G_SENSITIVITY, "unknown", 2),
        ({"gyro_bias_random_walk": [2e-4] * 3}, (), "stochastic", 2),
        ({"gyro_saturation": 1.5}, (), "data_fault", 1),
    ],
)
def test_the_exit_code_follows_the_verdict(effects, options, verdict, code, tmp_path, capsys):
    run = str(tmp_path / "run.parquet")
    imucal.write(simulated(RUN_SEED, effects=effects).recording, run)
    assert main(["gap", run, *options, "--json", "-"]) == code
    found = json.loads(capsys.readouterr().out)
    assert found["verdict"] == verdict
    if verdict == "stochastic":
        # A random walk is not given the name of an effect.
        assert found["effects"] == [] and found["remainder"]["matters"]
        assert (found["generic"]["block"], found["generic"]["kernel"]) == ("gyro_bias", "random_walk")
