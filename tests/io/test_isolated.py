"""Formats whose libraries trust the file are read in a child process with limits."""

import os
import signal
import sys
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io

import imucal
import imucal.io.isolated as isolated
from array_files import ARRAY_WRITERS, canonical
from imucal.io import FORMATS

CORPUS = Path(__file__).parents[1] / "fuzz" / "corpus"
POSIX = pytest.mark.skipif(sys.platform == "win32", reason="the limits are those of POSIX")


@pytest.mark.parametrize(
    ("name", "format", "reason"),
    [
        pytest.param("dataflash_hang.bin", "dataflash", "more memory", marks=POSIX),
        ("dataflash_overflow.bin", "dataflash", "cannot be read as dataflash"),
        pytest.param("mcap_memoryerror.mcap", "mcap", "more memory", marks=POSIX),
        ("ulog_keyerror.ulg", "ulog", "cannot be read as PX4 ULog"),
        ("mat5_segfault.mat", "matlab", "cannot be read as MATLAB"),
        ("mat4_memoryerror.mat", "matlab", "cannot be read as MATLAB"),
        ("parquet_2GB.parquet", "parquet", "damaged or truncated Parquet"),
        ("parquet_unicode.parquet", "parquet", "Parquet"),
    ],
)
def test_damage_that_breaks_a_library_is_an_error_of_the_file(name, format, reason):
    with pytest.raises(imucal.FormatError, match=f"{name} .*{reason}") as caught:
        imucal.read(CORPUS / name, format=format)
    assert any(way in str(caught.value) for way in ("write it again", "save the arrays", "download it"))


@pytest.mark.parametrize("name", ARRAY_WRITERS)
def test_a_recording_from_a_child_is_that_of_the_reader(tmp_path, known, name):
    path = tmp_path / name
    ARRAY_WRITERS[name](path, known)
    recording = imucal.read(path)
    format = {".h5": "hdf5", ".mat": "matlab", ".npz": "numpy"}[path.suffix]
    direct = FORMATS[format].read(path)
    for field in ("time_s", "specific_force", "angular_rate", "temperature_degc"):
        found, expected = getattr(recording, field), getattr(direct, field)
        np.testing.assert_array_equal(found, expected)
        assert found.dtype == expected.dtype
    assert (recording.name, recording.sources) == (direct.name, direct.sources)


def test_findings_and_auxiliary_inputs_come_back(tmp_path, known):
    path = tmp_path / "run.h5"
    with h5py.File(path, "w") as file:
        for name, array in canonical(known).items():
            file[name] = array
        file["fan"] = np.arange(400.0)
        file["counts"] = np.arange(400, dtype=np.int16)
    recording = imucal.read(path)
    np.testing.assert_array_equal(recording.auxiliary["fan"], np.arange(400.0))
    np.testing.assert_array_equal(recording.auxiliary["counts"], np.arange(400.0))


def test_a_name_that_is_not_utf8(tmp_path, known):
    path = os.fsdecode(os.fsencode(tmp_path) + b"/run\xff.h5")
    try:
        ARRAY_WRITERS["run.h5"](tmp_path / "run.h5", known)
        (tmp_path / "run.h5").rename(path)
    except OSError:
        pytest.skip("the file system needs names in UTF-8")
    assert len(imucal.read(path)) == 400


@POSIX
def test_a_child_that_takes_too_long_is_ended(tmp_path, known, monkeypatch):
    scipy.io.savemat(tmp_path / "run.mat", canonical(known))
    monkeypatch.setattr(isolated, "START", "while True: pass")
    monkeypatch.setattr(isolated, "DURATION", 1e-3)
    with pytest.raises(imucal.FormatError, match=r"run.mat cannot be read as MATLAB.*took more than 0 s"):
        imucal.read(tmp_path / "run.mat")


@POSIX
@pytest.mark.parametrize(
    ("number", "reason"),
    [(signal.SIGXCPU, "s of processor time"), (signal.SIGSEGV, r"has crashed \(SIGSEGV\)")],
)
def test_the_cause_of_a_childs_end_is_named(tmp_path, known, monkeypatch, number, reason):
    scipy.io.savemat(tmp_path / "run.mat", canonical(known))
    monkeypatch.setattr(isolated, "START", f"import os; os.kill(os.getpid(), {int(number)})")
    with pytest.raises(imucal.FormatError, match=reason):
        imucal.read(tmp_path / "run.mat")


def test_without_a_child_the_file_is_read_all_the_same(tmp_path, known, monkeypatch):
    scipy.io.savemat(tmp_path / "run.mat", canonical(known))
    monkeypatch.setattr(sys, "executable", "/opt/program/blender")
    assert len(imucal.read(tmp_path / "run.mat")) == 400


def test_only_the_needed_data_sets_are_read(tmp_path, known):
    """Nobody opens the other file of a data set; a data set that is not needed does not matter."""
    outside = tmp_path / "outside.bin"
    np.zeros(400).tofile(outside)
    path = tmp_path / "run.h5"
    with h5py.File(path, "w") as file:
        for name, array in canonical(known).items():
            file[f"run/{name}"] = array
        file.create_dataset("other/secret", (400,), "f8", external=[(str(outside), 0, 3200)])
        file["run/link"] = h5py.ExternalLink("other.h5", "/x")
    assert len(imucal.read(path)) == 400
    with pytest.raises(imucal.FormatError, match="other/secret are in another file"):
        imucal.read(path, columns="time_s=other/secret,accel_mps2=run/accel_mps2,gyro_radps=run/gyro_radps")
    layout = h5py.VirtualLayout((400, 3), "f8")
    layout[:] = h5py.VirtualSource(str(outside), "x", (400, 3))
    with h5py.File(path, "a") as file:
        file.create_virtual_dataset("virtual", layout)
    with pytest.raises(imucal.FormatError, match="virtual are in another file"):
        imucal.read(path, columns="time_s=run/time_ns,accel_mps2=virtual,gyro_radps=run/gyro_radps")


def test_numpy_arrays_that_claim_more_than_the_file_has(tmp_path, known):
    np.savez(tmp_path / "run.npz", **canonical(known))
    with zipfile.ZipFile(tmp_path / "run.npz") as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    huge = members["gyro_radps.npy"].replace(b"(400, 3)", b"(9999,3)")
    with zipfile.ZipFile(tmp_path / "bad.npz", "w") as archive:
        for name, content in {**members, "gyro_radps.npy": huge}.items():
            archive.writestr(name, content)
    with pytest.raises(
        imucal.FormatError, match=r"bad\.npz cannot be read as NumPy: an array of shape \(9999, 3\) needs"
    ):
        imucal.read(tmp_path / "bad.npz")
