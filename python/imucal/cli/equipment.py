"""The options of `imucal stand` that describe the stand and the unit's data."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import imucal.cli.completion as completion
from imucal.cli.options import options_of
from imucal.cli.parameters import option
from imucal.errors import InputError

if TYPE_CHECKING:
    from imucal.rig.motion import Program
    from imucal.stand.clock import Clock
    from imucal.stand.driver import Driver, Progress, Source
    from imucal.stand.stream import StreamSource

__all__ = ["Equipment", "equipment_options"]

DRIVERS = ("simulated", "grbl", "dynamixel", "external", "manual")
# Drivers whose runs can be resumed.
RESUMED = ("grbl",)
# Headings of the options in the help.
SIMULATED = "Simulated driver"
GRBL = "Controller"
MOTORS = "Serial port of the motors"
DYNAMIXEL = "Dynamixel motors"
EXTERNAL = "External driver"
START = "Start of the motors"
UNIT = "The unit's data"
# For each heading of the help, the drivers to which the options under this heading apply.
OF_PANEL = {
    SIMULATED: ("simulated",),
    GRBL: ("grbl",),
    MOTORS: ("grbl", "dynamixel"),
    DYNAMIXEL: ("dynamixel",),
    EXTERNAL: ("external",),
    START: ("grbl", "dynamixel", "external"),
    UNIT: ("grbl", "dynamixel", "external", "manual"),
}


def _option(name: str, help: str, panel: str | None = None, **more: Any) -> Any:
    return option(name, help=help, panel=panel, **more)


@dataclass(frozen=True)
class Equipment:
    """The driver of a stand and the source of the unit's samples; the fields are command line options."""

    driver: Annotated[str, _option("--driver", f"Driver of the stand: {', '.join(DRIVERS)}.")] = "simulated"
    speed: Annotated[
        float,
        _option("--speed", "Speed-up relative to real time; the samples do not depend on it.", SIMULATED),
    ] = 1.0
    unit: Annotated[
        str,
        _option(
            "--unit",
            "The simulated unit, see `imucal simulate --unit`.",
            SIMULATED,
            metavar="NAME|FILE",
            completion=completion.units,
        ),
    ] = "paper"
    stand: Annotated[
        str | None,
        _option(
            "--stand",
            "Errors of the stand: a stand file, cheap, or cheap:SEED for another stand.",
            SIMULATED,
            metavar="FILE|cheap",
        ),
    ] = None
    rate_hz: Annotated[float, _option("--rate-hz", "Sampling rate of the simulated unit, Hz.", SIMULATED)] = (
        200.0
    )
    fault: Annotated[
        str | None,
        _option(
            "--fault",
            "A hidden fault, to test a production line: slip, loose-mount, clipping or dead-axis.",
            SIMULATED,
            metavar="NAME",
        ),
    ] = None

    fault_seed: Annotated[
        int, _option("--fault-seed", "Seed of the size, axis and time of the hidden fault.", SIMULATED)
    ] = 1
    port: Annotated[
        str | None,
        _option("--port", "Serial port of the controller or of the motors.", MOTORS, metavar="PORT"),
    ] = None
    baud: Annotated[
        int, _option("--baud", "Baud rate of the port; Dynamixel motors are delivered with 57600.", MOTORS)
    ] = 115200
    axes: Annotated[str, _option("--axes", "grbl: axis letters of the motors, outermost first.", GRBL)] = (
        "XYZ"
    )
    home: Annotated[
        bool, _option("--home", "grbl: run the homing cycle ($H) first; its end position is the zero.", GRBL)
    ] = False
    unlock: Annotated[
        bool, _option("--unlock", "grbl: unlock a controller that is locked by an alarm ($X).", GRBL)
    ] = False
    start_here: Annotated[
        bool, _option("--start-here", "The position of the motors at the start is the zero.", START)
    ] = False
    unwind: Annotated[bool, _option("--unwind", "Turn the motors back to zero first.", START)] = False
    resume_hold: Annotated[
        bool,
        _option("--resume-hold", "grbl: end a feed hold, or the hold after a closed door, by itself.", GRBL),
    ] = False
    ids: Annotated[str, _option("--ids", "Numbers of the three motors, outermost first.", DYNAMIXEL)] = (
        "1,2,3"
    )
    command: Annotated[
        str | None,
        _option(
            "--command",
            "external: command of the program that moves the stand, see docs/external-stand.md.",
            EXTERNAL,
            metavar="COMMAND",
        ),
    ] = None
    source: Annotated[
        str | None,
        _option(
            "--source",
            "Source of the unit's data: a serial port, tcp://HOST:PORT, or - for standard input.",
            UNIT,
            metavar="ADDRESS",
        ),
    ] = None
    source_baud: Annotated[int, _option("--source-baud", "Baud rate of the unit's serial port.", UNIT)] = (
        921600
    )
    columns: Annotated[
        str | None,
        _option(
            "--columns",
            "Format of text lines: a name for each number, '-' to ignore one, '*' at the end for a checksum "
            "as in NMEA 0183.",
            UNIT,
        ),
    ] = None
    packet: Annotated[
        Path | None, _option("--packet", "File that describes the unit's binary packets.", UNIT)
    ] = None
    sample_rate_hz: Annotated[
        float | None, _option("--sample-rate", "Sampling rate of a unit that sends no time, Hz.", UNIT)
    ] = None

    def to_dict(self) -> dict[str, Any]:
        """The options as stored in a journal, from which `stand resume` opens the same equipment."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: str(value) if isinstance(value, Path) else value for name, value in values.items()}

    @classmethod
    def of_dict(cls, values: dict[str, Any], **changes: Any) -> Equipment:
        """The equipment stored in a journal. Options that this version does not know are ignored.

        changes   options that replace those in the journal
        """
        known = {field.name for field in fields(cls)}
        given = {name: value for name, value in values.items() if name in known} | changes
        packet = given.get("packet")
        return cls(**{**given, "packet": None if packet is None else Path(packet)})

    @property
    def files(self) -> tuple[str | Path | None, ...]:
        """Values of the options that name an input file or, instead, a built-in unit or stand."""
        return (self.unit, self.stand, self.packet)

    def open(
        self, program: Program, seed: int, *, resume: Progress | None = None, clock: Clock | None = None
    ) -> tuple[Driver, Source]:
        """Return the driver of the stand and the source of the unit's data for a run.

        seed    seed of simulated noise
        resume  the progress of an interrupted run that is to be continued; None for a new run
        clock   clock of the run; default: the clock of the computer
        """
        self._require_own_options()
        if resume is not None and self.driver not in RESUMED:
            raise InputError(f"a run with the driver {self.driver} cannot be resumed: run it again")
        if self.driver == "simulated":
            from imucal.stand.faults import SimulatedUnit
            from imucal.stand.simulated import SimulatedStand

            mounted = SimulatedUnit(self.unit, self.stand, self.rate_hz, self.fault, self.fault_seed)
            simulated = SimulatedStand(program, mounted, seed=seed, speed=self.speed)
            return simulated, simulated
        if self.driver == "grbl":
            from imucal.stand.clock import SYSTEM_CLOCK
            from imucal.stand.gcode import Axes
            from imucal.stand.grbl import GrblDriver
            from imucal.stand.grbl_start import Consent

            if self.port is None:
                raise InputError("the driver grbl needs the serial port of the controller: give --port")
            axes = Axes(self.axes.upper())
            clock = clock or SYSTEM_CLOCK
            driver = GrblDriver(
                program,
                self.port,
                baud=self.baud,
                axes=axes,
                consent=Consent(self.home, self.unlock, self.start_here, self.unwind),
                resume_hold=self.resume_hold,
                resume=resume,
                clock=clock,
            )
            return driver, self._unit(clock)
        if self.driver == "dynamixel":
            import shlex
            import sys

            from imucal.stand.dynamixel import ids_of
            from imucal.stand.external import ExternalDriver

            if self.port is None:
                raise InputError("the driver dynamixel needs the serial port of the motors: give --port")
            ids = ",".join(map(str, ids_of(self.ids)))
            words = [sys.executable, "-m", "imucal.stand.dynamixel", "--port", self.port]
            words += ["--baud", str(self.baud), "--ids", ids]
            return ExternalDriver(
                program, shlex.join(words), start_here=self.start_here, unwind=self.unwind
            ), self._unit()
        if self.driver == "external":
            from imucal.stand.external import ExternalDriver

            if self.command is None:
                raise InputError("the driver external needs the command of the stand: give --command")
            return ExternalDriver(
                program, self.command, start_here=self.start_here, unwind=self.unwind
            ), self._unit()
        if self.driver == "manual":
            from imucal.stand.manual import ManualDriver

            unit = self._unit()
            return ManualDriver(program, unit.columns), unit
        raise InputError(f"there is no driver {self.driver!r}: give one of {', '.join(DRIVERS)}")

    def _require_own_options(self) -> None:
        """Refuse options of other drivers, which would otherwise be ignored silently."""
        declared = get_type_hints(type(self), include_extras=True)
        for field in fields(self):
            given = declared[field.name].__metadata__[0]
            drivers = OF_PANEL.get(given.panel, DRIVERS)
            if (
                self.driver in DRIVERS
                and self.driver not in drivers
                and getattr(self, field.name) != field.default
            ):
                raise InputError(
                    f"the driver {self.driver} has no option {given.names[0]}: give --driver "
                    f"{' or '.join(drivers)}, or leave it out"
                )

    def _unit(self, clock: Clock | None = None) -> StreamSource:
        from imucal.stand.clock import SYSTEM_CLOCK
        from imucal.stand.unit_source import unit_source

        if self.source is None:
            raise InputError(f"the driver {self.driver} needs the source of the unit's data: give --source")
        return unit_source(
            self.source,
            baud=self.source_baud,
            columns=self.columns,
            packet=self.packet,
            rate_hz=self.sample_rate_hz,
            clock=clock or SYSTEM_CLOCK,
        )


equipment_options = options_of("equipment", Equipment)
