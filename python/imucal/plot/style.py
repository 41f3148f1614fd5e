"""How all figures look: their colours in the light and in the dark, and plotly itself.

Data colours are near those of Okabe and Ito, which colour-blind readers tell apart; in the dark they are
lighter. Every series also has a marker of its own, for paper without colour. Figures are made in the light; a
page in the dark exchanges each colour of `DARK` by its counterpart.
"""

from __future__ import annotations

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
# Behind data: what noise explains, and where limits are kept.
BAND: Final = "rgba(111,119,128,0.18)"

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
}

FONT: Final = "system-ui, -apple-system, Segoe UI, Roboto, sans-serif"


def styled(figure: Figure, height: int) -> Figure:
    """The figure as all of them look, `height` in pixels; its width is that of the place where it stands."""
    figure.update_layout(
        template="none",
        height=height,
        margin={"l": 60, "r": 14, "t": 34, "b": 48},
        legend={"orientation": "h", "yanchor": "bottom", "y": 1.01, "x": 0, "font": {"size": 12}},
        paper_bgcolor=PAPER,
        plot_bgcolor=PAPER,
        font={"family": FONT, "size": 13, "color": INK},
        hoverlabel={"bgcolor": PAPER, "bordercolor": GREY, "font": {"color": INK}, "align": "left"},
        # Another theme draws the figure again: what the reader has turned or zoomed stays.
        uirevision="kept",
    )
    axis = {
        "gridcolor": GRID,
        "zerolinecolor": GREY,
        "zerolinewidth": 1,
        "automargin": True,
        "exponentformat": "power",
        "minexponent": 5,
    }
    figure.update_xaxes(**axis, title_standoff=8)
    figure.update_yaxes(**axis, title_standoff=8)
    return figure


def rows_of(names: list[str]) -> dict[str, Any]:
    """A vertical axis with one row for each name, the first on top."""
    return {
        "categoryorder": "array",
        "categoryarray": names[::-1],
        "range": [-0.6, len(names) - 0.4],
        "tickmode": "array",
        "tickvals": names,
        "tickfont": {"size": 12},
    }


def plotly() -> tuple[Any, Any]:
    """The graph objects of plotly and `make_subplots`; ImucalError without plotly."""
    try:
        import plotly.graph_objects as go
        from plotly.subplots import make_subplots
    except ImportError as error:
        raise ImucalError(
            'figures need plotly, which is not installed: pip install "imucal-rs[report]", '
            "or leave the report out"
        ) from error
    return go, make_subplots


def shown_unit(unit: str) -> str:
    """A unit as it is printed: m/s², and nothing for a pure number."""
    return "" if unit == "1" else unit.replace("^2", "²").replace("sqrt(Hz)", "√Hz")
