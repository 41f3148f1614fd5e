"""The list of formats as a page: docs/formats.md is this text, and so is `imucal convert --list`."""

from __future__ import annotations

from collections.abc import Iterator

__all__ = ["page"]

HEAD = """# Formats that are read

`imucal.read(path, ...)`, every command that takes a recording, and `imucal convert FILE -o rec.csv` read
these. The format is found out from the file; `--format` (`format=`) names it where it is not. Where a file
holds several sensors, topics or groups, the error lists them with the option that chooses one. In Python
the options have the same names, with underscores.

Calibrate what the sensor measured: a calibration of data that somebody has corrected already comes on top
of that correction.
"""

FOOT = """## Arrays with names

MATLAB, HDF5 and NumPy files hold arrays with names. An array is found by its canonical name, that of a
column (`time_s`, `accel_x_mps2`, `temp_degc`) or of a whole triad of shape (N, 3) (`accel_mps2`,
`gyro_radps`, `stand_rad`); further arrays beside them with a number for every sample become auxiliary
inputs. `--columns` takes other names:

* `--columns time_s=t,accel_g=imu/acc,gyro_dps=imu/gyr`: ours=theirs. Nothing else is read then. For a
  CSV or Parquet file the same names columns; of the others those with names of ours stay.
* `--columns time_s,accel_x_g,...,gyro_z_dps`: a name for every column of the one array of shape (N, k) that
  has as many, `-` for one to leave out.

`--group` says where the arrays are, or which array is meant, if there are several.

## Time stamps of their own

Where accelerometer and gyroscope are recorded with different time stamps, they are brought onto one clock:

* The slower sensor is the clock, the gyroscope if both have the same rate (within 2 %).
* At the same rate the other sensor is interpolated between its two neighbouring samples. They share noise
  then: white noise per sample becomes up to 1.41 times smaller, the warning says by how much. A calibration
  takes noise that samples share into account, its standard deviations stay what they were; `imucal noise`
  shows the loss at times of a few samples.
* A faster sensor is averaged over one interval of the clock, centred at the stamp: the angle that a
  gyroscope turned through is kept.
* Samples of the clock where the other sensor has none, before it, after it and in its gaps, are left out:
  the gap stays visible.
* Rates that differ by more than 10 times are refused, and so are stamps that go back, and values that are
  not finite.

`imucal convert` prints what was done; inspect, calibrate, evaluate and noise keep it among their findings.

## Libraries

An extra is installed by its name, `pip install "imucal-rs[ros]"`, or all of them by `pip install
"imucal-rs[all]"`. A library is imported when a file needs it.
"""


def page() -> str:
    """The whole page, as Markdown."""
    return "\n".join([HEAD, *_overview(), *_sections(), FOOT])


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
