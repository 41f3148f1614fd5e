"""The options for reading recordings, shared by all commands."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import imucal.cli.completion as completion
from imucal.cli.as_typed import AXES_GIVEN
from imucal.cli.options import options_of
from imucal.cli.parameters import argument, option
from imucal.errors import InputError

if TYPE_CHECKING:
    from imucal.recording.means import Means
    from imucal.recording.recording import Recording

__all__ = ["Files", "Reading", "reading_options"]

Files = Annotated[list[Path], argument(metavar="REC...", help="Recordings of one unit.")]

T = TypeVar("T")
# Heading of the reading options in the help.
_PANEL = "Files of other programs"


def _option(name: str, help: str) -> Any:
    names = completion.formats if name == "--format" else None
    return option(name, help=help, panel=_PANEL, completion=names)


@dataclass(frozen=True)
class Reading:
    """Options for reading files; the fields are the arguments of `imucal.read`."""

    format: Annotated[
        str | None,
        _option("--format", "Format, see `imucal convert --list`; detected from the file if not given."),
    ] = None
    columns: Annotated[
        str | None,
        _option(
            "--columns",
            "A name for every column, '-' to ignore it: accel_x_mps2,...,gyro_z_dps; or canonical=name,... "
            "if the file has other names.",
        ),
    ] = None
    rate_hz: Annotated[
        float | None, _option("--rate-hz", "Sampling rate, Hz, if there is no time column.")
    ] = None
    skip_rows: Annotated[int | None, _option("--skip-rows", "columns: lines to skip at the start.")] = None
    topic: Annotated[
        str | None,
        _option("--topic", "ROS, MCAP: topic, or two as ACCEL,GYRO. PX4, ArduPilot: name of the message."),
    ] = None
    instance: Annotated[
        int | None, _option("--instance", "PX4, ArduPilot: number of the sensor, from 0.")
    ] = None
    group: Annotated[str | None, _option("--group", "MATLAB, HDF5, NumPy: group of the arrays.")] = None
    receive_time: Annotated[
        bool, _option("--receive-time", "ROS, MCAP: use the time stamps of the bag, not of the messages.")
    ] = False
    time_unit: Annotated[str | None, _option("--time-unit", "Two files without units: s, ms, us or ns.")] = (
        None
    )
    accel_unit: Annotated[
        str | None, _option("--accel-unit", "Two files without units: lsb, m/s^2, g, mg, ...")
    ] = None
    gyro_unit: Annotated[
        str | None, _option("--gyro-unit", "Two files without units: lsb, rad/s, deg/s, ...")
    ] = None
    temp_scale: Annotated[
        str | None,
        _option(
            "--temp-scale",
            "SLOPE,OFFSET of a column temp_lsb, degC per count and degC; 1/340,36.53 for an MPU-6050.",
        ),
    ] = None
    axes: Annotated[
        str | None,
        _option(
            "--axes",
            "Change of axes for both sensors: frd or ned (z down), flu (no change), or the file's axes that "
            "become x, y and z, such as x,-y,-z. For one sensor: accel=... or gyro=...",
        ),
    ] = None

    def one(self, paths: Sequence[Path]) -> Recording:
        """The recording in these files."""
        from imucal.io import read

        return read(*paths, **self._options())

    def by_pieces(self, paths: Sequence[Path], use: Callable[[Iterator[Recording]], T]) -> T:
        """Call `use` with the recording in pieces, or in one piece if its format cannot be read in pieces."""
        from imucal.io import NotInPartsError, read_pieces

        try:
            return use(read_pieces(*paths, **self._options()))
        except NotInPartsError:
            return use(iter([self.one(paths)]))

    def each(self, paths: Sequence[Path]) -> list[Recording]:
        """The recordings in these files. If each sensor has its own file, two files make one recording."""
        from imucal.io import files_per_recording

        size = files_per_recording(self.format, paths)
        if len(paths) % size:
            raise InputError(
                f"{len(paths)} files given, but the format {self.format} needs {size} for each recording"
            )
        return [self.one(paths[start : start + size]) for start in range(0, len(paths), size)]

    def means(self, paths: Sequence[Path]) -> Means:
        """The table of mean readings in one file."""
        from imucal.io.means import read_means

        if len(paths) != 1:
            raise InputError(
                f"{len(paths)} files given with --means: give one table, with one row for each pose"
            )
        return read_means(paths[0], **self._options())

    def _options(self) -> dict[str, Any]:
        AXES_GIVEN.set(self.axes)
        return {field.name: getattr(self, field.name) for field in fields(self)}


reading_options = options_of("reading", Reading)
