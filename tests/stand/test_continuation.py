"""The time of samples after an interruption, by the class itself, because a run cannot be given arrivals."""

import pytest

from imucal.stand.continuation import WAITS_S, Continuation

# The last sample before the interruption: its time, and the host time at which it arrived, s.
LAST_S, HOST_S = 100.0, 5000.0
PER_S = 1000.0


def shift_of(counts, arrivals, *, turn=None, is_clock=True):
    """The shift of the counter, and the number of samples that had to wait for it."""
    found = Continuation(LAST_S, HOST_S, per_s=PER_S, turn=turn, is_clock=is_clock)
    for count, arrived_s in zip(counts, arrivals, strict=True):
        found.add(((count,), arrived_s), count)
        if (shift := found.shift(arrived_s)) is not None:
            return shift, len(found.waiting)
    return None, len(counts)


def ticks(start_s, number):
    """Counts of samples every 10 ms from a time, and these times, s."""
    times = [start_s + 0.01 * i for i in range(number)]
    return [PER_S * time_s for time_s in times], times


def test_the_clock_of_the_unit_has_continued():
    counts, times = ticks(LAST_S + 7.0, 10)
    assert shift_of(counts, [HOST_S - LAST_S + t for t in times]) == (0.0, 1)


@pytest.mark.parametrize("stored_s", [0.5, 3.0, 40.0])
def test_samples_that_were_stored_arrive_late(stored_s):
    """All samples since the interruption come at once, then samples come as they are taken."""
    counts, times = ticks(LAST_S + 0.01, int(100 * stored_s) + 100)
    arrivals = [HOST_S - LAST_S + max(t, LAST_S + stored_s) for t in times]
    assert shift_of(counts, arrivals)[0] == 0.0


def test_a_counter_wraps_among_stored_samples():
    turn = 2.0**16
    # The counter has wrapped once before, and wraps at 131.072 s again.
    counts, times = ticks(130.0, 400)
    arrivals = [HOST_S - LAST_S + max(t, 133.0) for t in times]
    assert shift_of([count % turn for count in counts], arrivals, turn=turn)[0] == turn


@pytest.mark.parametrize("stored_s", [0.0, 0.7])
def test_a_unit_that_has_restarted_continues_by_the_host_clock(stored_s):
    counts, times = ticks(0.2, 400)
    # It was switched on 9 s after the interruption.
    arrivals = [HOST_S + 9.0 + max(t, stored_s) for t in times]
    shift, waited = shift_of(counts, arrivals)
    assert shift == pytest.approx(PER_S * (LAST_S + 9.0))
    assert arrivals[waited - 1] - arrivals[0] == pytest.approx(WAITS_S, abs=0.02)


def test_a_unit_without_a_clock_continues_by_its_least_delayed_sample():
    arrivals = [HOST_S + 4.0 + max(0.001 * i, 1.5) for i in range(4000)]
    shift, _ = shift_of(range(4000), arrivals, is_clock=False)
    assert shift == pytest.approx(PER_S * (LAST_S + 4.0))
