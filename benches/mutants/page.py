"""The page docs/results/mutants.md: how many deliberate errors the tests find, and each that they do not."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from mutants.given import IN_PYTHON, IN_RUST
from mutants.reasons import REASONS
from mutants.sites import Site
from mutants.trial import LONGEST_S, Answer
from sections import write_section

__all__ = ["write_language"]

PAGE = Path(__file__).resolve().parents[2] / "docs/results/mutants.md"
HEADINGS = {"python": "Python", "rust": "Rust"}
GIVEN = {"python": IN_PYTHON, "rust": IN_RUST}
# Smallest share of errors that tests should find.
LEAST_FOUND = 0.85


def write_language(
    language: str, seed: int, answers: Sequence[tuple[Site, Answer]], left_out: Sequence[str]
) -> None:
    """Replace the section of a language.

    left_out  Python tests that fail on the copy without an error, and did not run with errors
    """
    answers, given = answers[: -len(GIVEN[language])], answers[-len(GIVEN[language]) :]
    share = sum(answer.test is not None for _, answer in answers) / len(answers)
    verdict = "met" if share >= LEAST_FOUND else "missed"
    rows = [
        f"| {site.path} | `{_cell(site.text)}` | `{_cell(site.before)}` | `{_cell(site.after)}` "
        f"| {REASONS.get(site.name, '')} |"
        for site, answer in answers
        if answer.test is None
    ]
    rows_given = [
        f"| {site.path} | `{_cell(site.before)}` | `{_cell(site.after)}` | {_found_by(answer)} |"
        for site, answer in given
    ]
    hours = sum(answer.seconds for _, answer in answers) / 3600
    body = f"""
`make mutants` (seed {seed}): {len(answers) - len(rows)} of {len(answers)} errors are found, {share:.0%}; the
aim is {LEAST_FOUND:.0%}: {verdict}. With each error, the tests that reach it run, cheap ones first, up to
{LONGEST_S / 60:.0f} minutes of Python tests. One after the other, these tests take {hours:.1f} h.
{_left_out(left_out)}
Errors that are not drawn, which earlier tests passed:

| file | instead of | error | found by |
|---|---|---|---|
{chr(10).join(rows_given)}

The errors that these tests do not find:

| file | line | instead of | error | why it is harmless, if it is |
|---|---|---|---|---|
{chr(10).join(rows)}
"""
    write_section(PAGE, "Tests against deliberate errors", HEADINGS[language], body)


def _found_by(answer: Answer) -> str:
    return "**no test**" if answer.test is None else f"`{_cell(answer.test.partition('[')[0])}`"


def _left_out(tests: Sequence[str]) -> str:
    if not tests:
        return ""
    names = ", ".join(f"`{_cell(test)}`" for test in tests)
    return f"\nThese tests fail on a copy of the sources without an error, and are left out: {names}.\n"


def _cell(text: str) -> str:
    return text.replace("|", "\\|")
