"""The page docs/formats.md on file formats, which `imucal convert --list` also prints."""

from __future__ import annotations

from collections.abc import Iterator

from imucal.cli.exports_page import exports_section

__all__ = ["page"]

HEAD = """# Formats that are read

`imucal.read(path, ...)`, every command that takes a recording, and `imucal convert FILE -o rec.csv` read
these formats. The format is recognised from the file. `--format` (in Python `format=`) selects it
explicitly. If a file contains several sensors, topics or groups, the error message lists them and the
option that selects one of them. In Python the options have the same names, with underscores.

Calibrate a unit from uncorrected sensor data. If the data have already been corrected by another
calibration, the new calibration is valid only for data that the other calibration has corrected.

The option `--axes`, for example `--axes frd`, changes the axes of a recording of any format after
reading; see [Axes and frames](frames.md).
"""

FOOT = """## Temperature

A temperature is in degC (`temp_degc`), kelvin (`temp_k`) or degrees Fahrenheit (`temp_degf`). Raw counts
(`temp_lsb`) need the slope and the offset of the datasheet, `--temp-scale SLOPE,OFFSET` in degC per count
and degC; the slope may be a fraction. Without `--temp-scale` the counts become an auxiliary input.

| sensor | `--temp-scale` |
|---|---|
| MPU-6050 | `1/340,36.53` |
| ICM-42688-P | `1/132.48,25` |
| LSM6DSO | `1/256,25` |
| BMI160, BMI270 | `1/512,23` |

Recordings are written with `temp_degc`. Temperatures outside -60 to 150 degC are refused
(`temperature_implausible`), and the message names the unit in which the values would be plausible.

## Damaged files

Files of the formats rosbag, mcap, ulog, dataflash, matlab and hdf5 are read by a child process. The
libraries of these formats do not check the lengths that a file states, so a damaged file can crash them
or exhaust the memory. The child process may allocate 100 MB plus 10 times the size of the file, and use
6 s of processor time plus 4 s per megabyte. A file that needs more memory or time is refused. If a valid
file is refused because it is compressed, save the data uncompressed, or as Parquet. Values that an HDF5
file stores in other files are not read.

## Arrays with names

MATLAB, HDF5 and NumPy files contain named arrays. An array is found by its canonical name: the name of a
column (`time_s`, `accel_x_mps2`, `temp_degc`) or of a triad of shape (N, 3) (`accel_mps2`, `gyro_radps`,
`stand_rad`). Further arrays with one number per sample become auxiliary inputs. `--columns` selects arrays
with other names:

* `--columns time_s=t,accel_g=imu/acc,gyro_dps=imu/gyr` assigns canonical names to the names in the file. No
  other arrays are read. In a CSV or Parquet file the same syntax assigns names to columns, and the other
  columns with canonical names are still read.
* `--columns time_s,accel_x_g,...,gyro_z_dps` names the columns of the one array of shape (N, k) with this
  number of columns; `-` skips a column.

`--group` selects the group that contains the arrays, or one of several arrays.

## Data frames

In Python, a data frame with the canonical column names is accepted wherever a recording is expected. The
data frame may be of pandas (2.2), polars, pyarrow, DuckDB, or any other library with the Arrow interface
`__arrow_c_stream__`. `imucal.read(frame, columns="time_s=t,...")` reads a data frame with other column
names. `Recording.to_arrow()` and `Recording.to_pandas()` return the columns with the canonical names and
bit-identical values, and `polars.DataFrame(recording)` accepts a recording directly.

## Separate time stamps

If accelerometer and gyroscope are recorded with different time stamps, they are resampled to one clock:

* The common time stamps are those of the slower sensor, or of the gyroscope if both sensors have the same
  rate (within 2 %).
* If both sensors have the same rate, the accelerometer is interpolated linearly to the time stamps of the
  gyroscope. The noise of interpolated samples is correlated, and the white noise per sample is up to 1.41
  times smaller; the warning gives the factor. A calibration accounts for this correlation, so the
  standard deviations do not change. `imucal noise` shows the smaller noise at averaging times of a few
  samples.
* A faster sensor is averaged over one sampling interval of the slower sensor, centred at the time stamp.
  The average preserves the integrated angle of a gyroscope.
* Time stamps at which one sensor has no samples are left out. These are times before the first sample,
  after the last sample, and in gaps of this sensor. A gap remains visible in the time stamps.
* Rates that differ by more than a factor of 10, time stamps that decrease, and values that are not finite
  are refused.

`imucal convert` prints each of these steps that was applied. The commands inspect, calibrate, evaluate
and noise report the steps as findings.

## Libraries

Each extra is installed by its name, for example `pip install "imucal-rs[ros]"`, and all extras by
`pip install "imucal-rs[all]"`. A library is imported only when a file needs it.
"""


def page() -> str:
    """The page docs/formats.md as Markdown."""
    return "\n".join([HEAD, *_overview(), *_sections(), *exports_section(), FOOT])


def _overview() -> Iterator[str]:
    from imucal.io import FORMATS

    rows = [(name, row.title, row.extra or "-", row.known_by) for name, row in FORMATS.items()]
    headings = ("`--format`", "what", "extra", "recognised by")
    widths = [max(len(row[i]) for row in (headings, *rows)) for i in range(4)]
    for row in (headings, tuple("-" * width for width in widths), *rows):
        yield "| " + " | ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) + " |"
    yield ""


def _sections() -> Iterator[str]:
    from imucal.io import FORMATS

    for name, row in FORMATS.items():
        options = ", ".join(f"`--{option.replace('_', '-')}`" for option in row.options)
        yield f"## {name}: {row.title}"
        yield ""
        yield f"* Reads: {row.reads}."
        yield f"* Units: {row.units}."
        yield f"* Time stamps: {row.time}."
        yield f"* Options: {options or 'none'}."
        yield ""
        yield f"      imucal convert {row.example} --format {name} -o rec.csv"
        yield ""
