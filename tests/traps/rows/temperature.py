"""Traps of the temperature column: other units under the name of degC, reading errors, and raw counts."""

from pathlib import Path

import numpy as np

import imucal
from changes import stand_run, truth_of
from trap import Options, Question, Right, Trap, good, refused

# Offset and size of the warming of a simulated unit, degC.
START_DEGC, RISE_DEGC = 21.0, 6.0


def named(kind: str, name: str, column: str, values, *right: Right, **options) -> Trap:
    """A trap that calibrates the run with a further column; `values` makes it of the temperatures in degC."""

    def make(folder: Path) -> Question:
        run = stand_run()
        degc = START_DEGC + RISE_DEGC * np.arange(len(run.recording)) / len(run.recording)
        recording = imucal.Recording(
            run.recording.time_s,
            run.recording.specific_force,
            run.recording.angular_rate,
            auxiliary={"column": values(degc)},
            name="run",
        )
        path = folder / "run.csv"
        imucal.write(recording, path)
        header, rows = path.read_text().split("\n", 1)
        path.write_text(header.replace("column", column) + "\n" + rows)

        def call():
            return imucal.calibrate(imucal.read(path, **options))

        return Question(["calibrate", str(path), *Options(options).words()], call, truth_of(run))

    return Trap(kind, name, make, right)


def at(place, value):
    def change(degc):
        degc = degc.copy()
        degc[place] = value
        return degc

    return change


OTHER_UNIT = tuple(
    named("a temperature in another unit is called degC", name, "temp_degc", change, refused(says))
    for name, change, says in (
        ("kelvin", lambda t: t + 273.15, "temperature_implausible.*temp_k"),
        ("kelvin in the cold", lambda t: t - 50 + 273.15, "temperature_implausible.*temp_k"),
        ("kelvin in an oven", lambda t: t + 60 + 273.15, "temperature_implausible.*temp_k"),
        (
            "degrees Fahrenheit in an oven",
            lambda t: 1.8 * (t + 55) + 32,
            "temperature_implausible.*temp_degf",
        ),
        ("hundredths of a degree", lambda t: np.round(100 * t), "temperature_implausible.*hundredths"),
        ("thousandths of a degree", lambda t: np.round(1000 * t), "temperature_implausible.*thousandths"),
        ("counts of an MPU-6050", lambda t: np.round(340 * (t - 36.53)), "temperature_implausible.*temp_lsb"),
        (
            "unsigned counts",
            lambda t: np.round(65536 + 340 * (t - 36.53)),
            "temperature_implausible.*temp_lsb",
        ),
    )
)

READING_ERRORS = tuple(
    named(
        "a thermometer that fails",
        name,
        "temp_degc",
        change,
        refused("temperature_implausible.*leave their cells empty"),
    )
    for name, change in (
        ("-127 degC in one sample", at(700, -127.0)),
        ("absolute zero in a second", at(slice(4000, 4100), -273.15)),
        ("999 degC every ten seconds", at(slice(500, None, 1000), 999.0)),
    )
)

READ = tuple(
    named("a temperature in its unit", name, column, change, good(), **options)
    for name, column, change, options in (
        ("kelvin", "temp_k", lambda t: t + 273.15, {}),
        ("degrees Fahrenheit", "temp_degf", lambda t: 1.8 * t + 32, {}),
        ("degC", "temp_degc", lambda t: t, {}),
        (
            "counts with their scale",
            "temp_lsb",
            lambda t: np.round(340 * (t - 36.53)),
            {"temp_scale": "1/340,36.53"},
        ),
        ("counts without a scale", "temp_lsb", lambda t: np.round(256 * (t - 25)), {}),
    )
)

WRONG_SCALE = (
    named(
        "counts of a temperature with a wrong scale",
        "slope per degC instead of degC per count",
        "temp_lsb",
        lambda t: np.round(340 * (t - 36.53)),
        refused("temperature_implausible"),
        temp_scale="340,36.53",
    ),
    named(
        "counts of a temperature with a wrong scale",
        "no offset",
        "temp_lsb",
        lambda t: np.round(340 * (t - 36.53)),
        refused("temp_scale is '1/340'"),
        temp_scale="1/340",
    ),
    named(
        "counts of a temperature with a wrong scale",
        "a scale without counts",
        "temp_degc",
        lambda t: t,
        refused("no column temp_lsb"),
        temp_scale="1/340,36.53",
    ),
)

TRAPS = (*OTHER_UNIT, *READING_ERRORS, *READ, *WRONG_SCALE)
