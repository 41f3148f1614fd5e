"""Advice about rounding: a smaller range, or dither, gives the truth with smaller standard deviations."""

import numpy as np
import pytest
from advice import advice_about, findings_of, of_code, outcome_of, run

import imucal
from changes import changed, truth_of

# Step of a gyroscope, rad/s, six times the noise of a sample.
STEP = 0.026


def rounded(step: float, dither: float = 0.0) -> imucal.Recording:
    """The good recording with rounded rates, after a vibration of this standard deviation, in steps."""
    good = run().recording
    vibration = dither * step * np.random.default_rng(1).standard_normal(good.angular_rate.shape)
    return changed(good, angular_rate=np.rint((good.angular_rate + vibration) / step) * step)


@pytest.mark.parametrize(
    ("followed", "says"),
    [(rounded(STEP / 16), "smaller range"), (rounded(STEP, dither=0.5), "dither")],
    ids=["smaller range", "dither"],
)
def test_advice_about_rounding(followed: imucal.Recording, says: str) -> None:
    code = of_code("noise_below_lsb")
    spoilt = rounded(STEP)
    assert says in advice_about(code, spoilt)
    assert outcome_of(spoilt, truth_of(run())) == "truth"
    assert code not in [finding.code for finding in findings_of(followed)]
    assert outcome_of(followed, truth_of(run())) == "truth"
