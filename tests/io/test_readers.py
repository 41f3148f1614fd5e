"""What readers share: the catalogue and its page, recognition, libraries, one clock for two sensors.

`recording_from_streams` is called directly, because no file format can be written with every combination of
clocks.
"""

import re
from pathlib import Path

import numpy as np
import pytest

import imucal
from imucal.cli.formats_page import page
from imucal.io import FORMATS
from imucal.io.streams import Stream, recording_from_streams

ROOT = Path(__file__).resolve().parents[2]


# The catalogue


def test_page_of_formats_is_the_catalogue(command):
    done = command("convert", "--list")
    assert done.returncode == 0
    assert done.stdout == page()
    assert (ROOT / "docs/formats.md").read_text(encoding="utf-8") == page(), (
        "run `imucal convert --list > docs/formats.md`"
    )


def test_page_names_every_format_extra_and_option():
    extras = re.search(
        r"\[project.optional-dependencies\]\n(.*?)\n\n", (ROOT / "pyproject.toml").read_text(), re.DOTALL
    )[1]
    in_all = set(re.search(r'all = \["imucal-rs\[(.*)\]"\]', extras)[1].split(","))
    assert in_all == set(re.findall(r"^(\w+) = ", extras, re.MULTILINE)) - {"all"}
    for name, row in FORMATS.items():
        assert f"## {name}: {row.title}" in page()
        assert row.extra is None or row.extra in in_all
        for option in row.options:
            assert f"--{option.replace('_', '-')}" in page()
        # What an example shows, the format knows.
        for option in re.findall(r"--([a-z-]+)", row.example):
            assert option.replace("-", "_") in row.options


# Recognition


@pytest.mark.parametrize(
    ("name", "format", "message"),
    [
        ("run.bag", "rosbag", "cannot be read as a ROS bag"),
        ("run.db3", "rosbag", "cannot be read as a ROS bag"),
        ("run.mcap", "mcap", "cannot be read as MCAP"),
        ("run.ulg", "ulog", "cannot be read as ULog"),
        ("run.bin", "dataflash", "not a dataflash log"),
        ("run.h5", "hdf5", "cannot be read as HDF5"),
        ("run.npz", "numpy", "cannot be read as NumPy"),
    ],
)
def test_text_under_the_name_of_another_format(tmp_path, name, format, message):
    (tmp_path / name).write_text("t,ax,ay\n1,2,3\n" * 100)
    with pytest.raises(imucal.FormatError, match=f"{name} .*{message}"):
        imucal.read(tmp_path / name)
    with pytest.raises(imucal.FormatError, match=name):
        imucal.read(tmp_path / name, format=format)


@pytest.mark.parametrize(
    ("format", "module", "extra"),
    [
        ("rosbag", "rosbags.rosbag2", "ros"),
        ("mcap", "mcap.reader", "ros"),
        ("ulog", "pyulog", "px4"),
        ("dataflash", "pymavlink.DFReader", "ardupilot"),
        ("matlab", "scipy.io", "matlab"),
        ("hdf5", "h5py", "hdf5"),
    ],
)
def test_missing_library_is_named_with_its_extra(tmp_path, monkeypatch, format, module, extra):
    # The child process that reads these formats gets the search path.
    shadow = tmp_path / "shadow" / f"{module.split('.')[0]}.py"
    shadow.parent.mkdir()
    shadow.write_text("raise ImportError('it is not installed')")
    monkeypatch.syspath_prepend(shadow.parent)
    path = tmp_path / "run"
    path.write_bytes(b"\xa3\x95" + bytes(100))
    with pytest.raises(imucal.ImucalError, match=re.escape(f'pip install "imucal-rs[{extra}]"')) as caught:
        imucal.read(path, format=format)
    assert module.split(".")[0] in str(caught.value)


@pytest.mark.parametrize(
    ("format", "options"),
    [("ulog", {"group": "a"}), ("rosbag", {"instance": 0}), ("hdf5", {"receive_time": True})],
)
def test_options_of_other_formats_are_refused(tmp_path, format, options):
    (tmp_path / "run").write_bytes(b"x")
    with pytest.raises(imucal.InputError, match=f"the format {format} has no option {next(iter(options))}"):
        imucal.read(tmp_path / "run", format=format, **options)


def test_missing_files_of_every_format_are_named(tmp_path):
    for format, row in FORMATS.items():
        options = {"columns": "accel_x_g"} if format == "columns" else {}
        with pytest.raises(imucal.InputError, match=r"none: there is no such file"):
            imucal.read(*[tmp_path / "none"] * row.files, format=format, **options)


# One clock for two sensors


def stream(name, time_s, values):
    return Stream(name, np.round(np.asarray(time_s) * 1e9).astype(np.int64), values)


def turning(time_s):
    """Rates of a turn, and the angles that they are the derivative of."""
    time_s = np.asarray(time_s)
    rate = np.stack([np.sin(3 * time_s), 0.5 + 0 * time_s, np.cos(5 * time_s)], axis=1)
    angle = np.stack([-np.cos(3 * time_s) / 3, 0.5 * time_s, np.sin(5 * time_s) / 5], axis=1)
    return rate, angle


def only(recording):
    (finding,) = recording.findings
    assert finding.code == "resampled"
    return finding


def test_sensors_of_one_rate_keep_the_gyroscope_and_interpolate_the_accelerometer():
    gyro_s = 10 + np.arange(1000) * 0.01
    accel_s = gyro_s + 0.004
    # A line is interpolated exactly.
    ramp = np.outer(accel_s - 10, [1.0, -2.0, 3.0])
    rate, _ = turning(gyro_s)
    recording = recording_from_streams("run", stream("a", accel_s, ramp), stream("g", gyro_s, rate), [])
    np.testing.assert_array_equal(recording.angular_rate, rate[1:])
    np.testing.assert_allclose(recording.time_s, gyro_s[1:] - gyro_s[1], atol=1e-12)
    np.testing.assert_allclose(recording.specific_force, np.outer(gyro_s[1:] - 10, [1, -2, 3]), atol=1e-9)
    finding = only(recording)
    assert (finding.columns, finding.count) == (("accel",), 1)
    assert "a (100 Hz) was interpolated to the time stamps of g (100 Hz)" in finding.message


def test_white_noise_after_interpolation_is_what_the_finding_says():
    gyro_s = np.arange(20_000) * 0.01
    noise = np.random.default_rng(4).normal(size=(20_000, 3))
    recording = recording_from_streams(
        "run", stream("a", gyro_s + 0.003, noise), stream("g", gyro_s, np.zeros((20_000, 3))), []
    )
    left = float(re.search(r"per sample is ([\d.]+) of", only(recording).message)[1])
    assert recording.specific_force.std() == pytest.approx(left, abs=0.01)
    assert left == pytest.approx(np.hypot(0.3, 0.7), abs=0.005)


@pytest.mark.parametrize("ratio", [2, 3.7, 8])
def test_faster_gyroscope_is_averaged_and_keeps_the_angle(ratio):
    accel_s = 5 + np.arange(500) * 0.02
    gyro_s = np.arange(4.9, 15.2, 0.02 / ratio)
    rate, _ = turning(gyro_s)
    recording = recording_from_streams(
        "run", stream("a", accel_s, np.ones((500, 3))), stream("g", gyro_s, rate), []
    )
    np.testing.assert_array_equal(recording.specific_force, np.ones((500, 3)))
    turned = np.cumsum(recording.angular_rate, axis=0) * 0.02
    _, angle = turning(accel_s + 0.01)
    _, start = turning(accel_s[:1] - 0.01)
    # What remains is the straight line between two samples of the gyroscope, w'' dt^2 / 12 of the turn.
    np.testing.assert_allclose(turned, angle - start, atol=25 * (0.02 / ratio) ** 2 / 12)
    assert "averaged over the intervals" in only(recording).message
    assert only(recording).value == pytest.approx(ratio, rel=1e-6)


def test_faster_accelerometer_is_averaged():
    gyro_s, accel_s = np.arange(300) * 0.01, np.arange(3000) * 0.001
    noise = np.random.default_rng(6).normal(size=(3000, 3))
    rate, _ = turning(gyro_s)
    recording = recording_from_streams("run", stream("a", accel_s, noise), stream("g", gyro_s, rate), [])
    np.testing.assert_array_equal(recording.angular_rate, rate[1:])
    assert recording.specific_force.std() == pytest.approx(10**-0.5, rel=0.1)
    # Trapezoids over the eleven samples of one interval.
    weights = np.array([0.5, *[1.0] * 9, 0.5]) / 10
    np.testing.assert_allclose(recording.specific_force[0], weights @ noise[5:16], atol=1e-12)


def test_gap_of_one_sensor_stays_a_gap():
    gyro_s = np.arange(1000) * 0.01
    accel_s = np.delete(gyro_s + 0.005, slice(400, 500))
    ones = np.ones((1000, 3))
    recording = recording_from_streams("run", stream("a", accel_s, ones[:900]), stream("g", gyro_s, ones), [])
    steps = np.diff(recording.time_s)
    assert steps.max() == pytest.approx(1.02)
    assert len(recording) == 1000 - 1 - 101
    assert only(recording).count == 102


def test_findings_of_a_reader_reach_the_results(tmp_path):
    gyro_s = np.arange(3000) * 0.01
    random = np.random.default_rng(3)
    force = np.array([0, 0, 9.8]) + random.normal(scale=0.01, size=(3000, 3))
    rate = random.normal(scale=0.001, size=(3000, 3))
    recording = recording_from_streams(
        "run", stream("a", gyro_s + 0.005, force), stream("g", gyro_s, rate), []
    )
    for result in (imucal.inspect(recording), imucal.noise(recording), recording.between(1, 20)):
        assert recording.findings[0] in result.findings


def test_calibration_of_interpolated_samples_claims_no_more_than_it_knows():
    """Half a step between the sensors, where interpolation halves the variance of white noise."""
    ratios, errors = [], []
    for seed in (1, 2, 3, 4):
        simulation = imucal.simulate("random", seed=seed, rate_hz=400.0)
        truth = {parameter.name: parameter.value for parameter in simulation.truth.calibration.parameters}
        run = simulation.recording
        accel = stream("a", run.time_s[::2], run.specific_force[::2])
        std = []
        for start in (0, 1):
            gyro = stream("g", run.time_s[start::2], run.angular_rate[start::2])
            parameters = imucal.calibrate(recording_from_streams("run", accel, gyro, [])).parameters
            std.append([p.std for p in parameters if p.name.startswith("accel")])
        ratios.append(np.divide(std[1], std[0]))
        errors += [(p.value - truth[p.name]) / p.std for p in parameters]
    assert 0.9 < np.mean(ratios) < 1.1
    assert np.sqrt(np.mean(np.square(errors))) < 1.25


EVEN_S = np.arange(100) * 0.01
ONES = np.ones((100, 3))


@pytest.mark.parametrize(
    ("accel", "gyro", "message"),
    [
        (([], np.zeros((0, 3))), (EVEN_S, ONES), "a contains no samples"),
        (([0.5], np.ones((1, 3))), (EVEN_S, ONES), "a contains a single sample"),
        ((EVEN_S * 11, ONES), (EVEN_S, ONES), r"a has 9.09\d+ Hz, g 100 Hz, a ratio of more than 10"),
        ((EVEN_S + 50, ONES), (EVEN_S, ONES), r"only 0 common samples"),
        (
            (EVEN_S[::-1], ONES),
            (EVEN_S, ONES),
            "time stamps of a do not increase at 99 samples, first after 0.0",
        ),
        (
            (EVEN_S + 0.005, ONES),
            (EVEN_S, np.where(EVEN_S[:, None] == 0.25, np.nan, ONES)),
            "g has 1 samples that .*0.25",
        ),
    ],
)
def test_sensors_that_cannot_share_a_clock(accel, gyro, message):
    with pytest.raises(imucal.FormatError, match=message):
        recording_from_streams("run", stream("a", *accel), stream("g", *gyro), [])


def test_equal_stamps_are_left_alone_with_all_their_faults():
    time_s, values = np.array([0, 0.01, 0.01, 0.005]), np.array([[1, np.nan, 3]] * 4)
    recording = recording_from_streams("run", stream("a", time_s, values), stream("g", time_s, values), [])
    np.testing.assert_array_equal(recording.time_s, time_s)
    np.testing.assert_array_equal(recording.specific_force, values)
    assert recording.findings == ()
