"""The style of all figures: colours for light and dark themes, layout, and the import of plotly.

Data colours are based on those of Okabe and Ito, which are distinguishable for colour-blind readers. Every
series also has its own marker, for prints without colour. Figures use the light colours; a page in the dark
theme replaces each of them by its entry in `DARK`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from imucal.errors import ImucalError

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

INK: Final = "#1a1a1a"
PAPER: Final = "#ffffff"
GRID: Final = "#dde1e6"
BALL: Final = "#eceff2"
GREY: Final = "#6f7780"
BLUE: Final = "#0072b2"
VERMILION: Final = "#d55e00"
GREEN: Final = "#008560"
# Background colour of ranges of residuals that noise explains, of allowed ranges, and of rests and moves.
BAND: Final = "rgba(111,119,128,0.18)"
# Background colour of rests that the fit excludes.
EXCLUDED: Final = "rgba(213,94,0,0.22)"

DARK: Final = {
    INK: "#e8e8e8",
    PAPER: "#16181c",
    GRID: "#3a4049",
    BALL: "#2a2f36",
    GREY: "#9aa3ad",
    BLUE: "#56b4e9",
    VERMILION: "#ff8c42",
    GREEN: "#2cc79b",
    BAND: "rgba(154,163,173,0.22)",
    EXCLUDED: "rgba(255,140,66,0.3)",
}

FONT: Final = "system-ui, -apple-system, Segoe UI, Roboto, sans-serif"


def styled(figure: Figure, height: int) -> Figure:
    """Apply the common style to a figure with a height in pixels and the width of the page."""
    axis = {
        "gridcolor": GRID,
        "zerolinecolor": GREY,
        "zerolinewidth": 1,
        "automargin": True,
        "exponentformat": "power",
        "minexponent": 5,
        "title": {"standoff": 8},
    }
    # Ticks in the colour of the background, which are invisible, keep the labels of the two axes apart in the
    # corner of the figure.
    ticks = {"ticks": "outside", "ticklen": 4, "tickcolor": PAPER}
    layout = figure.layout.to_plotly_json()
    axes = {name: axis for name in ("yaxis", *layout) if name.startswith("yaxis")}
    axes |= {name: axis | ticks for name in ("xaxis", *layout) if name.startswith("xaxis")}
    style = {
        "template": "none",
        "height": height,
        "margin": {"l": 60, "r": 14, "t": 34, "b": 48},
        "legend": {"orientation": "h", "yanchor": "bottom", "y": 1.01, "x": 0, "font": {"size": 12}},
        "paper_bgcolor": PAPER,
        "plot_bgcolor": PAPER,
        "font": {"family": FONT, "size": 13, "color": INK},
        "hoverlabel": {"bgcolor": PAPER, "bordercolor": GREY, "font": {"color": INK}, "align": "left"},
        # A change of the colour theme redraws the figure. With a constant `uirevision`, rotation and zoom are
        # kept.
        "uirevision": "kept",
        **axes,
    }
    # Assigning the whole layout at once takes a tenth of the time of updating each axis separately.
    figure.layout = _merged(layout, style)
    return figure


def _merged(old: Mapping[str, Any], new: Mapping[str, Any]) -> dict[str, Any]:
    """The layout `old` with the entries of `new`, which replace entries of the same name."""
    replaced = {
        name: _merged(old[name], value) if isinstance(value, dict) and name in old else value
        for name, value in new.items()
    }
    return {**old, **replaced}


def rows_of(names: list[str]) -> dict[str, Any]:
    """A vertical axis with one row per name, the first at the top."""
    return {
        "categoryorder": "array",
        "categoryarray": names[::-1],
        "range": [-0.6, len(names) - 0.4],
        "tickmode": "array",
        "tickvals": names,
        "tickfont": {"size": 12},
    }


def stacked_panels(rows: Mapping[str, int], *, row_px: int, panel_px: int) -> tuple[Figure, int]:
    """A figure with one panel below the other, and the height of all panels, pixels.

    rows      number of rows of each panel, by its title
    row_px    height of a row
    panel_px  height of the title and of the tick labels of a panel
    """
    _, make_subplots = plotly()
    height = sum(rows.values()) * row_px + len(rows) * panel_px
    figure = make_subplots(
        rows=len(rows),
        row_heights=list(rows.values()),
        vertical_spacing=panel_px / height if len(rows) > 1 else 0.0,
        subplot_titles=list(rows),
    )
    figure.update_annotations(x=0, xanchor="left", font={"size": 13})
    figure.update_layout(showlegend=False)
    return figure, height


def plotly() -> tuple[Any, Any]:
    """The modules plotly.graph_objects and `make_subplots`. Raises ImucalError if plotly is missing."""
    try:
        import plotly.graph_objects as go
        from plotly.subplots import make_subplots
    except ImportError as error:
        raise ImucalError(
            'figures need plotly, which is not installed: pip install "imucal-rs[report]", '
            "or run without the report"
        ) from error
    return go, make_subplots


def shown_unit(unit: str) -> str:
    """A unit as printed: m/s²; empty for a dimensionless number."""
    if unit == "1":
        return ""
    for written, printed in (("^2", "²"), ("^3", "³"), ("sqrt(Hz)", "√Hz"), ("sqrt(h)", "√h"), ("ug", "µg")):
        unit = unit.replace(written, printed)
    return unit
