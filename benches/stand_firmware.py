"""`stand calibrate` with the firmware of a controller: `make stand-firmware`.

Writes docs/results/stand-firmware.md. The whole program runs on a simulator of GRBL (GRBL_SIM=PATH) in real
time, about nine minutes. The unit is simulated with the angles that the firmware reports: they pass a filter
that acts like an elastic coupling, so that the angles of the unit, its angular rate and its specific force
are consistent. The parameters found are compared with those of the unit, and with those found in a
simulation of the same programs.
"""

import os
import tempfile
import time
from collections import deque
from contextlib import nullcontext
from pathlib import Path

import numpy as np

import imucal
from grbl_firmware import Firmware
from imucal import Program
from imucal.stand.grbl import GrblDriver
from imucal.stand.line import Order, calibrate_unit
from serial_lines import MemoryLine
from stand_devices import ControllerDevice, RealTime
from stand_scenarios import SETTINGS

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs/results/stand-firmware.md"
UNIT, SEED, CONTROL_SEED, CONTROL_MOVES = "random:bmi088:7", 1, 5, 20
UNIT_HZ = 100.0
# Natural frequency of the coupling, rad/s, and the step of its integration, s.
COUPLING_RADPS, STEP_S = 40.0, 0.001
# Latency of the samples, s: the position of the firmware is known when the next report has come.
BEHIND_S = 0.3


class Coupled:
    """A unit on an elastic coupling, as a source of samples."""

    columns = ("time_s", *(f"accel_{a}_mps2" for a in "xyz"), *(f"gyro_{a}_radps" for a in "xyz"))

    def __init__(self, device, unit, seed):
        self.device, self.unit = device, unit
        # Angular rate per specific force that the gyroscope shows in addition, rad/s per m/s^2.
        self.from_force = next(e.values for e in unit.effects if e.name == "gyro_g_sensitivity").reshape(3, 3)
        self.random = np.random.default_rng(seed)
        self.angle, self.rate = np.zeros(3), np.zeros(3)
        self.time_s, self.taken = 0.0, deque()

    def start(self):
        self.begun_s = time.monotonic()
        # Time of the device at the first sample.
        self.zero_s = self.device.now_s

    def read(self, wait_s):
        time.sleep(wait_s)
        truth = list(self.device.truth)
        at = np.array([at_s for at_s, _ in truth]) - self.zero_s
        positions = np.array([position for _, position in truth])
        rows, self.arrived = [], []
        until_s = time.monotonic() - self.begun_s - BEHIND_S
        steps = int(max(until_s - self.time_s, 0.0) * UNIT_HZ)
        for _ in range(steps):
            end_s = self.time_s + 1.0 / UNIT_HZ
            fine_s = np.arange(self.time_s, end_s - STEP_S / 2, STEP_S)
            target = np.radians(np.column_stack([np.interp(fine_s, at, angle) for angle in positions.T]))
            for aim in target:
                pull = COUPLING_RADPS**2 * (aim - self.angle) - 2 * COUPLING_RADPS * self.rate
                self.rate = self.rate + STEP_S * pull
                self.angle = self.angle + STEP_S * self.rate
            self.time_s = end_s
            rows.append([end_s, *self._measured()])
            self.arrived.append(self.begun_s + end_s)
        return np.array(rows).reshape(-1, 7)

    def _measured(self):
        """Samples of the unit at the angles and rates of the three motors."""
        rotation, rate = np.eye(3), np.zeros(3)
        for axis in range(3):
            rate = rotation_about(axis, self.angle[axis]).T @ rate
            rate[axis] += self.rate[axis]
            rotation = rotation @ rotation_about(axis, self.angle[axis])
        force = rotation.T @ np.array([0.0, 0.0, imucal.units.STANDARD_GRAVITY_MPS2])
        rate = rate + self.from_force @ force
        out = []
        for sensor, true in ((self.unit.accelerometer, force), (self.unit.gyroscope, rate)):
            noise = sensor.noise_density * np.sqrt(UNIT_HZ / 2) * self.random.normal(size=3)
            out += (sensor.sensitivity @ true + sensor.bias + noise).tolist()
        return out

    def arrivals(self):
        return np.array(self.arrived)

    def events(self):
        return ()

    def counts(self):
        return {}

    def close(self):
        pass


def rotation_about(axis, angle):
    c, s = np.cos(angle), np.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    rotation = np.eye(3)
    rotation[i, i] = rotation[j, j] = c
    rotation[i, j], rotation[j, i] = -s, s
    return rotation


def main() -> None:
    path = os.environ["GRBL_SIM"]
    calibration = imucal.simulate(imucal.Static(1.0), seed=1, unit=UNIT).truth.calibration
    unit = imucal.rig.unit.unit_of(UNIT)
    with tempfile.TemporaryDirectory() as folder:
        firmware = Firmware(path, folder, SETTINGS)
        line = MemoryLine(115200, 0.005)
        device = ControllerDevice(line, firmware, latency_s=0.005)
        order = Order(
            Program.random(seed=SEED),
            seed=SEED,
            control=Program.random(seed=CONTROL_SEED, moves=CONTROL_MOVES),
            control_seed=CONTROL_SEED,
        )

        def equipment(program, seed):
            return GrblDriver(program, "memory", open_port=line.open_port), Coupled(device, unit, seed)

        with RealTime(device, by_clock=True):
            outcome = calibrate_unit(order, equipment, folder, view=lambda _: nullcontext(None))
        firmware.stop()
    result = outcome.assessment.result if outcome.assessment else None
    truth = {parameter.name: parameter.value for parameter in calibration.parameters}
    simulated = imucal.calibrate(
        imucal.simulate(order.program, seed=SEED, unit=UNIT, rate_hz=UNIT_HZ).recording
    )
    slowest = firmware.slowest()
    PAGE.write_text(page(Path(path).name, outcome, result, simulated, truth, slowest), encoding="utf-8")
    print(PAGE.relative_to(ROOT))


def pulls(result, truth):
    """Errors of the parameters over their standard deviations."""
    return {p.name: (p.value - truth[p.name]) / p.std for p in result.parameters if p.name in truth}


def counted(events):
    """Messages of events by code: the first one, and the number of events."""
    by_code = {}
    for event in events:
        by_code.setdefault(event["code"], []).append(event["message"])
    return [f"{code} {len(texts)}: {texts[0]}" for code, texts in by_code.items()]


def page(firmware, outcome, result, simulated, truth, slowest):
    reasons = "; ".join(f"`{reason.code}`: {reason.message}" for reason in outcome.reasons) or "none"
    runs = "".join(
        f"| {name} | {done.state} | {done.samples} | {'; '.join(counted(done.events)) or 'none'} |\n"
        for name, done in outcome.runs.items()
    )
    found = {"firmware": result, "simulation": simulated}
    rows, errors, verdicts = "", {}, ""
    for name, one in found.items():
        if one is None:
            continue
        errors[name] = pulls(one, truth)
        sizes = np.abs(list(errors[name].values()))
        rms = np.sqrt(np.mean(sizes**2))
        verdicts += f"* {name}: {one.verdict}. {'; '.join(one.reasons)}\n"
        rows += f"| {name} | {one.verdict} | {len(sizes)} | {rms:.2f} | {sizes.max():.2f} |\n"
    each = "".join(
        f"| `{name}` | {' | '.join(f'{errors[of].get(name, np.nan):+.2f}' for of in errors)} |\n"
        for name in next(iter(errors.values()))
    )
    return f"""# Calibration with the firmware of a controller

This page, written by `make stand-firmware`, reports `imucal stand calibrate` with the firmware `{firmware}`,
compiled for the computer, in real time: the program `random` with seed {SEED}, and a control program with
seed {CONTROL_SEED} and {CONTROL_MOVES} moves. The unit is `{UNIT}` at {UNIT_HZ:g} Hz; it follows the angles
that the firmware reports, through an elastic coupling. The simulation has the same unit and program without
a controller.

In the slowest second of uniform motion, the time of the simulator passed at {100 * slowest:.0f} % of real
time, by the rates and positions in its reports.

The verdict of `stand calibrate` is **{outcome.verdict}**. Reasons: {reasons}.

| run | ended as | samples | events |
|---|---|---|---|
{runs}
| motion from | verdict of the calibration | parameters | rms of error / std | largest |
|---|---|---|---|---|
{rows}
The verdicts of both calibrations with their reasons:

{verdicts}
The errors of the parameters over their standard deviations:

| parameter | {" | ".join(errors)} |
|---|{"---|" * len(errors)}
{each}"""


if __name__ == "__main__":
    main()
