"""The core runs without std and without an allocator, and gives the numbers that Python gives.

`no_std/` is a static library that fails to build when `imucal-core` pulls std or alloc. Linked into a
shared one, with nothing but itself, it is called here through its C interface.

The numbers to compare with come from `imucal._core`, because the public API does not integrate.
"""

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

# Each build overwrites the library of the one before.
pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("tests/no_std")]

ROOT = Path(__file__).resolve().parents[2]
TARGET = ROOT / "tests/no_std/target"

# What every C library for bare metal has; the compiler itself calls these.
MEMORY_ROUTINES = {"memcpy", "memmove", "memset", "memcmp", "bcmp"}

ACCELEROMETER = (
    np.array([[0.9804, 0.0012, 0.0055], [0.0012, 0.9727, 0.0043], [0.0055, 0.0043, 0.9921]]),
    np.array([-0.42, 0.24, 0.39]),
)
GYROSCOPE = (
    np.array([[0.9771, 0.0097, -0.0060], [-0.0084, 1.0309, -0.0031], [0.0087, 0.0036, 1.0030]]),
    np.array([-0.0350, 0.0042, 0.0010]),
)


def need(tool):
    """The path of a tool that the proof cannot do without."""
    path = shutil.which(tool)
    if path is None:
        pytest.fail(
            f"{tool} is not on PATH: this test needs cargo, gcc and nm; install Rust, gcc and binutils"
        )
    return path


def build(root):
    """Build the proof of the tree at `root`."""
    manifest = root / "tests/no_std/Cargo.toml"
    command = [need("cargo"), "build", "--release", "--locked", "--manifest-path", manifest]
    return subprocess.run([*command, "--target-dir", TARGET], capture_output=True, text=True, check=False)


def numbers(dtype, ndim=1):
    """A C argument that takes arrays of this type."""
    return np.ctypeslib.ndpointer(dtype=dtype, ndim=ndim, flags="C_CONTIGUOUS")


@pytest.fixture(scope="module")
def shared_library(tmp_path_factory):
    """Path of the proof as a shared library."""
    done = build(ROOT)
    assert done.returncode == 0, done.stderr
    path = tmp_path_factory.mktemp("no_std") / "libimucal_no_std.so"
    archive = TARGET / "release/libimucal_no_std.a"
    whole = ["-Wl,--whole-archive", archive, "-Wl,--no-whole-archive"]
    link = [need("gcc"), "-shared", "-nostdlib", "-Wl,--gc-sections", "-o", path, *whole]
    linked = subprocess.run(link, capture_output=True, text=True, check=False)
    assert linked.returncode == 0, linked.stderr
    return path


@pytest.fixture(scope="module")
def device(shared_library):
    """The functions of the device."""
    library = ctypes.CDLL(str(shared_library))
    size = ctypes.c_size_t
    for function, dtype in [
        (library.imucal_correct_f64, np.float64),
        (library.imucal_correct_f32, np.float32),
    ]:
        triad, vectors = numbers(dtype), numbers(dtype, 2)
        function.argtypes = [triad, triad, vectors, vectors, size]
        function.restype = ctypes.c_int32
    column, vectors = numbers(np.float64), numbers(np.float64, 2)
    library.imucal_integrate.argtypes = [column, vectors, size, column]
    library.imucal_integrate.restype = None
    samples, rests = [vectors, vectors, size], [numbers(np.uintp, 2), size]
    library.imucal_correct_g_sensitivity.argtypes = [column, size, *samples]
    library.imucal_correct_g_sensitivity.restype = ctypes.c_int32
    library.imucal_find_rests.argtypes = [column, size, ctypes.c_double, *samples, *rests]
    library.imucal_find_rests.restype = ctypes.c_int32
    return library


def correct(function, dtype, accelerometer, gyroscope, rate, force):
    """Correct on the device; gives the status, the rate and the force."""
    triads = [np.concatenate([t.ravel(), b]).astype(dtype) for t, b in (accelerometer, gyroscope)]
    rate, force = rate.astype(dtype), force.astype(dtype)
    return function(*triads, rate, force, len(rate)), rate, force


def integrate(device, time_s, rate):
    """Integrate on the device to the quaternion [w, x, y, z]."""
    wxyz = np.zeros(4)
    device.imucal_integrate(time_s, rate, len(rate), wxyz)
    return wxyz


def angle_between(p, q):
    """The angle between two rotations, rad, good to rounding however small it is."""
    vector = p[0] * q[1:] - q[0] * p[1:] - np.cross(p[1:], q[1:])
    return 2 * np.arctan2(np.linalg.norm(vector), abs(p @ q))


def random_samples(count):
    """Raw rates and forces as a moving unit gives them."""
    random = np.random.default_rng(20)
    return random.normal(0, 2, (count, 3)), random.normal(0, 9.8, (count, 3))


def random_move():
    """Two seconds of an uneven, fast move: time and rate."""
    random = np.random.default_rng(21)
    time_s = 100 + np.cumsum(random.uniform(0.002, 0.02, 200))
    phase = random.uniform(0, 6, 3)
    return time_s, np.sin(time_s[:, None] * [3.0, 5.0, 7.0] + phase) * [4.0, 2.0, 9.0]


def calibration_in_python(accelerometer, gyroscope):
    """The same calibration as an `imucal.Calibration`."""
    import imucal

    return imucal.Calibration(
        accelerometer=imucal.Triad(sensitivity=accelerometer[0], bias=accelerometer[1]),
        gyroscope=imucal.Triad(sensitivity=gyroscope[0], bias=gyroscope[1]),
    )


def test_the_proof_needs_no_symbol_from_outside(shared_library):
    listing = [need("nm"), "-D", "--undefined-only", "--format=posix", shared_library]
    symbols = subprocess.run(listing, capture_output=True, text=True, check=True).stdout
    undefined = {line.split()[0].split("@")[0] for line in symbols.splitlines()}
    assert undefined <= MEMORY_ROUTINES


USE_STD = """
extern crate std;
/// A vector of std.
pub fn used(n: usize) -> std::vec::Vec<u8> { std::vec![0; n] }
"""
USE_ALLOC = USE_STD.replace("std", "alloc")


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        pytest.param(lambda source: source, None, id="no change builds"),
        # std brings a panic handler of its own, the second one.
        pytest.param(lambda source: source + USE_STD, "E0152", id="use std"),
        pytest.param(lambda source: source.replace("#![no_std]\n", ""), "E0152", id="no_std is dropped"),
        # alloc needs a global allocator, and there is none.
        pytest.param(lambda source: source + USE_ALLOC, "no global memory allocator", id="use alloc"),
    ],
)
def test_the_proof_fails_when_the_core_pulls_std_or_alloc(tmp_path, change, reason):
    no_builds = shutil.ignore_patterns("target")
    for part in ["rust", "tests/no_std"]:
        shutil.copytree(ROOT / part, tmp_path / part, ignore=no_builds)
    for part in ["Cargo.toml", "Cargo.lock"]:
        shutil.copy(ROOT / part, tmp_path / part)
    source = tmp_path / "rust/imucal-core/src/lib.rs"
    source.write_text(change(source.read_text()))

    done = build(tmp_path)

    assert (done.returncode == 0) == (reason is None), done.stderr
    assert reason is None or reason in done.stderr


def test_correct_undoes_the_sensor_model(device):
    rate, force = random_samples(1000)
    raw_rate = rate @ GYROSCOPE[0].T + GYROSCOPE[1]
    raw_force = force @ ACCELEROMETER[0].T + ACCELEROMETER[1]
    for function, dtype, rounding in [
        (device.imucal_correct_f64, np.float64, 1e-14),
        (device.imucal_correct_f32, np.float32, 5e-6),
    ]:
        status, rate_back, force_back = correct(
            function, dtype, ACCELEROMETER, GYROSCOPE, raw_rate, raw_force
        )
        assert status == 0
        np.testing.assert_allclose(rate_back, rate, rtol=0, atol=rounding)
        np.testing.assert_allclose(force_back, force, rtol=0, atol=rounding)


def test_a_triad_without_inverse_is_refused(device):
    flat = (np.ones((3, 3)), np.zeros(3))
    rate, force = random_samples(1)
    status, *_ = correct(device.imucal_correct_f64, np.float64, ACCELEROMETER, flat, rate, force)
    assert status == -1


@pytest.mark.parametrize("count", [9, 8])
def test_a_g_sensitivity_is_taken_away(device, count):
    rate, force = random_samples(100)
    g_sensitivity = np.array([[0.02, 0.06, 0.14], [-0.28, 0.004, 0.17], [-0.15, -0.17, 0.05]]) * 1e-3
    corrected_rate, corrected_force = rate + force @ g_sensitivity.T, force.copy()
    values = g_sensitivity.ravel()[:count].copy()
    status = device.imucal_correct_g_sensitivity(values, count, corrected_rate, corrected_force, len(rate))
    assert status == (0 if count == 9 else -1)
    if status == 0:
        np.testing.assert_allclose(corrected_rate, rate, rtol=0, atol=1e-14)
        assert np.array_equal(corrected_force, force)


def test_correct_gives_the_numbers_of_python_to_the_last_bit(device):
    rate, force = random_samples(10_000)
    status, on_device_rate, on_device_force = correct(
        device.imucal_correct_f64, np.float64, ACCELEROMETER, GYROSCOPE, rate, force
    )
    assert status == 0
    in_python_rate, in_python_force = calibration_in_python(ACCELEROMETER, GYROSCOPE).apply(rate, force)
    assert np.array_equal(on_device_rate, in_python_rate)
    assert np.array_equal(on_device_force, in_python_force)


def test_a_constant_turn_is_integrated_to_its_angle(device):
    time_s = np.linspace(0, 2, 201)
    rate = np.tile([0.0, 0.0, 0.4], (201, 1))
    np.testing.assert_allclose(integrate(device, time_s, rate), [np.cos(0.4), 0, 0, np.sin(0.4)], atol=1e-14)


def test_integration_agrees_with_the_batch_one(device):
    import imucal._core as _core

    time_s, rate = random_move()
    assert angle_between(integrate(device, time_s, rate), _core.integrate(time_s, rate)) < 1e-13


def test_rests_are_found_in_a_stream(device):
    random = np.random.default_rng(22)
    rate, force = random.normal(0, 0.003, (3000, 3)), random.normal(0, 0.02, (3000, 3))
    force[:, 2] += 9.8
    rate[1200:1800] += random.normal(0, 1, (600, 3))
    noise_variance = np.array([0.003**2] * 3 + [0.02**2] * 3)
    rests = np.zeros((8, 2), dtype=np.uintp)
    found = device.imucal_find_rests(noise_variance, 10, 3.0, rate, force, len(rate), rests, len(rests))
    # One block of ten is trimmed at either end.
    assert rests[:found].tolist() == [[10, 1190], [1810, 2990]]
