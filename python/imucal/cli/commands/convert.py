"""The command `imucal convert`, which converts files of other programs to a recording."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from click.exceptions import Exit

from imucal.cli.options import JsonPath, RecordingPath
from imucal.cli.output import Output, require_apart
from imucal.cli.parameters import argument, option
from imucal.cli.reading import Reading, reading_options
from imucal.cli.working import working
from imucal.errors import InputError

if TYPE_CHECKING:
    from imucal.finding import Finding
    from imucal.io.pieces import Whole
    from imucal.recording.recording import Recording

__all__ = ["convert"]


def _print_formats(wanted: bool) -> None:
    if wanted:
        from imucal.cli.formats_page import page

        print(page(), end="")
        raise Exit


def _without_rotation(pieces: Iterator[Recording], output: Path) -> Iterator[Recording]:
    """Pass the pieces on unchanged. Raises InputError if an autopilot has rotated the samples."""
    for piece in pieces:
        rotated = [finding for finding in piece.findings if finding.code == "board_rotated"]
        if rotated:
            raise InputError(
                f"{rotated[0].message}, and {output.name} cannot store this rotation: calibrate from the log "
                "itself, or give the axes of the output (--axes; x,y,z for the axes of the vehicle)"
            )
        yield piece


def _lacking(whole: Whole) -> list[Finding]:
    """The warning that samples of the written recording are not numbers, if there are any."""
    from imucal.io.remarks import remark

    if not whole.lacking:
        return []
    warning = remark(
        whole.first.name,
        "non_finite",
        f"{whole.lacking} of {whole.samples} samples lack a number for the force or the rate",
        "a calibration needs both in every sample: leave these rows out, or record both sensors at similar "
        "rates",
    )
    return [replace(warning, count=whole.lacking)]


@reading_options
def convert(
    files: Annotated[
        list[Path],
        argument(metavar="FILE...", help="The file, the two files, or the folder of one recording."),
    ],
    output: RecordingPath,
    reading: Reading,
    formats: Annotated[
        bool,
        option(
            "--list", callback=_print_formats, is_eager=True, help="List the supported formats, and exit."
        ),
    ] = False,
    hold: Annotated[
        bool,
        option(
            "--hold-temperature",
            help="Fill gaps of a slowly sampled temperature with the last reading, for at most 10 s.",
        ),
    ] = False,
    json: JsonPath = None,
) -> None:
    """Convert files of other programs to a recording.

    Repairs to the data are printed, because the output file does not state them. If an autopilot has rotated
    the samples of a log, the log is converted only with --axes.

    Example: imucal convert xsens_acc.mat xsens_gyro.mat --format imu_tk -o run.csv
    """
    from imucal.io import write_pieces
    from imucal.io.held import hold_temperature
    from imucal.io.pieces import Whole

    require_apart(files, {"--output": output, "--json": json})

    def written(pieces: Iterator[Recording]) -> Whole:
        kept = pieces if reading.axes else _without_rotation(pieces, output)
        whole = Whole(hold_temperature(kept) if hold else kept)
        write_pieces(whole, output)
        return whole

    with working("converting"):
        whole = reading.by_pieces(files, written)
    recording = whole.first
    findings = [*recording.findings, *_lacking(whole)]
    out = Output(json)
    out.document(
        {
            "output": str(output),
            "samples": whole.samples,
            "duration_s": whole.duration_s,
            "rate_hz": recording.rate_hz if len(recording) > 1 else None,
            "accel_unit": recording.accel_unit,
            "gyro_unit": recording.gyro_unit,
            "sources": [asdict(source) for source in recording.sources],
            "findings": [finding.to_dict() for finding in findings],
        }
    )
    out.line(f"{output}: {whole!r}")
    out.findings(findings)
