"""Proposals of columns that would mix units or axes, if they were made from the order of the columns."""

import numpy as np
import pytest

import imucal
from export_files import DEG, FORCE, RATE, TIME_S, lines, write

# The second unit moves otherwise.
OTHER_FORCE, OTHER_RATE = FORCE[:, ::-1], -RATE


def message(path, **options):
    with pytest.raises(imucal.ImucalError) as caught:
        imucal.read(path, **options)
    return str(caught.value)


def followed(path):
    columns = message(path).partition("--columns '")[2].partition("'")[0]
    return imucal.read(path, columns=columns)


def names(*stems, unit=""):
    return ",".join(f"{stem.format(axis)}{unit}" for stem in stems for axis in "xyz")


@pytest.mark.parametrize(
    "stems",
    [
        ("left_gyro_{}", "right_acc_{}", "right_gyro_{}", "left_acc_{}"),
        ("gyro{}1", "acc{}2", "gyro{}2", "acc{}1"),
        (
            "left.angular_velocity.{}",
            "right.acceleration.{}",
            "right.angular_velocity.{}",
            "left.acceleration.{}",
        ),
    ],
)
def test_the_sensors_of_one_unit_are_proposed_together(tmp_path, stems):
    columns = lines(TIME_S, RATE, OTHER_FORCE, OTHER_RATE, FORCE)
    recording = followed(write(tmp_path, "run.csv", f"time (s),{names(*stems)}", columns))
    unit = (FORCE, RATE) if recording.specific_force[0, 2] == FORCE[0, 2] else (OTHER_FORCE, OTHER_RATE)
    np.testing.assert_allclose(recording.specific_force, unit[0], atol=1e-9)
    np.testing.assert_allclose(recording.angular_rate, unit[1], atol=1e-9)


def test_sensors_of_unknown_units_are_not_proposed(tmp_path):
    stems = ("red_gyro_{}", "front_acc_{}", "blue_gyro_{}", "back_acc_{}")
    columns = lines(TIME_S, RATE, OTHER_FORCE, OTHER_RATE, FORCE)
    said = message(write(tmp_path, "run.csv", f"time (s),{names(*stems)}", columns))
    assert "choose the columns of one unit" in said and "--columns '" not in said


@pytest.mark.parametrize("order", ["p q r", "yaw_rate pitch_rate roll_rate", "r q p"])
def test_rates_have_the_axes_of_their_names(tmp_path, order):
    rates = RATE / DEG if order == "p q r" else RATE[:, ::-1] / DEG
    header = f"time (s),{names('acc_{}', unit=' (m/s^2)')}," + ",".join(f"{n} (deg/s)" for n in order.split())
    recording = followed(write(tmp_path, "run.csv", header, lines(TIME_S, FORCE, rates)))
    np.testing.assert_allclose(recording.angular_rate, RATE, atol=1e-9)


@pytest.mark.parametrize("rates", ["rotationRate.{}", "gyro.{}"])
def test_rates_without_axes_are_asked_for(tmp_path, rates):
    header = f"time (s),{names('acc_{}')}," + ",".join(map(rates.format, ("alpha", "beta", "gamma")))
    said = message(write(tmp_path, "run.csv", header, lines(TIME_S, FORCE, RATE)))
    assert "name the gyroscope, but not the axes" in said and "--columns '" not in said


def test_two_sensors_of_a_kind_in_the_file_of_a_sensor_are_refused(tmp_path):
    accel = write(tmp_path, "accel.csv", f"time (s),{names('left_acc_{}', 'right_acc_{}')}",
                  lines(TIME_S, FORCE, OTHER_FORCE))  # fmt: skip
    gyro = write(tmp_path, "gyro.csv", f"time (s),{names('gyro_{}')}", lines(TIME_S, RATE))
    for paths in ((accel, gyro), (tmp_path,)):
        with pytest.raises(
            imucal.InputError, match=r"2 sensors of one kind \(left_acc_x, right_acc_x, ...\)"
        ):
            imucal.read(*paths, gyro_unit="rad/s")


def test_rows_of_sensors_that_are_numbers_are_not_called_one_sensor(tmp_path):
    both = np.concatenate(
        [np.column_stack([np.full(len(v), code), TIME_S, v]) for code, v in ((1, FORCE), (4, RATE))]
    )
    path = write(tmp_path, "accelerometer_gyroscope.csv", "type,time (s),x,y,z", lines(both))
    assert "name no sensor" in message(path)
