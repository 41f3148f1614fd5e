"""A trap: input on which a tool easily gives a wrong result that looks right, and the outcome that is right.

A trap writes its files into a folder and asks one question, as a command and through the API. The outcome is
`refused`, `poor`, `incomplete` or `good`; a good one whose parameters are far from the truth is `wrong`.
"""

import contextlib
import io
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import imucal
from imucal.cli import main

# Largest accepted error of a parameter in a usable result, in its stated standard deviations.
# Noise alone exceeds it in one of 80,000 calibrations with 21 parameters.
WITHIN_SIGMAS = 5.0

Outcome = Literal["refused", "poor", "incomplete", "good", "wrong"]


@dataclass(frozen=True)
class Right:
    """One right outcome; `says` is a pattern that the output or a finding's code must match."""

    outcome: Outcome
    says: str = ""

    def __str__(self) -> str:
        return f"{self.outcome} ({self.says})" if self.says else self.outcome


def refused(says: str) -> Right:
    """No result: exit code 1, an exception, with this code or text."""
    return Right("refused", says)


def poor(says: str = "") -> Right:
    """A result that is not to be relied on: exit code 2."""
    return Right("poor", says)


def incomplete(says: str = "") -> Right:
    """A usable result, with this code or text about what the model lacks."""
    return Right("incomplete", says)


def good(says: str = "") -> Right:
    """A good verdict, every parameter within its standard deviations, and this code or text in the output."""
    return Right("good", says)


@dataclass(frozen=True)
class Question:
    """What a user asks: the words of a command after `imucal`, and a call that returns a result or raises.

    truth   parameters of the unit by name, or None if the question has no parameters for an answer
    """

    command: Sequence[str]
    call: Callable[[], Any]
    truth: Mapping[str, float] | None = None


@dataclass(frozen=True)
class Trap:
    """One row of the table.

    kind    what is wrong with the input, in a few words; rows are counted by kind
    name    what distinguishes this row within its kind
    make    writes the files into a folder and returns the question
    right   outcomes that are right
    """

    kind: str
    name: str
    make: Callable[[Path], Question]
    right: tuple[Right, ...]


@dataclass(frozen=True)
class Observed:
    """The outcome of a question, all text of the answer, and the largest error in standard deviations."""

    outcome: Outcome
    text: str
    worst_sigmas: float | None = None

    def is_right(self, trap: Trap) -> bool:
        """Whether one of the right outcomes of the trap was observed."""
        return any(
            right.outcome == self.outcome and re.search(right.says, self.text, re.DOTALL)
            for right in trap.right
        )


@dataclass(frozen=True)
class Answers:
    """The answers to one trap."""

    by_command: Observed
    by_call: Observed


def answers_to(trap: Trap, folder: Path) -> Answers:
    """Ask the command and the API; `folder` is empty and takes the files of the trap."""
    question = trap.make(folder)
    return Answers(answer_by_command(question, folder), _by_call(question))


def answer_by_command(question: Question, folder: Path) -> Observed:
    """Ask the command alone; the files of the question are in `folder`."""
    shown, document = io.StringIO(), folder / "trap-result.json"
    with contextlib.redirect_stdout(shown), contextlib.redirect_stderr(shown):
        code = main([*map(str, question.command), "--json", str(document)])
    if code not in (0, 1, 2):
        raise AssertionError(f"exit code {code}: {shown.getvalue()}")
    told = json.loads(document.read_text()) if document.exists() else {}
    outcome = {1: "refused", 2: "poor"}.get(code) or _verdict(told)
    return _judged(outcome, told, shown.getvalue(), question.truth)


def _by_call(question: Question) -> Observed:
    try:
        result = question.call()
    except imucal.ImucalError as error:
        return Observed("refused", json.dumps(error.to_dict()) + str(error))
    told = result.to_dict() if hasattr(result, "to_dict") else {}
    text = result.summary() if hasattr(result, "summary") else str(result)
    return _judged(_verdict(told), told, text, question.truth)


def _verdict(told: Mapping[str, Any]) -> Outcome:
    """The verdict of a result document; documents without one, such as that of `convert`, count as good."""
    verdict = told.get("verdict", "good")
    word = verdict["verdict"] if isinstance(verdict, dict) else verdict
    return word if word in ("poor", "incomplete") else "good"


def _judged(
    outcome: Outcome, told: Mapping[str, Any], shown: str, truth: Mapping[str, float] | None
) -> Observed:
    text = shown + json.dumps(told)
    if truth is None or outcome != "good":
        return Observed(outcome, text)
    worst = max(
        abs(parameter["value"] - truth[parameter["name"]]) / parameter["std"]
        for parameter in told["parameters"]
        if parameter["name"] in truth
    )
    return Observed(outcome if worst <= WITHIN_SIGMAS else "wrong", text, worst)


@dataclass
class Options:
    """Options of the API, and the same as words of a command."""

    by_name: Mapping[str, Any] = field(default_factory=dict)

    def words(self) -> list[str]:
        """The options as words: `min_rest_s=2.0` is `--min-rest-s=2.0`."""
        names = {"gravity_mps2": "gravity", "gravity_sigma_mps2": "gravity-sigma", "latitude_deg": "latitude"}
        names |= {"height_m": "height", "effects": "effect"}
        words = []
        for name, value in self.by_name.items():
            flag = "--" + names.get(name, name).replace("_", "-")
            if isinstance(value, list):
                words += [f"{flag}={item}" for item in value]
            else:
                words.append(flag if value is True else f"{flag}={value}")
        return words
