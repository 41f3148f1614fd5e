"""Units in headers: any spelling of a unit is read, and a unit that is not read is never taken for none."""

import itertools

import numpy as np
import pytest

import imucal
from imucal.io.header import header_of
from imucal.io.unit_words import split_unit

ROWS = 300
RANDOM = np.random.default_rng(17)
TIME_S = np.arange(ROWS) / 50
FORCE = np.array([0.2, -0.1, 9.7]) + RANDOM.normal(scale=0.02, size=(ROWS, 3))
RATE = RANDOM.normal(scale=1e-3, size=(ROWS, 3))
G, DEG = 9.80665, np.pi / 180

ACCEL_SIZES = {
    ("mps2", 1.0): "(m/s^2) (N/kg)",
    ("cmps2", 0.01): "(cm/s²) (cm/s^2) [cm/s/s] (Gal) (cm·s⁻²) cm·s⁻² _cm_s2 _gal",
    ("mmps2", 0.001): "(mm/s²) [mm/sec^2] _mm_s2 _mm/s2",
    ("ftps2", 0.3048): "(ft/s²) (ft/s^2) _ft_s2",
    ("g", G): "(g) _g",
    ("mg", G / 1e3): "(mg) (milli-g)",
    ("ug", G / 1e6): "(µg) [ug] _ug",
}
GYRO_SIZES = {
    ("radps", 1.0): "(rad/s) _rad_per_s _rad_per_sec _rad_per_second",
    ("mradps", 1e-3): "(mrad/s) [mrad·s⁻¹] _mrad_s _mrad/s _mradps",
    ("dps", DEG): "(deg/s) [°/s] (˚/s) _dps _deg/s _deg_per_sec _degpersec",
    ("mdps", DEG / 1e3): "(mdps) (m°/s) _mdeg_s",
    ("dpmin", DEG / 60): "(deg/min) (°/min) _deg_min",
    ("dph", DEG / 3600): "(deg/h) [°/h] (dph) (deg/hr) _deg_h _deg_per_hour _dph",
    ("rpm", 2 * np.pi / 60): "(rpm) (rev/min) _rpm",
    ("gonps", np.pi / 200): "(gon/s) _gon_s",
}


def spelled(sizes):
    return [(suffix, size, word) for (suffix, size), words in sizes.items() for word in words.split()]


def header(time="t (s)", accel="(m/s^2)", gyro="(rad/s)"):
    """A header with these texts after the names of the axes."""

    def names(what, text):
        return [f"{what} {axis}{text if text[:1] == '_' else ' ' + text}" for axis in "xyz"]

    return [time, *names("Acc", accel), *names("Gyr", gyro)]


def columns(time=1.0, accel=1.0, gyro=1.0):
    return np.column_stack([TIME_S / time, FORCE / accel, RATE / gyro])


def write(folder, names, values, name="run.csv"):
    rows = [",".join(map(repr, row)) for row in values.tolist()]
    path = folder / name
    path.write_text("\n".join([",".join(names), *rows]) + "\n", encoding="utf-8")
    return path


def refusal(*paths, **options):
    with pytest.raises(imucal.ImucalError) as caught:
        imucal.read(*paths, **options)
    return str(caught.value)


def require_run(recording):
    np.testing.assert_allclose(recording.specific_force, FORCE, rtol=1e-12)
    np.testing.assert_allclose(recording.angular_rate, RATE, rtol=1e-12)


@pytest.mark.parametrize(("suffix", "size", "text"), spelled(ACCEL_SIZES))
def test_units_of_the_accelerometer(tmp_path, suffix, size, text):
    recording = imucal.read(write(tmp_path, header(accel=text), columns(accel=size)))
    require_run(recording)
    assert recording.column_units == (suffix, "radps")


@pytest.mark.parametrize(("suffix", "size", "text"), spelled(GYRO_SIZES))
def test_units_of_the_gyroscope(tmp_path, suffix, size, text):
    recording = imucal.read(write(tmp_path, header(gyro=text), columns(gyro=size)))
    require_run(recording)
    assert recording.column_units == ("mps2", suffix)


@pytest.mark.parametrize(
    ("accel", "gyro"), [*itertools.zip_longest(ACCEL_SIZES, GYRO_SIZES, fillvalue=("mps2", 1.0))]
)
def test_canonical_names_end_with_the_same_units(tmp_path, accel, gyro):
    names = [f"accel_{axis}_{accel[0]}" for axis in "xyz"] + [f"gyro_{axis}_{gyro[0]}" for axis in "xyz"]
    values = columns(accel=accel[1], gyro=gyro[1])
    require_run(imucal.read(write(tmp_path, ["time_s", *names], values)))


@pytest.mark.parametrize(
    ("text", "unread"),
    [
        ("(smoot)", "smoot"),
        ("(inch/s²)", "inch/s²"),
        ("inch/s2", "inch/s2"),
        ("km/s²", "km/s²"),
        ("(0.01 m/s²)", "0.01 m/s²"),
        ("0.01 m/s^2", "0.01 m/s^2"),
        ("[1/1024 g]", "1/1024 g"),
    ],
)
def test_a_unit_of_the_accelerometer_that_is_not_read_is_not_absent(tmp_path, text, unread):
    message = refusal(write(tmp_path, header(accel=text), columns(accel=0.01)))
    assert f"the header gives units that are not read ({unread})" in message
    assert "does not give" not in message
    assert "accel_x_" not in message


@pytest.mark.parametrize(
    ("text", "unread"),
    [
        # gon/s in English, deg/s in German.
        ("(grad/s)", "grad/s"),
        ("(rps)", "rps"),
        ("_rps", "rps"),
        ("(rad/s^2)", "rad/s^2"),
        ("(DPS x10)", "DPS x10"),
        ("0.1 dps", "0.1 dps"),
    ],
)
def test_a_unit_of_the_gyroscope_that_is_not_read_is_not_absent(tmp_path, text, unread):
    path = write(tmp_path, header(gyro=text), columns(gyro=0.9 * DEG))
    message = refusal(path)
    assert f"the header gives units that are not read ({unread})" in message
    assert "gyro_x_" not in message
    # Someone who knows the unit can state it.
    names = header(gyro=text)
    canonical = header("time_s", "", "")[:1] + [
        f"{what}_{axis}_{unit}" for what, unit in (("accel", "mps2"), ("gyro", "gonps")) for axis in "xyz"
    ]
    given = ",".join(f"{ours}={theirs}" for ours, theirs in zip(canonical, names, strict=True))
    require_run(imucal.read(path, columns=given))


@pytest.mark.parametrize("ending", ["csv", "parquet"])
@pytest.mark.parametrize(
    ("time", "unread"),
    [
        ("t (ticks)", "ticks"),
        ("time_frames", "frames"),
        ("Time [min]", "min"),
        ("t (1/100 sec)", "1/100 sec"),
        ("t (ms x10)", "ms x10"),
    ],
)
def test_a_unit_of_time_that_is_not_read_is_not_absent(tmp_path, time, unread, ending):
    names, values = header(time), np.column_stack([np.arange(ROWS) * 20, columns()[:, 1:]])
    path = saved(tmp_path, names, values, ending)
    message = refusal(path)
    assert f"a unit of time that is not read ({unread}): give the sampling rate" in message
    assert f"={time}" not in message
    require_run(imucal.read(path, rate_hz=50))


def saved(folder, names, values, ending):
    """The path of a file with these columns."""
    if ending == "csv":
        return write(folder, names, values)
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    parquet.write_table(pyarrow.table(list(values.T), names=names), folder / "run.parquet")
    return folder / "run.parquet"


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_options_that_contradict_the_header_are_refused(tmp_path, ending):
    names = header(accel="(cm/s²)")
    path = saved(tmp_path, names, columns(accel=0.01), ending)
    canonical = ["time_s"] + [
        f"{what}_{axis}_{unit}" for what, unit in (("accel", "mg"), ("gyro", "radps")) for axis in "xyz"
    ]
    given = ",".join(f"{ours}={theirs}" for ours, theirs in zip(canonical, names, strict=True))
    assert "the header contradicts the given columns: accel_x_mg is given" in refusal(path, columns=given)
    require_run(imucal.read(path, columns=given.replace("_mg", "_cmps2")))
    require_run(imucal.read(path))


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_different_units_of_the_axes_are_said(tmp_path, ending):
    names = header()
    names[1] = "Acc x (g)"
    message = refusal(saved(tmp_path, names, columns(), ending))
    assert (
        "different units for the axes of one sensor (Acc x (g), Acc y (m/s^2), Acc z (m/s^2))"
        in message.replace("The header", "the header")
    )
    assert "--columns '" not in message


def test_two_files_with_units_that_are_not_read(tmp_path):
    names, values = header(accel="(smoot)"), columns()
    accel = write(tmp_path, names[:4], values[:, :4], "accel.csv")
    gyro = write(tmp_path, ["t (s)", *names[4:]], values[:, [0, 4, 5, 6]], "gyro.csv")
    message = refusal(accel, gyro)
    assert "a unit that is not read (smoot)" in message
    assert "give --accel-unit" in message
    require_run(imucal.read(accel, gyro, accel_unit="m/s^2"))
    # The accelerometer alone.
    assert "a unit that is not read (smoot)" in refusal(accel)
    clock = write(tmp_path, ["t (ticks)", *header()[1:4]], values[:, :4], "clock.csv")
    assert "a unit of time that is not read (ticks)" in refusal(clock, gyro)


@pytest.mark.parametrize("text", ["(IMU)", "[calibrated]", "(z-axis)", "[0]", ""])
def test_remarks_are_no_units(tmp_path, text):
    message = refusal(write(tmp_path, header(gyro=text.replace("z-axis", "body frame")), columns()))
    assert "the header does not give every unit" in message
    assert "not read" not in message


def test_lines_of_labels_with_units(tmp_path):
    path = tmp_path / "plotter.txt"
    names = [f"{sensor}{axis}" for sensor in "ag" for axis in "xyz"]
    units = ["cm/s²"] * 3 + ["deg/h"] * 3
    rows = [
        f"t: {row[0]} s, "
        + ", ".join(f"{n}: {v:.12f} {u}" for n, v, u in zip(names, row[1:], units, strict=True))
        for row in columns(accel=0.01, gyro=DEG / 3600)
    ]
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    require_run(imucal.read(path))


def test_units_may_be_words():
    assert split_unit("Gyro X (degrees per second)") == ("Gyro X", ("gyro", "dps"))
    assert split_unit("Acc X [meters per second squared]") == ("Acc X", ("accel", "mps2"))
    assert split_unit("Gyro X (degrees per hour)") == ("Gyro X", ("gyro", "dph"))


ROS = ["linear_acceleration_{}", "angular_velocity_{}"]


@pytest.mark.parametrize(
    ("accel", "gyro"),
    [
        (("(inch/s²)", "(inch/s²)", "(inch/s²)"), ("", "", "")),
        (("", "", ""), ("(deg/s)", "", "")),
        (("(g)", "(mg)", "(g)"), ("", "", "")),
    ],
)
def test_the_units_of_a_program_do_not_replace_those_of_the_header(accel, gyro):
    names = [
        f"{what.format(axis)} {text}".strip()
        for what, texts in zip(ROS, (accel, gyro), strict=True)
        for axis, text in zip("xyz", texts, strict=True)
    ]
    found = header_of(["time_s", *names])
    assert found.program is not None and found.program.name == "ROS"
    stated = found.accel[0] if any(accel) else found.gyro[0]
    assert stated.unit is None
    assert (found.gyro[0] if any(accel) else found.accel[0]).unit in ("mps2", "radps")


def test_a_time_column_without_a_readable_unit_hides_no_other(tmp_path):
    names = ["Timestamp", "Time (frame)", *header(accel="(g)", gyro="(dps)")[1:]]
    values = np.column_stack([1e3 * TIME_S, np.arange(ROWS), FORCE / G, RATE / DEG])
    message = refusal(write(tmp_path, names, values))
    assert "time_ms=Timestamp" in message
