"""The page docs/results/mutants.md: how many deliberate errors the tests find, and each that they do not."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mutants.reasons import REASONS
from mutants.sites import Site
from sections import write_section

__all__ = ["Trial", "write_language"]

PAGE = Path(__file__).resolve().parents[2] / "docs/results/mutants.md"
HEADINGS = {"python": "Python", "rust": "Rust"}
# Smallest share of errors that tests should find.
LEAST_FOUND = 0.85


@dataclass(frozen=True)
class Trial:
    """One error, the test that found it, or None, and the time of its tests, s."""

    site: Site
    test: str | None
    seconds: float


def write_language(language: str, seed: int, trials: list[Trial]) -> None:
    """Replace the section of a language."""
    found = [trial for trial in trials if trial.test is not None]
    share = len(found) / len(trials)
    verdict = "met" if share >= LEAST_FOUND else "missed"
    rows = [
        f"| {trial.site.path} | `{_cell(trial.site.text)}` | `{_cell(trial.site.before)}` "
        f"| `{_cell(trial.site.after)}` | {REASONS.get(trial.site.name, '')} |"
        for trial in trials
        if trial.test is None
    ]
    hours = sum(trial.seconds for trial in trials) / 3600
    body = f"""
`make mutants` (seed {seed}): {len(found)} of {len(trials)} errors are found, {share:.0%}; the aim is
{LEAST_FOUND:.0%}: {verdict}. The tests of all errors took {hours:.1f} h of one processor.

The errors that these tests do not find:

| file | line | instead of | error | why it is harmless, if it is |
|---|---|---|---|---|
{chr(10).join(rows)}
"""
    write_section(PAGE, "Tests against deliberate errors", HEADINGS[language], body)


def _cell(text: str) -> str:
    return text.replace("|", "\\|")
