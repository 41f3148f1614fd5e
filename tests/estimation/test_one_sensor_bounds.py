"""Coverage and errors of one sensor over the Cramér-Rao bound; `make one-sensor` has more runs."""

import pytest

from bench_module import bench_module

RUNS = 10


@pytest.fixture(scope="module")
def bench():
    """The bench of `make one-sensor`."""
    with bench_module("one_sensor") as module:
        yield module


@pytest.mark.parametrize(
    ("sensor", "moves"), [("accelerometer alone", 23), ("gyroscope, accelerometer given", 13)]
)
def test_intervals_cover_the_truth_and_errors_are_near_the_bound(bench, sensor, moves):
    figures = bench.Figures.of([bench.TRIALS[sensor](moves, seed) for seed in range(1, RUNS + 1)])
    assert (figures.refused, figures.good) == (0, RUNS)
    # Three standard deviations for 90 and 120 parameters, of which those of one run are correlated.
    assert 0.87 <= figures.inside <= 1.0
    assert 0.8 <= figures.ratio <= 1.25
