"""The report of a search for a missing effect."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import imucal.plot as plot
import imucal.report.sentences as sentences
from imucal.gap.own_motion import own_motion
from imucal.gap.remainder import SIGNIFICANT
from imucal.gap.sizes import for_people, p_text
from imucal.gap.temperature_loop import temperature_loops
from imucal.gap.text import nothing_in_words
from imucal.plot.evidence import channel_name
from imucal.plot.style import shown_unit
from imucal.report.blocks import finding_texts
from imucal.report.gap_tables import RATIO, effects_table, gap_figures_table
from imucal.report.gap_tabs import change, evidence, laws, next_motion, temperature, visible, where
from imucal.report.meaning import meanings
from imucal.report.page import Shown, Tab, write_page
from imucal.report.tables import heading, item_list, paragraph, table

if TYPE_CHECKING:
    from imucal.gap import Gap
    from imucal.gap.own_motion import OwnMotion
    from imucal.gap.remainder import SessionStep
    from imucal.recording.recording import Recording

__all__ = ["write_gap_page"]


def write_gap_page(
    path: str | Path,
    gap: Gap,
    *,
    recordings: Recording | Sequence[Recording] = (),
    control: Recording | Sequence[Recording] | None = None,
) -> None:
    """Write the report of a search.

    recordings, control  recordings of the search; without them, the page shows no signals

    Raises ImucalError without plotly, and InputError if the file cannot be written or the recordings are not
    those of the search.
    """
    motion = own_motion(gap, recordings, control=control) if gap.fits and recordings else None
    tabs = [Tab("Summary", tuple(_summary(gap, motion)))]
    # If the search refused the recordings, there are no residuals to show.
    if getattr(gap, "where", None):
        tabs.append(Tab("Where", tuple(where(gap, motion))))
    loops = temperature_loops(gap, recordings) if motion is not None else ()
    if loops:
        tabs.append(Tab("Temperature", tuple(temperature(loops))))
    if gap.laws:
        tabs.append(Tab("Laws", tuple(laws(gap, motion))))
    if gap.ranking:
        tabs.append(Tab("Evidence", tuple(evidence(gap))))
    if gap.calibration_set is not None:
        tabs.append(Tab("Before and after", tuple(change(gap))))
    if gap.smallest_visible or gap.not_observable:
        tabs.append(Tab("Detectable effects", tuple(visible(gap))))
    if gap.next_motion is not None:
        tabs.append(Tab("Next motion", tuple(next_motion(gap.next_motion))))
    write_page(path, "Missing effects", tabs, sentences.of_gap(gap))


def _summary(gap: Gap, motion: OwnMotion | None) -> Iterator[Shown | str]:
    if motion is not None and motion.signals is not None:
        yield from _signals(gap, motion)
    yield from meanings([str(effect["name"]) for effect in gap.effects if effect["parameters"]])
    parameters = effects_table(gap)
    if parameters:
        yield heading("Effects added to the model")
        yield parameters
    yield from _left(gap)
    if gap.resembles:
        yield paragraph(f"The residuals weakly resemble {', '.join(gap.resembles)}.")
    if gap.ambiguous_with:
        yield paragraph(f"Equally plausible: {' or '.join(gap.ambiguous_with)}.")
    yield gap_figures_table(gap)
    remarks = list(dict.fromkeys([*gap.notes, *finding_texts(gap.findings)]))
    if remarks:
        yield heading("Notes")
        yield item_list(remarks)


def _signals(gap: Gap, motion: OwnMotion) -> Iterator[Shown | str]:
    signals = motion.signals
    if signals is None:
        return
    name = f"{signals.recording} (control)" if signals.is_control else signals.recording
    of_hand = (
        " Within moves the fit does not use the accelerometer, because the accelerometer also measures the "
        "acceleration of the hand, or its resolution is coarser than its noise."
        if gap.is_hand_moved
        else ""
    )
    yield heading("The move with the largest residual")
    yield Shown(
        "signals",
        plot.move_signals(signals, has_effects=gap.has_effects, is_hand_moved=gap.is_hand_moved),
        f"Move {signals.move} (shaded) of {name}: gravity as the accelerometer measures it, "
        f"and as the gyroscope predicts it from the rest before the move.{of_hand}",
    )


def _left(gap: Gap) -> Iterator[str]:
    """Section on the residuals that the found effects do not explain.

    The section contains the result of the test of these residuals, the changes of the biases between
    sessions, and a table of each kind of residual with its noise.
    """
    if gap.remainder is None:
        return
    yield heading("Remaining residuals")
    words = gap.remainder.description or "the residuals do not exceed their noise significantly"
    if gap.remainder.session is not None:
        # A short text is enough, because the verdict at the top of the page contains the whole description.
        words = "the biases changed between the sessions"
    elif gap.remainder.kind == "nothing" and gap.remainder.p_value < SIGNIFICANT:
        words = nothing_in_words(gap, gap.remainder.p_value)
    # Some descriptions contain the p-value.
    p_value = p_text(gap.remainder.p_value)
    kind = gap.remainder.kind.capitalize()
    yield paragraph(f"{kind}: {words}{'' if p_value in words else f' ({p_value})'}.")
    if gap.remainder.session is not None:
        yield _session_table(gap.remainder.session)
    found = gap.has_effects
    if gap.where is None:
        return
    rows = []
    for row in gap.where["channels"]:
        after = row["times_noise_after"] if found else row["times_noise"]
        if after is None:
            continue
        noise, unit = for_people(row["noise_rms"], row["unit"])
        rows.append((after, [channel_name(row), f"{after:.3g}", f"{noise:.3g}", shown_unit(unit)]))
    rows.sort(key=lambda row: -row[0])
    header = [
        "calibration recordings, with the effects" if found else "calibration recordings",
        RATIO,
        "noise",
        "unit",
    ]
    yield table(header, [cells for _, cells in rows])


def _session_table(session: SessionStep) -> str:
    rows = []
    for name, change_si, unit in (
        ("gyroscope bias", session.gyroscope_radps, "rad/s"),
        ("accelerometer bias", session.accelerometer_mps2, "m/s^2"),
    ):
        if change_si is not None:
            shown = [for_people(value, unit) for value in change_si]
            rows.append([name, *(f"{value:.3g}" for value, _ in shown), shown_unit(shown[0][1])])
    return table(["change between the sessions", "x", "y", "z", "unit"], rows) if rows else ""
