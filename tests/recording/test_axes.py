"""Changes of axes: of recordings, in calibration files, and in exports."""

from pathlib import Path

import numpy as np
import pytest

import imucal
from imucal import Program, Recording
from imucal.cli import main
from imucal.recording.axes import Axes

RUN = imucal.simulate(Program.random(seed=2, moves=18, hold_s=1.5), unit="paper", rate_hz=100, seed=2)


def counts(force, kind=np.int16, **fields):
    force = np.array(force, dtype=kind)
    zero = np.zeros((len(force), 3), dtype=kind)
    return Recording(np.arange(len(force)) / 100, force, zero, accel_unit="lsb", gyro_unit="lsb", **fields)


@pytest.mark.parametrize(
    ("axes", "force", "rate"),
    [
        ("flu", [1, 2, 3], [4, 5, 6]),
        ("frd", [1, -2, -3], [4, -5, -6]),
        ("NED", [1, -2, -3], [4, -5, -6]),
        ("z,-x,-y", [3, -1, -2], [6, -4, -5]),
        ("accel=-x,-y,-z", [-1, -2, -3], [4, 5, 6]),
        ("gyro=y,x,z", [1, 2, 3], [5, 4, 6]),
        ("accel=z,y,x gyro=-z,y,x", [3, 2, 1], [-6, 5, 4]),
        ("accel=z,y,x;gyro=-z,y,x", [3, 2, 1], [-6, 5, 4]),
    ],
)
def test_columns_after_a_change(axes, force, rate):
    changed = Recording([0.0], [[1, 2, 3]], [[4, 5, 6]]).with_axes(axes)
    np.testing.assert_array_equal(changed.specific_force, [force])
    np.testing.assert_array_equal(changed.angular_rate, [rate])
    assert changed.with_axes(str(imucal.recording.axes.Axes.parse(changed.axes).inverse)).axes == "x,y,z"


@pytest.mark.parametrize(
    "axes", ["", "xyz", "x,y", "x,x,z", "x,y,w", "mag=x,y,z", "accel=x,y,z accel=z,y,x", "enu,"]
)
def test_other_texts_are_refused(axes):
    with pytest.raises(imucal.InputError, match="give frd, ned, flu"):
        Recording([0.0], [[1, 2, 3]], [[4, 5, 6]]).with_axes(axes)


def test_the_lowest_count_has_its_negative_value():
    changed = counts([[-32768, 32767, 5]]).with_axes("-x,-y,z")
    np.testing.assert_array_equal(changed.specific_force, [[32768, -32767, 5]])
    assert counts([[1, 2, 3]]).with_axes("y,z,x").specific_force.dtype == np.int16
    assert counts([[1, 2, 3]], np.float32).with_axes("frd").specific_force.dtype == np.float32


def test_a_magnetometer_has_the_same_axes():
    field = {f"mag_{axis}_ut": [float(k)] for k, axis in enumerate("xyz", 1)}
    changed = Recording([0.0], [[0, 0, 9.8]], [[0, 0, 0]], auxiliary=field).with_axes("z,-x,-y")
    assert [changed.auxiliary[name][0] for name in field] == [3, -1, -2]
    one = Recording([0.0], [[0, 0, 9.8]], [[0, 0, 0]], auxiliary=field).with_axes("accel=-x,-y,-z")
    assert [one.auxiliary[name][0] for name in field] == [1, 2, 3]


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """FRD data of a simulated unit, and the calibration that was made with --axes frd."""
    folder = tmp_path_factory.mktemp("axes")
    raw = RUN.recording.with_axes("frd")
    imucal.write(raw, folder / "frd.csv")
    assert main(["calibrate", str(folder / "frd.csv"), "--axes", "frd", "-o", str(folder / "unit.json")]) == 0
    return folder


def test_a_calibration_takes_recordings_with_its_axes_only(files, capsys):
    unit = imucal.Calibration.load(files / "unit.json")
    assert unit.axes == "x,-y,-z"
    out = ["-o", str(files / "out.csv")]
    assert main(["apply", str(files / "unit.json"), str(files / "frd.csv"), *out]) == 1
    advice = "with the axes x,-y,-z: read the recording with the axes x,-y,-z"
    assert advice in capsys.readouterr().err
    # The axes of the calibration are absolute, so the option that was given does not change them.
    imucal.calibrate(imucal.read(files / "frd.csv")).calibration.save(files / "plain.json")
    assert main(["apply", str(files / "plain.json"), str(files / "frd.csv"), "--axes", "frd", *out]) == 1
    said = capsys.readouterr().err
    assert "was read with the axes x,-y,-z" in said and "read the recording with the axes x,y,z" in said
    assert main(["apply", str(files / "unit.json"), str(files / "frd.csv"), "--axes", "frd", *out]) == 0
    corrected = imucal.read(files / "out.csv")
    expected = unit.apply_recording(imucal.read(files / "frd.csv", axes="frd"))
    np.testing.assert_array_equal(corrected.specific_force, expected.specific_force)


def test_recordings_of_one_unit_have_the_same_axes(files):
    one, other = imucal.read(files / "frd.csv"), imucal.read(files / "frd.csv", axes="frd")
    with pytest.raises(imucal.InputError, match="read all recordings of one unit with the same axes"):
        imucal.calibrate([one, other])


@pytest.mark.parametrize("format", ["px4", "ardupilot"])
def test_exports_are_along_the_columns(files, format):
    """With and without --axes frd, the parameters of an autopilot, whose axes are FRD, are the same."""
    unit = imucal.Calibration.load(files / "unit.json")
    plain = imucal.calibrate(imucal.read(files / "frd.csv")).calibration
    values = [
        [line for line in imucal.export(calibration, format).text.splitlines() if not line.startswith("#")]
        for calibration in (unit, plain)
    ]
    assert len(values[0]) == len(values[1])
    for one, other in zip(*values, strict=True):
        for a, b in zip(one.replace(",", " ").split(), other.replace(",", " ").split(), strict=True):
            try:
                assert float(a) == pytest.approx(float(b), abs=1e-5)
            except ValueError:
                assert a == b


# The format ros omits the matrix of the gyroscope, whose entries are up to 0.03.
@pytest.mark.parametrize(("format", "tolerance"), [("c-header", 1e-9), ("ros", 0.2)])
def test_exports_of_matrices_correct_raw_samples_to_the_body_frame(files, format, tolerance):
    unit = imucal.Calibration.load(files / "unit.json")
    exported = imucal.export(unit, format)
    assert "read with axes='x,-y,-z'" in " ".join(exported.text.split())
    raw = imucal.read(files / "frd.csv")
    of_raw = exported.same_as.apply_recording(raw)
    if format == "ros":
        # Without a rotation, the corrected samples are along the columns as well.
        of_raw = of_raw.with_axes("frd")
    of_file = unit.apply_recording(imucal.read(files / "frd.csv", axes="frd"))
    np.testing.assert_allclose(of_raw.specific_force, of_file.specific_force, atol=tolerance)
    np.testing.assert_allclose(of_raw.angular_rate, of_file.angular_rate, atol=tolerance)
    residual = exported.residual(imucal.read(files / "frd.csv", axes="frd"))
    assert residual.exported.figures.gravity_norm_rms_mps2 < 0.01


def rows_of_makers():
    page = (Path(__file__).resolve().parents[2] / "docs/frames.md").read_text(encoding="utf-8")
    table = page.partition("`--axes` for FLU |\n")[2].partition("\n\n")[0]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()[1:]]
    return [row for row in rows if row[4]]


@pytest.mark.parametrize("row", rows_of_makers(), ids=lambda row: row[0])
def test_the_page_on_frames_gives_axes_with_z_up(row):
    """With the axes of the page, a unit at rest reads +g on z, and both sensors are right-handed."""
    _, _, _, reads, axes = row
    force = [{"0": 0.0, "+g": 9.81, "-g": -9.81}[word.strip()] for word in reads.strip("()").split(",")]
    rate = [0.1, 0.2, 0.3]
    recording = Recording([0.0], [force], [rate]).with_axes(axes.strip("`'"))
    assert recording.specific_force.tolist() == [[0.0, 0.0, 9.81]]
    # On iOS the accelerometer alone has the reversed sign.
    changed = Axes.parse(axes.strip("`'"))
    assert np.linalg.det(changed.gyro) == pytest.approx(1.0)
    sign = -1.0 if "iOS" in row[0] else 1.0
    np.testing.assert_array_equal(changed.accel, sign * changed.gyro)
