"""A stand: the errors of a simulated one (`Stand`), what drives a real one, and what records."""

from imucal.stand.model import Stand, stand_from_name, stand_of

# A simulation needs the first one alone: drivers and recording are imported where they are used.
__all__ = ["Stand", "stand_from_name", "stand_of"]
