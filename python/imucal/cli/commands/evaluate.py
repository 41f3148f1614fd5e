"""The command `imucal evaluate`, which evaluates a calibration on further recordings of the unit."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from imucal.cli.decisions import show_rests_and_moves
from imucal.cli.options import (
    MIN_REST_S,
    JsonPath,
    LimitsPath,
    MinRest,
    ReportPath,
    Require,
    Required,
    UnitsOption,
    UnitSystem,
    Verbose,
)
from imucal.cli.output import Output, prepare_report, require_apart
from imucal.cli.parameters import argument
from imucal.cli.reading import Files, Reading, reading_options
from imucal.cli.working import working

if TYPE_CHECKING:
    from imucal.estimation.rests import Move, Rest

__all__ = ["evaluate"]


@reading_options
def evaluate(
    calibration: Annotated[Path, argument(metavar="CAL", help="Calibration file.")],
    recordings: Files,
    reading: Reading,
    min_rest_s: MinRest = MIN_REST_S,
    limits: LimitsPath = None,
    require: Require = Required.incomplete,
    verbose: Verbose = False,
    report: ReportPath = None,
    units: UnitsOption = UnitSystem.datasheet,
    json: JsonPath = None,
) -> None:
    """Evaluate a calibration on recordings of the same unit that were not used for its fit.

    Example: imucal evaluate unit-0042.json control.csv
    """
    import imucal

    require_apart([calibration, *recordings, limits], {"--report": report, "--json": json})
    prepare_report(report)
    with working("reading"):
        loaded = imucal.Calibration.load(calibration)
        wanted = imucal.Limits.load(limits, user_effects=loaded.user_effects) if limits else None
        judges = reading.each(recordings)
    with working("evaluating"):
        judged = imucal.evaluate(loaded, judges, min_rest_s=min_rest_s)
    if wanted is not None:
        judged = judged.judged_by(wanted, loaded)
    if report is not None:
        from imucal.report import write_evaluation_page

        write_evaluation_page(report, judged, title=f"Evaluation of {calibration.name}")
    out = Output(json, units)
    out.document(judged.to_dict)
    if verbose:
        show_rests_and_moves(out, judged.rests, judged.moves)
    out.line(f"{_evaluated(judged.rests, 'rests')}, {_evaluated(judged.moves, 'moves')}")
    out.figures({"uncalibrated": judged.before, "calibrated": judged.figures})
    out.findings(judged.findings)
    out.judgement(judged.judgement, verbose)
    out.verdict(judged.verdict, judged.reasons, require)


def _evaluated(items: Sequence[Rest] | Sequence[Move], what: str) -> str:
    from imucal.estimation.rests import used_of

    all_used = all(item.excluded is None for item in items)
    return f"{len(items)} {what}" if all_used else f"{used_of(items)} {what} evaluated"
