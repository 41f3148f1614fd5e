"""The external driver with the program of docs/external-stand.md, and with programs that fail.

The commands are real processes, so the tests run in real time.
"""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

import imucal
from imucal import Program, Step
from imucal.stand.external import ExternalDriver
from imucal.stand.recorder import record
from unit_ticks import Ticks

pytestmark = pytest.mark.slow

PAGE = Path(__file__).parents[2] / "docs/external-stand.md"
PROGRAM = Program((Step((0, 0, 0), 0.0, 0.2), Step((20, 0, 0), 0.3, 0.2), Step((0, -30, 10), 0.3, 0.2)))


@pytest.fixture
def stand(tmp_path):
    """Run the program with a stand program of this text; the result."""

    def run(text, **options):
        path = tmp_path / "my_stand.py"
        path.write_text(text)
        driver = ExternalDriver(PROGRAM, f"{sys.executable} {path}", **options)
        return record(driver, Ticks(), tmp_path / "run.csv", steps=len(PROGRAM.steps))

    return run


def example(changes=()):
    text = re.search(r"```python\n(import sys, time\n.*?)```", PAGE.read_text(), re.DOTALL)[1]
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return text


def test_the_program_of_the_page(stand, tmp_path):
    done = stand(example())
    assert (done.state, done.message) == ("completed", "")
    angles = np.degrees(imucal.read(tmp_path / "run.csv").stand_rad)
    for pose in np.cumsum([step.turn_deg for step in PROGRAM.steps], axis=0):
        assert (np.abs(angles - pose).max(axis=1) < 1.01).sum() > 10
    assert np.abs(angles[-5:]).max() < 1.01


@pytest.mark.parametrize(
    ("changes", "state", "said"),
    [
        ([("        target = [float(number) for number in numbers]\n", "")], "stalled", "short of step 2"),
        (
            [
                (
                    'print("ok", flush=True)\n    elif word == "position"',
                    'print("error jammed", flush=True)\n    elif word == "position"',
                )
            ],
            "stand_error",
            "jammed",
        ),
        (
            [("        start, since = angles()", "        sys.exit(3)\n        start, since = angles()")],
            "stand_exited",
            "exit code 3",
        ),
        (
            [("for angle in angles()), flush", "for angle in angles()[:2]), flush")],
            "",
            "three angles are needed",
        ),
        (
            [("start, target, since = [0.0] * 3, [0.0] * 3", "start, target, since = [9.0] * 3, [9.0] * 3")],
            "",
            "--unwind",
        ),
    ],
    ids=["stalled", "error", "exit", "angles", "not at zero"],
)
def test_a_program_that_fails(stand, changes, state, said):
    if not state:
        with pytest.raises(imucal.ImucalError, match=said):
            stand(example(changes))
        return
    done = stand(example(changes))
    assert done.state == state
    assert said in done.message


def test_a_start_that_is_not_at_zero(stand, tmp_path):
    at = [("start, target, since = [0.0] * 3, [0.0] * 3", "start, target, since = [9.0] * 3, [9.0] * 3")]
    assert stand(example(at), unwind=True).state == "completed"
    (tmp_path / "run.csv").unlink()
    assert stand(example(at), start_here=True).state == "completed"
    assert np.abs(np.degrees(imucal.read(tmp_path / "run.csv").stand_rad)[0]).max() < 1.0


def test_a_command_that_does_not_exist(stand, tmp_path):
    driver = ExternalDriver(PROGRAM, str(tmp_path / "nothing"))
    with pytest.raises(imucal.ImucalError, match="cannot be started"):
        driver.start()
