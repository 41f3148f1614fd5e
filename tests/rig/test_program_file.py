"""The stand's program file: what comes back, what is refused, and what the simulated stand does with it."""

import json

import numpy as np
import pytest

import imucal

STEPS = (
    imucal.Step((0.0, 0.0, 0.0), 0.0, 2.0),
    imucal.Step((0.0, 90.0, 0.0), 1.5, 2.0),
    imucal.Step((10.0, 0.1, -370.0), 2.0, 3.0),
)


def test_round_trip(tmp_path):
    program = imucal.Program(STEPS)
    program.write(tmp_path / "program.json")
    assert imucal.Program.read(tmp_path / "program.json") == program


def test_the_stand_follows_the_program(tmp_path):
    imucal.Program(STEPS).write(tmp_path / "program.json")
    run = imucal.simulate(tmp_path / "program.json", unit="ideal", rate_hz=100, seed=1)
    assert run.recording.duration_s == pytest.approx(2 + 1.5 + 2 + 2 + 3 - 0.01)
    assert run.truth.rests == ((0.0, 2.0), (3.5, 5.5), (7.5, 10.5))
    end_deg = np.rad2deg(run.recording.stand_rad[-1])
    np.testing.assert_allclose(end_deg, [10.0, 90.1, -370.0], atol=1e-9)
    assert np.linalg.norm(run.truth.specific_force, axis=1) == pytest.approx(9.80665, abs=1e-12)


def test_named_programs_are_the_papers():
    assert len(imucal.Program.random(seed=1).steps) == 46
    assert imucal.Program.random(seed=1) == imucal.Program.random(seed=1)
    assert imucal.Program.random(seed=1) != imucal.Program.random(seed=2)
    grid = imucal.Program.grid()
    assert sum(step.turn_deg[1] for step in grid.steps) == pytest.approx(180)
    assert {step.hold_s for step in grid.steps} == {5.0}


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ({"steps": []}, "has no schema"),
        ({"schema": "imucal.program/1"}, r"\$\.steps is missing"),
        ({"schema": "imucal.program/1", "steps": []}, r"\$\.steps is empty"),
        (
            {"schema": "imucal.program/1", "steps": [{"turn_deg": [1, 2], "move_s": 1, "hold_s": 1}]},
            r"\$\.steps\[0\]\.turn_deg .*3 items, not 2",
        ),
        (
            {"schema": "imucal.program/1", "steps": [{"turn_deg": [1, 2, 3], "move_s": -1, "hold_s": 1}]},
            r"\$\.steps\[0\]\.move_s is -1.0, it must not be negative",
        ),
        (
            {"schema": "imucal.program/1", "steps": [{"turn_deg": [1, 2, 3], "move_s": 1}]},
            r"\$\.steps\[0\]\.hold_s is missing",
        ),
    ],
)
def test_bad_program(tmp_path, document, message):
    path = tmp_path / "program.json"
    path.write_text(json.dumps(document))
    with pytest.raises(imucal.FormatError, match=message):
        imucal.Program.read(path)


def test_turn_in_no_time_is_refused():
    program = imucal.Program((imucal.Step((1.0, 0.0, 0.0), 0.0, 1.0),))
    with pytest.raises(imucal.InputError, match="the turn takes no time"):
        imucal.simulate(program, seed=1)
