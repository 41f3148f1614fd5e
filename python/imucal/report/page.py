"""One self-contained HTML file.

Everything the page needs is inside it, plotly.js included, and its content security policy forbids the
browser to load anything else: a page mailed to a supplier looks the same there, and tells nobody that it was
opened.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from imucal.atomic import write_text

if TYPE_CHECKING:
    from plotly.graph_objects import Figure


@dataclass(frozen=True)
class Section:
    """A heading with text, tables and figures below it."""

    heading: str
    text: str = ""
    """Plain text, one paragraph."""
    tables: tuple[str, ...] = ()
    """HTML of `imucal.report.tables`."""
    figures: tuple[tuple[Figure, str], ...] = ()
    """Each figure with its caption in plain text."""


def write_page(
    path: str | Path, title: str, sections: Iterable[Section], *, verdict: str = "", beside: str = ""
) -> None:
    """Write the page, atomically.

    Args:
        path: The HTML file.
        title: Heading of the page and name of its tab.
        sections: In the order shown.
        verdict: The one sentence that a hurried reader needs, shown first.
        beside: What supports the verdict, a sentence or two.
    """
    script = ""
    body = []
    for section in sections:
        if section.figures and not script:
            script = _plotly_script()
        body.append(_section_html(section))
    lead = "".join(
        f'<p class="{name}">{escape(text)}</p>'
        for name, text in (("verdict", verdict), ("beside", beside))
        if text
    )
    write_text(
        Path(path),
        _PAGE.format(title=escape(title), style=_STYLE, script=script, lead=lead, body="\n".join(body)),
    )


def _section_html(section: Section) -> str:
    parts = [f"<h2>{escape(section.heading)}</h2>"]
    if section.text:
        parts.append(f"<p>{escape(section.text)}</p>")
    parts += section.tables
    parts += [_figure_html(figure, caption) for figure, caption in section.figures]
    return "<section>\n" + "\n".join(parts) + "\n</section>"


def _figure_html(figure: Figure, caption: str) -> str:
    plot = figure.to_html(
        full_html=False, include_plotlyjs=False, config={"responsive": True, "displayModeBar": False}
    )
    return f"<figure>\n<figcaption>{escape(caption)}</figcaption>\n{plot}\n</figure>"


def _plotly_script() -> str:
    # The caller holds a figure, so plotly is installed.
    from plotly.offline import get_plotlyjs

    return f"<script>{get_plotlyjs()}</script>"


_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; script-src 'unsafe-inline'; \
style-src 'unsafe-inline'; img-src data: blob:">
<title>{title}</title>
<style>{style}</style>
{script}
</head>
<body>
<main>
<h1>{title}</h1>
{lead}
{body}
</main>
</body>
</html>
"""

# Plotly draws SVG and writes colours into it; `!important` lets the reader's colour scheme win.
_STYLE = """
:root { --ink: #1a1a1a; --paper: #ffffff; --soft: #f1f3f5; --line: #c9ced4; --accent: #0072B2; }
@media screen and (prefers-color-scheme: dark) {
  :root { --ink: #e8e8e8; --paper: #16181c; --soft: #22262c; --line: #454b54; --accent: #56B4E9; }
  /* The blue of the figures is too dark here; plotly writes colours as rgb(). */
  .js-plotly-plot [style*="stroke: rgb(0, 114, 178)"] { stroke: var(--accent) !important; }
}
* { box-sizing: border-box; }
body { margin: 0; background: var(--paper); color: var(--ink); font: 1rem/1.5 system-ui, sans-serif; }
main { max-width: 62rem; margin: 0 auto; padding: 1rem; }
h1 { font-size: 1.6rem; line-height: 1.2; }
h2 { font-size: 1.2rem; margin-top: 2rem; border-bottom: 1px solid var(--line); }
.verdict { font-size: 1.15rem; padding: .75rem 1rem; background: var(--soft);
  border-left: .3rem solid var(--accent); }
.table { overflow-x: auto; padding-bottom: .3rem; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: .9rem; }
th, td { padding: .2rem .7rem; border-bottom: 1px solid var(--line); text-align: right; white-space: nowrap; }
th:first-child { text-align: left; font-weight: normal; white-space: normal; }
thead th, thead th:first-child { font-weight: 600; }
figure { margin: 1.5rem 0; }
figcaption { font-size: .9rem; margin-bottom: .5rem; }
.js-plotly-plot text { fill: var(--ink) !important; }
.js-plotly-plot .gridlayer path { stroke: var(--line) !important; }
.js-plotly-plot .zerolinelayer path { stroke: var(--ink) !important; stroke-opacity: .4 !important; }
.js-plotly-plot .hoverlayer text { fill: #ffffff !important; }
@media (max-width: 30rem) {
  th, td { padding: .2rem .4rem; }
  thead th:first-child, tbody th { min-width: 7rem; }
}
@media print {
  main { max-width: none; padding: 0; }
  figure { margin: .5rem 0; }
  figure, tr { break-inside: avoid; }
  h2 { break-after: avoid; }
}
"""
