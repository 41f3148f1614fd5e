"""What the shell offers after the Tab key for arguments that are names: `imucal --install-completion`."""

from __future__ import annotations

__all__ = [
    "effects",
    "effects_and_disturbances",
    "effects_to_estimate",
    "effects_to_simulate",
    "formats",
    "line_programs",
    "plans",
    "programs",
    "stand_limits",
    "units",
]


def effects(incomplete: str) -> list[str]:
    """Names of the catalogue."""
    from imucal.effects.effect import catalogue

    return _starting([effect.name for effect in catalogue()], incomplete)


def effects_and_disturbances(incomplete: str) -> list[str]:
    """Names of effects, noise and faults."""
    from imucal.effects.disturbance import disturbances

    return effects(incomplete) + _starting([row.name for row in disturbances()], incomplete)


def effects_to_estimate(incomplete: str) -> list[str]:
    """Effects that a calibration can have, with `:full` where there is a full form."""
    from imucal.effects.effect import catalogue

    names = []
    for effect in catalogue():
        if effect.sensor != "encoder":
            names.append(effect.name)
            if effect.plain < len(effect.parameters):
                names.append(f"{effect.name}:full")
    return _starting(names, incomplete)


def effects_to_simulate(incomplete: str) -> list[str]:
    """Effects, noise and faults with their typical sizes."""
    return _starting([f"{name}=typical" for name in effects_and_disturbances("")], incomplete)


def formats(incomplete: str) -> list[str]:
    """Formats of recordings."""
    from imucal.io import FORMATS

    return _starting(list(FORMATS), incomplete)


def line_programs(incomplete: str) -> list[str]:
    """Programs that determine all of a unit; a file is completed by the shell."""
    return _starting(["optimal", "random"], incomplete)


def plans(incomplete: str) -> list[str]:
    """Programs to plan; a file is completed by the shell."""
    return _starting(["grid", "optimal", "random"], incomplete)


def programs(incomplete: str) -> list[str]:
    """Motions that have a name; a file is completed by the shell."""
    return _starting(["grid", "random", "static", "tumble"], incomplete)


def stand_limits(incomplete: str) -> list[str]:
    """Stands that have a name."""
    from imucal.rig.stand_limits import NAMED

    return _starting(list(NAMED), incomplete)


def units(incomplete: str) -> list[str]:
    """Units that the package brings."""
    from imucal.rig.unit import unit_names

    return _starting(list(unit_names()), incomplete)


def _starting(names: list[str], incomplete: str) -> list[str]:
    return [name for name in names if name.startswith(incomplete)]
