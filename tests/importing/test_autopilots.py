"""Calibrations of INAV, PX4 and ArduPilot with their thermal terms against the formulas of these programs."""

import dataclasses

import numpy as np
import pytest

import imucal
from autopilot_imports import (
    ARDUPILOT_LAYOUTS,
    AUTOPILOTS,
    COUNTS,
    PX4_LAYOUTS,
    ardupilot_corrected,
    ardupilot_values,
    inav_corrected,
    inav_text,
    plain,
    px4_corrected,
    px4_values,
)
from import_files import WARM, assert_same, assert_same_recording, same_after_a_file, written
from realsense_imports import REALSENSE


@pytest.mark.parametrize(("per_g", "per_dps"), [(None, None), (1365.0, 16.384)])
def test_inav(per_g, per_dps, tmp_path):
    path = written(tmp_path, "dump.txt", inav_text())
    calibration = imucal.read_calibration(path, accel_lsb_per_g=per_g, gyro_lsb_per_dps=per_dps)
    same_after_a_file(calibration, tmp_path)
    assert_same(calibration, *inav_corrected(per_g or 2048, per_dps or 16.4), raw=COUNTS)
    assert (calibration.accel_unit, calibration.gyro_unit, calibration.frame) == ("lsb", "lsb", "symmetric")
    imported = calibration.provenance.imported
    assert f"acc_1G is taken as {per_g or 2048:g} counts per g" in imported.notes[0]
    assert {"accel_misalignment", "gyro_scale"} <= set(
        imported.missing
    ) and "gyro_bias" not in imported.missing


def test_inav_measures_the_zero_of_the_gyroscope_at_its_start(tmp_path):
    path = written(tmp_path, "dump.txt", inav_text(init_gyro_cal="ON"))
    calibration = imucal.read_calibration(path)
    assert_same(calibration, *inav_corrected(2048, 16.4, zero=(0, 0, 0)), raw=COUNTS)
    imported = calibration.provenance.imported
    assert "gyro_bias" in imported.missing and "at each start" in imported.notes[-1]


def test_inav_settings_that_diff_does_not_list_are_defaults(tmp_path):
    path = written(tmp_path, "diff.txt", inav_text(accgain_y=None))
    calibration = imucal.read_calibration(path)
    assert_same(calibration, *inav_corrected(2048, 16.4, gain=(4180, 4096, 4137)), raw=COUNTS)
    assert any(note.startswith("accgain_y not in the file") for note in calibration.provenance.imported.notes)


def test_the_resolution_is_for_inav_only(tmp_path):
    path = written(tmp_path, "calibration.json", REALSENSE)
    with pytest.raises(imucal.InputError, match="realsense does not use the resolution"):
        imucal.read_calibration(path, accel_lsb_per_g=2048)
    with pytest.raises(imucal.InputError, match="accel_lsb_per_g is -1"):
        imucal.read_calibration(written(tmp_path, "dump.txt", inav_text()), accel_lsb_per_g=-1)


@pytest.mark.parametrize("instance", [0, 1])
@pytest.mark.parametrize("layout", PX4_LAYOUTS)
def test_px4(layout, instance, tmp_path):
    values = plain(px4_values(instance=instance))
    # The first lines of QGroundControl, and of the console.
    head = ["# Onboard parameters for Vehicle 1", "#", "# Stack: PX4 Pro", "Symbols: x = used, + = saved"]
    lines = [*head, *(PX4_LAYOUTS[layout](*item) for item in values.items())]
    path = written(tmp_path, "vehicle.params", "\n".join(lines))
    calibration = same_after_a_file(imucal.read_calibration(path, instance=instance), tmp_path)
    assert_same_recording(calibration, WARM, *px4_corrected(values, WARM, instance))
    assert calibration.temperature_range_degc == (-10.0, 70.0)


def test_px4_of_old_versions_scales_the_gyroscope(tmp_path):
    values = plain(px4_values()) | {
        f"CAL_GYRO0_{a}SCALE": v for a, v in zip("XYZ", (1.2, 0.9, 1.1), strict=True)
    }
    text = "\n".join(PX4_LAYOUTS["QGroundControl"](*item) for item in values.items())
    calibration = imucal.read_calibration(written(tmp_path, "old.params", text))
    # Module sensors of old versions: (raw - thermal - offset) * scale for the gyroscope too.
    rate, force = px4_corrected(values, WARM)
    assert_same_recording(calibration, WARM, rate * [1.2, 0.9, 1.1], force)
    assert "gyro_scale" not in calibration.provenance.imported.missing
    text += "\n" + PX4_LAYOUTS["QGroundControl"]("TC_G1_SCL_0", 1.01)
    with pytest.raises(imucal.InputError, match="TC_G1_SCL is not 1"):
        imucal.read_calibration(written(tmp_path, "older.params", text))


@pytest.mark.parametrize("instance", [0, 1, 2])
@pytest.mark.parametrize("layout", ARDUPILOT_LAYOUTS)
def test_ardupilot(layout, instance, tmp_path):
    values = plain(ardupilot_values(instance=instance))
    text = "\n".join(["#NOTE: 2026", *(ARDUPILOT_LAYOUTS[layout].format(*item) for item in values.items())])
    path = written(tmp_path, "copter.param", text)
    calibration = same_after_a_file(imucal.read_calibration(path, instance=instance), tmp_path)
    assert_same_recording(calibration, WARM, *ardupilot_corrected(values, WARM, instance))


@pytest.mark.parametrize("name", AUTOPILOTS)
def test_cubic_thermal_terms(name, tmp_path):
    """As fits of autopilots have them; they are constant at temperatures outside of their range."""
    make, formula, layout = AUTOPILOTS[name]
    values = plain(make(cubic=1e-6))
    prefix = "param set " if name == "px4" else ""
    text = "\n".join(prefix + layout.format(n, repr(v)) for n, v in values.items())
    path = written(tmp_path, "cubic.param", text)
    hot = dataclasses.replace(WARM, temperature_degc=np.linspace(-40.0, 100.0, 400))
    calibration = same_after_a_file(imucal.read_calibration(path), tmp_path)
    assert_same_recording(calibration, hot, *formula(values, hot))
    at_one = imucal.read_calibration(path, temperature_degc=51.0)
    at_51 = dataclasses.replace(WARM, temperature_degc=np.full(400, 51.0))
    assert_same_recording(at_one, at_51, *formula(values, at_51))
    assert at_one.temperature_range_degc == (51.0, 51.0) and not at_one.effects


def test_an_autopilot_that_rotates_after_the_correction_is_noted(tmp_path):
    values = plain(px4_values()) | {"CAL_ACC0_ROT": 8, "CAL_GYRO0_ROT": 8}
    text = "\n".join(PX4_LAYOUTS["QGroundControl"](*item) for item in values.items())
    notes = imucal.read_calibration(written(tmp_path, "a.params", text)).provenance.imported.notes
    assert any("CAL_ACC0_ROT 8" in note for note in notes)
    with pytest.raises(imucal.InputError, match="CAL_GYRO0_ROT is 4"):
        imucal.read_calibration(
            written(
                tmp_path,
                "b.params",
                text.replace("ROT\t8\t6", "ROT\t4\t6", 2).replace("CAL_ACC0_ROT\t4", "CAL_ACC0_ROT\t8"),
            )
        )
