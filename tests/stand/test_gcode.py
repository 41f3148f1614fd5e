"""G-code of a program: the controller comes to the program's poses, in the time that was foretold.

Blocks and durations are taken from `imucal.stand.gcode`, because the command writes the text only.
"""

import json

import numpy as np
import pytest

import imucal
from grbl_controller import Controller
from imucal import Program, Step
from imucal.stand.gcode import Axes, MotorLimits, blocks_of, duration_s, gcode, late

SLOW = MotorLimits((90.0, 180.0, 360.0), (150.0, 300.0, 1000.0))


def executed(text, limits, axes="XYZ"):
    """The controller after it has taken a file line by line, each when the one before was answered."""
    controller = Controller(
        tuple(60 * rate for rate in limits.max_rate_dps), limits.acceleration_dps2, axes=axes
    )
    controller.take()
    for line in text.splitlines():
        controller.receive(line.encode() + b"\n")
        said = b""
        while not said.endswith(b"ok\r\n"):
            controller.advance(0.05)
            said += controller.take()
            assert b"error" not in said, (line, said)
    while not controller.idle:
        controller.advance(0.05)
    assert controller.overflowed == 0
    return controller


@pytest.mark.parametrize("limits", [MotorLimits(), SLOW], ids=["fast", "slow"])
@pytest.mark.parametrize(
    "program",
    [Program.random(seed=3, moves=6), Program(Program.grid(hold_s=1.0).steps[:12])],
    ids=["random", "grid"],
)
def test_time_and_poses_are_those_of_the_controller(program, limits):
    blocks = blocks_of(program, limits)
    controller = executed(gcode(blocks, Axes(), "test"), limits)
    foretold_s = duration_s(blocks)
    # Its clock ticks in milliseconds.
    assert controller.busy_s == pytest.approx(foretold_s, rel=1e-3)
    poses = np.array([pose for pose, _ in controller.dwelt])
    assert np.allclose(poses, np.cumsum([step.turn_deg for step in program.steps], axis=0), atol=1e-3)
    assert [hold_s for _, hold_s in controller.dwelt] == pytest.approx([b.hold_s for b in blocks])


def test_moves_take_what_the_program_says_if_the_motors_can():
    program = Program.random(seed=1)
    blocks = blocks_of(program, MotorLimits())
    assert late(blocks) == []
    moving = [(b.move_s, s.move_s) for b, s in zip(blocks, program.steps, strict=True) if any(s.turn_deg)]
    assert [a for a, _ in moving] == pytest.approx([b for _, b in moving], abs=1e-3)
    # Slow motors take longer, and the steps are named.
    slow = blocks_of(program, SLOW)
    assert late(slow)
    assert duration_s(slow) > duration_s(blocks)


def test_a_hold_is_rounded_up_to_the_steps_of_the_controller():
    program = Program((Step((10, 0, 0), 1, 0.12), Step((0, 0, 0), 0, 0.1), Step((1, 1, 1), 1, 0)))
    blocks = blocks_of(program, MotorLimits())
    assert [round(block.hold_s, 6) for block in blocks] == [0.15, 0.1, 0.0]
    controller = executed(gcode(blocks, Axes(), "short"), MotorLimits())
    assert controller.busy_s == pytest.approx(duration_s(blocks), abs=5e-3)


def test_axes_have_the_letters_that_are_asked_for():
    blocks = blocks_of(Program((Step((10, -20, 0), 1, 1),)), MotorLimits())
    text = gcode(blocks, Axes("ABC"), "a (strange) title é")
    assert "A10B-20C0F" in text
    assert "(a _strange_ title _)" in text
    assert executed(text, MotorLimits(), axes="ABC").dwelt == [((10.0, -20.0, 0.0), 1.0)]
    for letters in ("AB", "AAB", "XYQ", ""):
        with pytest.raises(imucal.InputError, match="axes"):
            Axes(letters)
    with pytest.raises(imucal.InputError, match="acceleration"):
        MotorLimits(acceleration_dps2=(0.0, 1.0, 1.0))


def test_gcode_by_the_command(tmp_path, command):
    Program.random(seed=2, moves=3).write(tmp_path / "program.json")
    done = command(
        *("stand", "gcode", tmp_path / "program.json", "-o", tmp_path / "run.nc", "--axes", "ABC"),
        *("--max-rate-dps", "90,180,360", "--acceleration-dps2", "200", "--json", "-"),
    )
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    limits = MotorLimits((90.0, 180.0, 360.0), (200.0, 200.0, 200.0))
    text = (tmp_path / "run.nc").read_text()
    assert executed(text, limits, axes="ABC").busy_s == pytest.approx(document["duration_s"], rel=2e-3)
    assert document["steps"] == 4
    assert len(document["range_deg"]) == 3
    assert document["late_steps"] == [1, 2, 3]
    assert "longer" in done.stderr
