"""Every row of the table of traps has a right outcome, by the command and through the API."""

import pytest

from rows import TRAPS
from trap import answers_to

pytestmark = pytest.mark.slow


def test_rows_have_names_of_their_own():
    names = [(trap.kind, trap.name) for trap in TRAPS]
    assert len(names) == len(set(names))


@pytest.mark.parametrize("trap", TRAPS, ids=lambda trap: f"{trap.kind}: {trap.name}")
def test_outcome_is_right(trap, tmp_path):
    answers = answers_to(trap, tmp_path)
    for asked, observed in (("command", answers.by_command), ("API", answers.by_call)):
        right = " or ".join(map(str, trap.right))
        worst = "" if observed.worst_sigmas is None else f", {observed.worst_sigmas:.1f} sigma"
        assert observed.is_right(trap), (
            f"{asked}: {observed.outcome}{worst} instead of {right}\n{observed.text[:2000]}"
        )
    assert answers.by_command.outcome == answers.by_call.outcome
