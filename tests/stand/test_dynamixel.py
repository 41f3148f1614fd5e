"""Dynamixel motors on an emulated bus, driven by the maker's library, through the command of the driver."""

import sys

import numpy as np
import pytest

if sys.platform == "win32":
    pytest.skip("pseudo-terminals are POSIX", allow_module_level=True)
pytest.importorskip("dynamixel_sdk")

import imucal
from dynamixel_bus import Bus, Motor
from imucal import Program, Step
from imucal.cli.equipment import Equipment
from imucal.stand.dynamixel import Motors, ids_of
from imucal.stand.recorder import record
from unit_ticks import Ticks

pytestmark = pytest.mark.slow

PROGRAM = Program((Step((0, 0, 0), 0.0, 0.2), Step((20, 0, 0), 0.3, 0.2), Step((0, -30, 10), 0.3, 0.2)))


@pytest.fixture
def stand(tmp_path, monkeypatch):
    """Run the program on motors; the result."""

    def run(motors, watch=None, **bus):
        monkeypatch.setattr(Equipment, "_unit", lambda self: Ticks())
        with Bus(motors, **bus) as opened:
            equipment = Equipment(driver="dynamixel", port=opened.path, ids="1,2,3", baud=57600)
            driver, source = equipment.open(PROGRAM, 1)
            return record(driver, source, tmp_path / "run.csv", steps=len(PROGRAM.steps), watch=watch)

    return run


@pytest.mark.parametrize("lose_every", [0, 23], ids=["whole", "answers lost"])
def test_a_run(stand, tmp_path, lose_every):
    motors = {number: Motor() for number in (1, 2, 3)}
    done = stand(motors, lose_every=lose_every)
    assert (done.state, done.message) == ("completed", "")
    angles = np.degrees(imucal.read(tmp_path / "run.csv").stand_rad)
    for pose in np.cumsum([step.turn_deg for step in PROGRAM.steps], axis=0):
        assert (np.abs(angles - pose).max(axis=1) < 1.01).any()
    assert [round(motor.position * 360 / 4096) for motor in motors.values()] == [0, 0, 0]


def test_a_motor_that_restarts_ends_the_run(stand):
    motors = {number: Motor() for number in (1, 2, 3)}

    def watch(moment):
        if moment.status.step >= 1:
            motors[2].restart()

    done = stand(motors, watch)
    assert done.state == "stand_error"
    assert "motor 2 has restarted" in done.message


@pytest.mark.parametrize(
    ("motors", "said"),
    [
        ({1: Motor(), 2: Motor(), 3: Motor(mode=3)}, "motor 3 is in operating mode 3"),
        ({1: Motor(), 2: Motor()}, "motor 3 does not answer"),
    ],
    ids=["mode", "missing"],
)
def test_motors_that_cannot_be_used(stand, motors, said):
    with pytest.raises(imucal.ImucalError, match=said):
        stand(motors)


def test_no_port():
    with pytest.raises(imucal.ImucalError, match="cannot be opened"):
        Motors("/dev/nothing", 57600, (1, 2, 3))


@pytest.mark.parametrize("ids", ["1,2", "1,1,2", "a,b,c", "1,2,300"])
def test_ids_that_are_not_three_motors(ids):
    with pytest.raises(imucal.InputError, match="--ids"):
        ids_of(ids)
