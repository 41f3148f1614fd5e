"""Data frames with the Arrow interface as recordings, and recordings as Arrow tables and data frames."""

import subprocess
import sys

import numpy as np
import pyarrow as pa
import pytest

import imucal

# What a program does with tables and files, and whether pandas is then imported.
SCRIPT = """
import sys
import numpy as np
import imucal

made = imucal.simulate("random", seed=1, rate_hz=50.0).recording
for ending in (".csv", ".parquet"):
    imucal.write(made, sys.argv[1] + ending)
    read = imucal.read(sys.argv[1] + ending)
    pieces = list(imucal.io.read_pieces(sys.argv[1] + ending))
frame = read.to_arrow()
if "polars" in sys.argv:
    import polars

    frame = polars.DataFrame(read)
imucal.inspect(frame)
result = imucal.calibrate(frame)
result.calibration.apply_recording(frame)
if "polars" in sys.argv:
    from imucal.report import write_calibration_page

    write_calibration_page(sys.argv[1] + ".html", result)
print("pandas" in sys.modules)
"""


class OfAnotherLibrary:
    """An object that has nothing but the Arrow interface."""

    def __init__(self, table):
        self.table = table

    def __arrow_c_stream__(self, requested_schema=None):
        return self.table.__arrow_c_stream__(requested_schema)

    def __iter__(self):
        return iter(self.table.column_names)


@pytest.fixture(scope="module")
def run():
    return imucal.simulate("random", seed=1, rate_hz=50.0).recording


@pytest.fixture
def recording(run):
    part = run.between(0, 4)
    return imucal.Recording(
        part.time_s,
        part.specific_force,
        part.angular_rate,
        temperature_degc=np.linspace(20, 21, len(part)),
        auxiliary={"supply_v": np.full(len(part), 3.3)},
    )


def assert_equal(one, other):
    """The recordings have the same bits."""
    for column in ("time_s", "specific_force", "angular_rate", "temperature_degc"):
        a, b = getattr(one, column), getattr(other, column)
        assert (a.dtype, a.shape, a.tobytes()) == (b.dtype, b.shape, b.tobytes()), column
    assert list(one.auxiliary) == list(other.auxiliary)
    for name, values in one.auxiliary.items():
        assert values.tobytes() == other.auxiliary[name].tobytes(), name


@pytest.fixture
def extreme():
    """Numbers whose bits are easily lost: subnormal, largest, negative zero, NaN, and all digits."""
    numbers = np.random.default_rng(1).normal(size=(8, 3))
    numbers[:5, 0] = 5e-324, 1.7976931348623157e308, -0.0, np.nan, 0.1 + 0.2
    return imucal.Recording(
        1e9 + np.arange(8) / 3,
        numbers,
        numbers[::-1],
        temperature_degc=numbers[:, 1],
        auxiliary={"supply_v": numbers[:, 2]},
    )


def pandas_frame(recording):
    pytest.importorskip("pandas")
    return recording.to_pandas()


def polars_frame(recording):
    return pytest.importorskip("polars").DataFrame(recording)


FRAMES = {
    "arrow": imucal.Recording.to_arrow,
    "interface": lambda recording: OfAnotherLibrary(recording.to_arrow()),
    "stream": lambda recording: pa.RecordBatchReader.from_stream(recording),
    "pandas": pandas_frame,
    "polars": polars_frame,
}


@pytest.mark.parametrize("library", FRAMES)
def test_frames_and_recordings_have_the_same_bits(recording, extreme, library):
    for given in (recording, extreme):
        assert_equal(imucal.read(FRAMES[library](given)), given)


@pytest.mark.parametrize("kind", [np.float32, np.int16])
@pytest.mark.parametrize("library", ["arrow", "pandas", "polars"])
def test_smaller_types_of_a_frame_keep_their_numbers(library, kind):
    counts = np.random.default_rng(2).integers(-32768, 32767, (20, 3)).astype(kind)
    given = imucal.Recording(np.arange(20) / 10, counts, counts, accel_unit="lsb", gyro_unit="lsb")
    read = imucal.read(FRAMES[library](given))
    # float32 holds every number of 16 bits.
    assert read.specific_force.dtype == np.float32
    np.testing.assert_array_equal(read.specific_force, counts)
    np.testing.assert_array_equal(read.angular_rate, counts)


def test_a_frame_is_taken_where_a_recording_is_expected(run):
    frame, given = OfAnotherLibrary(run.to_arrow()), imucal.calibrate(run)
    for recordings in (frame, [frame]):
        result = imucal.calibrate(recordings)
        assert [p.value for p in result.parameters] == [p.value for p in given.parameters]
    assert imucal.inspect(frame).to_dict() is not None
    corrected = given.calibration.apply_recording(frame)
    np.testing.assert_array_equal(corrected.angular_rate, given.calibration.apply_recording(run).angular_rate)


def test_names_rates_and_units_of_a_frame(recording):
    table = recording.to_arrow()
    other = table.rename_columns(["t" if name == "time_s" else name for name in table.column_names])
    with pytest.raises(imucal.FormatError, match=r"time_s .* is missing.*--columns 'time_s=t'"):
        imucal.calibrate(other)
    read = imucal.read(other, columns="time_s=t")
    np.testing.assert_array_equal(read.time_s, recording.time_s)
    np.testing.assert_array_equal(read.specific_force, recording.specific_force)
    np.testing.assert_allclose(imucal.read(table.drop(["time_s"]), rate_hz=10).time_s[1], 0.1)
    scaled = table.rename_columns([name.replace("radps", "dps") for name in table.column_names])
    np.testing.assert_allclose(
        imucal.read(scaled).angular_rate, np.radians(recording.angular_rate), rtol=1e-14
    )
    decimal = table.set_column(
        table.column_names.index("accel_x_mps2"),
        "accel_x_mps2",
        pa.array(recording.specific_force[:, 0].round(3)).cast(pa.decimal128(9, 3), safe=False),
    )
    np.testing.assert_allclose(
        imucal.read(decimal).specific_force[:, 0], recording.specific_force[:, 0], atol=6e-4
    )


@pytest.mark.parametrize(
    ("given", "options", "message"),
    [
        (pa.table({"time_s": [0.0]}), {}, "accel_x_.* is missing"),
        (pa.table({"time_s": [0.0]}), {"topic": "a"}, "a data frame has no option topic"),
        ({"time_s": [0.0]}, {}, "a dict is neither the path of a file nor a data frame"),
    ],
)
def test_frames_that_are_no_recording(given, options, message):
    with pytest.raises(imucal.ImucalError, match=message):
        imucal.read(given, **options)
    with pytest.raises(imucal.ImucalError) as caught:
        imucal.calibrate(given)
    assert "is the path of a file" not in str(caught.value)


def test_pandas_is_named_where_it_is_missing(recording, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(imucal.ImucalError, match="to_pandas needs pandas"):
        recording.to_pandas()


def imports_pandas(tmp_path, *words, path=None):
    """What SCRIPT prints, with `path` before the installed packages."""
    before = "" if path is None else f"import sys; sys.path.insert(0, {str(path)!r})\n"
    command = [sys.executable, "-c", before + SCRIPT, tmp_path / "run", *words]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_reading_writing_and_calibrating_do_not_import_pandas(tmp_path):
    # Arrow imports pandas wherever it finds it, so there has to be one.
    (tmp_path / "pandas.py").write_text("__version__ = '2.2.0'\n")
    assert imports_pandas(tmp_path, path=tmp_path) == "False\n"


@pytest.mark.slow
def test_polars_and_reports_do_not_import_pandas(tmp_path):
    for library in ("pandas", "polars", "plotly"):
        pytest.importorskip(library)
    assert imports_pandas(tmp_path, "polars") == "False\n"
