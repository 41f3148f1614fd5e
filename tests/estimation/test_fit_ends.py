"""A fit that has not converged makes the verdict poor.

The fits themselves are in Rust (numerics/fit_report/tests.rs): a bound of five iterations, a flat valley, a
kink. No recording is known that ends like that, so the library's outcome is replaced here.
"""

import pytest

import imucal
import imucal._core as _core

STALLED = "the joint fit stalled after 31 iterations: the result is not its optimum"


class Ended:
    """An outcome whose joint fit ended otherwise."""

    def __init__(self, outcome, termination, reasons):
        self._outcome = outcome
        self.joint_fit = {**outcome.joint_fit, "termination": termination}
        self.verdict, self.reasons = "poor", reasons

    def __getattr__(self, name):
        return getattr(self._outcome, name)


@pytest.fixture(scope="module")
def run():
    return imucal.simulate("random", seed=3, rate_hz=100).recording


def test_a_converged_fit_gives_no_reason(run):
    result = imucal.calibrate(run)
    assert result.fit.joint.termination == "converged"
    assert (result.verdict, result.reasons) == ("good", ())


def test_a_fit_that_has_not_converged_is_poor_and_says_why(run, monkeypatch):
    calibrate = _core.calibrate
    monkeypatch.setattr(_core, "calibrate", lambda *args: Ended(calibrate(*args), "stalled", [STALLED]))
    result = imucal.calibrate(run)
    assert (result.verdict, result.reasons) == ("poor", (STALLED,))
    assert f"verdict: poor; {STALLED}" in result.summary()
    document = result.to_dict()
    assert (document["verdict"], document["reasons"]) == ("poor", [STALLED])
    assert document["fit"]["joint"]["termination"] == "stalled"
