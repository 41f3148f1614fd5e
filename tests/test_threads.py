"""Long recordings are shared out to all processors, which changes no bit of a result."""

import os
import sys
from contextlib import contextmanager

import numpy as np
import pytest

import imucal

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="a process cannot be kept to one processor")


@contextmanager
def one_processor():
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(before)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


@pytest.mark.parametrize("joint", [True, False])
def test_processors_change_no_bit_of_a_calibration(joint):
    # 600,000 samples in moves; fewer are not shared out.
    program = imucal.Program.random(seed=1, moves=30, hold_s=1.5, move_s=2.0)
    recording = imucal.simulate(program, rate_hz=10_000.0, seed=1).recording
    results = [imucal.calibrate(recording, joint=joint)]
    with one_processor():
        results.append(imucal.calibrate(recording, joint=joint))
    ours, alone = ([(p.value, p.std) for p in result.parameters] for result in results)
    assert ours == alone
    assert len(results[0].moves) == 30
    covariances = [np.asarray(result.calibration.covariance) for result in results]
    np.testing.assert_array_equal(*covariances)
