"""The report of an inspection: the signals of recordings, their findings, rests and predicted accuracy."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import imucal.plot as plot
import imucal.report.sentences as sentences
from imucal.errors import InputError
from imucal.plot.style import shown_unit
from imucal.report.blocks import finding_texts
from imucal.report.page import Shown, Tab, Verdict, write_page
from imucal.report.tables import heading, item_list, paragraph, table
from imucal.units import datasheet

if TYPE_CHECKING:
    from imucal.estimation.inspection import Inspection
    from imucal.recording.recording import Recording

__all__ = ["facts_table", "predicted_table", "rests_table", "write_inspection_page"]

# Maximum number of rests in the table of a page. The JSON document contains all rests.
MOST_RESTS = 60


def write_inspection_page(
    path: str | Path,
    inspections: Inspection | Sequence[Inspection],
    recordings: Recording | Sequence[Recording],
) -> None:
    """Write the report of the inspections of recordings, given in the same order.

    Raises ImucalError if plotly is not installed, and InputError if the file cannot be written.
    """
    seen = [inspections] if not isinstance(inspections, Sequence) else list(inspections)
    inspected = [recordings] if not isinstance(recordings, Sequence) else list(recordings)
    if len(seen) != len(inspected) or not seen:
        raise InputError(
            f"there are {len(seen)} inspections of {len(inspected)} recordings: give one inspection per "
            "recording"
        )
    tabs = [
        Tab(inspection.name if len(seen) > 1 else "Signals", tuple(_content(inspection, recording, number)))
        for number, (inspection, recording) in enumerate(zip(seen, inspected, strict=True))
    ]
    title = f"Recording {seen[0].name}" if len(seen) == 1 else f"{len(seen)} recordings"
    write_page(path, title, tabs, _verdict(seen))


def facts_table(inspection: Inspection) -> str:
    """Length, rate and sensors of a recording."""
    rows = [
        ["samples", str(inspection.samples)],
        ["duration", f"{inspection.duration_s:.5g} s"],
        ["sampling rate", inspection.rate_in_words],
        ["sensors", inspection.sensors_in_words],
        ["rests", str(len(inspection.rests))],
    ]
    return table(["", ""], rows, words=(1,))


def rests_table(inspection: Inspection) -> str:
    """Times of the rests, and reasons for exclusions; at most 60 rests."""
    with_reasons = any(rest.excluded for rest in inspection.rests)
    rows = [
        [
            f"rest {number}",
            f"{rest.start_s:.2f}",
            f"{rest.end_s:.2f}",
            f"{rest.end_s - rest.start_s:.2f}",
            *([rest.excluded or ""] if with_reasons else []),
        ]
        for number, rest in enumerate(inspection.rests)
    ]
    header = [
        f"the first {MOST_RESTS} of {len(rows)}" if len(rows) > MOST_RESTS else "rest",
        "from s",
        "to s",
        "duration s",
        *(["excluded"] if with_reasons else []),
    ]
    return table(header, rows[:MOST_RESTS], words=(4,)) if rows else ""


def predicted_table(inspection: Inspection) -> str:
    """Predicted standard deviation of each parameter, in the units of datasheets."""
    rows = []
    for p in inspection.predicted_sigma:
        scale = datasheet(p.name, p.unit)
        std = "not determined" if p.std is None else f"{abs(scale.factor) * p.std:.2g}"
        rows.append([p.name, std, shown_unit(scale.unit) or "1"])
    return table(["parameter", "predicted 1 σ", "unit"], rows) if rows else ""


def _content(inspection: Inspection, recording: Recording, number: int) -> Iterator[Shown | str]:
    rests = "rests are shaded" if inspection.rests else "no rest was found"
    yield Shown(
        f"signals-{number}",
        plot.recording_signals(recording, inspection),
        f"Signals over time: the smallest and the largest sample in each short interval; {rests}. Crosses "
        "are samples at the end of a sensor's range."
        if any(finding.code.endswith("_saturation") for finding in inspection.findings)
        else f"Signals over time: the smallest and the largest sample in each short interval; {rests}.",
    )
    yield facts_table(inspection)
    if inspection.findings:
        yield heading("Findings")
        yield item_list(finding_texts(inspection.findings))
    yield heading("Rests")
    yield paragraph(f"{inspection.explanation}.")
    yield rests_table(inspection)
    if inspection.predicted_sigma:
        yield heading("Accuracy that this recording can give")
        yield paragraph(
            "Predicted from the rests, the moves and the noise at rest. A calibration reaches these standard "
            "deviations if the data contain no errors other than noise and those of the linear model."
        )
        yield predicted_table(inspection)


def _verdict(seen: Sequence[Inspection]) -> Verdict:
    verdicts = [sentences.of_inspection(inspection) for inspection in seen]
    order = ["poor", "incomplete", "good"]
    worst = min(verdicts, key=lambda verdict: order.index(verdict.mood))
    if len(seen) == 1:
        return worst
    good = sum(verdict.mood == "good" for verdict in verdicts)
    if good == len(seen):
        return Verdict("good", f"Each of the {good} recordings determines all parameters.")
    of = seen[verdicts.index(worst)].name
    return Verdict(
        worst.mood, f"{good} of {len(seen)} recordings determine all parameters.", f"{of}: {worst.sentence}"
    )
