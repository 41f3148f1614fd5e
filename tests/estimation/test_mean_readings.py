"""Tables of mean readings: one row for each pose, with noise of the table, given, of a profile or unknown."""

import numpy as np
import pyarrow.csv
import pytest

import imucal
from exact_covariance import covariance_of_norms, normalised

SIGMA = 0.003


@pytest.fixture(scope="module")
def truth():
    """Sensitivity and bias of the accelerometer of a poor unit, m/s^2."""
    sensitivity = np.array([[1.02, 0.004, -0.006], [0.004, 0.98, 0.003], [-0.006, 0.003, 1.01]])
    return sensitivity, np.array([0.3, -0.2, 0.1])


@pytest.fixture(scope="module")
def poses():
    """Twenty directions up: the faces of a cube, and those to its corners and some edges."""
    faces = [sign * np.eye(3)[axis] for axis in range(3) for sign in (1, -1)]
    corners = [np.array([x, y, z]) for x in (1, -1) for y in (1, -1) for z in (1, -1)]
    edges = [np.array([1, 1, 0]), np.array([1, 0, -1]), np.array([0, -1, 1]), np.array([-1, 0, 1])]
    edges += [np.array([-1, 1, 0]), np.array([0, 1, 1])]
    return np.array([v / np.linalg.norm(v) for v in (*faces, *corners, *edges)])


@pytest.fixture(scope="module")
def means(truth, poses):
    sensitivity, bias = truth
    random = np.random.default_rng(5)
    force = 9.80665 * poses @ sensitivity.T + bias + random.normal(scale=SIGMA, size=poses.shape)
    rate = np.array([0.01, -0.02, 0.03]) + random.normal(scale=1e-4, size=poses.shape)
    return imucal.Means(specific_force=force, angular_rate=rate, name="table")


def errors(result, truth):
    sensitivity, bias = truth
    expected = np.array([*bias, *np.diag(sensitivity), *sensitivity[np.triu_indices(3, 1)]])
    return np.array([(p.value - e) / p.std for p, e in zip(result.parameters, expected, strict=True)])


@pytest.mark.parametrize("noise", ["columns", "given", "unit", "residuals"])
def test_the_nine_parameters_are_within_their_sigma(noise, means, truth):
    fields = {"specific_force": means.specific_force, "angular_rate": means.angular_rate}
    given = {}
    if noise == "columns":
        fields["specific_force_std"] = np.full(means.specific_force.shape, SIGMA)
    elif noise == "given":
        given["noise_mps2"] = SIGMA
    elif noise == "unit":
        unit = imucal.Unit(imucal.Sensor(noise_density=SIGMA * 2.0), imucal.Sensor())
        fields["duration_s"], given["unit"] = np.full(len(means), 4.0), unit
    result = imucal.calibrate(imucal.Means(**fields), **given)
    assert (np.abs(errors(result, truth)) < 4).all(), errors(result, truth)
    assert result.from_means.noise_from == noise
    assert result.verdict == ("incomplete" if noise == "residuals" else "good"), result.reasons
    if noise == "residuals":
        assert "estimated from the residuals of the 20 rests" in result.reasons[0]
    assert result.calibration.noise == {} and result.calibration.gyroscope is None
    if noise in ("columns", "unit"):
        variance = np.full(means.specific_force.shape, SIGMA**2)
        triad = result.calibration.accelerometer
        expected = covariance_of_norms(means.specific_force, variance, triad)
        covariance = result.calibration.covariance
        assert normalised(covariance, expected) == pytest.approx(normalised(expected, expected), abs=1e-3)


def test_the_mean_rates_give_the_bias_of_the_gyroscope_alone(means):
    result = imucal.calibrate(means, noise_mps2=SIGMA)
    bias = result.from_means.gyro_bias
    assert [p.name for p in bias] == ["gyro_bias_x", "gyro_bias_y", "gyro_bias_z"]
    for parameter, expected in zip(bias, (0.01, -0.02, 0.03), strict=True):
        assert abs(parameter.value - expected) < 4 * parameter.std
    of_means = means.angular_rate.std(axis=0, ddof=1) / np.sqrt(len(means))
    assert [p.std for p in bias] == pytest.approx(of_means)
    assert "scale and misalignment of the gyroscope need moves" in result.summary()
    document = result.to_dict()
    assert document["gyroscope"] is None and len(document["from_means"]["gyro_bias"]) == 3


def test_a_wrong_noise_is_noticed(means):
    result = imucal.calibrate(means, noise_mps2=SIGMA / 10)
    assert result.verdict == "incomplete" and "residuals exceed their noise" in result.reasons[0]


def test_six_positions_need_a_smaller_model(means, truth):
    six = imucal.Means(specific_force=means.specific_force[:6], name="six")
    with pytest.raises(imucal.NotEnoughMotionError, match="misalignment") as raised:
        imucal.calibrate(six, noise_mps2=SIGMA)
    assert "Without more motion, model='orthogonal' estimates biases and scales" in str(raised.value)
    assert "direction of gravity" in str(raised.value) and "rotation by 90 deg" not in str(raised.value)
    # The residuals of six rows and six parameters do not show their noise.
    with pytest.raises(imucal.NotEnoughMotionError) as raised:
        imucal.calibrate(six)
    assert "model='orthogonal' estimates biases and scales if the noise of the means is given" in str(
        raised.value
    )
    with pytest.raises(imucal.NotEnoughMotionError, match="give their standard deviation") as raised:
        imucal.calibrate(six, model="orthogonal")
    assert "model=" not in str(raised.value)
    result = imucal.calibrate(six, noise_mps2=SIGMA, model="orthogonal")
    assert (np.abs(errors(result, truth)) < 4).all(), errors(result, truth)
    assert result.verdict == "incomplete"
    assert any("accel_misalignment" in reason for reason in result.reasons), result.reasons
    assert "rotation by 90 deg" not in result.summary()


@pytest.mark.parametrize("sigma", [0.01, 0.02])
def test_the_sigma_of_a_scale_includes_the_square_of_unknown_misalignments(sigma):
    # For a reading along a sensitive axis with misalignments m and n, the norm |T^-1 a| gives the scale
    # 1 + 3/2 (m^2 + n^2). With the standard deviation s of m and n, the rms error of the scale is
    # 3 sqrt(2) s^2.
    means = imucal.Means(specific_force=9.80665 * np.array([*np.eye(3), *-np.eye(3)]))
    hold = {"accel_misalignment": (0.0, sigma)}
    result = imucal.calibrate(means, model="orthogonal", noise_mps2=1e-7, hold=hold)
    scales = [p for p in result.parameters if p.name in [f"accel_sensitivity_{axis * 2}" for axis in "xyz"]]
    assert [p.std for p in scales] == pytest.approx([3 * np.sqrt(2.0) * sigma**2] * 3, rel=1e-2)
    assert all(p.value == pytest.approx(1.0, abs=1e-9) for p in scales)


def test_without_noise_and_without_residuals_nothing_is_known(means):
    six = imucal.Means(specific_force=means.specific_force[:6], name="six")
    with pytest.raises(imucal.NotEnoughMotionError, match=r"standard deviation \(noise_mps2=..., --noise\)"):
        imucal.calibrate(six, model="orthogonal")


def test_a_file_is_read_with_its_deviations(means, tmp_path):
    path = tmp_path / "table.csv"
    header = ",".join([f"accel_{a}_g" for a in "xyz"] + [f"accel_{a}_std_mg" for a in "xyz"] + ["duration_s"])
    rows = np.column_stack(
        [means.specific_force / 9.80665, np.full((len(means), 3), 0.5), np.full(len(means), 3)]
    )
    path.write_text("\n".join([header, *(",".join(map(repr, row)) for row in rows.tolist())]) + "\n")
    table = imucal.read_means(path)
    assert np.allclose(table.specific_force, means.specific_force, rtol=1e-12)
    assert np.allclose(table.specific_force_std, 0.5e-3 * 9.80665) and (table.duration_s == 3).all()
    assert table.angular_rate is None
    with pytest.raises(imucal.FormatError, match="--means"):
        imucal.read(path)
    frame = pyarrow.csv.read_csv(path)
    assert np.array_equal(imucal.read_means(frame).specific_force, table.specific_force)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"specific_force": np.full((12, 3), np.nan)}, "every mean is a number"),
        ({"specific_force_std": np.zeros((20, 3))}, "a positive one"),
        ({"specific_force_std": np.ones((3, 3))}, "20"),
    ],
)
def test_wrong_tables_are_refused(change, words, means):
    with pytest.raises(imucal.InputError, match=words):
        imucal.calibrate(imucal.Means(**{"specific_force": means.specific_force, **change}))


def test_a_table_is_no_recording(means):
    with pytest.raises(imucal.InputError, match="a Means is given where a Recording is needed"):
        imucal.inspect(means)
    with pytest.raises(imucal.InputError, match="leave it out"):
        imucal.calibrate(imucal.Recording([0.0], [[0, 0, 9.8]], [[0, 0, 0]]), noise_mps2=0.1)


def test_copies_of_rows_are_no_further_rests(means):
    force, rate = means.specific_force, means.angular_rate
    once = imucal.calibrate(means, noise_mps2=SIGMA)
    rows = [*range(20), *range(20), 3, 4]
    pasted = imucal.Means(specific_force=force[rows], angular_rate=rate[rows], name="pasted")
    result = imucal.calibrate(pasted, noise_mps2=SIGMA)
    assert [(p.value, p.std) for p in result.parameters] == [(p.value, p.std) for p in once.parameters]
    assert [p.std for p in result.from_means.gyro_bias] == [p.std for p in once.from_means.gyro_bias]
    (warning,) = [f for f in result.findings if f.code == "samples_duplicated"]
    assert warning.count == 22 and "21, 22, 23, 24, 25, 26, 27, 28 and 14 more" in warning.message
    assert "row 21 is a copy of row 1)" in warning.message
    # A row that differs in one column is another rest.
    rate = rate[rows].copy()
    rate[20:] += 1e-5
    again = imucal.Means(specific_force=force[rows], angular_rate=rate)
    assert len(imucal.calibrate(again, noise_mps2=SIGMA).rests) == 40
