"""Writing of a self-contained HTML page.

The page contains everything it needs, including plotly.js. Its content security policy forbids the browser to
load anything from elsewhere. The page therefore looks the same for every recipient, and opening it is not
visible to anyone else. Without JavaScript the text and tables of all tabs are shown one after the other, as
on paper.
"""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from imucal.document.atomic import write_text

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

__all__ = ["Shown", "Tab", "Verdict", "require_plotly", "write_page"]

MARKS = {"good": "✔", "found": "+", "incomplete": "◐", "poor": "✘", "open": "?"}


@dataclass(frozen=True)
class Verdict:
    """The verdict at the top of a page.

    mood       "good", "found" (something was missing and is known now), "incomplete", "poor", or "open" (no
               clear verdict); selects mark and colour
    sentence   the verdict in one sentence
    beside     numbers that support the verdict, as text
    """

    mood: str
    sentence: str
    beside: str = ""


@dataclass(frozen=True, eq=False)
class Shown:
    """A figure with its caption in plain text, and an identifier that is unique in the page.

    printed  whether the figure is printed on paper. Figures that repeat a table are not printed, and neither
             are three-dimensional views, whose canvas is empty on paper
    """

    name: str
    figure: Figure
    caption: str
    printed: bool = True


@dataclass(frozen=True)
class Tab:
    """A tab: its heading, and its content of figures and HTML from `imucal.report.tables`."""

    heading: str
    content: tuple[Shown | str, ...]


def require_plotly() -> None:
    """Raises ImucalError without plotly; called before a computation whose report will need it."""
    from imucal.plot.style import plotly

    plotly()


def write_page(
    path: str | Path,
    title: str,
    tabs: Sequence[Tab],
    verdict: Verdict,
    *,
    footer: str | None = None,
    compressed: bool = False,
    reload_s: float | None = None,
) -> None:
    """Write the page atomically.

    path        the HTML file
    title       heading of the page and title of the browser window
    footer      text at the foot of every printed page, beside the page number; default: the title
    compressed  whether plotly.js is compressed, to 2 MB instead of 5 MB; needs a browser of 2023 or newer
    reload_s    time, s, after which the browser loads the page again, or None
    """
    from imucal.plot.style import DARK

    figures = any(isinstance(item, Shown) for tab in tabs for item in tab.content)
    folder = Path(__file__).parent
    page = _PAGE.format(
        title=escape(title),
        reload="" if reload_s is None else f'<meta http-equiv="refresh" content="{reload_s:g}">\n',
        style=(folder / "page.css").read_text(encoding="utf-8"),
        footer=_css_string(title if footer is None else footer),
        plotly=_plotly_script(compressed) if figures else "",
        dark=_json(json.dumps(DARK)),
        script=(folder / "page.js").read_text(encoding="utf-8"),
        verdict=_verdict_html(verdict),
        tabs="\n".join(_tab_html(tab) for tab in tabs),
    )
    write_text(Path(path), page)


def _verdict_html(verdict: Verdict) -> str:
    beside = f"\n<p>{escape(verdict.beside)}</p>" if verdict.beside else ""
    return (
        f'<div class="verdict {verdict.mood}">'
        f'<span class="mark" aria-hidden="true">{MARKS[verdict.mood]}</span>'
        f"<div><p><strong>{escape(verdict.sentence)}</strong></p>{beside}</div></div>"
    )


def _tab_html(tab: Tab) -> str:
    name = "".join(c if c.isalnum() else "-" for c in tab.heading.lower())
    parts = [item if isinstance(item, str) else _figure_html(item) for item in tab.content]
    return (
        f'<section class="tab" id="{name}">\n<h2>{escape(tab.heading)}</h2>\n'
        + "\n".join(parts)
        + "\n</section>"
    )


def _figure_html(shown: Shown) -> str:
    caption = escape(shown.caption)
    height = shown.figure.layout.height
    opening = "<figure>" if shown.printed else '<figure class="screen">'
    return (
        f"{opening}\n<figcaption>{caption}</figcaption>\n"
        f'<div class="plot" id="figure-{shown.name}" role="img" aria-label="{caption}" '
        f'style="min-height: {height}px"></div>\n'
        f'<script type="application/json">{_json(shown.figure.to_json())}</script>\n</figure>'
    )


def _css_string(text: str) -> str:
    """A string of CSS; characters that could end it or the style element are escaped."""
    return '"' + "".join(c if c.isalnum() or c in " .,-_" else f"\\{ord(c):x} " for c in text) + '"'


def _json(text: str | None) -> str:
    # `<` is escaped, so that text from recordings, such as a file name, cannot close the script element.
    return (text or "").replace("<", "\\u003c")


def _plotly_script(compressed: bool) -> str:
    # This import cannot fail. The page contains a figure, and plotly has made this figure.
    from plotly.offline import get_plotlyjs

    if not compressed:
        return f"<script>{get_plotlyjs()}</script>"
    # The time stamp in the gzip header is set to 0, so that the same page always has the same bytes, whenever
    # it is written.
    content = base64.b64encode(gzip.compress(get_plotlyjs().encode(), mtime=0)).decode("ascii")
    return f'<script type="text/plain" id="plotly">{content}</script>\n<script>{_DECOMPRESS}</script>'


# JavaScript that decompresses and runs plotly.js, and then notifies the page, which draws its figures.
_DECOMPRESS = """
(async () => {
  const text = atob(document.getElementById("plotly").textContent);
  const bytes = Uint8Array.from(text, (sign) => sign.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  const script = document.createElement("script");
  script.textContent = await new Response(stream).text();
  document.head.append(script);
  dispatchEvent(new Event("plotlyready"));
})();
"""


_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
{reload}<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; script-src 'unsafe-inline'; \
style-src 'unsafe-inline'; img-src data: blob:">
<title>{title}</title>
<style>
{style}@media print {{ @page {{ @bottom-left {{ content: {footer}; font: 8pt system-ui, sans-serif; \
color: #5b636c; }} }} }}
</style>
{plotly}
</head>
<body>
<main>
<header>
<h1>{title}</h1>
<button id="theme" type="button" hidden>Dark</button>
</header>
{verdict}
<nav id="tabs" role="tablist" aria-label="Parts of the report" hidden></nav>
{tabs}
</main>
<script type="application/json" id="dark">{dark}</script>
<script>
{script}</script>
</body>
</html>
"""
