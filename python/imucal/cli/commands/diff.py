"""The command `imucal diff`, which tests whether two calibrations of a unit differ significantly."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from click.exceptions import Exit

from imucal.cli.options import JsonPath, UnitsOption, UnitSystem
from imucal.cli.output import POOR_VERDICT, Output, require_apart
from imucal.cli.parameters import argument, option

if TYPE_CHECKING:
    from imucal.calibration.difference import Change
    from imucal.calibration.parameter_text import Units

__all__ = ["diff"]


def diff(
    before: Annotated[Path, argument(metavar="BEFORE", help="Calibration file.")],
    after: Annotated[Path, argument(metavar="AFTER", help="Later calibration file of the same unit.")],
    sigmas: Annotated[
        float,
        option(
            "--sigmas",
            help="Significance threshold in standard deviations. With 3, 0.27 % of comparisons of an "
            "unchanged unit are false alarms, over all parameters together.",
        ),
    ] = 3.0,
    units: UnitsOption = UnitSystem.datasheet,
    json: JsonPath = None,
) -> None:
    """Compare two calibrations of a unit: difference of each parameter in standard deviations.

    The exit code is 0 if the calibrations agree within their uncertainties, and 2 if they do not. It is also
    2 if no parameter has a standard deviation in both files, as in calibrations of other programs.

    Example: imucal diff unit-0042-may.json unit-0042-june.json
    """
    import imucal

    require_apart([before, after], {"--json": json})
    found = imucal.diff(imucal.Calibration.load(before), imucal.Calibration.load(after), sigmas=sigmas)
    out = Output(json, units)
    out.document(found.to_dict())
    out.table(
        ("parameter", "before", "after", "difference", "1 sigma", "sigmas", "unit", ""),
        (_row(change, units.units) for change in found.changes),
    )
    if found.p_value is not None:
        tested = sum(c.std is not None for c in found.changes)
        out.line(
            f"threshold for each of {tested} parameters: {found.limit_sigmas:.2f} sigma; jointly: chi2 "
            f"{found.chi2:.4g} with {found.dof} degrees of freedom, p {found.p_value:.2g}"
        )
    for note in found.notes:
        out.line(f"note: {note}")
    out.line("; ".join((f"verdict: {found.verdict}", *found.reasons)))
    if found.reasons:
        raise Exit(POOR_VERDICT)


def _row(change: Change, units: Units) -> tuple[str, ...]:
    from imucal.calibration.parameter_text import parameter_row, sigma_text
    from imucal.calibration.triad import Parameter

    before, after = (
        parameter_row(Parameter(change.name, value, change.std, change.unit), units)
        for value in (change.before, change.after)
    )
    difference = units(change.name, change.unit).factor * change.difference
    return (
        before.name,
        before.value,
        after.value,
        f"{'+' if difference >= 0 else '-'}{sigma_text(abs(difference))}",
        before.sigma,
        "-" if change.sigmas is None else f"{change.sigmas:+.1f}",
        before.unit,
        "MOVED" if change.moved else "",
    )
