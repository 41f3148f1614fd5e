"""Coverage and errors of one sensor over the Cramér-Rao bound; `make one-sensor` has more runs."""

import importlib.util
import sys
from pathlib import Path

import pytest

BENCHES = Path(__file__).resolve().parents[2] / "benches"
RUNS = 10


@pytest.fixture(scope="module")
def bench():
    """The bench of `make one-sensor`; its other modules are found beside it."""
    sys.path.insert(0, str(BENCHES))
    try:
        spec = importlib.util.spec_from_file_location("one_sensor_bench", BENCHES / "one_sensor.py")
        module = importlib.util.module_from_spec(spec)
        sys.modules["one_sensor_bench"] = module
        spec.loader.exec_module(module)
        yield module
    finally:
        sys.path.remove(str(BENCHES))
        sys.modules.pop("one_sensor_bench", None)


@pytest.mark.parametrize(
    ("sensor", "moves"), [("accelerometer alone", 23), ("gyroscope, accelerometer given", 13)]
)
def test_intervals_cover_the_truth_and_errors_are_near_the_bound(bench, sensor, moves):
    figures = bench.Figures.of([bench.TRIALS[sensor](moves, seed) for seed in range(1, RUNS + 1)])
    assert (figures.refused, figures.good) == (0, RUNS)
    # Three standard deviations for 90 and 120 parameters, of which those of one run are correlated.
    assert 0.87 <= figures.inside <= 1.0
    assert 0.8 <= figures.ratio <= 1.25
