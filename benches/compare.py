"""Computing time compared with SciPy programs of the same model: `make bench`, to docs/results/speed.md."""

import importlib.util
import os

# Set before NumPy is imported, because its linear algebra reads these variables at import.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import platform
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
import scipy
from ahrs.filters import AngularRate
from scipy.spatial.transform import Rotation

import imucal
import imucal._core as _core
import scipy_peer
from kernels import kernel_lines
from sections import machine_name, write_section

ROOT = Path(__file__).resolve().parent.parent
SHARED = ROOT.parent / "shared"
XSENS = SHARED / "data" / "xsens_mti"
# A second SciPy program for the same recording; it accepts raw counts only.
OTHERS = SHARED / "baseline" / "scipy_calibration.py"
REPORT = ROOT / "docs" / "results" / "speed.md"
ROUNDS = 9
# Samples for the loop in Python, whose time is extrapolated to all samples.
OF_AHRS = 5_000
# Smallest ratio of the time of the second SciPy program to that of imucal, in two stages and jointly.
AIMS = {"imucal": 200.0, "imucal, joint": 70.0}


@dataclass(frozen=True)
class Run:
    """A recording, and the inputs that only the SciPy program needs."""

    name: str
    recording: imucal.Recording
    gravity_mps2: float
    gyro_nominal: float


def a_run() -> Run:
    """The Xsens recording if it is available, otherwise a simulated run of the same length."""
    if XSENS.is_dir():
        recording = imucal.read(XSENS / "xsens_acc.mat", XSENS / "xsens_gyro.mat", format="imu_tk")
        return Run("the Xsens recording (512 s at 100 Hz, raw counts)", recording, 9.81744, 4770.0)
    program = imucal.Program.random(seed=1, moves=37, max_rate_dps=60.0, move_s=3.0, hold_s=10.5)
    recording = imucal.simulate(program, rate_hz=100.0, seed=1).recording
    return Run(
        f"a simulated run ({recording.duration_s:.0f} s at 100 Hz), for the Xsens files are not in {XSENS}",
        recording,
        9.80665,
        1.0,
    )


def medians_ms(functions: dict[str, Callable[[], object]], rounds: int = ROUNDS) -> dict[str, float]:
    """Median times over interleaved rounds, so that other load affects all functions equally."""
    times: dict[str, list[float]] = {name: [] for name in functions}
    for turn in range(rounds + 1):
        for name, function in functions.items():
            start = time.perf_counter()
            function()
            if turn > 0:  # the first round warms up
                times[name].append((time.perf_counter() - start) * 1e3)
    return {name: statistics.median(values) for name, values in times.items()}


def program_of_others() -> ModuleType | None:
    """The second SciPy program, if it is available."""
    spec = importlib.util.spec_from_file_location("scipy_calibration", OTHERS)
    if not OTHERS.is_file() or spec is None or spec.loader is None:
        return None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def calibration_lines(run: Run) -> list[str]:
    """Table of both fits of imucal and the SciPy programs."""
    recording, gravity = run.recording, run.gravity_mps2
    columns = recording.time_s, recording.specific_force, recording.angular_rate
    told = {"gravity_mps2": gravity, "gyro_nominal": run.gyro_nominal}
    ours = imucal.calibrate(recording, gravity_mps2=gravity, joint=False)
    rests = np.array([(rest.first, rest.end) for rest in ours.rests])
    own = scipy_peer.calibrate(*columns, **told)
    same = scipy_peer.calibrate(*columns, **told, rests=rests)

    functions: dict[str, Callable[[], object]] = {
        "imucal": lambda: imucal.calibrate(recording, gravity_mps2=gravity, joint=False),
        "imucal, joint": lambda: imucal.calibrate(recording, gravity_mps2=gravity),
        "scipy_peer": lambda: scipy_peer.calibrate(*columns, **told),
        "scipy_peer with rests given": lambda: scipy_peer.calibrate(*columns, **told, rests=rests),
    }
    others = program_of_others() if recording.accel_unit == "lsb" else None
    if others is not None:
        with_time = [np.column_stack([recording.time_s, triad]) for triad in columns[1:]]
        functions["scipy_calibration"] = lambda: others.calibrate(*with_time, use_means=True)
    ms = medians_ms(functions)
    times = {name: value / ms["imucal"] for name, value in ms.items()}
    std = np.array([parameter.std for parameter in ours.parameters])

    def farthest(peer: scipy_peer.PeerResult) -> str:
        entries = peer.accel_sensitivity[scipy_peer.ROWS, scipy_peer.COLUMNS]
        values = np.concatenate([peer.accel_bias, entries, peer.gyro_bias, peer.gyro_sensitivity.ravel()])
        return f"{np.max(np.abs(values - [p.value for p in ours.parameters]) / std):.2f}"

    programs = {
        "imucal": ("imucal, two stages: checks, rests, both fits, 21 x 21 covariance", len(rests), ""),
        "imucal, joint": ("imucal, jointly (the default): the same, and outliers", len(rests), ""),
        "scipy_peer": ("SciPy, scipy_peer.py: rests, both fits, σ", len(own.rests), farthest(own)),
        "scipy_peer with rests given": ("SciPy, scipy_peer.py: both fits, σ", len(rests), farthest(same)),
        "scipy_calibration": ("SciPy, scipy_calibration.py: rests, both fits", 38, ""),
    }
    rows = [
        f"| {what} | {ms[name]:.1f} | {times[name]:.1f} | {count} | {apart} |"
        for name, (what, count, apart) in programs.items()
        if name in ms
    ]
    slowest = "scipy_calibration" if others is not None else "scipy_peer"
    judged = [
        f"* {name}: 1/{ms[slowest] / ms[name]:.1f} of the time of {slowest}"
        + (
            f", the aim is 1/{aim:.0f}: {'met' if ms[slowest] >= aim * ms[name] else 'missed'}"
            if others
            else ""
        )
        for name, aim in AIMS.items()
    ]
    return [
        f"From arrays in memory to 21 parameters with standard deviations, on {run.name}.",
        "",
        "| | ms | times imucal, two stages | rests | farthest parameter from imucal's, σ |",
        "|---|---:|---:|---:|---:|",
        *rows,
        "",
        *judged,
    ]


def integration_lines() -> list[str]:
    """Table of the integration of one million samples to a rotation."""
    samples = 1_000_000
    time_s = np.arange(samples) * 1e-3
    rate = np.sin(np.outer(time_s, [1.3, 0.9, 2.1]) + np.arange(3.0)) * [1.0, 2.0, 1.5]

    def with_rotation() -> Rotation:
        step_s = np.diff(time_s)[:, None]
        before, after = rate[:-1], rate[1:]
        turn = step_s / 2 * (before + after) + step_s**2 / 12 * scipy_peer.cross(before, after)
        steps = Rotation.from_rotvec(turn)
        while len(steps) > 1:
            odd = steps[-1:] if len(steps) % 2 else None
            steps = steps[:-1:2] * steps[1::2]
            if odd is not None:
                steps = Rotation.concatenate([steps, odd])
        return steps

    def with_ahrs() -> np.ndarray:
        return AngularRate(gyr=rate[:OF_AHRS], frequency=1e3, method="closed").Q[-1]

    def with_sum() -> np.ndarray:
        return ((rate[:-1] + rate[1:]) * (np.diff(time_s) / 2)[:, None]).sum(axis=0)

    ms = medians_ms(
        {
            "imucal": lambda: _core.integrate(time_s, rate),
            "rotation": with_rotation,
            "sum": with_sum,
        }
    )
    ahrs_ms = medians_ms({"ahrs": with_ahrs}, rounds=1)["ahrs"] * samples / OF_AHRS
    w, x, y, z = _core.integrate(time_s, rate)
    apart = (with_rotation().inv() * Rotation.from_quat([x, y, z, w])).magnitude()[0]
    row = "| {} | {:.1f} | {:.1f} |".format
    return [
        "One million samples of angular rate to one rotation.",
        "",
        "| | ms | times imucal |",
        "|---|---:|---:|",
        row("imucal: streaming, fourth order", ms["imucal"], 1.0),
        row(
            "SciPy: the same steps, `Rotation` products in a tree",
            ms["rotation"],
            ms["rotation"] / ms["imucal"],
        ),
        row(
            f"ahrs: `AngularRate`, first order (taken from {OF_AHRS:,} samples)",
            ahrs_ms,
            ahrs_ms / ms["imucal"],
        ),
        row("NumPy: sum of the rates (no rotation, a lower bound)", ms["sum"], ms["sum"] / ms["imucal"]),
        "",
        f"The two rotations are {apart:.0e} rad apart.",
    ]


def machine() -> str:
    """Machine and versions of the measurement."""
    return (
        f"Written by `make bench`. {machine_name()}, one used. {platform.system()}, "
        f"Python {platform.python_version()}, NumPy {np.__version__}, SciPy {scipy.__version__}, "
        f"imucal {imucal.__version__}. Medians of {ROUNDS} interleaved rounds in one process."
    )


def main() -> None:
    # All programs are compared on one processor with one thread.
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    calibration = "\n".join(
        [
            machine(),
            "",
            *calibration_lines(a_run()),
            "",
            "[scipy_peer.py](../../benches/scipy_peer.py) is optimised as far as possible: it uses a",
            "product tree over all moves at once, an analytic Jacobian for the accelerometer, and a start",
            "value within 0.2 %, which imucal does not need. scipy_calibration.py, which is not in this",
            "repository, makes the same two fits with Runge-Kutta steps, nine trial thresholds for the",
            "rests, and a start value with an error of 30 %.",
        ]
    )
    write_section(REPORT, "Speed", "Calibration", calibration)
    write_section(REPORT, "Speed", "Integration", "\n".join(integration_lines()))
    write_section(REPORT, "Speed", "Kernels", "\n".join(kernel_lines(machine_name())))


if __name__ == "__main__":
    main()
