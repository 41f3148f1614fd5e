"""Faults of a stand on the firmware of a GRBL controller, compiled for this computer: `make test-firmware`.

GRBL_SIM is the path of grblHAL's simulator, or of grbl-sim (docs/stand.md). Without it the tests are
skipped. They run in real time.
"""

import os
import sys

import pytest

if not os.environ.get("GRBL_SIM"):
    pytest.skip("GRBL_SIM is not set: give the path of a GRBL simulator", allow_module_level=True)
if sys.platform == "win32":
    pytest.skip("the devices need POSIX", allow_module_level=True)

from grbl_firmware import on_firmware
from stand_scenarios import SCENARIOS


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_fault(name, tmp_path):
    ran = on_firmware(os.environ["GRBL_SIM"], SCENARIOS[name], tmp_path)
    if ran is None:
        pytest.skip(f"this simulator has no {SCENARIOS[name].needs}")
    assert ran.faults == [], (ran.state, ran.message, ran.events)
