"""Traps of several recordings: of several units, of one unit whose biases moved, and a soak beside a run."""

import dataclasses

import numpy as np

import imucal
from imucal import Program
from recordings import calibrating, same
from trap import good, incomplete, poor, refused

WARM = {"gyro_bias_temperature": (1e-4, -0.5e-4, 2e-4)}


def of_unit(unit, seed=2):
    program = Program.random(seed=seed, moves=30, hold_s=2.0)
    return same(imucal.simulate(program, unit=unit, rate_hz=100, seed=seed).recording)


def shifted(recording, shift):
    return dataclasses.replace(recording, angular_rate=recording.angular_rate + np.asarray(shift))


def soak(temperature, effects):
    pose = imucal.Static(600.0, (0.9, 0.3, -0.2, 0.1))
    return same(
        imucal.simulate(
            pose, unit="paper", rate_hz=25, seed=7, temperature=temperature, effects=effects
        ).recording
    )


UNITS = tuple(
    calibrating(
        "recordings of several units",
        name,
        lambda r, units=units: [same(r), *(of_unit(unit, 2 + k) for k, unit in enumerate(units))],
        refused(
            rf"several_units.*{1 + len(set(units))} different units|{1 + len(set(units))} different units"
        ),
    )
    for name, units in {
        "two of one type": ["random:paper:5"],
        "three of one type": ["random:paper:5", "random:paper:6"],
        "one unit twice and another": ["random:paper:5", "random:paper:5"],
    }.items()
)

MOVED = tuple(
    calibrating(
        "the biases moved between recordings of one unit",
        f"{rate_radps} rad/s",
        lambda r, rate=rate_radps: [same(r), shifted(of_unit("paper"), [rate, 0.0, 0.0])],
        incomplete("biases_moved|biases moved"),
        poor("biases_moved|biases moved"),
        changing=("gyro_bias",),
    )
    for rate_radps in (0.005, 0.02)
)

SOAKS = (
    calibrating(
        "a long rest beside a run",
        "constant temperature",
        lambda r: [same(r), soak(25.0, {})],
        good(),
    ),
    calibrating(
        "a long rest beside a run",
        "the temperature changes the bias",
        lambda r: [same(r), soak(imucal.Temperature.cycle(15.0, 45.0, 600.0), WARM)],
        incomplete("residuals exceed their noise"),
        poor("residuals"),
    ),
)

TRAPS = (*UNITS, *MOVED, *SOAKS)
