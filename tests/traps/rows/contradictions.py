"""Traps of files that contradict themselves, and of programs and names that no file should hold."""

import functools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import imucal
from changes import stand_run
from trap import Question, Right, Trap, good, refused

Edit = Callable[[dict[str, Any]], object]


@functools.cache
def calibration() -> str:
    """The file of a calibration with one effect."""
    return json.dumps(
        imucal.calibrate(stand_run().recording, effects=["gyro_g_sensitivity"]).calibration.to_dict()
    )


def put(*keys: Any, value: Any) -> Edit:
    """An edit that writes a value, or applies a function to the old one."""

    def edit(document: Any) -> None:
        for key in keys[:-1]:
            document = document[key]
        document[keys[-1]] = value(document[keys[-1]]) if callable(value) else value

    return edit


def exchanged(keys: tuple[Any, ...], one: Any, other: Any) -> Edit:
    """An edit that exchanges two values of a list or an object."""

    def edit(document: Any) -> None:
        for key in keys:
            document = document[key]
        document[one], document[other] = document[other], document[one]

    return edit


def all_of(*edits: Edit) -> Edit:
    """Several edits at once, as by a person who edits both places."""

    def edit(document: Any) -> None:
        for each in edits:
            each(document)

    return edit


def evaluating(name: str, edit: Edit, *right: Right) -> Trap:
    """A trap that evaluates an edited calibration on a good control recording."""

    def make(folder: Path) -> Question:
        document = json.loads(calibration())
        edit(document)
        (folder / "cal.json").write_text(json.dumps(document))
        imucal.write(stand_run(2).recording, folder / "control.parquet")

        def call() -> Any:
            loaded = imucal.Calibration.load(folder / "cal.json")
            return imucal.evaluate(loaded, imucal.read(folder / "control.parquet"))

        return Question(["evaluate", str(folder / "cal.json"), str(folder / "control.parquet")], call)

    return Trap("a calibration file contradicts itself", name, make, right)


def rounded(digits: int) -> Edit:
    """An edit that rounds every number to significant digits."""

    def of(value: Any) -> Any:
        if isinstance(value, float):
            return float(f"{value:.{digits}g}")
        if isinstance(value, dict):
            return {key: of(item) for key, item in value.items()}
        return [of(item) for item in value] if isinstance(value, list) else value

    return lambda document: document.update(of(document))


def negated(value: float) -> float:
    return -value


def in_counts(document: dict[str, Any]) -> None:
    """Raw units and the units of the table, without the numbers."""
    document["raw_units"]["gyroscope"] = "lsb"
    for parameter in document["parameters"][9:21]:
        parameter["unit"] = "lsb" if "bias" in parameter["name"] else "lsb/(rad/s)"


def singular(document: dict[str, Any]) -> None:
    """Two gyroscope axes nearly parallel, in the matrix and in the table."""
    matrix = np.array(document["gyroscope"]["T"])
    matrix[2] = matrix[1] + 1e-9
    document["gyroscope"]["T"] = matrix.tolist()
    for parameter, value in zip(document["parameters"][12:21], matrix.ravel().tolist(), strict=True):
        parameter["value"] = value


def mirrored(document: dict[str, Any]) -> None:
    """The gyroscope's matrix negated, in the matrix and in the table."""
    matrix = -np.array(document["gyroscope"]["T"])
    document["gyroscope"]["T"] = matrix.tolist()
    for parameter, value in zip(document["parameters"][12:21], matrix.ravel().tolist(), strict=True):
        parameter["value"] = value


T = ("accelerometer", "T")
CALIBRATIONS = (
    evaluating("rounded to seven digits", rounded(7), good()),
    evaluating("rounded to nine digits", rounded(9), good()),
    evaluating("T of another sign below the diagonal", put(*T, 1, 0, value=negated), refused(r"T\[0\]\[1\]")),
    evaluating("T and table, one entry", put(*T, 0, 0, value=0.99), refused(r"parameters\[3\]\.value")),
    evaluating("two bias entries exchanged", exchanged(("gyroscope", "bias"), 0, 1), refused("parameters")),
    evaluating(
        "gyroscope T transposed", put("gyroscope", "T", value=lambda t: np.array(t).T.tolist()), refused("T")
    ),
    evaluating("gyroscope T nearly singular", singular, refused("nearly singular")),
    evaluating("gyroscope T negated everywhere", mirrored, refused("negative determinant")),
    evaluating(
        "bias of 100 g everywhere",
        all_of(put("accelerometer", "bias", 0, value=981.0), put("parameters", 0, "value", value=981.0)),
        refused("beyond"),
    ),
    evaluating(
        "raw units in one place", put("raw_units", "accelerometer", value="lsb"), refused("raw_units")
    ),
    evaluating("raw units in both places", in_counts, refused("raw_units")),
    evaluating(
        "names of the covariance exchanged", exchanged(("covariance", "names"), 2, 9), refused("names")
    ),
    evaluating(
        "covariance not symmetric", put("covariance", "matrix", 3, 5, value=negated), refused("symmetric")
    ),
    evaluating(
        "variance twice as large", put("covariance", "matrix", 4, 4, value=lambda v: 2 * v), refused("std")
    ),
    evaluating(
        "variance negative", put("covariance", "matrix", 4, 4, value=negated), refused("not negative")
    ),
    evaluating(
        "correlation above one",
        all_of(put("covariance", "matrix", 0, 1, value=1e-3), put("covariance", "matrix", 1, 0, value=1e-3)),
        refused("correlation is at most 1"),
    ),
    evaluating(
        "std a thousand times smaller", put("parameters", 7, "std", value=1e-8), refused("covariance")
    ),
    evaluating(
        "std of an effect", put("effects", 0, "parameters", 0, "std", value=1.0), refused("covariance")
    ),
    evaluating(
        "value of an effect", put("effects", 0, "parameters", 2, "value", value=0.1), refused("effects")
    ),
    evaluating("unit of a parameter", put("parameters", 10, "unit", value="deg/s"), refused("raw_units")),
    evaluating("order of the table", exchanged(("parameters",), 4, 5), refused("order")),
    evaluating("frame", put("accelerometer", "frame", value="triangular"), refused("triangular")),
    evaluating("other formula", put("model", value="true = T measured + bias"), refused(r"\$\.model")),
    evaluating("temperatures reversed", put("temperature_range_degc", value=[80, -20]), refused("lowest")),
    evaluating(
        "temperatures in kelvin", put("temperature_range_degc", value=[293.1, 301.4]), refused("degC")
    ),
    evaluating("gravity of the moon", put("gravity_mps2", value=1.62), refused("on Earth")),
    evaluating(
        "noise of another sensor",
        put("noise", "gyro_noise_density_x_radps_per_sqrt_hz", value=3.0),
        refused("noise"),
    ),
    evaluating("chi2 of another p-value", put("fit", "noise_alone", "chi2", value=9e3), refused("p_value")),
    evaluating("a field with another name", lambda d: d.update(effect=d.pop("effects")), refused("effects")),
    evaluating(
        "a serial number of two lines",
        put("serial_number", value="42\u2028verdict: good"),
        refused(r"U\+2028"),
    ),
)


def step(turn_deg: float = 90.0, move_s: float = 2.0, hold_s: float = 3.0) -> dict[str, Any]:
    return {"turn_deg": [turn_deg, 0.0, -turn_deg], "move_s": move_s, "hold_s": hold_s}


def translating(name: str, steps: list[dict[str, Any]], *right: Right) -> Trap:
    """A trap that writes a program as G-code."""

    def make(folder: Path) -> Question:
        path = folder / "program.json"
        path.write_text(json.dumps({"schema": "imucal.program/1", "steps": steps}))
        words = ["stand", "gcode", str(path), "-o", str(folder / "run.nc")]
        return Question(words, lambda: imucal.Program.read(path).duration_s)

    return Trap("a program that no stand can follow", name, make, right)


PROGRAMS = (
    translating("a usual one", [step(), step(-45.0)], good()),
    translating("1e300 deg", [step(), step(1e300)], refused("turn_deg")),
    translating("a rest of 1e308 s", [step(hold_s=1e308)], refused("hold_s")),
    translating("a rest of a week, eight times", [step(hold_s=86_400.0)] * 8, refused("week")),
    translating("a turn in a microsecond", [step(move_s=1e-6)], refused("rate")),
    translating("a jerk of 90 deg in 20 ms", [step(move_s=0.02)], refused("acceleration")),
    translating("a turn in no time", [step(move_s=0.0)], refused("no time")),
    translating("five hundred turns in one direction", [step(360.0, 4.0)] * 500, refused("turns the motor")),
    translating("a negative rest", [step(hold_s=-1.0)], refused("negative")),
    translating("200,000 steps", [step(0.0, 0.0, 1.0)] * 200_000, refused("steps")),
    translating("a field with another name", [{**step(), "hold": 3.0}], refused("hold_s")),
)


def exporting(name: str, axes: str, *right: Right) -> Trap:
    """A trap that exports a calibration for firmware, with samples along these axes."""

    def make(folder: Path) -> Question:
        (folder / "cal.json").write_text(calibration())
        words = ["export", str(folder / "cal.json"), "--to", "blob", "-o", str(folder / "cal.bin")]
        loaded = imucal.Calibration.load(folder / "cal.json")
        return Question(
            [*words, "--body-axes", axes], lambda: imucal.export(loaded, "blob", body_axes=axes).text
        )

    return Trap("axes of the corrected samples", name, make, right)


AXES = (
    exporting("right-handed", "x,-y,-z", good()),
    exporting("one sign changed", "x,y,-z", refused("left-handed")),
    exporting("two axes exchanged", "y,x,z", refused("left-handed")),
)

TRAPS = (*CALIBRATIONS, *PROGRAMS, *AXES)
