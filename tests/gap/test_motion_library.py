"""Motions that a search advises have the poses that their descriptions name.

The functions are internal, because a search returns only the motion that it advises.
"""

import numpy as np

import imucal
from imucal.gap.motion_library import _circles, _headings


def up_at_rests(steps):
    """The direction of up in the body frame in the middle of the rest after each step, (steps, 3)."""
    run = imucal.simulate(imucal.Program(tuple(steps)), unit="ideal", seed=1)
    end_s = np.cumsum([step.move_s + step.hold_s for step in steps])
    middle_s = end_s - np.array([step.hold_s for step in steps]) / 2
    force = run.truth.specific_force[np.searchsorted(run.recording.time_s, middle_s)]
    return force / np.linalg.norm(force, axis=1, keepdims=True)


def test_headings_are_four_in_each_of_six_poses():
    poses, counts = np.unique(np.round(up_at_rests(_headings()), 6) + 0.0, axis=0, return_counts=True)
    assert sorted(map(tuple, np.abs(poses))) == sorted([(1, 0, 0), (0, 1, 0), (0, 0, 1)] * 2)
    assert (counts >= 4).all()


def test_circles_are_closed():
    up = up_at_rests(_circles().steps)
    assert np.allclose(up[0], up[-1], atol=1e-9)
    # Each body axis points up once and down once, within a step of a circle.
    assert np.allclose(up.min(axis=0), -1, atol=0.02) and np.allclose(up.max(axis=0), 1, atol=0.02)
