"""The options by which `imucal stand` knows its equipment, in one place: what moves, and what sends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from imucal.cli import completion
from imucal.cli.options import options_of
from imucal.errors import InputError

if TYPE_CHECKING:
    from imucal.motion import Program
    from imucal.stand.driver import Driver, Source

__all__ = ["Equipment", "equipment_options"]

DRIVERS = ("simulated",)
SIMULATED = "Simulated driver"


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

    def open(self, program: Program, seed: int) -> tuple[Driver, Source]:
        """The driver and the source for a run; `seed` is that of simulated noise."""
        if self.driver == "simulated":
            from imucal.stand.faults import SimulatedUnit
            from imucal.stand.simulated import SimulatedStand

            unit = SimulatedUnit(self.unit, self.stand, self.rate_hz, self.fault, seed)
            simulated = SimulatedStand(program, unit, seed=seed, speed=self.speed)
            return simulated, simulated
        raise InputError(f"there is no driver {self.driver!r}: give one of {', '.join(DRIVERS)}")


equipment_options = options_of("equipment", Equipment)
