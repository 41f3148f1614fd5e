"""Two MPU-9150 units against the calibrations that the authors of their recordings have published.

Mikov, Reginya and Moschevikin, In-situ gyroscope calibration based on accelerometer data, ICINS 2020; the
table of the real units in the README of github.com/mikoff/imu-calib. Their program fits the accelerometer to
samples, and the gyroscope with its bias to the moves. It takes 9.81 m/s^2 for gravity.
"""

from dataclasses import dataclass

import numpy as np
import pytest

import imucal

pytestmark = pytest.mark.slow

COLUMNS = "accel_x_mps2,accel_y_mps2,accel_z_mps2,gyro_x_radps,gyro_y_radps,gyro_z_radps"
AUTHORS_GRAVITY_MPS2 = 9.81


@dataclass
class Published:
    """Rows of the table for one unit: scale x y z in %, misalignment yz xy xz in deg, bias x y z.

    accel      bias in m/s^2
    gyro       bias in deg/s
    epsilon    rotation between the frames of both sensors, deg
    """

    accel: tuple
    gyro: tuple
    epsilon: tuple


UNITS = {
    0: Published(
        (0.363, 0.315, 0.647, 0.123, 0.02, 0.317, 0.103, 0.097, 0.344),
        (0.041, 0.457, 0.826, -0.034, -0.12, 0.806, 1.146, -0.401, 1.261),
        (0.03, -0.364, -0.074),
    ),
    1: Published(
        (0.471, 0.482, 0.932, -0.284, -0.01, 0.145, 0.09, 0.07, 0.338),
        (0.007, 0.26, -0.179, -0.639, 0.21, 0.262, -0.573, 1.089, 0.286),
        (-0.565, 0.013, 0.069),
    ),
}


def sensor_error_model(row):
    """imu_model.py: an upper triangular matrix, and the bias in the unit of the table."""
    scale, (yz, xy, xz) = 1.0 + np.array(row[:3]) / 100.0, np.radians(row[3:6])
    return np.array([[scale[0], xy, xz], [0.0, scale[1], yz], [0.0, 0.0, scale[2]]]), np.array(row[6:])


def calibration(published):
    """cost_functions.py, residual_gyr: w = C Rm raw - C b with Rm^-1 = 1 + skew(epsilon)."""
    x, y, z = np.radians(published.epsilon)
    rotation = np.array([[1.0, -z, y], [z, 1.0, -x], [-y, x, 1.0]])
    matrix, bias_dps = sensor_error_model(published.gyro)
    return imucal.Calibration(
        imucal.Triad(*sensor_error_model(published.accel)),
        imucal.Triad(rotation @ matrix, rotation @ np.radians(bias_dps)),
        frame="given",
        gravity_mps2=AUTHORS_GRAVITY_MPS2,
    )


@pytest.fixture(scope="module", params=UNITS)
def both(request, data_file):
    """The recording of a unit, the published calibration and that of imucal."""
    recording = imucal.read(data_file(f"mpu9150/imu{request.param}.log"), columns=COLUMNS, rate_hz=100)
    result = imucal.calibrate(recording, gravity_mps2=AUTHORS_GRAVITY_MPS2)
    return recording, calibration(UNITS[request.param]), result.calibration


def test_the_accelerometer_is_that_of_its_authors(both):
    _, published, found = both
    # |f| determines T^-T T^-1 alone, which is the same in every frame.
    grams = [np.linalg.inv(c.accelerometer.sensitivity) for c in (found, published)]
    found_gram, published_gram = (inverse.T @ inverse for inverse in grams)
    assert np.abs(found_gram - published_gram).max() < 1e-3
    assert found.accelerometer.bias == pytest.approx(published.accelerometer.bias, abs=1e-3)


def test_the_gyroscope_propagates_gravity_better_than_that_of_its_authors(both):
    """The gyroscope scales of unit 1 differ by about 0.4 %. Both programs have fitted these moves."""
    recording, published, found = both
    theirs, ours = (
        imucal.evaluate(unit, recording).figures.gravity_direction_rms_deg for unit in (published, found)
    )
    assert ours < 0.7 * theirs
