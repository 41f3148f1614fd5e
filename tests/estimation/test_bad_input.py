"""Bad input: a table of what is done to a good simulated recording, and what must come of it.

Refused: the named error with its reason code, exit code 1, no calibration file. Poor: finished, exit code 2.
Warned: the calibration is right and lists the code. A message says what, where, the number, and the way out.

`with_own_names` is called directly, because names of recordings show only in messages.
"""

import dataclasses
import errno
import functools
import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

import imucal
from changes import (
    MOVES,
    changed,
    force,
    noise,
    poses_within,
    program,
    put,
    rate,
    rows,
    stand_run,
    time,
    with_new_time,
    without,
)
from imucal import FormatError, InputError, NotEnoughMotionError, Program, Recording
from imucal.cli import main
from imucal.recording.one_unit import with_own_names

STANDARD_GRAVITY = 9.80665
UP = np.array([0, 0, 9.8])
COMMAND = Path(sys.executable).with_name("imucal")
CHECKS = Path(__file__).resolve().parents[2] / "rust" / "imucal" / "src" / "check"


# The good recording and what spoils it


def axis(number, factor):
    """One axis times a factor."""
    return lambda values: values * np.where(np.arange(3) == number, factor, 1.0)


def outer_join(r):
    """A row for each sample of each sensor, as a merge of two tables by their times has it."""
    even = np.arange(len(r))[:, None] % 2 == 0
    return changed(
        r,
        specific_force=np.where(even, r.specific_force, np.nan),
        angular_rate=np.where(even, np.nan, r.angular_rate),
    )


def counts(r, per_mps2=1000.0, per_radps=5000.0, offset=0.0, wrap=None):
    read = (lambda values: values) if wrap is None else (lambda values: values % wrap)
    return changed(
        r,
        specific_force=read(np.round(r.specific_force * per_mps2 + offset)),
        angular_rate=read(np.round(r.angular_rate * per_radps + offset)),
        accel_unit="lsb",
        gyro_unit="lsb",
    )


# The tables


@dataclass(frozen=True)
class Case:
    """What is done to the good recording (or recordings), and what must come of it."""

    change: Callable[[Recording], object]
    error: type[imucal.ImucalError] | None = InputError
    code: str | None = None
    words: str = ""
    options: Mapping[str, object] = field(default_factory=dict)


def refused(change, code, words="", **options):
    return Case(change, InputError, code, words, options)


def undetermined(change, words, **options):
    return Case(change, NotEnoughMotionError, None, words, options)


def same(r):
    return r


REFUSED = {
    # Too little
    "no sample": refused(rows(slice(0, 0)), "empty", "there is no sample"),
    "one row": refused(rows(slice(0, 1)), "too_short", "1 samples in 0.00 s"),
    "two rows": refused(rows(slice(0, 2)), "too_short", "200 samples"),
    "three seconds": refused(rows(slice(0, 300)), "too_short", "300 samples in 2.99 s"),
    # No numbers
    "all NaN": refused(
        lambda r: changed(r, specific_force=np.full((len(r), 3), np.nan)), "non_finite", "100.00 %"
    ),
    "one NaN": refused(
        force(put((100, 1), np.nan)), "non_finite", "accel_y have NaN or infinity in 1 samples"
    ),
    "one infinity": refused(rate(put((70, 2), np.inf)), "non_finite", "gyro_z"),
    "NaN in time": refused(time(put(50, np.nan)), "non_finite", "time_s"),
    "outer join": refused(
        outer_join, "non_finite", "in separate rows: 6100 .* different time stamps: first interp"
    ),
    "one masked": refused(
        lambda r: changed(
            r, angular_rate=np.ma.array(r.angular_rate, mask=put((9, 0), True)(np.zeros((len(r), 3), bool)))
        ),
        "non_finite",
        "gyro_x have NaN or infinity in 1 samples .* sample 9",
    ),
    # Time
    "time reversed": refused(time(lambda t: t[::-1]), "time_not_increasing", "goes back 12199 times"),
    "counter overflow": refused(time(lambda t: t % 65.536), "time_not_increasing", "unwrap the counter"),
    "a tenth of stamps equal": refused(
        time(lambda t: np.floor(t * 90) / 90), "samples_duplicated", "finer resolution"
    ),
    "float32 epoch": refused(
        lambda r: changed(r, time_s=(r.time_s + 1.7e9).astype(np.float32)), "samples_duplicated", "time stamp"
    ),
    "clock on arrival": refused(
        time(lambda t: np.sort(noise(0.006)(t))), "clock_irregular", "the sensor's own clock"
    ),
    "time stamps of packets": refused(
        time(lambda t: np.arange(len(t)) // 16 * 0.16 + np.arange(len(t)) % 16 * 1e-4),
        "clock_irregular",
        "bursts of 16 samples: 0.100 ms .* (rate_hz=|--rate-hz )100",
    ),
    "milliseconds as seconds": refused(time(lambda t: t * 1e3), "clock_rate", "time_ms"),
    "seconds as nanoseconds": refused(
        time(lambda t: t * 1e-9), "clock_rate", "name it time_s|after its unit"
    ),
    "ten hours at 2 Hz": refused(
        lambda _: changed(stand_run().recording, **at_2_hz()), "clock_rate", "record at 5 Hz or more"
    ),
    "half the sample rate": refused(time(lambda t: t * 2), "gyro_units", "the sample rate"),
    "wrong sample rate": refused(time(lambda t: t * 1.5), "gyro_units", "the sample rate"),
    "samples written twice, time made anew": refused(
        with_new_time(
            rows(
                lambda n: np.sort(
                    np.r_[np.arange(n), np.random.default_rng(0).choice(n, n // 5, replace=False)]
                )
            )
        ),
        "samples_duplicated",
        "they are additional rows.*drop the repeated rows",
    ),
    "single samples lost, time made anew": refused(
        with_new_time(rows(lambda n: np.setdiff1d(np.arange(n), np.arange(70, n, 101)))),
        "samples_missing",
        "jumps by two time steps",
    ),
    # Range
    "gyroscope cut off": refused(
        rate(lambda w: np.clip(w, -2, 2)), "gyro_saturation", "extreme value 2.00000 rad/s"
    ),
    "accelerometer cut off": refused(
        lambda r: counts(force(lambda f: np.clip(f, -8, 8))(r), per_mps2=32767 / 8),
        "accel_saturation",
        "32767 lsb",
    ),
    "negative counts read as unsigned": refused(
        lambda r: counts(r, wrap=65536),
        "counts_unsigned",
        "jump between the ends of the range 0 to 65535 .* subtract 65536 from values above 32767",
    ),
    "negative counts read as unsigned, saturation left out": refused(
        lambda r: counts(r, wrap=65536),
        "counts_unsigned",
        "subtract 65536",
        exclude_saturated=True,
    ),
    # Dead axes
    "gyroscope dead": refused(
        rate(np.zeros_like), "stuck_axis", "gyro_x is constant at 0 rad/s for 12200 samples"
    ),
    "gyroscope constant": refused(rate(lambda w: 0 * w + 0.01), "stuck_axis", "gyro_x is constant at 0.01"),
    "gyro_y dead": refused(rate(axis(1, 0)), "stuck_axis", "gyro_y is constant at 0 rad/s"),
    "accel_z dead": refused(force(axis(2, 0)), "stuck_axis", "accel_z is constant at"),
    "accelerometer constant": refused(
        force(lambda f: np.zeros_like(f) + UP), "stuck_axis", "accel_z is constant at 9.8"
    ),
    # Units
    "accelerometer in g": refused(force(lambda f: f / STANDARD_GRAVITY), "accel_units", "looks like g: name"),
    "accelerometer in cm/s^2": refused(force(lambda f: f * 100), "accel_units", "cm/s\\^2"),
    "accelerometer in mg": refused(
        force(lambda f: f * 1000 / STANDARD_GRAVITY), "accel_units", "looks like mg"
    ),
    "accelerometer in counts": refused(force(lambda f: f * 400), "accel_units", "accel_x_lsb"),
    "gravity removed": refused(force(lambda f: f * 0.01), "accel_units", "gravity removed"),
    "triads swapped": refused(
        lambda r: changed(r, specific_force=r.angular_rate, angular_rate=r.specific_force),
        "accel_units",
        "swapped",
    ),
    "accel_x in g": refused(
        force(axis(0, 1 / STANDARD_GRAVITY)), "accel_units", "accel_x has the gain 0.1000"
    ),
    "accel_y half as large again": refused(force(axis(1, 1.5)), "accel_units", "accel_y has the gain 1.4"),
    "gyroscope in deg/s": refused(rate(np.degrees), "gyro_units", "deg/s"),
    "gyroscope in mrad/s": refused(rate(lambda w: w * 1000), "gyro_units", "of any MEMS gyroscope"),
    "gyroscope converted twice": refused(rate(np.radians), "gyro_units", "a second time"),
    "gyro_x converted twice": refused(rate(axis(0, 1 / 57.3)), "gyro_units", "gyro_x has the gain 0.017"),
    "gyro_z doubled": refused(rate(axis(2, 2)), "gyro_units", "gyro_z has the gain 2.0"),
    "gyroscope bias of 100 deg/s": refused(
        rate(lambda w: w + np.array([0, 0, 1.7])), "gyro_units", "at rest"
    ),
    "gyro_x and accel_x swapped": refused(
        lambda r: changed(
            r,
            specific_force=np.column_stack([r.angular_rate[:, 0], r.specific_force[:, 1:]]),
            angular_rate=np.column_stack([r.specific_force[:, 0], r.angular_rate[:, 1:]]),
        ),
        "gyro_units",
        "at rest",
    ),
    "temperature in kelvin": refused(
        lambda r: changed(r, temperature_degc=298.15 + 0.1 * np.sin(r.time_s)),
        "temperature_implausible",
        "12200 samples are outside -60 to 150 degC.* name the column temp_k",
    ),
    # Signs and order of axes
    "gravity reversed on a stand": refused(
        lambda r: changed(r, specific_force=-r.specific_force, stand_rad=r.stand_rad),
        "gravity_sign",
        "motors at zero",
    ),
    "gyro_y reversed": refused(
        rate(axis(1, -1)), "left_handed_axes", "gyro_y is reversed: pass (--)?axes(=.| )gyro=x,-y,z"
    ),
    "gyroscope reversed": refused(
        rate(lambda w: -w), "left_handed_axes", "two causes fit.*is reversed.*both sensors are mirrored"
    ),
    "accel_x reversed": refused(
        force(axis(0, -1)), "left_handed_axes", "accel_x is reversed: pass (--)?axes(=.| )accel=-x,y,z"
    ),
    "gyro_x and gyro_y exchanged": refused(
        rate(lambda w: w[:, [1, 0, 2]]), "left_handed_axes", "gyro_x and gyro_y are exchanged"
    ),
    "accel_y and accel_z exchanged": refused(
        force(lambda f: f[:, [0, 2, 1]]), "left_handed_axes", "accel_y and accel_z are exchanged"
    ),
    "samples in reverse order": refused(
        lambda r: changed(r, specific_force=r.specific_force[::-1], angular_rate=r.angular_rate[::-1]),
        "left_handed_axes",
        "sign of the gyroscope is reversed",
    ),
    "gyroscope of another motion": refused(
        lambda r: changed(r, angular_rate=stand_run(5).recording.angular_rate[: len(r)]),
        "left_handed_axes|gyro_units",
    ),
    # Several recordings
    "ten identical recordings": refused(
        lambda r: [r] * 10, "recordings_overlap", "give every recording once"
    ),
    "a part given again": refused(
        lambda r: [r, rows(slice(3000, 9000))(r)], "recordings_overlap", "from sample 3000"
    ),
    "the same with every sample held": refused(
        lambda r: [r, rows(lambda n: np.arange(n).repeat(2))(r)], "recordings_overlap", "from sample 0"
    ),
    "one in counts": refused(lambda r: [r, counts(r)], None, "need the same raw units"),
    "no recording": refused(lambda r: [], None, "give at least one|Missing argument"),
    # Motion that does not determine the parameters
    "no moves": undetermined(program(((0.0, 0.0, 0.0), 1.0, 60.0)), "1 rests do not determine .* bias x"),
    "no rests": undetermined(
        lambda _: (
            imucal.simulate(Program.random(seed=1, moves=30, hold_s=0.0), rate_hz=100, seed=1).recording
        ),
        "rest",
    ),
    "short rests": undetermined(
        lambda _: (
            imucal.simulate(Program.random(seed=1, moves=30, hold_s=0.3), rate_hz=100, seed=1).recording
        ),
        "pass (a shorter )?(min_rest_s|--min-rest-s)",
    ),
    "longer rests asked for": undetermined(same, "no rest of 10 s or more", min_rest_s=10),
    "one orientation": undetermined(
        program(*[((0.0, 0.0, 20.0), 1.0, 2.0)] * 18), "no rest with x within 40 deg of vertical"
    ),
    "all rests alike, whole turns between": undetermined(
        program(*[((360.0, 0.0, 0.0), 3.0, 2.0), ((0.0, 360.0, 0.0), 3.0, 2.0)] * 9), "add rests with x up"
    ),
    "all rests alike, in counts": undetermined(
        lambda r: counts(program(*[((360.0, 0.0, 0.0), 3.0, 2.0), ((0.0, 360.0, 0.0), 3.0, 2.0)] * 9)(r)),
        "at least 9 different poses",
    ),
    "rests within 10 deg": undetermined(poses_within(10.0), "no rest with y within 40 deg of vertical"),
    "two faces": undetermined(
        program(*[((0.0, 180.0, 90.0), 2.0, 2.0), ((0.0, -180.0, 90.0), 2.0, 2.0)] * 10),
        "x up and with x down",
    ),
    "six faces with few turns": undetermined(
        program(
            ((0.0, 0.0, 0.0), 1.0, 2.0),
            *[((90.0, 0.0, 0.0), 2.0, 2.0)] * 3,
            ((90.0, 90.0, 0.0), 2.0, 2.0),
            ((0.0, 180.0, 0.0), 2.0, 2.0),
        ),
        "rests with edges and corners up",
    ),
    "moves about one axis": undetermined(
        program(*[((0.0, 40.0, 0.0), 1.0, 2.0)] * 18),
        "hardly any rotation about body|no rest with y within 40",
    ),
    "nothing but noise": undetermined(
        lambda r: changed(
            r,
            specific_force=noise(0.01)(np.zeros((len(r), 3)) + UP),
            angular_rate=noise(0.003)(np.zeros((len(r), 3))),
        ),
        "do not determine",
    ),
    "gyroscope noise only": undetermined(
        rate(lambda w: noise(0.003)(0 * w)), "30 moves do not determine .* no more than noise"
    ),
    "a gap in every move": undetermined(
        rows(without(*MOVES)), "0 of 30 moves are usable .* 30 for gaps in time"
    ),
    "all moves saturated": undetermined(
        rate(lambda w: np.clip(w, -0.4, 0.4)),
        "moves are usable .* for saturated samples",
        exclude_saturated=True,
    ),
    "all rests saturated": undetermined(
        lambda r: changed(
            counts(r), angular_rate=put((slice(100, None, 50), 0), 32767)(counts(r).angular_rate.copy())
        ),
        "0 of 31 rests are usable; left out: 31 for saturated samples",
        exclude_saturated=True,
    ),
    # Options
    "gravity in g": refused(same, None, "(gravity_mps2|--gravity) = 1: on Earth", gravity_mps2=1.0),
    "gravity a tenth too large": refused(same, None, "(mps2|--gravity) = 10.8: on Earth", gravity_mps2=10.8),
    "gravity NaN": refused(same, None, "(gravity_mps2|--gravity) = NaN", gravity_mps2=float("nan")),
    "min_rest_s negative": refused(same, None, "(min_rest_s|--min-rest-s) = -1", min_rest_s=-1.0),
    "min_rest_s NaN": refused(same, None, "(min_rest_s|--min-rest-s) = NaN", min_rest_s=float("nan")),
    "accel_nominal NaN": refused(same, None, "accel.nominal = NaN", accel_nominal=float("nan")),
    "gyro_nominal negative": refused(same, None, "(gyro_nominal|--gyro-nominal) = -131", gyro_nominal=-131.0),
    "one fold": refused(same, None, "folds is 1", folds=1),
    "minus one fold": refused(same, None, "folds is -1", folds=-1),
    "unknown frame": refused(same, None, "frame is 'ned'", frame="ned"),
    # Numbers at the end of the range
    "one huge rate": refused(
        rate(put((3000, 0), 1e300)),
        "value_impossible",
        r"1 sample is above 1e4 rad/s.* 1.000e300 in gyro_x, sample 3000, at 30.00 s .*leave out these rows",
    ),
    "huge counts": refused(
        lambda r: changed(r, specific_force=r.specific_force * 1e150, accel_unit="lsb"),
        "value_impossible",
        "12200 samples are above 2e9 lsb.* in accel_x, sample 0.* give the unit of accel",
    ),
    "tiny counts": undetermined(
        lambda r: changed(r, specific_force=r.specific_force * 1e-150, accel_unit="lsb"), "9 different poses"
    ),
    "huge values": refused(
        force(lambda f: f * 1e30),
        "value_impossible",
        r"12200 samples are above 1e5 m/s\^2.* in accel_x, sample 0.* give the unit of accel",
    ),
    "tiny values": refused(force(lambda f: f * 1e-300), "accel_units", "gravity removed"),
}


def at_2_hz():
    n = 72_000
    values = np.random.default_rng(0).normal(size=(n, 3))
    return {"time_s": np.arange(n) / 2, "specific_force": values + UP, "angular_rate": values * 0.01}


POOR = {
    "samples lost, time made anew": with_new_time(rows(without(*((a + 45, a + 55) for a, _ in MOVES)))),
    "gyroscope cut off before its filter": rate(
        lambda w: noise(0.003)(np.clip(w, -3, 3) * [1.01, 0.98, 1.02])
    ),
    "accelerometer cut off before its filter": force(lambda f: noise(0.01)(np.clip(f, -9.5, 9.5))),
    "accelerometer that warms up": force(lambda f: f * np.linspace(1, 1.02, len(f))[:, None]),
}

WARNED = {
    "a few rows twice": (
        rows(lambda n: np.sort(np.r_[np.arange(n), np.arange(50, n, 300)])),
        "samples_duplicated",
    ),
    "held samples": (
        lambda r: changed(
            r,
            **{
                name: np.repeat(getattr(r, name)[::2], 2, axis=0)
                for name in ("specific_force", "angular_rate")
            },
        ),
        "samples_duplicated",
    ),
    "single samples lost": (
        rows(lambda n: np.setdiff1d(np.arange(n), np.arange(70, n, 101))),
        "samples_missing",
    ),
    "gaps in half of the moves": (rows(without(*MOVES[::2])), "samples_missing"),
    "gap in a rest": (rows(without((450, 480))), "samples_missing"),
    "jitter of the clock": (time(lambda t: np.sort(noise(0.002)(t))), "clock_irregular"),
    "temperature jump": (
        lambda r: changed(r, temperature_degc=np.where(np.arange(len(r)) == 5000, -40.0, 25.0)),
        "temperature_jump",
    ),
    "NaN in the stand": (
        lambda r: changed(r, stand_rad=put((7, 0), np.nan)(r.stand_rad.copy())),
        "non_finite",
    ),
}

# What only arrays can be: the numbers are those of the good recording.
ARRAYS = {
    "Fortran order": (np.asfortranarray, 0),
    "strided": (lambda a: np.repeat(a, 2, axis=0)[::2], 0),
    "reversed view": (lambda a: a[::-1].copy()[::-1], 0),
    "columns of a wider array": (lambda a: np.hstack([a, a])[:, :3] if a.ndim == 2 else a, 0),
    "transposed": (lambda a: a.T.copy().T, 0),
    "big endian": (lambda a: a.astype(">f8"), 0),
    "masked without a mask": (np.ma.array, 0),
    "lists": (lambda a: a.tolist(), 0),
    "float32": (lambda a: a.astype(np.float32) if a.ndim == 2 else a, 1e-6),
    "longdouble": (lambda a: a.astype(np.longdouble), 0),
}

BAD_ARRAYS = {
    "(3, N)": (np.zeros((3, 500)), "its transpose"),
    "(N, 4)": (np.zeros((500, 4)), r"the shape \(500, 4\)"),
    "(N,)": (np.zeros(500), r"the shape \(500,\)"),
    "another length": (np.zeros((499, 3)), "499 rows but 500"),
    "empty": ([], "0 rows but 500"),
    "complex": (np.zeros((500, 3), complex), "complex128"),
    "text": ([["a", "b", "c"]] * 500, "real numbers"),
    "ragged": ([[1, 2, 3], [4, 5]] * 250, "cannot be made an array"),
    "objects": (np.full((500, 3), None), "real numbers"),
}

# The motion or the sign shows these, but the result is right for what the numbers say.
ELSEWHERE = {
    # A calibrated result needs other truth: test_turned_gyroscope_is_calibrated_as_it_is_mounted.
    "axes_turned",
    # So does one axis in counts of its own: test_an_axis_in_other_counts_than_the_others_is_said.
    "gains_differ",
    # A Recording has columns of one length: BAD_ARRAYS.
    "lengths_differ",
    # One sensor alone: tests/estimation/test_accelerometer_alone.py.
    "sensor_missing",
    # Noise and bias of a sensor at rest: tests/noise/test_noise.py and tests/advice/test_analyses.py.
    "noise_implausible",
    "bias_implausible",
    # A gain that three axes of a good factory calibration share: tests/estimation/test_references.py.
    "gyro_common_gain",
}


# Recordings


def text_of(error):
    """The message, which has a way out and nothing of the machine."""
    message = str(error)
    assert ": " in message or "give" in message, message
    assert "Some(" not in message and "Traceback" not in message, message
    return message


def command_line(options):
    names = {"gravity_mps2": "gravity"}
    line = []
    for name, value in options.items():
        flag = "--" + names.get(name, name).replace("_", "-")
        line += [flag] if value is True else [f"{flag}={value}"]
    return line


def written(recordings, folder):
    recordings = recordings if isinstance(recordings, list) else [recordings]
    paths = [folder / f"{number}.parquet" for number in range(len(recordings))]
    for recording, path in zip(recordings, paths, strict=True):
        imucal.write(recording, path)
    return [str(path) for path in paths]


@pytest.mark.parametrize("name", REFUSED)
def test_refused(name, tmp_path, capsys):
    case = REFUSED[name]
    recordings = case.change(stand_run().recording)
    with pytest.raises(case.error, match=re.compile(case.words, re.DOTALL)) as caught:
        imucal.calibrate(recordings, **case.options)
    assert type(caught.value) is case.error
    if case.words != "give at least one|Missing argument":
        text_of(caught.value)
    findings = getattr(caught.value, "findings", [])
    if case.code is not None:
        assert any(re.fullmatch(case.code, finding.code) for finding in findings), findings
    for finding in findings:
        assert finding.severity == "error"
        assert len(finding.way_out) > 10
        assert finding.code == "empty" or re.search(r"\d", finding.message)
        assert f"[{finding.code}]" in str(caught.value)

    output = tmp_path / "cal.json"
    before = [*written(recordings, tmp_path)]
    assert main(["calibrate", *before, "-o", str(output), *command_line(case.options)]) == 1
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.startswith("imucal: ")
    assert "Traceback" not in shown.err
    assert re.search(case.words, shown.err, re.DOTALL)
    assert all(f"[{finding.code}]" in shown.err for finding in findings)
    assert sorted(map(str, tmp_path.iterdir())) == before


@pytest.mark.parametrize("name", [name for name, case in REFUSED.items() if case.code and not case.options])
def test_inspect_shows_what_is_refused(name, tmp_path, capsys):
    recordings = REFUSED[name].change(stand_run().recording)
    paths = written(recordings, tmp_path)
    code = main(["inspect", *paths, "--json", str(tmp_path / "seen.json")])
    seen = json.loads((tmp_path / "seen.json").read_text())["recordings"]
    assert code in (0, 2)
    assert (code == 0) == all(item["usable"] and item["missing"] is None for item in seen)
    # What the columns and rests show is a finding; what only the fit shows is said to be missing.
    shown = capsys.readouterr().out
    assert REFUSED[name].code == "recordings_overlap" or re.search(rf"\[({REFUSED[name].code})\]", shown)


def test_apply_refuses_counts_that_lost_their_sign(tmp_path, capsys):
    recording = stand_run().recording
    unit = imucal.calibrate(counts(recording)).calibration
    assert np.isfinite(unit.apply_recording(counts(recording)).angular_rate).all()
    said = "counts_unsigned.* subtract 65536 from values above 32767"
    with pytest.raises(InputError, match=re.compile(said, re.DOTALL)):
        unit.apply_recording(counts(recording, wrap=65536))
    unit.save(tmp_path / "cal.json")
    [run] = written(counts(recording, wrap=65536), tmp_path)
    assert main(["apply", str(tmp_path / "cal.json"), run, "-o", str(tmp_path / "out.csv")]) == 1
    assert re.search(said, capsys.readouterr().err, re.DOTALL)
    assert not (tmp_path / "out.csv").exists()


@pytest.mark.parametrize(
    ("serial_number", "said"),
    [(42, "give text, '42'"), ("", "is empty"), (" ", "is empty"), ("a\nb", "can be printed")],
)
def test_what_is_no_serial_number_is_refused(serial_number, said, tmp_path, capsys):
    recording = stand_run().recording
    with pytest.raises(InputError, match=said):
        imucal.calibrate(recording, serial_number=serial_number)
    with pytest.raises(InputError, match=said):
        dataclasses.replace(stand_run().truth.calibration, serial_number=serial_number)
    if isinstance(serial_number, str):
        [run] = written(recording, tmp_path)
        assert main(["calibrate", run, "--serial-number", serial_number]) == 1
        assert said in capsys.readouterr().err


def test_a_control_recording_counts_once(tmp_path, capsys):
    run, control = stand_run().recording, stand_run(seed=2).recording
    said = "the control recordings .* have the same .* samples: give every recording once"
    with pytest.raises(InputError, match=said):
        imucal.calibrate(run, control=[control, control])
    unit = imucal.calibrate(run).calibration
    with pytest.raises(InputError, match=said):
        imucal.evaluate(unit, [control, changed(control, name="copy")])


@pytest.mark.parametrize("share", [0.3, 0.45])
def test_a_bias_that_jumps_is_no_good_verdict(share):
    recording = stand_run().recording
    jump = np.zeros((len(recording), 3))
    jump[int((1 - share) * len(recording)) :, 0] = 0.02
    result = imucal.calibrate(changed(recording, angular_rate=recording.angular_rate + jump))
    assert result.verdict == "poor"
    assert "rests are left out because their mean rates are far from those of the others" in result.reasons[0]


@pytest.mark.parametrize("rows", [50, None])
def test_old_line_ends_are_read(rows, tmp_path):
    imucal.write(stand_run().recording, tmp_path / "run.csv")
    lines = (tmp_path / "run.csv").read_bytes().splitlines()[:rows]
    (tmp_path / "old.csv").write_bytes(b"\r".join([*lines, b""]))
    (tmp_path / "new.csv").write_bytes(b"\n".join([*lines, b""]))
    old, new = (imucal.read(tmp_path / name) for name in ("old.csv", "new.csv"))
    np.testing.assert_array_equal(old.angular_rate, new.angular_rate)
    whole = list(imucal.io.read_pieces(tmp_path / "old.csv"))
    assert sum(map(len, whole)) == len(new)


@pytest.mark.parametrize("name", POOR)
def test_poor(name, tmp_path, capsys):
    recordings = POOR[name](stand_run().recording)
    result = imucal.calibrate(recordings)
    assert result.verdict == "poor"
    assert "times what noise explains" in result.reasons[0] or "contradict the others" in result.reasons[0]
    paths = written(recordings, tmp_path)
    assert main(["calibrate", *paths, "-o", str(tmp_path / "cal.json")]) == 2
    assert f"verdict: poor; {result.reasons[0]}" in capsys.readouterr().out


def errors_in_sigmas(result, truth):
    values = {parameter.name: parameter.value for parameter in truth.parameters}
    return {p.name: (p.value - values[p.name]) / p.std for p in result.parameters}


@pytest.mark.parametrize("name", WARNED)
def test_warned_and_right(name, tmp_path, capsys):
    change, code = WARNED[name]
    recording = change(stand_run().recording)
    result = imucal.calibrate(recording)
    assert result.verdict == "good"
    assert [finding.code for finding in result.findings if finding.severity == "warning"].count(code) == 1
    errors = errors_in_sigmas(result, stand_run().truth.calibration)
    assert max(map(abs, errors.values())) < 5, errors
    assert main(["calibrate", *written(recording, tmp_path), "-o", str(tmp_path / "cal.json")]) == 0
    assert f"[{code}]" in capsys.readouterr().out
    assert (tmp_path / "cal.json").exists()


def test_moves_that_the_jitter_of_the_clock_spoils_are_no_good_verdict(tmp_path, capsys):
    recording = time(lambda t: np.sort(noise(0.0025)(t)))(stand_run().recording)
    result = imucal.calibrate(recording)
    assert result.verdict == "incomplete"
    assert "gravity direction after the moves" in result.reasons[0]
    assert "clock_irregular" in [finding.code for finding in result.findings]
    main(["calibrate", *written(recording, tmp_path), "-o", str(tmp_path / "cal.json")])
    shown = capsys.readouterr().out
    assert "verdict: incomplete" in shown
    assert "[clock_irregular]" in shown


def test_turned_gyroscope_is_calibrated_as_it_is_mounted():
    turn = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    run = stand_run()
    result = imucal.calibrate(rate(lambda w: w @ turn.T)(run.recording))
    assert [finding.code for finding in result.findings] == ["axes_turned"]
    assert result.verdict == "good"
    expected = turn @ run.truth.calibration.gyroscope.sensitivity
    np.testing.assert_allclose(result.calibration.gyroscope.sensitivity, expected, atol=2e-3)


def test_reversed_gravity_without_a_stand_is_said():
    result = imucal.calibrate(force(lambda f: -f)(stand_run().recording))
    assert [(f.code, f.severity) for f in result.findings] == [("gravity_sign", "warning")]


def test_an_axis_in_other_counts_than_the_others_is_said():
    in_counts = counts(stand_run().recording)
    assert not imucal.calibrate(in_counts).findings
    result = imucal.calibrate(rate(axis(1, 0.5))(in_counts))
    assert [(f.code, f.severity, f.columns) for f in result.findings] == [
        ("gains_differ", "warning", ("gyro_y",))
    ]


def test_every_code_has_a_case():
    """A code in the checks that no table expects fails here."""
    source = "".join(
        path.read_text().split("#[cfg(test)]\nmod tests")[0]
        for path in [*CHECKS.glob("*.rs"), CHECKS.with_suffix(".rs")]
    )
    used = set(re.findall(r'\(\s*"([a-z_]+)",\s*(?:recording|ACCEL|GYRO)\b', source))
    used |= set(re.findall(r'[( ]"([a-z]+_units)"', source))
    documented = {
        code
        for text in re.findall(r"Codes?: (.*?)\.\n", source, re.DOTALL)
        for code in re.findall(r"`([a-z_]+)`", text)
    }
    assert documented <= used
    assert len(used) >= 19
    expected = {code for case in REFUSED.values() for code in (case.code or "").split("|")}
    expected |= {code for _, code in WARNED.values()} | ELSEWHERE
    assert used <= expected
    assert expected - {""} <= used


# Arrays


@functools.cache
def good_result():
    return imucal.calibrate(changed(stand_run().recording))


@pytest.mark.parametrize("name", ARRAYS)
def test_arrays_of_any_layout_give_the_same_calibration(name):
    change, tolerance = ARRAYS[name]
    good = stand_run().recording
    recording = Recording(*(change(getattr(good, c)) for c in ("time_s", "specific_force", "angular_rate")))
    result, expected = imucal.calibrate(recording), good_result()
    for found, wanted in zip(result.parameters, expected.parameters, strict=True):
        if tolerance == 0:
            assert (found.value, found.std) == (wanted.value, wanted.std)
        else:
            assert found.value == pytest.approx(wanted.value, abs=tolerance)
            assert found.std == pytest.approx(wanted.std, rel=1e-3)
    rate_in, force_in = change(good.angular_rate), change(good.specific_force)
    for found, wanted in zip(
        result.calibration.apply(rate_in, force_in),
        expected.calibration.apply(good.angular_rate, good.specific_force),
        strict=True,
    ):
        np.testing.assert_allclose(found, wanted, rtol=0, atol=100 * tolerance)


@pytest.mark.parametrize("name", BAD_ARRAYS)
def test_bad_arrays(name):
    values, words = BAD_ARRAYS[name]
    good = np.zeros((500, 3))
    for columns in ((values, good), (good, values)):
        with pytest.raises(InputError, match=words) as caught:
            Recording(np.arange(500), *columns, name="run")
        assert "run: " in str(caught.value)
    calibration = good_result().calibration
    if name != "empty":
        with pytest.raises(InputError, match=words.replace("but 500", "but")):
            calibration.apply(good, values)


# Files


@functools.cache
def folder():
    """Good files, and bad ones made of them."""
    place = Path(tempfile.mkdtemp(prefix="imucal-"))
    good, control = changed(stand_run().recording), stand_run(2).recording
    imucal.write(good, place / "good.parquet")
    imucal.write(good, place / "good.csv")
    imucal.write(control, place / "control.parquet")
    imucal.write(counts(good), place / "counts.parquet")
    imucal.write(changed(control, angular_rate=0 * control.angular_rate + 0.01), place / "dead.parquet")
    hasty = Program.random(seed=2, moves=30, hold_s=0.5)
    imucal.write(imucal.simulate(hasty, rate_hz=100, seed=2).recording, place / "no-rest.parquet")
    imucal.write(program(((0.0, 0.0, 0.0), 1.0, 60.0))(None), place / "still.parquet")
    calibration = good_result().calibration
    calibration.save(place / "cal.json")
    document = json.loads((place / "cal.json").read_text())

    lines = (place / "good.csv").read_text().splitlines()
    header, cells = lines[0], lines[50].split(",")
    text = {
        "nothing.csv": "",
        "header.csv": header + "\n",
        "missing.csv": "\n".join(line.rpartition(",")[0] for line in lines),
        "mixed.csv": "\n".join([header.replace("accel_x_mps2", "accel_x_g"), *lines[1:]]),
        "twice.csv": "\n".join([header.replace("accel_y", "accel_x"), *lines[1:]]),
        "text.csv": "\n".join([*lines[:50], ",".join([*cells[:2], "full", *cells[3:]]), *lines[51:]]),
        "gap.csv": "\n".join([*lines[:50], ",".join([*cells[:2], "", *cells[3:]]), *lines[51:]]),
        "ragged.csv": "\n".join([*lines[:50], lines[50] + ",7", *lines[51:]]),
        "cut.csv": "\n".join(lines).rpartition(",")[0],
        "comma.csv": "\n".join(line.replace(".", ",") for line in lines),
        "page.csv": "<!doctype html>\n<html><body>404</body></html>\n",
        "text.parquet": "hello",
        "text.json": "time_s,accel_x",
        "cut.json": (place / "cal.json").read_text()[:500],
        "null.json": "null",
        "nan.json": json.dumps({**document, "gravity_mps2": float("nan")}),
        "schema.json": json.dumps({**document, "schema": "imucal.calibration/9"}),
        "shape.json": json.dumps(
            {**document, "accelerometer": {**document["accelerometer"], "T": [[1, 0, 0]]}}
        ),
        "unit.json": json.dumps({**document, "raw_units": {"accelerometer": "lsb", "gyroscope": "lsb"}}),
        "singular.json": json.dumps(
            {**document, "accelerometer": {**document["accelerometer"], "T": [[0] * 3] * 3}}
        ),
        "gravity.json": json.dumps({**document, "gravity_mps2": 9.75}),
    }
    for name, content in text.items():
        (place / name).write_text(content)
    (place / "binary.csv").write_bytes(np.random.default_rng(0).bytes(3000))
    (place / "utf16.csv").write_bytes("\n".join(lines).encode("utf-16"))
    (place / "cut.parquet").write_bytes((place / "good.parquet").read_bytes()[:9000])
    (place / "garbled.parquet").write_bytes(b"PAR1" + np.random.default_rng(0).bytes(500) + b"PAR1")
    (place / "folder.csv").mkdir()
    return place


# Command line, the words of the message, and the class that the same call raises in Python.
BAD_FILES = {
    "no such file": ("calibrate none.csv", "none.csv: there is no such file", InputError),
    "a folder": ("calibrate folder.csv", "folder.csv is a folder", InputError),
    "an empty file": ("calibrate nothing.csv", r"nothing.csv is empty \(0 bytes\)", FormatError),
    "a header alone": ("calibrate header.csv", r"header.csv: there is no sample \[empty\]", None),
    "a column missing": (
        "calibrate missing.csv",
        r"missing.csv: the column gyro_z_\* is missing",
        FormatError,
    ),
    "mixed units": ("calibrate mixed.csv", "the units of accel_x_g, accel_y_mps2, .* are mixed", FormatError),
    "a column twice": ("calibrate twice.csv", "the column accel_x_mps2 is given twice", FormatError),
    "an empty cell": ("calibrate gap.csv", r"accel_y have NaN .* sample 49 \[non_finite\]", None),
    "decimal commas": ("calibrate comma.csv", "line 2 has 14 values, 7 are needed", FormatError),
    "a web page": ("calibrate page.csv", "page.csv: the format could not be determined", FormatError),
    "a binary file": ("calibrate binary.csv", "binary.csv is a binary file", FormatError),
    "a cut Parquet": ("calibrate cut.parquet", "cut.parquet is a damaged or truncated Parquet", FormatError),
    "a garbled Parquet": ("calibrate garbled.parquet", "garbled.parquet is a damaged", FormatError),
    "text named Parquet": ("calibrate text.parquet", "text.parquet is not a Parquet file", FormatError),
    "the same file twice": ("calibrate good.csv good.parquet", "[recordings_overlap]", None),
    "units of two kinds": ("calibrate good.parquet counts.parquet", "need the same raw units", None),
    "control of the same data": ("calibrate good.csv --control good.parquet", "give another recording", None),
    "control without rests": ("calibrate good.csv --control no-rest.parquet", "no rest of 1 s or more", None),
    "control with a dead gyroscope": ("calibrate good.csv --control dead.parquet", "[stuck_axis]", None),
    "control in counts": ("calibrate good.csv --control counts.parquet", "calibration expects m/s", None),
    "unknown format": ("calibrate good.csv --format xml", "unknown format 'xml'", None),
    "a time column and a rate": ("calibrate good.csv --rate-hz 100", "there is a time column time_s", None),
    "text for a number": ("calibrate good.csv --gravity earth", "'--gravity'", None),
    "evaluate: not JSON": (
        "evaluate text.json good.csv",
        "text.json is not JSON: line 1, column 1",
        FormatError,
    ),
    "evaluate: cut JSON": ("evaluate cut.json good.csv", "cut.json is not JSON: line", FormatError),
    "evaluate: null": ("evaluate null.json good.csv", "has no schema", FormatError),
    "evaluate: NaN": ("evaluate nan.json good.csv", "NaN is no JSON number", FormatError),
    "evaluate: another schema": (
        "evaluate schema.json good.csv",
        "has the schema 'imucal.calibration/9'",
        FormatError,
    ),
    "evaluate: wrong shape": (
        "evaluate shape.json good.csv",
        r"\$.accelerometer.T .* 3 items, not 1",
        FormatError,
    ),
    "evaluate: singular": ("evaluate singular.json good.csv", "nearly singular", FormatError),
    "evaluate: a recording": ("evaluate good.parquet good.csv", "good.parquet is not JSON", FormatError),
    "evaluate: other units": (
        "evaluate unit.json control.parquet",
        r"\$.gyroscope.T is about 0.977 lsb per rad/s, but \$.raw_units.gyroscope is lsb",
        FormatError,
    ),
    "evaluate: no rests": ("evaluate cal.json no-rest.parquet", "no rest of 1 s or more", None),
    "evaluate: NaN for a duration": ("evaluate cal.json good.csv --min-rest-s nan", "min.rest.s = NaN", None),
    "apply: other units": (
        "apply cal.json counts.parquet -o out.csv",
        "but the calibration expects m/s",
        None,
    ),
    "apply: a cut file": ("apply cut.json good.csv -o out.csv", "cut.json is not JSON", FormatError),
    "convert: other ending": ("convert good.csv -o out.xlsx", "change the extension", None),
    "simulate: no rate": ("simulate random --rate-hz 0 -o out.csv", "rate_hz is 0", None),
    "simulate: not a program": (
        "simulate cal.json -o out.csv",
        "has the schema 'imucal.calibration/1'",
        None,
    ),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_bad_files(name, capsys, monkeypatch):
    line, words, error = BAD_FILES[name]
    arguments = line.split()
    monkeypatch.chdir(folder())
    before = sorted(Path().iterdir())
    if arguments[0] == "calibrate":
        arguments += ["-o", "out.json"]
    assert main(arguments) == 1
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.startswith("imucal: ")
    assert "Traceback" not in shown.err
    if words.startswith("["):
        assert words in shown.err
    else:
        assert re.search(words, shown.err), shown.err
    assert sorted(Path().iterdir()) == before
    if error is not None:
        call = imucal.read if arguments[0] == "calibrate" else imucal.Calibration.load
        with pytest.raises(error):
            call(arguments[1])


# Files of which one row is not read: the file, the row, and the warning about it.
LEFT_OUT = {
    "text in a cell": ("text.csv", 49, "1 lines with text among the numbers (the first: line 51)"),
    "a row too long": (
        "ragged.csv",
        49,
        "1 lines with too few or too many values (the first: line 51, '0.49,",
    ),
    "a cut CSV": ("cut.csv", 12199, "an incomplete last line ('121.99,"),
}


@pytest.mark.parametrize("name", LEFT_OUT)
def test_a_bad_row_is_left_out_and_said(name, capsys, monkeypatch, tmp_path):
    file, row, words = LEFT_OUT[name]
    monkeypatch.chdir(folder())
    recording, good = imucal.read(file), imucal.read("good.csv")
    for column in ("time_s", "specific_force", "angular_rate"):
        np.testing.assert_array_equal(
            getattr(recording, column), np.delete(getattr(good, column), row, axis=0)
        )
    [finding] = recording.findings
    assert (finding.code, finding.severity, finding.count) == ("lines_left_out", "warning", 1)
    assert words in finding.message
    assert main(["calibrate", file, "-o", str(tmp_path / "cal.json")]) == 0
    shown = capsys.readouterr().out
    assert f"warning: {file}: left out: {words}" in shown
    assert "[lines_left_out]" in shown


def test_utf_16_is_read(monkeypatch):
    monkeypatch.chdir(folder())
    recording, good = imucal.read("utf16.csv"), imucal.read("good.csv")
    assert not recording.findings
    for column in ("time_s", "specific_force", "angular_rate"):
        np.testing.assert_array_equal(getattr(recording, column), getattr(good, column))


def test_a_control_recording_without_moves_judges_nothing(capsys, monkeypatch):
    monkeypatch.chdir(folder())
    assert main(["evaluate", "cal.json", "still.parquet"]) == 2
    assert "verdict: poor; control set: 1 usable rests and no usable move" in capsys.readouterr().out


@pytest.mark.parametrize(("times", "control_times"), [(1, 1), (1, 2), (2, 1)])
def test_a_run_does_not_judge_itself_however_its_samples_are_held(times, control_times):
    run, control = (
        rows(lambda n, m=m: np.arange(n).repeat(m))(stand_run().recording) for m in (times, control_times)
    )
    with pytest.raises(InputError, match="which the calibration is made of"):
        imucal.calibrate(run, control=control)


def test_recordings_of_one_name_get_names_of_their_own():
    recordings = [changed(stand_run().recording, name=name) for name in ("a", "a", "a (2)", "a")]
    assert [r.name for r in with_own_names(recordings)] == ["a", "a (2)", "a (2) (2)", "a (3)"]


def test_a_calibration_for_another_gravity_is_a_poor_verdict(capsys, monkeypatch):
    monkeypatch.chdir(folder())
    assert main(["evaluate", "gravity.json", "control.parquet"]) == 2
    assert "verdict: poor; control set: residuals are" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["calibrate", "good.csv", "-o", "/dev/null"], 0, ""),
        (["calibrate", "missing.csv", "-o", "cal.json"], 1, "gyro_z"),
        (["calibrate", "cut.parquet", "-o", "cal.json"], 1, "damaged or truncated"),
        (["evaluate", "schema.json", "good.csv"], 1, "imucal.calibration/9"),
        (["evaluate", "gravity.json", "control.parquet"], 2, ""),
        (["calibrate", "good.csv", "--folds", "-1"], 1, "folds is -1"),
    ],
)
def test_installed_command(arguments, code, words):
    before = {path: path.stat().st_mtime_ns for path in folder().iterdir()}
    done = subprocess.run([COMMAND, *arguments], cwd=folder(), capture_output=True, text=True)
    assert done.returncode == code
    assert words in done.stderr
    assert "Traceback" not in done.stderr
    assert {path: path.stat().st_mtime_ns for path in folder().iterdir()} == before


# Places that cannot be read or written


POSIX = pytest.mark.skipif(sys.platform == "win32", reason="POSIX")
NOT_ROOT = pytest.mark.skipif(
    sys.platform != "win32" and os.geteuid() == 0, reason="the superuser may do anything"
)


@pytest.fixture
def run(tmp_path):
    """A good recording in its own folder, and a calibration file that was there before."""
    imucal.write(changed(stand_run().recording), tmp_path / "run.parquet")
    (tmp_path / "cal.json").write_text("old")
    return tmp_path


def calibrated(place, *more):
    return main(["calibrate", str(place / "run.parquet"), "-o", str(place / "cal.json"), *more])


def assert_old_files_only(place, capsys, words):
    shown = capsys.readouterr()
    assert words in shown.err
    assert "Traceback" not in shown.err
    assert (place / "cal.json").read_text() == "old"
    assert sorted(path.name for path in place.iterdir()) == ["cal.json", "run.parquet"]


@POSIX
@NOT_ROOT
def test_no_permission_to_read(run, capsys):
    (run / "run.parquet").chmod(0)
    assert calibrated(run) == 1
    assert_old_files_only(run, capsys, "no permission")


@POSIX
@NOT_ROOT
def test_read_only_folder(run, capsys):
    run.chmod(0o555)
    try:
        assert calibrated(run) == 1
        assert_old_files_only(run, capsys, "cannot be written: Permission denied")
    finally:
        run.chmod(0o755)


@POSIX
@pytest.mark.parametrize("number", [errno.EACCES, errno.EROFS, errno.EDQUOT])
def test_folder_that_takes_no_file(run, capsys, monkeypatch, number):
    def refuse(*_, **__):
        raise OSError(number, os.strerror(number))

    # Without files that have no name, as on other systems.
    monkeypatch.delattr("os.O_TMPFILE", raising=False)
    monkeypatch.setattr("tempfile.mkstemp", refuse)
    assert calibrated(run) == 1
    assert_old_files_only(run, capsys, f"cannot be written: {os.strerror(number)}")


@pytest.mark.parametrize("where", ["os.fsync", "os.link", "os.fchmod"])
def test_disk_full_at_any_step(run, capsys, monkeypatch, where):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(where, full)
    assert calibrated(run) == 1
    monkeypatch.undo()
    assert_old_files_only(run, capsys, "No space left on device; what was there is unchanged")


@POSIX
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
def test_full_device(run, capsys):
    assert main(["calibrate", str(run / "run.parquet"), "-o", "/dev/full"]) == 1
    assert_old_files_only(run, capsys, "/dev/full cannot be written: No space left on device")
    assert main(["calibrate", str(run / "run.parquet"), "--json", "/dev/full"]) == 1
    assert_old_files_only(run, capsys, "/dev/full cannot be written")


def test_output_that_is_a_folder_or_in_none(run, capsys):
    (run / "cal.json").unlink()
    (run / "cal.json").mkdir()
    assert calibrated(run) == 1
    assert "it is a folder" in capsys.readouterr().err
    assert main(["calibrate", str(run / "run.parquet"), "-o", str(run / "none" / "cal.json")]) == 1
    assert f"there is no folder {run / 'none'}: create it first" in capsys.readouterr().err


@pytest.mark.slow
@POSIX
@pytest.mark.skipif(sys.platform == "darwin", reason="file names are UTF-8 there")
def test_file_names_that_are_no_text(run):
    name = os.fsdecode(b"\xff.parquet")
    (run / "run.parquet").rename(run / name)
    environment = {**os.environ, "PYTHONIOENCODING": "utf-8:strict"}
    for arguments, code in (
        (["calibrate", name, "-o", "cal.json", "--json", "-"], 0),
        (["inspect", name], 0),
        (["convert", name, "-o", os.fsdecode(b"\xfe.csv")], 0),
        (["calibrate", os.fsdecode(b"\xfd.csv")], 1),
    ):
        done = subprocess.run([COMMAND, *arguments], cwd=run, capture_output=True, env=environment)
        assert done.returncode == code, done.stderr
        assert b"Traceback" not in done.stderr
    assert imucal.Calibration.load(run / "cal.json").provenance.files[0].path == name
