"""The binary form of a calibration: its bytes, read by the C header and by imucal-core, against `apply`."""

import dataclasses
import struct
import subprocess
import zlib

import numpy as np
import pytest

import imucal
import imucal._core as _core
from imucal.effects import catalogue
from imucal.effects.formula_effect import FormulaEffect

pytestmark = pytest.mark.slow

GCC = ("-O1", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wdouble-promotion", "-Wshadow", "-Werror")
UNIT = imucal.Calibration(
    imucal.Triad(
        [[0.9804, 0.0012, 0.0055], [0.0012, 0.9727, 0.0043], [0.0055, 0.0043, 0.9921]], [-0.42, 0.24, 0.39]
    ),
    imucal.Triad(
        [[0.9771, 0.0097, -0.006], [-0.0084, 1.0309, -0.0031], [0.0087, 0.0036, 1.003]],
        [-0.035, 0.0042, 0.001],
    ),
)
# Reads a calibration from the file of its first argument; then samples: raw rate and force, temperature,
# time, angular acceleration. Writes status, rate and force of each. With a second argument the raw samples
# become counts.
DRIVER = """
#include "loader.h"
#include <stdio.h>
int main(int argc, char **argv)
{
    static unsigned char blob[8192];
    imucal_calibration unit;
    imucal_surroundings at = imucal_surroundings_unknown();
    imucal_derivative state = IMUCAL_DERIVATIVE_START;
    imucal_temperature memory;
    float in[11], out[7], last_s = 0.0f;
    FILE *file = fopen(argv[1], "rb");
    size_t size = fread(blob, 1, sizeof blob, file);
    int i, loaded = imucal_calibration_load(&unit, blob, size);
    fclose(file);
    memset(&memory, 0, sizeof memory);
    imucal_differentiate(&unit, &state, 0.0f, in, out);
    if (loaded != IMUCAL_LOADED) return -loaded;
    while (fread(in, sizeof(float), 11, stdin) == 11) {
        at.temperature_degc = in[6];
        at.time_s = in[7];
        if (!isnan(in[6])) {
            imucal_temperature_update(&unit, &memory, in[7] - last_s, in[6]);
            last_s = in[7];
            at.temperature_history = &memory;
        }
        for (i = 0; i < 3; ++i) at.angular_acceleration_radps2[i] = in[8 + i];
        if (argc > 2) {
            int16_t counts[6];
            for (i = 0; i < 6; ++i) counts[i] = (int16_t)in[i];
            out[0] = (float)imucal_correct_counts(&unit, counts, counts + 3, &at, out + 1, out + 4);
        } else {
            out[0] = (float)imucal_correct(&unit, in, in + 3, &at, out + 1, out + 4);
        }
        fwrite(out, sizeof(float), 7, stdout);
    }
    return 0;
}
"""


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    """The C header with a driver, compiled as C99; it compiles as C++ as well."""
    folder = tmp_path_factory.mktemp("loader")
    imucal.export(UNIT, "c-loader").save(folder / "loader.h")
    source = DRIVER.replace("float in[11]", "float in[11] = {0}")
    for compiler, standard, name in (("g++", "-std=c++11", "main.cpp"), ("gcc", "-std=c99", "main.c")):
        (folder / name).write_text(source)
        command = [compiler, standard, *GCC, folder / name, "-o", folder / "main", "-lm"]
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
    return folder / "main"


def run(program, blob, rows, *options):
    path = program.parent / "unit.bin"
    path.write_bytes(blob)
    rows = np.asarray(rows, dtype="<f4")
    done = subprocess.run([program, path, *options], input=rows.tobytes(), capture_output=True)
    return done.returncode, np.frombuffer(done.stdout, "<f4").reshape(-1, 7)


def with_effects(*values, **changes):
    return dataclasses.replace(UNIT, effects=values, **changes)


def typical(effect, count):
    values = [
        p.typical * (1.0, -0.7)[k % 2] * (1 - 0.05 * k) for k, p in enumerate(effect.parameters[:count])
    ]
    return imucal.EffectValues(effect.name, values, None if effect.shape is None else 80.0)


def recording(unit, count=2000):
    random = np.random.default_rng(6)
    time_s = np.arange(count) / 200.0
    phase = random.uniform(0, 6, (2, 3))
    rate = 4.0 * np.sin(time_s[:, None] * [1.3, 2.1, 0.7] + phase[0])
    force = 12.0 * np.sin(time_s[:, None] * [0.9, 1.7, 2.9] + phase[1])
    return imucal.Recording(
        time_s,
        force @ unit.accelerometer.sensitivity.T + unit.accelerometer.bias,
        rate @ unit.gyroscope.sensitivity.T + unit.gyroscope.bias,
        temperature_degc=10.0 + 40.0 * time_s / time_s[-1],
        accel_unit=unit.accel_unit,
        gyro_unit=unit.gyro_unit,
    )


def rows_of(rec, acceleration):
    columns = (rec.angular_rate, rec.specific_force, rec.temperature_degc[:, None], rec.time_s[:, None])
    return np.hstack((*columns, acceleration))


CASES = [
    (effect, count)
    for effect in catalogue()
    if effect.sensor != "encoder" and "attitude" not in effect.needs
    for count in range(effect.plain, len(effect.parameters) + 1, effect.plain)
]


def memory_rounding(effect, own):
    """Bound of the rounding errors of the temperature memory, in the unit of the reading.

    Each step of a low-pass adds numbers to its state and rounds each sum. The state remembers the rounding
    errors of the steps within its time constant. The recording has 2000 steps of 5 ms at 4 K/s.
    """
    if effect.shape is not None:
        # The output of the low-pass is less than 64 K behind the temperature. Two sums are rounded.
        error = 2 * 2**-24 * 64.0 * min(2000, own.shape / 0.005)
    else:
        # Two low-passes with two and three sums, each less than 2 K behind. The rate, K/s, is the second lag
        # divided by the time constant. The direction follows the change of both lags with a smaller error.
        tau_s = _core.TEMPERATURE_SMOOTHING_S
        error = 5 * 2**-24 * 2.0 * (tau_s / 0.005) / tau_s
    powers = 25.0 ** (np.arange(len(own.values)) // 3)
    return error * np.abs(own.values * powers).reshape(-1, 3).sum(axis=0).max()


@pytest.mark.parametrize(("effect", "count"), CASES, ids=lambda case: getattr(case, "name", case))
def test_the_c_header_corrects_as_apply_does(program, effect, count):
    unit = with_effects(typical(effect, count))
    rec = recording(unit)
    exported = imucal.export(unit, "blob")
    assert exported.lost == ()
    expected = unit.apply_recording(rec)
    acceleration = np.zeros((len(rec), 3))
    if "angular_acceleration" in effect.needs:
        rate = UNIT.apply(rec.angular_rate, rec.specific_force)[0]
        for _ in range(3):
            acceleration = _core.angular_acceleration(rec.time_s, rate)
            code, out = run(program, exported.binary, rows_of(rec, acceleration))
            rate = out[:, 1:4].astype(float)
    code, out = run(program, exported.binary, rows_of(rec, acceleration))
    assert code == 0 and not out[:, 0].any()
    # Single precision: a few times 2^-24 of the largest values, 4 rad/s and 12 m/s^2.
    atol = 1e-4 if "angular_acceleration" in effect.needs else 8e-6
    if "temperature_history" in effect.needs:
        atol += memory_rounding(effect, typical(effect, count))
    np.testing.assert_allclose(out[:, 1:4], expected.angular_rate, rtol=0, atol=atol)
    np.testing.assert_allclose(out[:, 4:], expected.specific_force, rtol=0, atol=atol)


def test_the_form_is_the_documented_one():
    effect = next(e for e in catalogue() if e.name == "gyro_bias_warmup")
    unit = with_effects(typical(effect, 3), temperature_range_degc=(-5.5, 40.0))
    blob = imucal.export(unit, "blob").binary
    magic, version, flags, length, effects, omitted, x, y, z = struct.unpack_from("<4sBBHBB3b", blob)
    assert (magic, version, flags, length, effects, omitted) == (b"IMUC", 1, 4, len(blob), 1, 0)
    assert (x, y, z) == (1, 2, 3) and len(blob) == 128 + 8 + 12
    assert struct.unpack_from("<3f", blob, 16) == (-5.5, 40.0, 25.0)
    inverse = np.linalg.inv(UNIT.gyroscope.sensitivity)
    np.testing.assert_allclose(np.frombuffer(blob, "<f4", 9, 28), inverse.ravel(), rtol=1e-6)
    assert struct.unpack_from("<BBxxf", blob, 124) == (17, 3, 80.0)
    assert struct.unpack_from("<I", blob, len(blob) - 4) == (zlib.crc32(blob[:-4]),)


def test_a_resolution_makes_counts_of_si_units(program):
    exported = imucal.export(UNIT, "blob", accel_lsb_per_g=2048, gyro_lsb_per_dps=16.4, body_axes="y,-x,z")
    raw = np.array([[100, -2000, 300, 2048, -100, 50]], dtype=float)
    _, out = run(program, exported.binary, np.hstack((raw, np.full((1, 5), np.nan))), "counts")
    rate, force = UNIT.apply(np.radians(raw[:, :3] / 16.4), raw[:, 3:] / 2048 * 9.80665)
    turn = [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]
    np.testing.assert_allclose(out[:, 1:4], rate @ np.transpose(turn), atol=1e-6)
    np.testing.assert_allclose(out[:, 4:], force @ np.transpose(turn), atol=3e-6)
    assert "raw samples in lsb (2048 per g) and lsb (16.4 per deg/s)" in exported.text
    assert "int16_t" not in exported.text
    with pytest.raises(imucal.InputError, match="needs both"):
        imucal.export(UNIT, "blob", accel_lsb_per_g=2048)
    _, out = run(program, imucal.export(UNIT, "blob").binary, np.zeros((1, 11)), "counts")
    assert out[0, 0] == -2 and np.isnan(out[0, 1:]).all()


def test_counts_of_an_unsigned_sensor_are_too_large_for_the_function_of_counts():
    unsigned = imucal.Calibration(
        accelerometer=imucal.Triad(400.0 * np.eye(3), [33000.0, 33000.0, 32000.0]),
        gyroscope=imucal.Triad(4800.0 * np.eye(3), [32700.0, 32700.0, 32500.0]),
        accel_unit="lsb",
        gyro_unit="lsb",
    )
    assert "Counts at rest reach 36923 and exceed int16_t" in imucal.export(unsigned, "blob").text


def test_a_temperature_outside_the_recordings_is_limited_and_a_missing_one_reported(program):
    effect = next(e for e in catalogue() if e.name == "gyro_bias_temperature")
    blob = imucal.export(with_effects(typical(effect, 3), temperature_range_degc=(0.0, 50.0)), "blob").binary
    rows = np.zeros((5, 11))
    rows[:, 6] = [50.0, 90.0, 0.0, -40.0, np.nan]
    _, out = run(program, blob, rows)
    assert out[:, 0].tolist() == [0, 1, 0, 1, 2]
    assert (out[0, 1:] == out[1, 1:]).all() and (out[2, 1:] == out[3, 1:]).all()
    assert out[0, 1] != out[2, 1]


def test_a_formula_is_reported_and_counted():
    effect = FormulaEffect.of("gyro: k*w_x*f_x", columns=[])
    unit = dataclasses.replace(
        UNIT,
        effects=[imucal.EffectValues(effect.name, [1e-3] * len(effect.parameters))],
        user_effects=[effect],
    )
    exported = imucal.export(unit, "blob")
    assert exported.lost == (f"the effect {effect.name} (user-defined)",)
    assert exported.binary[9] == 1 and exported.binary[8] == 0
    assert "errors of omitted effects stay in the data" in exported.text


def test_damaged_bytes_are_refused(program):
    blob = imucal.export(UNIT, "blob").binary
    for place in range(0, len(blob), 7):
        bad = bytearray(blob)
        bad[place] ^= 0x40
        assert run(program, bytes(bad), np.zeros((1, 11)))[0] != 0, place
    assert run(program, b"\xff" * 256, np.zeros((1, 11)))[0] == 2
    assert run(program, blob[:100], np.zeros((1, 11)))[0] == 1
    newer = bytearray(blob[:-4])
    newer[4] = 2
    assert run(program, bytes(newer) + struct.pack("<I", zlib.crc32(newer)), np.zeros((1, 11)))[0] == 3


@pytest.mark.parametrize("axes", ["x,y,-z", "-x,-y,-z", "y,x,z"])
def test_left_handed_axes_are_refused(axes):
    with pytest.raises(imucal.InputError, match=f"body_axes is '{axes}', which is left-handed"):
        imucal.export(UNIT, "blob", body_axes=axes)
