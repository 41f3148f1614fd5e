"""Shell completion of arguments, such as names of effects; `imucal --install-completion` installs it.

Each function returns the possible values that begin with the text `incomplete`.
"""

from __future__ import annotations

__all__ = [
    "calibration_formats",
    "effects",
    "effects_and_disturbances",
    "effects_to_estimate",
    "effects_to_simulate",
    "exports",
    "formats",
    "line_programs",
    "plans",
    "programs",
    "stand_limits",
    "units",
]


def effects(incomplete: str) -> list[str]:
    """Names of effects."""
    from imucal.effects.table import catalogue

    return _starting([effect.name for effect in catalogue()], incomplete)


def effects_and_disturbances(incomplete: str) -> list[str]:
    """Names of effects, noise and faults."""
    from imucal.effects.disturbance import disturbances

    return effects(incomplete) + _starting([row.name for row in disturbances()], incomplete)


def effects_to_estimate(incomplete: str) -> list[str]:
    """Effects that a calibration can estimate; an effect with several forms is also listed as NAME:FORM."""
    from imucal.effects.table import catalogue

    names = []
    for effect in catalogue():
        if effect.sensor != "encoder":
            names.append(effect.name)
            names += [f"{effect.name}:{form}" for form in effect.forms]
    return _starting(names, incomplete)


def effects_to_simulate(incomplete: str) -> list[str]:
    """Effects, noise and faults with their typical sizes."""
    return _starting([f"{name}=typical" for name in effects_and_disturbances("")], incomplete)


def exports(incomplete: str) -> list[str]:
    """Formats in which a calibration is written."""
    from imucal.exporting import FORMATS

    return _starting(list(FORMATS), incomplete)


def formats(incomplete: str) -> list[str]:
    """Formats of recordings."""
    from imucal.io import FORMATS

    return _starting(list(FORMATS), incomplete)


def calibration_formats(incomplete: str) -> list[str]:
    """Formats of calibrations of other programs."""
    from imucal.importing import READERS

    return _starting(list(READERS), incomplete)


def line_programs(incomplete: str) -> list[str]:
    """Names of motion programs that determine all parameters. The shell completes names of program files."""
    return _starting(["optimal", "random"], incomplete)


def plans(incomplete: str) -> list[str]:
    """Names of motion programs that `imucal plan` accepts. The shell completes names of program files."""
    return _starting(["faces", "grid", "optimal", "random"], incomplete)


def programs(incomplete: str) -> list[str]:
    """Names of built-in motions of `imucal simulate`. The shell completes names of program files."""
    return _starting(["faces", "grid", "random", "static", "tumble"], incomplete)


def stand_limits(incomplete: str) -> list[str]:
    """Names of built-in sets of stand limits."""
    from imucal.rig.stand_limits import NAMED

    return _starting(list(NAMED), incomplete)


def units(incomplete: str) -> list[str]:
    """Names of built-in unit profiles."""
    from imucal.rig.unit import unit_names

    return _starting(list(unit_names()), incomplete)


def _starting(names: list[str], incomplete: str) -> list[str]:
    return [name for name in names if name.startswith(incomplete)]
