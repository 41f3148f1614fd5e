"""README and tutorial print the digits that they show on every processor of the x86-64 family.

The library uses the widest vector instructions of the processor. The order of sums depends on their width,
and so do the last bits of a result. The environment variable IMUCAL_VECTOR_BITS selects a width. The linear
algebra library faer still selects its instructions by the processor.
"""

import os
import platform
import shutil
import subprocess
import sys

import pytest

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="not a processor with AVX"),
]

WIDTHS = {"AVX2": "256", "AVX-512": "512"}
ALL_BITS = """
import imucal
run = imucal.simulate("random", seed=1, rate_hz=50.0).recording
print([parameter.value.hex() for parameter in imucal.calibrate(run).parameters])
"""


def bits(width):
    """All bits of a calibration."""
    environment = {**os.environ, "IMUCAL_VECTOR_BITS": width}
    command = [sys.executable, "-c", ALL_BITS]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout


@pytest.fixture(scope="module", params=WIDTHS.values(), ids=WIDTHS)
def width(request):
    """A width in bits that this library can compute with."""
    if request.param == "512" and bits("512") == bits("256"):
        pytest.skip("no AVX-512, and the library is built without its emulation: make test-vectors")
    return request.param


@pytest.fixture(scope="module")
def one_of_both(width):
    """A width that this library can compute with, as with another one."""
    if bits("512") == bits("256"):
        pytest.skip("the only width of this library and this processor, with which test_readme.py runs")
    return width


def test_the_readme_shows_the_digits_that_are_printed(run_page, one_of_both, tmp_path):
    assert run_page("README.md", tmp_path, IMUCAL_VECTOR_BITS=one_of_both) >= 7


def test_the_tutorial_shows_the_digits_that_are_printed(run_page, one_of_both, tmp_path, data_file):
    for name in ("xsens_acc.mat", "xsens_gyro.mat"):
        shutil.copy(data_file(f"xsens_mti/{name}"), tmp_path)
    assert run_page("docs/tutorial-xsens.md", tmp_path, IMUCAL_VECTOR_BITS=one_of_both) == 7


def test_the_width_is_that_of_the_environment(width):
    assert len({bits("64"), bits(width)}) == 2
    assert bits("") in map(bits, WIDTHS.values())
