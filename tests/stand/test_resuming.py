"""Runs that cannot be continued are refused with the way to keep their samples."""

import numpy as np
import pytest

import imucal
from imucal.stand.journal import Journal
from imucal.stand.resuming import interrupted_in

NAMES = ["time_s", *(f"accel_{axis}_mps2" for axis in "xyz"), *(f"gyro_{axis}_radps" for axis in "xyz")]


def test_a_run_without_the_zero_of_its_motors_is_not_continued(tmp_path):
    with Journal(tmp_path / "run.csv.journal", NAMES, {"driver": "simulated", "resume": {}}) as journal:
        journal.samples(np.zeros((5, len(NAMES))), 0.0)
    with pytest.raises(imucal.InputError, match=r"is not one of a GRBL stand.*imucal stand recover"):
        interrupted_in(tmp_path)
