"""Accuracy and speed compared with other programs: `make comparison`, to docs/comparison.md.

Every program gets the same simulated units, each in the form of recording that it needs. Accuracy is the
error of corrected samples, since programs use different parameters and body frames. The frames are aligned by
the rotation that fits the corrected specific forces to the true ones.

The crate imu-calib comes from crates.io and is compiled (benches/peers/imu_calib). The package imucal of FAU
Erlangen has the import name of this package, so a second interpreter runs it from a folder of its own.
"""

import json
import os
import subprocess
import sys
import tempfile
import textwrap

# Set before NumPy is imported, because its linear algebra reads these variables at import.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

import imucal
import scipy_peer
from sections import write_section

ROOT: Final = Path(__file__).resolve().parent.parent
PAGE: Final = ROOT / "docs" / "comparison.md"
PEER: Final = ROOT / "benches" / "peers" / "imu_calib"
FAU: Final = "imucal==2.6.0"
XSENS: Final = ROOT.parent / "shared" / "data" / "xsens_mti"
GRAVITY_MPS2: Final = 9.80665
# Gravity where the Xsens recording was made, m/s^2, and nominal counts of its sensors.
XSENS_GRAVITY_MPS2: Final = 9.81744
XSENS_ZERO, XSENS_ACCEL, XSENS_GYRO = 32768.0, 414.5, 4770.0
UNIT: Final = "paper"
SEEDS: Final = range(1, 21)
ROUNDS: Final = 9
RATE_HZ: Final = 200.0
# Angular rate at which the error of the corrected rate is stated, rad/s.
RATE_RADPS: Final = np.radians(100.0)
# Tilt of the faces of a box against gravity, and of the axes of its turns, standard deviation, deg.
TILTS_DEG: Final = {0.0: "exact faces", 1.0: "faces within 1 deg"}
# Figures of imu_tk on the Xsens recording, measured on another occasion, as it needs Ceres and Qt: time of
# the whole process, s, and rms error of the gravity direction over the moves, deg.
IMU_TK_S, IMU_TK_DEG = 0.459, 0.517

Matrix = NDArray[np.float64]


@dataclass(frozen=True)
class Linear:
    """measured = T true + b of both sensors."""

    accel: Matrix
    accel_bias: Matrix
    gyro: Matrix
    gyro_bias: Matrix


@dataclass(frozen=True)
class Session:
    """Six faces and a turn of 360 deg on three of them: (N, 6) force and rate of each part by its name."""

    parts: dict[str, Matrix]


def of_calibration(calibration: imucal.Calibration) -> Linear:
    accel, gyro = calibration.accelerometer, calibration.gyroscope
    assert gyro is not None
    return Linear(accel.sensitivity, accel.bias, gyro.sensitivity, gyro.bias)


def errors(found: Linear, truth: Linear) -> tuple[float, float]:
    """Rms errors per axis of the corrected force at rest, mg, and of the rate at 100 deg/s, deg/s."""
    accel = np.linalg.solve(found.accel, truth.accel)
    u, _, v = np.linalg.svd(accel)
    frame = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v

    def rms(matrix: Matrix, offset: Matrix, length: float) -> float:
        # Mean square of `excess v` over all directions of v: |excess|^2 length^2 / 3.
        excess = frame.T @ matrix - np.eye(3)
        return float(np.sqrt(((excess**2).sum() * length**2 / 3 + (offset**2).sum()) / 3))

    force = rms(accel, np.linalg.solve(found.accel, truth.accel_bias - found.accel_bias), GRAVITY_MPS2)
    gyro = np.linalg.solve(found.gyro, truth.gyro)
    rate = rms(gyro, np.linalg.solve(found.gyro, truth.gyro_bias - found.gyro_bias), RATE_RADPS)
    return force / GRAVITY_MPS2 * 1e3, float(np.degrees(rate))


# --- programs for recordings with rests in many poses ---


def by_imucal(recording: imucal.Recording, gravity: float) -> Linear:
    return of_calibration(imucal.calibrate(recording, gravity_mps2=gravity).calibration)


def by_scipy(recording: imucal.Recording, gravity: float) -> Linear:
    found = scipy_peer.calibrate(
        recording.time_s,
        np.asarray(recording.specific_force),
        np.asarray(recording.angular_rate),
        gravity_mps2=gravity,
        gyro_nominal=1.0,
    )
    return Linear(found.accel_sensitivity, found.accel_bias, found.gyro_sensitivity, found.gyro_bias)


# Length of the first rest, from which imu-calib derives its thresholds, s: its default.
FIRST_REST_S: Final = 4.0


def imu_calib(
    recording: imucal.Recording, gravity: float, first_rest_s: float = FIRST_REST_S, rounds: int = 1
) -> tuple[Linear, float]:
    """The result of the crate imu-calib, and its median time, s."""
    rows = np.column_stack([recording.time_s, recording.specific_force, recording.angular_rate])
    program = Path(os.environ["CARGO_TARGET_DIR"]) / "release" / "peer-imu-calib"
    arguments = [repr(gravity), repr(first_rest_s), str(rounds)]
    done = subprocess.run([program, *arguments], input=rows.tobytes(), capture_output=True, check=True)
    numbers = np.array(done.stdout.split(), dtype=float)
    accel, gyro = numbers[:18].reshape(2, 3, 3)
    return Linear(accel, numbers[18:21], gyro, numbers[21:24]), float(numbers[24])


def time_of_imu_calib(recording: imucal.Recording, gravity: float) -> float:
    """Processor time of a calibration, s: the difference of 1 + ROUNDS repetitions and of one."""
    taken = []
    for rounds in (1, 1 + ROUNDS):
        before = os.times().children_user
        imu_calib(recording, gravity, rounds=rounds)
        taken.append(os.times().children_user - before)
    return (taken[1] - taken[0]) / ROUNDS


# --- programs for six faces and turns ---

FACES: Final = {"x_p": 0, "x_a": 0, "y_p": 1, "y_a": 1, "z_p": 2, "z_a": 2}
FACE_S, TURN_S = 5.0, 6.0


def session(truth: Linear, noise: tuple[float, float], tilt_deg: float, seed: int) -> Session:
    """A session on faces that are tilted by a random angle; `noise` is that of a sample, m/s^2 and rad/s."""
    random = np.random.default_rng(seed)

    def tilted(vector: Matrix) -> Matrix:
        angle = np.radians(tilt_deg) * random.standard_normal(3)
        moved = vector + np.cross(angle, vector)
        return moved / np.linalg.norm(moved)

    def samples(force: Matrix, rate: Matrix) -> Matrix:
        measured = np.hstack(
            [force @ truth.accel.T + truth.accel_bias, rate @ truth.gyro.T + truth.gyro_bias]
        )
        return measured + random.standard_normal(measured.shape) * np.repeat(noise, 3)

    parts = {}
    for name, axis in FACES.items():
        up = tilted((1.0 if name.endswith("p") else -1.0) * np.eye(3)[axis])
        count = int(FACE_S * RATE_HZ)
        parts[name] = samples(np.tile(GRAVITY_MPS2 * up, (count, 1)), np.zeros((count, 3)))
    for name, axis in {"x_rot": 0, "y_rot": 1, "z_rot": 2}.items():
        up, count = tilted(np.eye(3)[axis]), int(TURN_S * RATE_HZ)
        rate = np.tile(-2 * np.pi / TURN_S * up, (count, 1))
        parts[name] = samples(np.tile(GRAVITY_MPS2 * up, (count, 1)), rate)
    return Session(parts)


def on_board(given: Session) -> Linear:
    """Bias and scale of the accelerometer from six faces, and gyroscope bias: the parameters of PX4."""
    means = {name: part.mean(axis=0) for name, part in given.parts.items() if name in FACES}
    pairs = [(means[f"{axis}_p"][i], means[f"{axis}_a"][i]) for i, axis in enumerate("xyz")]
    bias = np.array([(plus + minus) / 2 for plus, minus in pairs])
    scale = np.array([(plus - minus) / 2 / GRAVITY_MPS2 for plus, minus in pairs])
    return Linear(np.diag(scale), bias, np.eye(3), np.mean(list(means.values()), axis=0)[3:])


FAU_PROGRAM: Final = """
import json, sys
import numpy as np
from imucal import FerrarisCalibration, FerrarisSignalRegions
gravity, rate_hz = map(float, sys.argv[1:3])
for path in sys.argv[3:]:
    given = np.load(path)
    parts = {f"{kind}_{name}": given[name][:, columns] for name in given.files
             for kind, columns in (("acc", slice(0, 3)), ("gyr", slice(3, 6)))}
    found = FerrarisCalibration(grav=gravity).compute(
        FerrarisSignalRegions(**parts), rate_hz, from_acc_unit="m/s^2", from_gyr_unit="deg/s")
    result = found.K_a @ found.R_a, found.b_a, found.K_g @ found.R_g, found.b_g
    print(json.dumps([np.asarray(part).tolist() for part in result]))
"""


def by_fau(sessions: list[Session], folder: Path) -> list[Linear]:
    """The results of the package imucal of FAU Erlangen, without its correction for g-sensitivity."""
    degrees = np.repeat([1.0, 180.0 / np.pi], 3)
    paths = [folder / f"session-{number}.npz" for number in range(len(sessions))]
    for path, given in zip(paths, sessions, strict=True):
        np.savez(path, **{name: part * degrees for name, part in given.parts.items()})
    command = [sys.executable, "-c", FAU_PROGRAM, repr(GRAVITY_MPS2), repr(RATE_HZ), *paths]
    environment = {**os.environ, "PYTHONPATH": str(folder / "fau"), "PYTHONSAFEPATH": "1"}
    done = subprocess.run(command, env=environment, capture_output=True, check=True, text=True)
    results = [map(np.array, json.loads(line)) for line in done.stdout.splitlines()]
    return [Linear(a, a_bias, g, np.radians(g_bias)) for a, a_bias, g, g_bias in results]


# --- tables ---


def paragraph(text: str) -> str:
    return textwrap.fill(text, 120, break_on_hyphens=False)


def accuracy(folder: Path) -> str:
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--target", folder / "fau", FAU]
    subprocess.run(pip, check=True)
    found: dict[str, list[tuple[float, float]]] = {}
    sessions: list[tuple[str, Session, Linear]] = []
    for seed in SEEDS:
        program = imucal.Program.random(seed=seed, hold_s=5.0)
        run = imucal.simulate(program, seed=seed, unit=UNIT, rate_hz=RATE_HZ)
        truth = of_calibration(run.truth.calibration)

        def note(name: str, result: Linear, truth: Linear = truth) -> None:
            found.setdefault(name, []).append(errors(result, truth))

        note("uncalibrated", Linear(np.eye(3), np.zeros(3), np.eye(3), np.zeros(3)))
        note("imucal, 46 poses", by_imucal(run.recording, GRAVITY_MPS2))
        note("SciPy program, 46 poses", by_scipy(run.recording, GRAVITY_MPS2))
        note("imu-calib 0.3.1, 46 poses", imu_calib(run.recording, GRAVITY_MPS2)[0])
        rests = imucal.inspect(run.recording).rests
        assert len(rests) == 46, f"seed {seed}: {len(rests)} rests"
        time_s = run.recording.time_s
        still = (time_s >= rests[0].start_s) & (time_s <= rests[0].end_s)
        sigma = [
            float(np.std(np.asarray(samples)[still], axis=0).mean())
            for samples in (run.recording.specific_force, run.recording.angular_rate)
        ]
        noise = (sigma[0], sigma[1])
        for tilt_deg, how in TILTS_DEG.items():
            faces = session(truth, noise, tilt_deg, seed)
            sessions.append((how, faces, truth))
            note(f"on-board routine, {how}", on_board(faces))
    results = by_fau([given for _, given, _ in sessions], folder)
    for (how, _, truth), result in zip(sessions, results, strict=True):
        found.setdefault(f"FAU imucal 2.6.0, {how}", []).append(errors(result, truth))
    lines = [
        paragraph(
            f"The table gives medians over {len(SEEDS)} simulated runs (seeds {SEEDS[0]} to {SEEDS[-1]}, "
            f"unit `{UNIT}`, {RATE_HZ:g} Hz). Errors are rms values per axis of the corrected samples, after "
            "the body frames of the programs have been aligned."
        ),
        "",
        "| program and recording | specific force at rest, mg | rate at 100 deg/s, deg/s |",
        "|---|---:|---:|",
    ]
    for name, values in found.items():
        force, rate = np.median(np.array(values), axis=0)
        lines.append(f"| {name} | {force:.2g} | {rate:.2g} |")
    lines += [
        "",
        paragraph(
            "imucal, the SciPy program and imu-calib use recordings of 46 poses in random directions with "
            "moves between them. The on-board routine and FAU imucal use recordings of six faces for 5 s "
            "each. FAU imucal also uses three turns of 360 deg in 6 s. The faces and the axes of the turns "
            "are exact, or tilted by 1 deg (standard deviation), as on a table. The on-board routine "
            "estimates the parameters that PX4 and ArduPilot estimate from six faces: bias and scale of the "
            "accelerometer, and the bias of the gyroscope. The routine was written for this table; the code "
            "of PX4 and ArduPilot was not run. Kalibr is not in this table, because it needs a camera and "
            "a target."
        ),
    ]
    return "\n".join(lines)


def milliseconds(seconds: float) -> str:
    return f"{1e3 * seconds:.0f}" if seconds >= 0.01 else f"{1e3 * seconds:.1f}"


def timed(run: Callable[[], object]) -> float:
    """Median processor time of a call, s, which other programs on the machine hardly change."""
    taken = []
    for _ in range(ROUNDS):
        start = time.process_time()
        run()
        taken.append(time.process_time() - start)
    return statistics.median(taken)


def judged(found: Linear, recording: imucal.Recording) -> float | None:
    """Rms error of the gravity direction per move, deg, by `imucal.evaluate` for every program."""
    calibration = imucal.Calibration(
        accelerometer=imucal.Triad(found.accel, found.accel_bias),
        gyroscope=imucal.Triad(found.gyro, found.gyro_bias),
        frame="given",
        gravity_mps2=XSENS_GRAVITY_MPS2,
    )
    return imucal.evaluate(calibration, recording).figures.gravity_direction_rms_deg


def xsens() -> imucal.Recording:
    """The Xsens recording in SI units by the nominal sensitivities, for programs that need them."""
    raw = imucal.read(XSENS / "xsens_acc.mat", XSENS / "xsens_gyro.mat", format="imu_tk")
    return imucal.Recording(
        raw.time_s,
        (np.asarray(raw.specific_force, dtype=float) - XSENS_ZERO) / XSENS_ACCEL,
        (np.asarray(raw.angular_rate, dtype=float) - XSENS_ZERO) / XSENS_GYRO,
    )


def speed(_: Path) -> str:
    recording = xsens()
    rows = [
        (
            "imucal, 21 x 21 covariance and checks",
            timed(lambda: by_imucal(recording, XSENS_GRAVITY_MPS2)),
            judged(by_imucal(recording, XSENS_GRAVITY_MPS2), recording),
        ),
        (
            "imu-calib 0.3.1 (Rust), without covariance",
            time_of_imu_calib(recording, XSENS_GRAVITY_MPS2),
            judged(imu_calib(recording, XSENS_GRAVITY_MPS2)[0], recording),
        ),
        (
            "SciPy program",
            timed(lambda: by_scipy(recording, XSENS_GRAVITY_MPS2)),
            judged(by_scipy(recording, XSENS_GRAVITY_MPS2), recording),
        ),
        ("imu_tk (C++), the whole process, on another occasion", IMU_TK_S, IMU_TK_DEG),
    ]
    lines = [
        paragraph(
            "Each program calibrates the recording of imu_tk: an Xsens MTi moved by hand, 38 rests in 512 s "
            "at 100 Hz. Each time is the processor time for computing the parameters from arrays in memory, "
            f"the median of {ROUNDS} rounds."
        ),
        "",
        "| program | ms | gravity direction per move, deg rms |",
        "|---|---:|---:|",
        *(
            f"| {name} | {milliseconds(seconds)} | {'-' if deg is None else f'{deg:.2f}'} |"
            for name, seconds, deg in rows
        ),
        "",
        paragraph(
            "The last column is the error of the gravity direction per move, on the calibration recording. "
            "This error is the angle between two directions at the rest after a move: the direction that "
            "the gyroscope predicts from the rest before, and the direction that the accelerometer measures. "
            "`imucal evaluate` computed this angle for every program except imu_tk. imu_tk needs Ceres and "
            "Qt and was not built for this table. Its row was measured earlier. This unit has a "
            "g-sensitivity that none of these models contains. [imucal gap](gap.md) finds this effect, and "
            "the error then falls to less than a third ([tutorial](tutorial-xsens.md))."
        ),
    ]
    return "\n".join(lines)


PARTS: Final = {"accuracy": accuracy, "speed": speed}


def main() -> None:
    """Write the parts that are named on the command line, or all."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        # Not the folder of the workspace, so that its build is not touched.
        os.environ["CARGO_TARGET_DIR"] = str(ROOT / "target" / "peers")
        subprocess.run(["cargo", "build", "--quiet", "--release"], cwd=PEER, check=True)
        for part in sys.argv[1:] or PARTS:
            if part == "speed" and not XSENS.is_dir():
                print(f"no speed: {XSENS} is missing")
                continue
            write_section(PAGE, "Comparison", part.capitalize(), PARTS[part](folder))


if __name__ == "__main__":
    main()
