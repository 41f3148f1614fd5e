"""`imucal diff`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from click.exceptions import Exit

from imucal.cli.options import JsonPath
from imucal.cli.output import POOR_VERDICT, Output, require_apart
from imucal.cli.parameters import argument, option

__all__ = ["diff"]


def diff(
    before: Annotated[Path, argument(metavar="A.JSON", help="Calibration file.")],
    after: Annotated[Path, argument(metavar="B.JSON", help="Later calibration file of the same unit.")],
    sigmas: Annotated[
        float,
        option(
            "--sigmas",
            help="Significance threshold: the probability of a false alarm, over all parameters together, is "
            "that of a normal variable beyond this number of standard deviations.",
        ),
    ] = 3.0,
    json: JsonPath = None,
) -> None:
    """Compare two calibrations of a unit: difference of each parameter in standard deviations.

    Ends with 0 if they agree within their uncertainties, and with 2 if not or if no parameter has a standard
    deviation in both, as with calibrations of other programs.

    Example: imucal diff unit-0042-may.json unit-0042-june.json
    """
    import imucal

    require_apart([before, after], {"--json": json})
    found = imucal.diff(imucal.Calibration.load(before), imucal.Calibration.load(after), sigmas=sigmas)
    out = Output(json)
    out.document(found.to_dict())
    out.table(
        ("parameter", "before", "after", "difference", "1 sigma", "sigmas", "unit", ""),
        (
            (
                c.name,
                f"{c.before:.7g}",
                f"{c.after:.7g}",
                f"{c.difference:+.2e}",
                "-" if c.std is None else f"{c.std:.2e}",
                "-" if c.sigmas is None else f"{c.sigmas:+.1f}",
                c.unit,
                "MOVED" if c.moved else "",
            )
            for c in found.changes
        ),
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
