"""Traps of a sensor that is not there, and of tables of means."""

from pathlib import Path

import numpy as np

import imucal
from changes import stand_run
from trap import Question, Trap, good, incomplete, refused

ABSENT = "a sensor is not there"
MEANS = "a table of means"
# The parameters of the unit in `table`.
TRUTH = dict(zip([f"accel_bias_{axis}" for axis in "xyz"], (0.1, -0.2, 0.05), strict=True))
TRUTH |= dict(zip([f"accel_sensitivity_{axis}{axis}" for axis in "xyz"], (1.01, 0.99, 1.0), strict=True))


def _written(recording: imucal.Recording, folder: Path, name: str) -> Path:
    imucal.write(recording, folder / name)
    return folder / name


def alone(folder: Path) -> Question:
    path = _written(stand_run(1).recording.of_sensor("accelerometer"), folder, "accel.csv")
    return Question(("calibrate", path), lambda: imucal.calibrate(imucal.read(path)))


def with_effect(folder: Path) -> Question:
    path = _written(stand_run(1).recording.of_sensor("accelerometer"), folder, "accel.csv")
    effect = "accel_scale_quadratic"
    return Question(
        ("calibrate", path, "--effect", effect), lambda: imucal.calibrate(imucal.read(path), effects=[effect])
    )


def under_another_name(folder: Path) -> Question:
    path = _written(stand_run(1).recording, folder, "run.csv")
    header, rest = path.read_text().split("\n", 1)
    path.write_text(header.replace("gyro_x_radps", "gyr_x").replace("gyro_y_radps", "gyr_y") + "\n" + rest)
    text = path.read_text()
    path.write_text(text.replace("gyro_z_radps", "gyr_z", 1))
    return Question(("calibrate", path), lambda: imucal.calibrate(imucal.read(path)))


def control_without_gyroscope(folder: Path) -> Question:
    run, control = stand_run(1).recording, stand_run(2).recording.of_sensor("accelerometer")
    paths = _written(run, folder, "run.csv"), _written(control, folder, "control.csv")
    return Question(
        ("calibrate", paths[0], "--control", paths[1]),
        lambda: imucal.calibrate(imucal.read(paths[0]), control=imucal.read(paths[1])),
    )


def gyroscope_only(folder: Path) -> Question:
    path = _written(stand_run(1).recording.of_sensor("gyroscope"), folder, "gyro.csv")
    return Question(("calibrate", path), lambda: imucal.calibrate(imucal.read(path)))


def table(scale: float, rows: int, *words: str, digits: int = 17, times: int = 1):
    """A table of means of a unit with small errors, in g times `scale`; the options of the command.

    digits  decimal places of the means
    times   how often the whole table is written
    """

    def make(folder: Path) -> Question:
        random = np.random.default_rng(1)
        up = random.normal(size=(rows, 3))
        up /= np.linalg.norm(up, axis=1, keepdims=True)
        up[:6] = [sign * np.eye(3)[axis] for axis in range(3) for sign in (1, -1)]
        means = scale * (9.80665 * up * [1.01, 0.99, 1.0] + [0.1, -0.2, 0.05])
        means += scale * random.normal(scale=0.005, size=means.shape)
        path = folder / "table.csv"
        lines = [",".join(map(repr, row)) for row in np.round(means, digits).tolist()] * times
        path.write_text("\n".join(["accel_x_mps2,accel_y_mps2,accel_z_mps2", *lines]) + "\n")
        noise = float(words[1]) if words[:1] == ("--noise",) else None
        return Question(
            ("calibrate", path, "--means", *words),
            lambda: imucal.calibrate(imucal.read_means(path), noise_mps2=noise),
            None if scale != 1.0 or rows < 9 else TRUTH,
        )

    return make


TRAPS = (
    Trap(ABSENT, "an accelerometer alone", alone, (good("calibrated alone"),)),
    Trap(ABSENT, "an effect of an accelerometer alone", with_effect, (refused("sensor_missing"),)),
    Trap(ABSENT, "a gyroscope under another name", under_another_name, (refused("gyro_x"),)),
    Trap(ABSENT, "a control without gyroscope", control_without_gyroscope, (refused("sensor_missing"),)),
    Trap(ABSENT, "a gyroscope only", gyroscope_only, (refused("sensor_missing"),)),
    Trap(MEANS, "with its noise", table(1.0, 20, "--noise", "0.005"), (good("given standard deviation"),)),
    Trap(
        MEANS,
        "whose rows are written four times",
        table(1.0, 20, "--noise", "0.005", times=4),
        (good("60 of 80 rows are exact copies.*samples_duplicated"), refused("recordings_overlap")),
    ),
    Trap(
        MEANS,
        "in coarse steps, written twice",
        table(1.0, 20, "--noise", "0.01", digits=2, times=2),
        (good("20 of 40 rows are exact copies"),),
    ),
    Trap(MEANS, "without its noise", table(1.0, 20), (incomplete("from the residuals"),)),
    Trap(MEANS, "in g under names of m/s^2", table(1 / 9.80665, 20), (refused("accel_units"),)),
    Trap(MEANS, "with six rows", table(1.0, 6, "--noise", "0.005"), (refused("do not determine"),)),
)
