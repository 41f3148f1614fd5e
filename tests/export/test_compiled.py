"""The exports that are programs: C compiled by gcc, Rust by cargo, against `Calibration.apply`.

The derivative of the rate is taken from `imucal._core`, because the device gets it from its own
differentiator.
"""

import ctypes
import dataclasses
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import imucal
import imucal._core as _core
from c_compiler import GCC, gcc
from imucal.effects import catalogue
from imucal.effects.formula_effect import FormulaEffect
from imucal.exporting.formula_code import auxiliary_of

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
ACCELEROMETER = imucal.Triad(
    [[0.9804, 0.0012, 0.0055], [0.0012, 0.9727, 0.0043], [0.0055, 0.0043, 0.9921]], [-0.42, 0.24, 0.39]
)
GYROSCOPE = imucal.Triad(
    [[0.9771, 0.0097, -0.0060], [-0.0084, 1.0309, -0.0031], [0.0087, 0.0036, 1.0030]], [-0.035, 0.0042, 0.001]
)
UNIT = imucal.Calibration(ACCELEROMETER, GYROSCOPE)
TRIANGULAR = imucal.Calibration(
    imucal.Triad([[0.9804, 0, 0], [0.0112, 0.9727, 0], [-0.0155, 0.0083, 0.9921]], ACCELEROMETER.bias),
    GYROSCOPE,
    frame="triangular",
)
COUNTS = imucal.Calibration(
    imucal.Triad(ACCELEROMETER.sensitivity * 418.0, [32768.0, 32411.0, 32902.0]),
    imucal.Triad(GYROSCOPE.sensitivity * 4775.0, [32777.0, 32459.0, 32511.0]),
    accel_unit="lsb",
    gyro_unit="lsb",
)
NEEDS = ("temperature", "temperature_history", "time", "angular_acceleration")
PASSED = {
    "temperature": "temperature[i]",
    "temperature_history": "&memory",
    "time": "time[i]",
    "angular_acceleration": "acceleration + 3 * i",
    # The column of `recording` that is not called temperature.
    "supply_v": "temperature[i]",
    # The angles of `recording` are this column, too.
    "stand_2_rad": "temperature[i]",
}
MEMORY_ROUTINES = {"memcpy", "memset"}


def typical(effect, count):
    """Numbers of ordinary size, each another: a transposed matrix shows."""
    values = [
        p.typical * (1.0, -0.7)[k % 2] * (1 - 0.05 * k) for k, p in enumerate(effect.parameters[:count])
    ]
    return imucal.EffectValues(effect.name, values, None if effect.shape is None else 80.0)


def with_effects(*values, unit=UNIT):
    return imucal.Calibration(
        unit.accelerometer,
        unit.gyroscope,
        accel_unit=unit.accel_unit,
        gyro_unit=unit.gyro_unit,
        effects=values,
    )


def with_formula(text):
    effect = FormulaEffect.of(text, columns=["supply_v"])
    values = [2e-3 * (1.0, -0.7)[k % 2] * (1 - 0.05 * k) for k in range(len(effect.parameters))]
    return imucal.Calibration(
        ACCELEROMETER,
        GYROSCOPE,
        effects=[imucal.EffectValues(effect.name, values)],
        user_effects=[effect],
    )


# Each function and input stands in one of them. A comparison is of the other sensor: an effect that switches
# by what it changes has no inverse near the switch.
FORMULAS = {
    "formula_column": "gyro: k*(supply_v - 3.3)/10 + m*(f_z > 0.5)*w_x",
    "formula_sign": "gyro x: a*tanh(w/0.2) + b*sign(f_y)*w**2 + c*(-w_norm)",
    "formula_temperature": "accel: k*(abs(w_z) >= 1)*min(f, 3)*temp_degc/100",
    "formula_time": "gyro: k*exp(-time_s/80)*w_norm + q*sqrt(f_norm)*w_z**3/30",
    "formula_acceleration": "accel z: l*dw_x/9 + m*dw/9 - 2*n*f_x*f_x/9 + o*atan(log(f_norm))*cos(pi*w)",
    # Laws that a search finds.
    "formula_angle": "gyro: s*sin(2*stand_2_rad) + c*cos(2*stand_2_rad)",
    "formula_limit": "gyro: k*min(max(w, -0.03203), 0.03203)/3",
    "formula_waves": "accel: s*sin(2*pi*f/13.78) + c*cos(2*pi*f/13.78)",
    "formula_power": "accel: k*max(g, f_norm)**1.5/30*sin(tan(w_y/9))",
}


def units():
    """A calibration for each form of each effect, and three more."""
    yield "plain", UNIT
    yield "counts", COUNTS
    yield "triangular", TRIANGULAR
    for effect in catalogue():
        for count in range(effect.plain, len(effect.parameters) + 1, effect.plain):
            yield f"{effect.name}_{count}", with_effects(typical(effect, count))
    for name, formula in FORMULAS.items():
        yield name, with_formula(formula)
    several = [typical(e, len(e.parameters)) for e in catalogue() if e.sensor != "encoder"][::2]
    yield "several", with_effects(*several[:12])


UNITS = dict(units())


def needs_of(unit):
    left = unit.left_in_data
    found = {n for v in unit.effects if v.name not in left for n in unit.definition(v).needs}
    columns = {c for own in unit.user_effects for c in auxiliary_of(own)}
    return [*(need for need in NEEDS if need in found), *sorted(columns)]


def driver(headers):
    """A C program with a loop over samples for each header, `run_<name>_f64` and `run_<name>_f32`."""
    parts = []
    for name, path in headers.items():
        parts.append(f'#include "{path}"')
        passed = "".join(f" {PASSED[need]}," for need in needs_of(UNITS[name]))
        has_memory = "temperature_history" in needs_of(UNITS[name])
        for size, real in (("f64", "double"), ("f32", "float")):
            memory = f"{name}_temperature_{size} memory = {{0}};" if has_memory else ""
            update = (
                f"{name}_temperature_{size}_update(&memory, i ? time[i] - time[i - 1] : 0, temperature[i]);"
            )
            parts.append(f"""
void run_{name}_{size}(int n, {real} *rate, {real} *force, const {real} *temperature, const {real} *time,
                       const {real} *acceleration, int *status);
void run_{name}_{size}(int n, {real} *rate, {real} *force, const {real} *temperature, const {real} *time,
                       const {real} *acceleration, int *status) {{
    int i;
    {memory}
    (void)temperature; (void)time; (void)acceleration;
    for (i = 0; i < n; ++i) {{
        {update if has_memory else ""}
        status[i] = {name}_correct_{size}(rate + 3 * i, force + 3 * i,{passed} rate + 3 * i, force + 3 * i);
    }}
}}""")
    return "\n".join([*parts, ""])


@pytest.fixture(scope="module")
def headers(tmp_path_factory):
    folder = tmp_path_factory.mktemp("headers")
    paths = {}
    for name, unit in UNITS.items():
        paths[name] = folder / f"{name}.h"
        imucal.export(unit, "c-header", name=name).save(paths[name])
    return paths


@pytest.fixture(scope="module")
def library(headers, tmp_path_factory):
    folder = tmp_path_factory.mktemp("c")
    (folder / "driver.c").write_text(driver(headers))
    gcc(*GCC, "-shared", "-fPIC", folder / "driver.c", "-o", folder / "driver.so", "-lm")
    return ctypes.CDLL(str(folder / "driver.so"))


def run(library, name, dtype, rate, force, temperature_degc, time_s, acceleration):
    columns = [np.array(column, dtype=dtype, order="C") for column in (rate, force, temperature_degc, time_s)]
    columns.append(np.array(acceleration, dtype=dtype))
    status = np.full(len(rate), 7, dtype=np.int32)
    function = getattr(library, f"run_{name}_{'f64' if dtype == np.float64 else 'f32'}")
    pointers = [ctypes.c_void_p(column.ctypes.data) for column in (*columns, status)]
    function(len(rate), *pointers)
    return columns[0], columns[1], status


def recording(unit, count=3000):
    """A unit that turns fast, warms up and is thrown about: raw samples, in its own units."""
    random = np.random.default_rng(6)
    time_s = np.arange(count) / 200.0
    phase = random.uniform(0, 6, (2, 3))
    temperature_degc = 10.0 + 40.0 * time_s / time_s[-1]
    rate = 4.0 * np.sin(time_s[:, None] * [1.3, 2.1, 0.7] + phase[0])
    force = 12.0 * np.sin(time_s[:, None] * [0.9, 1.7, 2.9] + phase[1]) + random.normal(0, 0.1, (count, 3))
    return imucal.Recording(
        time_s,
        force @ unit.accelerometer.sensitivity.T + unit.accelerometer.bias,
        rate @ unit.gyroscope.sensitivity.T + unit.gyroscope.bias,
        temperature_degc=temperature_degc,
        auxiliary={"supply_v": temperature_degc},
        stand_rad=np.column_stack([temperature_degc] * 3),
        accel_unit=unit.accel_unit,
        gyro_unit=unit.gyro_unit,
    )


def acceleration_of(unit, run_c, rec):
    """The angular acceleration as `apply_recording` takes it: of the rate that a first pass corrects.

    For a delay of the gyroscope, it is the mean of this derivative and that of the measured rate.
    """
    if "angular_acceleration" not in needs_of(unit):
        return np.zeros((len(rec), 3))
    rate = imucal.Calibration(unit.accelerometer, unit.gyroscope).apply(rec.angular_rate, rec.specific_force)[
        0
    ]
    of_measured = _core.angular_acceleration(rec.time_s, rate)
    of_corrected = _core.angular_acceleration(rec.time_s, run_c(of_measured)[0])
    is_delayed = any(values.name == "gyro_time_offset" for values in unit.effects)
    return (of_corrected + of_measured) / 2.0 if is_delayed else of_corrected


@pytest.mark.parametrize("name", UNITS)
def test_the_header_gives_the_numbers_of_python(library, name):
    unit = UNITS[name]
    rec = recording(unit)
    expected = unit.apply_recording(rec)

    def run_c(acceleration, dtype=np.float64):
        columns = (rec.angular_rate, rec.specific_force, rec.temperature_degc, rec.time_s)
        return run(library, name, dtype, *columns, acceleration)

    acceleration = acceleration_of(unit, run_c, rec)
    rate, force, status = run_c(acceleration)
    assert not status.any()
    for found, wanted in ((rate, expected.angular_rate), (force, expected.specific_force)):
        largest = np.abs(wanted).max(axis=1, keepdims=True)
        # `Calibration` subtracts a formula from the raw samples, which rounds a second time.
        units = 6 if unit.user_effects else 2
        assert (np.abs(found - wanted) <= units * np.spacing(largest)).all()


def in_single_precision(rec):
    """The recording with samples that single precision represents exactly; raw counts are whole numbers."""
    to_samples = np.round if rec.accel_unit == "lsb" else rounded
    return dataclasses.replace(
        rec,
        specific_force=to_samples(rec.specific_force),
        angular_rate=to_samples(rec.angular_rate),
        temperature_degc=rounded(rec.temperature_degc),
        auxiliary={"supply_v": rounded(rec.temperature_degc)},
        stand_rad=rounded(rec.stand_rad),
    )


def rounded(values):
    return np.asarray(values).astype(np.float32).astype(np.float64)


@pytest.mark.parametrize("name", UNITS)
def test_single_precision_is_within_two_units_in_the_last_place(library, name):
    unit = UNITS[name]
    rec = in_single_precision(recording(unit))
    expected = unit.apply_recording(rec)
    columns = rec.angular_rate, rec.specific_force, rec.temperature_degc, rec.time_s
    acceleration = acceleration_of(unit, lambda a: run(library, name, np.float64, *columns, a), rec)
    rate, force, status = run(library, name, np.float32, *columns, acceleration)
    assert not status.any()
    for found, wanted, raw in (
        (rate, expected.angular_rate, rec.angular_rate),
        (force, expected.specific_force, rec.specific_force),
    ):
        if "temperature_history" in needs_of(unit):
            # The temperature memory also is in single precision. Its rounding errors accumulate.
            np.testing.assert_allclose(found, wanted, rtol=0, atol=8 * 2.0**-24 * 12.0)
            continue
        # For counts, the corrected sample is the only one in SI units.
        seen = [wanted] if unit is COUNTS else [wanted, raw]
        largest = np.abs(seen).max(axis=(0, 2)).astype(np.float32)[:, None]
        assert (np.abs(found - wanted) <= 2 * np.spacing(largest)).all()


def test_a_million_samples_are_within_two_units_in_the_last_place(library):
    random = np.random.default_rng(7)
    rate, force = random.normal(0, 2, (1_000_000, 3)), random.normal(0, 10, (1_000_000, 3))
    nothing = np.zeros(0)
    found_rate, found_force, _ = run(library, "plain", np.float64, rate, force, nothing, nothing, nothing)
    expected_rate, expected_force = UNIT.apply(rate, force)
    assert (np.abs(found_rate - expected_rate) <= 2 * np.spacing(np.abs(expected_rate))).all()
    assert (np.abs(found_force - expected_force) <= 2 * np.spacing(np.abs(expected_force))).all()


def test_what_cannot_be_undone_is_not_a_number(headers, library):
    # A cubic scale of this size has no inverse at a rate of 1e4 rad/s, and NaN has none at all.
    rate = np.array([[1e4, 0.0, 0.0], [np.nan, 0.0, 0.0], [0.1, 0.0, np.inf], [0.1, 0.2, 0.3]])
    nothing = np.zeros(0)
    for dtype in (np.float64, np.float32):
        found, force, status = run(
            library, "gyro_scale_cubic_3", dtype, rate, np.ones((4, 3)), nothing, nothing, nothing
        )
        assert status.tolist() == [-1, -1, -1, 0]
        assert np.isnan(found[:3]).all() and np.isnan(force[:3]).all() and np.isfinite(found[3]).all()


@pytest.mark.parametrize(
    ("name", "called"), [("gyro_scale_cubic_3", set()), ("gyro_bias_warmup_3", {"exp", "expf"})]
)
def test_the_header_calls_nothing_but_what_it_says(headers, tmp_path, name, called):
    says = "Link libm for exp." if called else "No function of libm is called."
    assert says in headers[name].read_text()
    (tmp_path / "driver.c").write_text(driver({name: headers[name]}))
    gcc(*GCC, "-c", tmp_path / "driver.c", "-o", tmp_path / "driver.o")
    listing = subprocess.run(
        ["nm", "--undefined-only", "--format=posix", tmp_path / "driver.o"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert {line.split()[0] for line in listing.stdout.splitlines()} - MEMORY_ROUTINES == called


def test_the_header_is_cplusplus_too(headers, tmp_path):
    source = tmp_path / "two.cpp"
    source.write_text(f'#include "{headers["several"]}"\nint main() {{ return 0; }}\n')
    done = subprocess.run(
        ["g++", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", source], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


def compiled(folder, *lines):
    """What gcc says of a C file of these lines; nothing if it takes it."""
    (folder / "main.c").write_text("\n".join([*lines, ""]))
    options = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-fsyntax-only"]
    done = subprocess.run(["gcc", *options, folder / "main.c"], capture_output=True, text=True)
    return done.stderr


def test_two_units_in_one_program_have_two_names(tmp_path):
    other = dataclasses.replace(UNIT, gyroscope=TRIANGULAR.accelerometer)
    for unit, file, name in ((UNIT, "a", None), (UNIT, "again", None), (other, "b", None), (other, "c", "b")):
        imucal.export(unit, "c-header", name=name).save(tmp_path / f"{file}.h")
    calls = [
        f"int main(void) {{ float v[3] = {{0, 0, 0}}; return {call}(v, v, v, v); }}"
        for call in ("imucal_correct_f32", "b_correct_f32")
    ]
    include = {file: f'#include "{file}.h"' for file in ("a", "again", "b", "c")}
    assert compiled(tmp_path, include["a"], include["a"], include["again"], calls[0]) == ""
    assert compiled(tmp_path, include["a"], include["c"], calls[0]) == ""
    assert compiled(tmp_path, include["a"], include["c"], calls[1]) == ""
    said = compiled(tmp_path, include["a"], include["b"], calls[0])
    assert "another calibration is included as imucal" in said
    assert "imucal export --name PREFIX" in said


@pytest.mark.parametrize("serial_number", ["0042", 'A"7\\x??/ */ µ'])
def test_the_serial_number_is_in_the_header(tmp_path, serial_number):
    unit = dataclasses.replace(UNIT, serial_number=serial_number)
    imucal.export(unit, "c-header", name="gimbal").save(tmp_path / "unit.h")
    (tmp_path / "main.c").write_text(
        '#include "unit.h"\n#include <stdio.h>\nint main(void) { return puts(GIMBAL_SERIAL_NUMBER) < 0; }\n'
    )
    gcc(*GCC, tmp_path / "main.c", "-o", tmp_path / "main")
    done = subprocess.run([tmp_path / "main"], capture_output=True, check=True)
    assert done.stdout.decode() == serial_number + "\n"


def test_the_temperatures_of_the_recordings_are_in_both_programs(tmp_path):
    effects = {effect.name: effect for effect in catalogue()}
    warm = with_effects(typical(effects["gyro_bias_temperature"], 3))
    unit = dataclasses.replace(warm, temperature_range_degc=(-5.5, 40.0))
    header, module = (imucal.export(unit, name).text for name in ("c-header", "rust"))
    (tmp_path / "unit.h").write_text(header)
    wanted = "IMUCAL_TEMPERATURE_MAX_DEGC-IMUCAL_TEMPERATURE_MIN_DEGC == 45.5f"
    main = (
        f"static int ok(float t) {{ return t < IMUCAL_TEMPERATURE_MAX_DEGC && {wanted}; }}\n"
        "int main(void) { return ok(39.0f) ? 0 : 1; }\n"
    )
    (tmp_path / "main.c").write_text(f'#include "unit.h"\n{main}')
    gcc(*GCC, tmp_path / "main.c", "-o", tmp_path / "main")
    assert subprocess.run([tmp_path / "main"]).returncode == 0
    assert "pub const TEMPERATURE_MIN_DEGC: f64 = -5.5;" in module
    assert "pub const TEMPERATURE_MAX_DEGC: f64 = 40.0;" in module
    note = "The recordings were at -5.5 to 40 degC: outside this range, gyro_bias_temperature are"
    assert note in header and note in module
    assert "TEMPERATURE_M" not in imucal.export(warm, "c-header").text + imucal.export(warm, "rust").text


@pytest.mark.parametrize("name", ["", "7up", "left-imu", "_x", "é"])
def test_a_name_that_c_cannot_have_is_refused(name):
    with pytest.raises(imucal.InputError, match="use letters, digits and _"):
        imucal.export(UNIT, "c-header", name=name)


def test_every_effect_of_the_catalogue_is_in_the_header():
    for effect in catalogue():
        assert imucal.export(with_effects(typical(effect, effect.plain)), "c-header").lost == (), effect.name


def test_an_effect_of_ones_own_is_said_to_be_lost():
    own = imucal.UserEffect(
        "gyro_bias_supply", "gyroscope", (imucal.EffectParameter("x", "rad/s/V", 1e-3),), None
    )
    unit = imucal.Calibration(
        ACCELEROMETER, GYROSCOPE, effects=(imucal.EffectValues(own.name, [1e-3]),), user_effects=(own,)
    )
    for name in ("c-header", "rust"):
        exported = imucal.export(unit, name)
        assert exported.lost == ("the effect gyro_bias_supply (user-defined)",)
        assert "Not exported: the effect gyro_bias_supply" in exported.text


FUSION = """
#pragma once
typedef union { float array[3]; struct { float x, y, z; } axis; } FusionVector;
typedef union {
    float array[3][3];
    struct { float xx, xy, xz, yx, yy, yz, zx, zy, zz; } element;
} FusionMatrix;
"""


def test_the_constants_of_fusion_compile(tmp_path):
    # The types of FusionMath.h; the numbers are tested with imufusion.
    (tmp_path / "Fusion.h").write_text(FUSION)
    imucal.export(UNIT, "fusion").save(tmp_path / "unit.h")
    names = [
        f"{s}{what}"
        for s in ("gyroscope", "accelerometer")
        for what in ("Misalignment", "Sensitivity", "Offset")
    ]
    uses = " + ".join(f"(int)sizeof({name})" for name in names)
    (tmp_path / "main.c").write_text(f'#include "unit.h"\nint main(void) {{ return {uses}; }}\n')
    gcc("-std=c99", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", tmp_path / "main.c")


def test_two_units_of_fusion_in_one_program_have_two_names(tmp_path):
    (tmp_path / "Fusion.h").write_text(FUSION)
    other = dataclasses.replace(UNIT, gyroscope=TRIANGULAR.accelerometer)
    for unit, file, name in ((UNIT, "a", None), (other, "b", None), (other, "c", "gimbal")):
        imucal.export(unit, "fusion", name=name).save(tmp_path / f"{file}.h")
    names = [
        f"{prefix}{sensor}{what}"
        for prefix in ("", "gimbal_")
        for sensor in ("gyroscope", "accelerometer")
        for what in ("Misalignment", "Sensitivity", "Offset")
    ]
    use = f"int main(void) {{ return {' + '.join(f'(int)sizeof({name})' for name in names)}; }}"
    include = {file: f'#include "{file}.h"' for file in ("a", "b", "c")}
    assert compiled(tmp_path, include["a"], include["c"], include["a"], use) == ""
    said = compiled(tmp_path, include["a"], include["b"], use)
    assert "another calibration is included as imucal" in said


# --- Rust -----------------------------------------------------------------------------------------


def test_the_rust_module_says_which_surroundings_its_effects_need():
    effects = {effect.name: effect for effect in catalogue()}
    names = (
        "gyro_g_sensitivity",
        "gyro_bias_temperature",
        "accel_lever_arm",
        "accel_bias_drift",
        "earth_rate",
    )
    text = imucal.export(with_effects(*(typical(effects[name], 3) for name in names[1:])), "rust").text
    said = text.replace("\n//   ", " ")
    assert "temperature_difference_k (sensor temperature minus REFERENCE_TEMPERATURE_DEGC)" in said
    assert all(field in said for field in ("time_s (since", "angular_acceleration (derivative"))
    left_in = "gyro_bias_temperature, accel_lever_arm, accel_bias_drift"
    assert f"these effects are not compensated: {left_in}\n" in said
    assert "pub const REFERENCE_TEMPERATURE_DEGC: f64 = 25.0;" in text
    text = imucal.export(with_effects(typical(effects[names[0]], 9)), "rust").text
    assert "Surroundings" not in text and "TEMPERATURE" not in text


def with_effects_and_formulas():
    """Three effects of the catalogue, and formulas for both sensors."""
    names = ("formula_column", "formula_sign", "formula_temperature", "formula_power")
    own = [with_formula(f"{name} = {FORMULAS[name]}") for name in names]
    return imucal.Calibration(
        ACCELEROMETER,
        GYROSCOPE,
        effects=[values for u in (with_catalogue(), *own) for values in u.effects],
        user_effects=[effect for u in own for effect in u.user_effects],
    )


def with_catalogue():
    effects = {effect.name: effect for effect in catalogue()}
    names = ("gyro_g_sensitivity", "gyro_bias_temperature", "accel_scale_cubic")
    return with_effects(*(typical(effects[name], effects[name].plain) for name in names))


# Each build overwrites the program of the one before.
@pytest.mark.xdist_group("tests/export_rust")
@pytest.mark.parametrize("features", ["", "formulas"])
def test_the_rust_module_runs_on_the_core(features):
    unit = with_effects_and_formulas() if features else with_catalogue()
    cargo = shutil.which("cargo")
    if cargo is None:
        pytest.fail("cargo is not on PATH: the Rust module cannot be tested without it")
    manifest = ROOT / "tests/export_rust/Cargo.toml"
    rec = recording(unit)
    rows = np.hstack((rec.angular_rate, rec.specific_force, rec.temperature_degc[:, None] - 25.0))
    # Its build of nalgebra is that of the proof without std.
    target = ROOT / "tests/no_std/target"
    # An unchanged module at an unchanged path is not compiled again.
    module, text = target / f"exported-{features or 'plain'}.rs", imucal.export(unit, "rust").text
    target.mkdir(exist_ok=True)
    if not module.exists() or module.read_text(encoding="utf-8") != text:
        module.write_text(text, encoding="utf-8")
    options = ["--release", "--locked", "--manifest-path", manifest, "--target-dir", target]
    options += ["--features", features]
    done = subprocess.run(
        [cargo, "run", "--quiet", *options],
        env={**os.environ, "IMUCAL_EXPORT": str(module)},
        input=rows.astype("<f8").tobytes(),
        capture_output=True,
    )
    assert done.returncode == 0, done.stderr.decode()
    double, single = np.frombuffer(done.stdout, "<f8").reshape(2, len(rec), 6)
    expected = unit.apply_recording(rec)
    wanted = np.hstack((expected.angular_rate, expected.specific_force))
    if features:
        # `Calibration` subtracts a formula from the raw samples, which rounds a second time.
        np.testing.assert_allclose(double, wanted, rtol=0, atol=1e-13)
    else:
        assert np.array_equal(double, wanted)
    np.testing.assert_allclose(single, wanted, rtol=0, atol=1e-5)
