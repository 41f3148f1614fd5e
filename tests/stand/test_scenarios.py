"""Faults of a stand with a GRBL controller, on the imitation in virtual time (stand_scenarios.py)."""

import sys
from contextlib import nullcontext

import pytest

if sys.platform == "win32":
    pytest.skip("the devices need POSIX", allow_module_level=True)

from grbl_controller import Controller
from stand_scenarios import SCENARIOS, run
from virtual_clock import VirtualClock

# Scenarios in which grblHAL differs: its welcome, and the way in which a target is set.
ON_HAL = (
    "no fault",
    "power cycle in a move",
    "power cycle in a hold, welcome lost",
    "killed in a move, resumed",
    "killed in a hold, resumed",
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "hal"), [*((name, False) for name in SCENARIOS), *((name, True) for name in ON_HAL)]
)
def test_a_fault(name, hal, tmp_path):
    scenario = SCENARIOS[name]
    clock = VirtualClock(0.005)

    def serve(devices):
        clock.devices += devices
        return nullcontext()

    controller = Controller(acceleration=(500.0,) * 3, hal=hal, **scenario.controller)
    ran = run(scenario, tmp_path, clock, controller, serve)
    assert ran.faults == [], (ran.state, ran.message, ran.events)
