"""The command `imucal effects`, which lists the sensor errors beyond bias, scale and misalignment."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import imucal.cli.completion as completion
from imucal.cli.options import JsonPath
from imucal.cli.output import Output, require_apart
from imucal.cli.parameters import argument, option

if TYPE_CHECKING:
    from imucal.effects.disturbance import Disturbance
    from imucal.effects.effect import Effect

__all__ = ["effects"]


def effects(
    name: Annotated[
        str | None,
        argument(
            metavar="[NAME]",
            help="Show all parameters of this effect, noise or fault.",
            completion=completion.effects_and_disturbances,
        ),
    ] = None,
    markdown: Annotated[
        Path | None, option("--markdown", metavar="PATH", help="Write the whole catalogue as a page.")
    ] = None,
    json: JsonPath = None,
) -> None:
    """List the errors beyond bias, scale and misalignment that imucal models: effects, noise and faults.

    Example: imucal effects gyro_g_sensitivity
    """
    from imucal.cli.effects_page import page
    from imucal.document.atomic import write_text
    from imucal.effects.disturbance import disturbances
    from imucal.effects.table import catalogue, find

    require_apart([], {"--markdown": markdown, "--json": json})
    out = Output(json)
    if markdown is not None:
        write_text(markdown, page())
    others = {row.name: row for row in disturbances()}
    if name is None:
        out.document({"effects": catalogue(), "noise_and_faults": disturbances()})
        _list(out, catalogue(), disturbances())
    elif name in others:
        out.document(_plain(others[name]))
        _show_disturbance(out, others[name])
    else:
        out.document(_plain(find(name)))
        _show(out, find(name))


def _plain(row: Effect | Disturbance) -> dict[str, Any]:
    from imucal.document.plain import plain

    document: dict[str, Any] = plain(row)
    return document


def _list(out: Output, rows: tuple[Effect, ...], others: tuple[Disturbance, ...]) -> None:
    from imucal.cli.effects_page import size

    out.line(
        "effects: parameters of the plain form, formula; typical size of the first parameter; observable in"
    )
    for row in rows:
        full = f" ({len(row.parameters)} in full)" if row.plain < len(row.parameters) else ""
        first = row.parameters[0]
        out.line(f"{row.name:<27} {row.sensor:<14} {row.plain}{full}, {row.formula}")
        out.line(f"    {size(first)}; {row.observable}")
    out.line("noise and faults: parameters; typical size; appears as")
    for other in others:
        names = ", ".join(parameter.name for parameter in other.parameters)
        out.line(f"{other.name:<27} {other.sensor:<14} {other.kind}: {names}")
        out.line(f"    {size(other.parameters[0])}; {other.looks_for}")
    out.line("`imucal effects NAME` shows details of one effect; its equation is in docs/model.md (15)")


def _show(out: Output, row: Effect) -> None:
    from imucal.cli.effects_page import NEEDS, size

    out.line(f"{row.name}: {row.formula}, on the {row.sensor}")
    numbers = [(parameter.name, size(parameter)) for parameter in row.parameters]
    if row.shape is not None:
        numbers.append((f"{row.shape.name} (shape)", size(row.shape)))
    out.table(["parameter", "typical"], numbers)
    if row.plain < len(row.parameters):
        out.line(f"the plain form has the first {row.plain} parameters")
    for need in row.needs:
        out.line(f"depends on {need.replace('_', ' ')}: {NEEDS[need]}")
    out.line(f"observable in: {row.observable}")
    for alias in row.aliases:
        out.line(f"similar to {alias.name}; distinguished by {alias.told_apart_by}")
    temperature = " --temperature cycle:10:40:320" if "temperature" in row.needs else ""
    out.line(f"to simulate it: imucal simulate random --effect {row.name}=typical{temperature} -o run.csv")
    if row.sensor == "encoder":
        out.line("it is an error of the stand, not of the unit: it is neither estimated nor compensated")
        return
    out.line(f"to estimate it: imucal calibrate run.csv --effect {row.name}")
    for form, count in row.forms.items():
        which = "all" if form == "full" else f"the first {count}"
        out.line(f"with {which} parameters: imucal calibrate run.csv --effect {row.name}:{form}")


def _show_disturbance(out: Output, row: Disturbance) -> None:
    from imucal.cli.effects_page import size

    what = "noise" if row.kind == "noise" else "a fault"
    out.line(f"{row.name}: {what}, {row.sensor}")
    out.table(["parameter", "typical"], [(parameter.name, size(parameter)) for parameter in row.parameters])
    out.line(f"appears as: {row.looks_for}")
    out.line("it is not a parameter of the model: it is neither estimated nor compensated")
