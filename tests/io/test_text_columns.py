"""Text tables with many columns of text, or without a row of numbers."""

import numpy as np
import pytest

import imucal
from export_files import FORCE, RATE, TIME_S, write


def test_csv_with_many_columns_of_text(tmp_path):
    names = ["time_s"] + [f"accel_{a}_mps2" for a in "xyz"] + [f"gyro_{a}_radps" for a in "xyz"]
    table = np.column_stack([TIME_S, FORCE, RATE]).tolist()
    for count in (5, 9):
        lines = [",".join([f"text {at}" for at in range(count)] + names)]
        lines += [",".join(["value"] * count + [*map(str, row)]) for row in table]
        recording = imucal.read(write(tmp_path, "run.csv", lines))
        np.testing.assert_allclose(recording.specific_force, FORCE, atol=1e-12)
        np.testing.assert_allclose(recording.angular_rate, RATE, atol=1e-12)


def test_csv_without_a_row_of_numbers_is_refused(tmp_path):
    lines = ["time_s,accel_x_g,accel_y_g,accel_z_g", "a,b,c,d", "e,f,g,h"]
    with pytest.raises(imucal.FormatError, match=r"run.csv: no line below the header .* 'a,b,c,d'"):
        imucal.read(write(tmp_path, "run.csv", lines))
