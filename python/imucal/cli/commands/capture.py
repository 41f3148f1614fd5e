"""`imucal capture`: guided recording by hand, and the calibration from it."""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from imucal.cli.calibration_summary import show_calibration
from imucal.cli.options import JsonPath, Require, Required, UnitsOption, UnitSystem, writing_option
from imucal.cli.output import Output, require_apart
from imucal.cli.parameters import argument, option
from imucal.cli.working import working
from imucal.errors import ImucalError, InputError

if TYPE_CHECKING:
    from imucal.capture.loop import Capture, Ending
    from imucal.capture.session import Order
    from imucal.estimation.result import CalibrationResult
    from imucal.recording.recording import Recording

__all__ = ["capture"]

# Headings of the options in the help.
UNIT = "The unit's data"
POSES = "The poses"
CALIBRATION = "The calibration"
# The calibration refuses a recording with these findings unless the affected rests and moves are excluded.
SATURATED = ("accel_saturation", "gyro_saturation")
# Schema of the document of --json.
SCHEMA = "imucal.capture-result/1"


def capture(
    recording: Annotated[Path, argument(metavar="OUT.csv", help="Recording to write.")],
    source: Annotated[
        str,
        option(
            "--source",
            metavar="ADDRESS",
            help="Source of the unit's data: a serial port, tcp://HOST:PORT, udp://:PORT, - for standard "
            "input, http://:PORT for Sensor Logger, phyphox://HOST, or ros2:///TOPIC.",
            panel=UNIT,
        ),
    ],
    baud: Annotated[int, option("--baud", help="Baud rate of the serial port.", panel=UNIT)] = 115200,
    columns: Annotated[
        str | None,
        option(
            "--columns",
            metavar="NAMES",
            help="Format of text lines: a name for each number, '-' to ignore one, '*' at the end for a "
            "checksum as in NMEA 0183.",
            panel=UNIT,
        ),
    ] = None,
    packet: Annotated[
        Path | None,
        option("--packet", metavar="FILE", help="File that describes binary packets.", panel=UNIT),
    ] = None,
    sample_rate_hz: Annotated[
        float | None,
        option("--sample-rate", metavar="HZ", help="Sampling rate of a unit that sends no time.", panel=UNIT),
    ] = None,
    hold_s: Annotated[
        float, option("--hold-s", metavar="S", help="Time for which each pose is held, s.", panel=POSES)
    ] = 3.0,
    poses: Annotated[
        int | None,
        option(
            "--poses",
            metavar="N",
            help="Smallest number of poses (default 18; with a target 9).",
            panel=POSES,
        ),
    ] = None,
    target: Annotated[
        list[str] | None,
        option(
            "--target",
            metavar="GROUP=SIGMA",
            help="End when the largest predicted standard deviation in a group is below SIGMA, such as "
            "accel_bias='100 ug' or gyro_sensitivity=5e-4. May be repeated; all must be reached.",
            panel=POSES,
        ),
    ] = None,
    program: Annotated[
        Path | None,
        option(
            "--program",
            metavar="FILE",
            help="Program file with the poses in their order, from `imucal plan optimal --stand hand -o "
            "FILE`; by default the faces, edges and corners of a box.",
            panel=POSES,
        ),
    ] = None,
    output: Annotated[
        Path | None, writing_option("Calibration file to write; OUT.json if not given.", "CAL.json")
    ] = None,
    gravity: Annotated[
        float | None,
        option(
            "--gravity", metavar="MPS2", help="Local gravity, as for `imucal calibrate`.", panel=CALIBRATION
        ),
    ] = None,
    latitude: Annotated[
        float | None,
        option("--latitude", metavar="DEG", help="Latitude, for normal gravity.", panel=CALIBRATION),
    ] = None,
    height: Annotated[
        float | None,
        option("--height", metavar="M", help="Height of the place, with --latitude.", panel=CALIBRATION),
    ] = None,
    serial_number: Annotated[
        str | None, option("--serial-number", help="Serial number, stored in the file.", panel=CALIBRATION)
    ] = None,
    plain: Annotated[
        bool,
        option("--plain", help="Lines of text instead of the full screen; the default without a terminal."),
    ] = False,
    require: Require = Required.incomplete,
    units: UnitsOption = UnitSystem.datasheet,
    json: JsonPath = None,
) -> None:
    """Record a unit that you hold in your hand, guided pose by pose, and calibrate it.

    Shows the next pose, reports immediately why a pose does not count and which faults the data have, and
    ends when all poses are recorded. Samples are written to OUT.csv as they arrive, so after an interrupt or
    a crash, the same command continues the recording. Needs `pip install 'imucal-rs[capture]'` for the full
    screen and serial ports.

    Example: imucal capture hand.csv --source /dev/ttyUSB0 --packet packet.json

    Example: imucal capture accel.csv --source /dev/ttyUSB0 --columns time_us,accel_x_g,accel_y_g,accel_z_g

    Example: imucal capture phone.csv --source http://:8000 --target gyro_sensitivity=5e-4

    Example: imucal capture phone.csv --source phyphox://192.168.0.42 --plain
    """
    import imucal
    from imucal.capture.file import CaptureFile, marker_of
    from imucal.capture.loop import Capture
    from imucal.capture.session import Session
    from imucal.stand.clock import SYSTEM_CLOCK
    from imucal.stand.unit_source import unit_source

    saved = output or recording.with_suffix(".json")
    require_apart(
        [packet, program],
        {"OUT.csv": recording, "its marker": marker_of(recording), "--output": saved, "--json": json},
    )
    order = _order(hold_s, poses, target, program, gravity)
    unit = unit_source(source, baud=baud, columns=columns, packet=packet, rate_hz=sample_rate_hz)
    session = Session(unit.columns, order)
    out = Output(json, units)
    with CaptureFile(recording, unit.columns, {"serial_number": serial_number}) as file:
        if len(file):
            unit.continue_after(file.existing[-1], SYSTEM_CLOCK.now_s() - file.age_s)
        events: list[Any] = []
        taken = Capture(unit, file, session, events.append)
        ending = _shown(taken, out, is_plain=plain or source == "-" or not _is_terminal())
        count = len(file)
        out.line(f"{recording}: {count} samples, {len(session.poses)} poses")
        if ending == "stopped":
            out.line(
                "interrupted: all samples so far are saved, and the same command continues the recording"
            )
            raise KeyboardInterrupt
        if not count:
            raise InputError(
                f"{recording} has no samples: {unit.remark or unit.hint or 'the unit sent nothing'}"
            )
        known = {
            "gravity_mps2": gravity,
            "latitude_deg": latitude,
            "height_m": height,
            "serial_number": serial_number,
        }
        try:
            with working("calibrating"):
                result, excluded = _calibrated(imucal.read(recording), known)
        except ImucalError:
            out.line(f"{recording} is kept, and the same command continues it")
            raise
        file.finish()
    result.calibration.save(saved)
    if excluded:
        out.line(f"saturated rotations are excluded, as with `imucal calibrate {recording} {excluded}`")
    out.document(
        {
            "schema": SCHEMA,
            "recording": str(recording),
            "samples": count,
            "ending": ending,
            "poses": [
                {"number": p.number, "start_s": p.start_s, "end_s": p.end_s, "up": p.up.tolist()}
                for p in session.poses
            ],
            "calibration": str(saved),
            "result": result.to_dict(),
        }
    )
    show_calibration(out, result, saved, require)


def _order(
    hold_s: float, poses: int | None, targets: list[str] | None, program: Path | None, gravity: float | None
) -> Order:
    from imucal.capture.session import Order
    from imucal.rig.motion import Program
    from imucal.stand.manual import ups_of
    from imucal.units import STANDARD_GRAVITY_MPS2

    given = {}
    for text in targets or ():
        group, equals, wish = text.partition("=")
        if not equals:
            raise InputError(f"--target {text}: give GROUP=SIGMA, such as accel_bias='100 ug'")
        given[group.strip()] = wish
    return Order(
        hold_s=hold_s,
        poses=poses,
        targets=given,
        directions=None if program is None else ups_of(Program.read(program)),
        gravity_mps2=STANDARD_GRAVITY_MPS2 if gravity is None else gravity,
    )


def _calibrated(recording: Recording, known: Mapping[str, Any]) -> tuple[CalibrationResult, str]:
    """Calibrate a recording, without its saturated rests and moves if it has any.

    Also returns the option with which `imucal calibrate` gives the same result; may be empty.
    """
    import imucal

    try:
        return imucal.calibrate([recording], **known), ""
    except ImucalError as error:
        if not any(finding.code in SATURATED for finding in error.findings):
            raise
    return imucal.calibrate([recording], exclude_saturated=True, **known), "--exclude-saturated"


def _is_terminal() -> bool:
    return (
        sys.stdin is not None
        and sys.stdin.isatty()
        and sys.stdout.isatty()
        and os.environ.get("TERM") != "dumb"
    )


def _shown(taken: Capture, out: Output, *, is_plain: bool) -> Ending:
    """Run a capture, and show it on the full screen or as lines of text."""
    if not is_plain and not all(map(importlib.util.find_spec, ("textual", "pyfiglet"))):
        out.line("for the full screen: pip install 'imucal-rs[capture]'")
        is_plain = True
    if is_plain:
        from imucal.capture.plain import PlainView

        view = PlainView(out.line, _ring)
        taken.say = view.say
        view.read_commands(taken.commands)
        try:
            return taken.run()
        except KeyboardInterrupt:
            return "stopped"
    from imucal.capture.screen import CaptureScreen

    screen = CaptureScreen(taken)
    try:
        screen.run()
    finally:
        screen.stop_recording()
    if screen.error is not None:
        raise screen.error
    return screen.ending or "stopped"


def _ring() -> None:
    """Ring the bell of the terminal."""
    with suppress(OSError):
        if sys.stderr.isatty():
            sys.stderr.write("\a")
            sys.stderr.flush()
