"""Arrays of any layout, type and content, as recordings and as arguments of a calibration."""

import numpy as np
import pytest

import imucal
from bad_recordings import good_result
from changes import (
    stand_run,
)
from imucal import InputError, Recording

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
