"""What a tool answered, in one form for all tools."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import imucal
from gap.case import Case


@dataclass(frozen=True)
class Said:
    """An answer.

    verdict     as in the schema imucal.gap/1, or "error: ..."
    names       what joined the model, the first first
    estimates   `<effect>_<parameter>` -> (value, standard deviation)
    generic     block and kernel of an unknown effect, in words
    gap         before, after, floor, closed on the control recording
    """

    verdict: str
    names: tuple[str, ...] = ()
    estimates: dict[str, tuple[float, float]] = field(default_factory=dict)
    ambiguous_with: tuple[str, ...] = ()
    resembles: tuple[str, ...] = ()
    generic: str = ""
    not_observable: tuple[str, ...] = ()
    smallest_visible: dict[str, float] = field(default_factory=dict)
    gap: dict[str, float | None] = field(default_factory=dict)
    advice: str = ""
    seconds: float = 0.0


def find_gap(
    measured: imucal.Recording | Sequence[imucal.Recording], control: imucal.Recording, case: Case
) -> tuple[Said, Any]:
    """Ask imucal; returns its answer in the common form, and as it is. It sees nothing of the case but its
    recordings and what a user would give.
    """
    start = time.perf_counter()
    try:
        gap = imucal.find_gap(measured, control=control, **case.given)
    except BaseException as error:
        # A panic of the library is no Exception; it counts as an answer, a wrong one, and the run goes on.
        if not isinstance(error, imucal.ImucalError) and type(error).__name__ != "PanicException":
            raise
        return Said(f"error: {error}"[:300], seconds=time.perf_counter() - start), None
    return read(gap, time.perf_counter() - start), gap


def read(gap: Any, seconds: float) -> Said:
    """An `imucal.Gap` in the common form."""
    generic, advice = part(gap, "generic"), part(gap, "next_motion")
    estimates = {}
    for effect in part(gap, "effects"):
        for parameter in part(effect, "parameters") or ():
            std = part(parameter, "std")
            name = f"{part(effect, 'name')}_{part(parameter, 'name')}"
            estimates[name] = (float(part(parameter, "value")), float("nan") if std is None else float(std))
    figures = part(gap, "gap")
    return Said(
        str(part(gap, "verdict")),
        tuple(part(effect, "name") for effect in part(gap, "effects")),
        estimates,
        tuple(part(gap, "ambiguous_with") or ()),
        tuple(part(gap, "resembles") or ()),
        "" if generic is None else f"{part(generic, 'block')}, {part(generic, 'kernel')}",
        tuple(part(item, "name") for item in part(gap, "not_observable") or ()),
        {name: float(part(size, "value")) for name, size in (part(gap, "smallest_visible") or {}).items()},
        {}
        if figures is None
        else {name: part(figures, name) for name in ("before", "after", "floor", "closed")},
        "" if advice is None else str(part(advice, "description")),
        seconds,
    )


def part(item: Any, name: str) -> Any:
    """A field of an object or of a mapping."""
    return item[name] if isinstance(item, Mapping) else getattr(item, name)
