"""Number of calls of the compiled library in a search: one question takes one call.

Calls cannot be seen from outside, so the functions of `imucal._core` are replaced.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import imucal
import imucal._core as _core

MOST_CALLS = 20


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Calls by name; each function and class of the library is replaced by one that counts."""
    counts: Counter[str] = Counter()

    def counted(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **named: Any) -> Any:
            counts[name] += 1
            return function(*arguments, **named)

        return call

    for name, value in vars(_core).items():
        if callable(value) and not name.startswith("__"):
            monkeypatch.setattr(_core, name, counted(name, value))
    return counts


def test_a_search_with_a_control_record_calls_the_library_a_few_times(calls: Counter[str]) -> None:
    hidden = [imucal.EffectValues("gyro_g_sensitivity", 3e-4 * np.array([1, -1, 1, 0, 1, -1, 1, 0, -1.0]))]
    run, control = (
        dataclasses.replace(
            imucal.simulate("random", seed=seed, rate_hz=100.0, effects=hidden).recording,
            stand_rad=None,
            name=f"run {seed}",
        )
        for seed in (3, 4)
    )
    calls.clear()
    gap = imucal.find_gap(run, control=control)
    assert gap.verdict == "named", gap.summary()
    assert 1 <= sum(calls.values()) <= MOST_CALLS, calls
