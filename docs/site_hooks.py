"""Processing of the pages by `make docs`; mkdocs.yml names this file twice.

As a hook of mkdocs it completes the navigation, adds the source files to which pages link and the page of the
commands, adds public names that the page of the Python interface does not list, typesets formulas, and sets
the weight of each page in the search. As an extension of mkdocstrings it converts aligned columns in
docstrings, which describe arguments and fields, to lists.
"""

from __future__ import annotations

import contextlib
import io
import re
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import griffe
from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

import imucal

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
LINK = re.compile(r"(!?\[[^\]]*\])\((?!https?://|#)([^)#\s]+)(#[^)]*)?\)")
# `name, other_name   description`: at least two spaces separate the columns.
COLUMNS = re.compile(r"(\w+(?:, \w+)*) {2,}(\S.*)")
# Terminal colours, which some build servers switch on.
COLOUR = re.compile(r"\x1b\[[0-9;]*m")
DIRECTIVE = re.compile(r"^::: imucal\.(\w+)$", re.MULTILINE)
COMMANDS_HEAD = """# Commands

The help of every command as `imucal COMMAND --help` prints it, written when the site is built.
"""
# Page whose formulas, in LaTeX between dollar signs, are typeset. On other pages a dollar sign is a prompt.
WITH_FORMULAS = "formulas.md"
FORMULA = re.compile(r"\$\$(.+?)\$\$|\$([^$]+)\$", re.DOTALL)
# Weight of the pages of a folder in the search: a page for users, with the weight 1, comes before a page of
# results or decisions in which the searched words are as frequent.
SEARCH_WEIGHTS = {"results/": 0.1, "decisions/": 0.03}
# Pages of more than one subject, in which most words occur: they come after the page of a subject.
SEARCH_WEIGHTS |= {"api.md": 0.1, "independent.md": 0.1, "model.md": 0.2, "commands.md": 0.3}
SEARCH_WEIGHTS |= {"effects.md": 0.5, "faq.md": 0.5}
# Pages of a special case, which have the words of the page of the usual case.
SEARCH_WEIGHTS |= {"few-poses.md": 0.5, "external-stand.md": 0.7}
LANGUAGES = {".py": "python", ".rs": "rust", ".sh": "sh", ".c": "c", ".toml": "toml", ".json": "json"}


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Complete the navigation."""
    config.nav = _navigation(config.nav or [])
    return config


def _navigation(entries: list[Any]) -> list[Any]:
    kept = []
    for entry in entries:
        [(title, target)] = entry.items()
        if isinstance(target, list):
            kept.append({title: _navigation(target)})
        elif target.endswith("*"):
            found = sorted(DOCS.glob(f"{target}.md"))
            kept.append({title: [str(path.relative_to(DOCS)) for path in found]})
        else:
            kept.append(entry)
    return kept


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the page of the commands, and a page for each file outside docs/ that a page links to."""
    files.append(File.generated(config, "commands.md", content=commands_page()))
    outside = {
        path
        for page in DOCS.rglob("*.md")
        for _, target, _ in LINK.findall(page.read_text(encoding="utf-8"))
        if DOCS not in (path := (page.parent / target).resolve()).parents and path.is_file()
    }
    for path in sorted(outside):
        files.append(File.generated(config, source_page(path), content=_source_text(path)))
    return files


def source_page(path: Path) -> str:
    """The page of the site for a file outside docs/."""
    name = str(path.relative_to(ROOT))
    return f"source/{name}" if path.suffix == ".md" else f"source/{name}.md"


def _source_text(path: Path) -> str:
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        # Its links start from where the file is, and lead nowhere from here.
        return LINK.sub(lambda link: link[1].strip("![]"), text)
    return f"# {path.relative_to(ROOT)}\n\n````{LANGUAGES.get(path.suffix, 'text')}\n{text}````\n"


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Redirect links that leave docs/ to the pages of their files; complete the page of the Python names."""
    folder = (DOCS / page.file.src_uri).parent

    def lead(link: re.Match[str]) -> str:
        text, target, anchor = link[1], link[2], link[3] or ""
        path = (folder / target).resolve()
        if path.is_file() and DOCS not in path.parents and ROOT in path.parents:
            up = "../" * page.file.src_uri.count("/")
            return f"{text}({up}{source_page(path)}{anchor})"
        return link[0]

    _weight(page)
    if page.file.src_uri.startswith("source/"):
        return markdown
    if page.file.src_uri == WITH_FORMULAS:
        return FORMULA.sub(_mark, like_github(LINK.sub(lead, markdown)))
    if page.file.src_uri == "api.md":
        markdown += _unlisted(markdown)
    return like_github(LINK.sub(lead, markdown))


def _weight(page: Page) -> None:
    """Give the page its weight in the search; source files are left out of it."""
    name = page.file.src_uri
    if name.startswith("source/"):
        page.meta["search"] = {"exclude": True}
    for start, weight in SEARCH_WEIGHTS.items():
        if name.startswith(start):
            page.meta["search"] = {"boost": weight}


def _mark(formula: re.Match[str]) -> str:
    """A formula in a form that Markdown leaves as it is."""
    kind = "block" if formula[1] else "inline"
    return f"@{kind} {(formula[1] or formula[2]).encode().hex()}@"


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Typeset the formulas as MathML, which browsers draw without a script."""
    if page.file.src_uri != WITH_FORMULAS:
        return html
    return re.sub(
        r"@(block|inline) ([0-9a-f]+)@",
        lambda mark: convert(bytes.fromhex(mark[2]).decode(), display=mark[1]),
        html,
    )


def like_github(markdown: str) -> str:
    """Adapt two constructs that Python-Markdown reads differently from GitHub.

    Continuation lines of a list item are indented by four spaces, and a bar in code within a table has no
    backslash.
    """
    lines: list[str] = []
    in_item = in_code = False
    for line in markdown.splitlines():
        in_code ^= line.startswith("```")
        starts_item = line.startswith("* ") and not in_code
        if starts_item and lines and lines[-1]:
            lines.append("")
        in_item = starts_item or (in_item and (not line or line.startswith("  ")))
        if in_item and not starts_item and line:
            line = f"  {line}"
        if line.startswith("|") and not in_code:
            line = re.sub(r"`[^`]*`", lambda code: code[0].replace("\\|", "|"), line)
        lines.append(line)
    return "\n".join(lines)


def _unlisted(page: str) -> str:
    """Directives for the public names that are missing on the page."""
    listed = {*DIRECTIVE.findall(page), "__version__"}
    names = [
        name
        for name in imucal.__all__
        if name not in listed and not isinstance(getattr(imucal, name), ModuleType)
    ]
    return "\n## More\n\n" + "".join(f"::: imucal.{name}\n\n" for name in names) if names else ""


def commands_page() -> str:
    """The help of every command as shown in a terminal."""
    from imucal.cli.app import app, main

    def shown(words: list[str]) -> str:
        text = io.StringIO()
        with contextlib.redirect_stdout(text):
            main([*words, "--help"])
        plain = COLOUR.sub("", text.getvalue()).strip("\n")
        lines = "\n".join(line.rstrip() for line in plain.splitlines())
        return f"## imucal {' '.join(words)}\n\n```text\n{lines}\n```\n"

    return "\n".join([COMMANDS_HEAD, *map(shown, _commands(app, []))])


def _commands(group: Any, words: list[str]) -> Iterator[list[str]]:
    """The words of every command, those of a group before its commands."""
    for name in group.list_commands(None):
        yield [*words, name]
        command = group.get_command(None, name)
        if hasattr(command, "list_commands"):
            yield from _commands(command, [*words, name])


class AlignedColumns(griffe.Extension):
    """Converts aligned columns of a docstring to a definition list."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rewrite the docstring of a module, class, function or attribute."""
        if obj.docstring is not None:
            obj.docstring.value = definitions(obj.docstring.value)


def definitions(docstring: str) -> str:
    """The docstring with aligned columns as Markdown lists.

    An indented line after a column continues it; other indented lines are formulas and stay unchanged.
    """
    lines: list[str] = []
    inside = False
    for line in docstring.splitlines():
        if columns := COLUMNS.fullmatch(line):
            if not inside and lines and lines[-1]:
                lines.append("")
            names = ", ".join(f"`{name}`" for name in columns[1].split(", "))
            lines += [names, f":   {_plain(columns[2])}", ""]
            inside = True
        elif inside and line.startswith("  "):
            lines[-2] += f" {_plain(line.strip())}"
        else:
            inside = False
            lines.append(line)
    return "\n".join(lines)


def _plain(text: str) -> str:
    """Text with escaped HTML characters."""
    return text.replace("<", "&lt;")
