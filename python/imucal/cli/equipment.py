"""The options by which `imucal stand` knows its equipment, in one place: what moves, and what sends."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

import imucal.cli.completion as completion
from imucal.cli.options import options_of
from imucal.errors import InputError

if TYPE_CHECKING:
    from imucal.rig.motion import Program
    from imucal.stand.driver import Driver, Source

__all__ = ["Equipment", "equipment_options"]

DRIVERS = ("simulated", "grbl", "manual")
SIMULATED = "Simulated driver"
GRBL = "Controller"
UNIT = "The unit's data"
# Which drivers the options under a heading are for.
OF_PANEL = {SIMULATED: ("simulated",), GRBL: ("grbl",), UNIT: ("grbl", "manual")}


def _option(name: str, help: str, panel: str | None = None, **more: Any) -> Any:
    return typer.Option(name, help=help, rich_help_panel=panel, **more)


@dataclass(frozen=True)
class Equipment:
    """What moves a stand, and what the unit on it sends; the fields are options."""

    driver: Annotated[str, _option("--driver", f"What moves the stand: {', '.join(DRIVERS)}.")] = "simulated"
    speed: Annotated[
        float,
        _option("--speed", "How many times faster than real time; the samples are the same.", SIMULATED),
    ] = 1.0
    unit: Annotated[
        str,
        _option(
            "--unit",
            "The unit, as `imucal simulate` takes it.",
            SIMULATED,
            metavar="NAME|FILE",
            autocompletion=completion.units,
        ),
    ] = "paper"
    stand: Annotated[
        str | None,
        _option(
            "--stand",
            "Errors of the stand: a stand file, cheap, or cheap:SEED for another one.",
            SIMULATED,
            metavar="FILE|cheap",
        ),
    ] = None
    rate_hz: Annotated[float, _option("--rate-hz", "Sample rate of the simulated unit.", SIMULATED)] = 200.0
    fault: Annotated[
        str | None,
        _option(
            "--fault",
            "A hidden fault, to try what a line makes of it: slip, loose-mount, clipping or dead-axis.",
            SIMULATED,
            metavar="NAME",
        ),
    ] = None

    fault_seed: Annotated[
        int, _option("--fault-seed", "Of the size and place of the hidden fault.", SIMULATED)
    ] = 1
    port: Annotated[
        str | None, _option("--port", "grbl: serial port of the controller.", GRBL, metavar="PORT")
    ] = None
    baud: Annotated[int, _option("--baud", "grbl: baud rate of the controller.", GRBL)] = 115200
    axes: Annotated[str, _option("--axes", "grbl: letters of the motors, outer motor first.", GRBL)] = "XYZ"
    source: Annotated[
        str | None,
        _option(
            "--source",
            "Where the unit sends: a serial port, tcp://HOST:PORT, or - for standard input.",
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
            "The unit sends lines of numbers: a name for each, '-' to leave one out, '*' at the end for a "
            "checksum as in NMEA 0183.",
            UNIT,
        ),
    ] = None
    packet: Annotated[
        Path | None, _option("--packet", "The unit sends binary packets, which this file describes.", UNIT)
    ] = None
    sample_rate_hz: Annotated[
        float | None, _option("--sample-rate", "Sample rate of a unit that sends no time, Hz.", UNIT)
    ] = None

    @property
    def files(self) -> tuple[str | Path | None, ...]:
        """What is read to know the equipment: files, or names of something built in."""
        return (self.unit, self.stand, self.packet)

    def open(self, program: Program, seed: int) -> tuple[Driver, Source]:
        """The driver and the source for a run; `seed` is that of simulated noise."""
        self._require_own_options()
        if self.driver == "simulated":
            from imucal.stand.faults import SimulatedUnit
            from imucal.stand.simulated import SimulatedStand

            mounted = SimulatedUnit(self.unit, self.stand, self.rate_hz, self.fault, self.fault_seed)
            simulated = SimulatedStand(program, mounted, seed=seed, speed=self.speed)
            return simulated, simulated
        if self.driver == "grbl":
            from imucal.stand.gcode import Axes
            from imucal.stand.grbl import GrblDriver

            if self.port is None:
                raise InputError("the driver grbl needs the port of the controller: give --port")
            axes = Axes(self.axes.upper())
            return GrblDriver(program, self.port, baud=self.baud, axes=axes), self._unit()
        if self.driver == "manual":
            from imucal.stand.manual import ManualDriver

            unit = self._unit()
            return ManualDriver(program, unit.columns), unit
        raise InputError(f"there is no driver {self.driver!r}: give one of {', '.join(DRIVERS)}")

    def _require_own_options(self) -> None:
        """Refuse options of another driver: without --driver all of a real stand would be passed over."""
        declared = get_type_hints(type(self), include_extras=True)
        for field in fields(self):
            # In an annotation its first argument, which typer keeps as `default`, is the option's name.
            option = declared[field.name].__metadata__[0]
            drivers = OF_PANEL.get(option.rich_help_panel, DRIVERS)
            if (
                self.driver in DRIVERS
                and self.driver not in drivers
                and getattr(self, field.name) != field.default
            ):
                raise InputError(
                    f"{option.default} is no option of the driver {self.driver}: give --driver "
                    f"{' or '.join(drivers)}, or leave it out"
                )

    def _unit(self) -> Source:
        import numpy as np

        from imucal.stand.lines import LineDecoder
        from imucal.stand.link import link_to
        from imucal.stand.packet import PacketDecoder, PacketFormat
        from imucal.stand.rows import recording_of
        from imucal.stand.stream import StreamSource

        if self.source is None:
            raise InputError(f"the driver {self.driver} needs the data of the unit: give --source")
        if (self.columns is None) == (self.packet is None):
            raise InputError("say what the unit sends: give either --columns or --packet")
        link = link_to(self.source, self.source_baud)
        decoder = (
            LineDecoder(self.columns or "")
            if self.packet is None
            else PacketDecoder(PacketFormat.read(self.packet))
        )
        source = StreamSource(link, decoder, rate_hz=self.sample_rate_hz)
        # Before the stand moves, not when the run is to be calibrated.
        recording_of(source.columns, np.zeros((0, len(source.columns))), "the data of the unit")
        return source


equipment_options = options_of("equipment", Equipment)
