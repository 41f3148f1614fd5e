"""Damaged digits in times that come as text without a checksum."""

import numpy as np
import pytest

from imucal.stand.lines import LineDecoder
from imucal.stand.stream import StreamSource
from imucal.stand.time_check import TimeCheck
from serial_lines import Fed


def paced(texts, rate_hz=100.0, stalls=(), template="time_us,a"):
    """Rows from lines that arrive at a rate; those of a stall arrive together at its end."""
    decoder = LineDecoder(template)
    check = TimeCheck(0, 1e6)
    rows, late = [], []
    for number, text in enumerate(texts):
        late.append(text)
        if any(first <= number < last for first, last in stalls):
            continue
        for line in late:
            for row in decoder.feed(f"{line}\n".encode()):
                rows += [passed for passed, _ in check.passed(row, 5.0 + number / rate_hz)]
        late = []
    return rows, check


def timed_lines(count, begin_us=1_000_000, step_us=10_000):
    return [f"{begin_us + step_us * n},{n}" for n in range(count)]


@pytest.mark.parametrize(
    "damage",
    [
        lambda text: text[1:],
        lambda text: text[:3] + text[4:],
        lambda text: "9" + text[1:],
        lambda text: "1" + text,
        lambda text: text[:2] + "9" + text[3:],
    ],
    ids=["first digit lost", "digit lost", "digit changed", "digit doubled", "ahead by seconds"],
)
def test_a_line_with_a_damaged_time_costs_its_sample_alone(damage):
    lines = timed_lines(300)
    for number in (1, 120, 200, 202, 250):
        lines[number] = damage(lines[number])
    rows, check = paced(lines, stalls=((60, 90), (150, 199)))
    # The last row waits for the next one.
    left_out = {1, 120, 200, 202, 250, 299}
    assert [row[1] for row in rows] == [n for n in range(300) if n not in left_out]
    assert check.damaged == 5 and not check.is_void


def test_the_first_line_may_be_the_end_of_a_line():
    lines = timed_lines(50)
    lines[0] = lines[0][3:]
    rows, check = paced(lines)
    assert [row[1] for row in rows] == list(range(1, 49))
    assert check.damaged == 1


def test_lost_lines_a_late_delivery_and_a_restart_are_no_damage():
    lines = timed_lines(100) + timed_lines(100, 20_000)
    del lines[30:55]
    # After a stall many lines arrive at once, with times that have gone on.
    rows, check = paced(lines, stalls=((70, 73), (100, 160)))
    assert len(rows) == 174 and check.damaged == 0


@pytest.mark.parametrize("step_us", [9_850, 10_150])
def test_a_unit_with_a_clock_of_its_own_rate_passes(step_us):
    rows, check = paced(timed_lines(3000, step_us=step_us))
    assert len(rows) == 2999 and check.damaged == 0


def test_a_time_in_another_unit_is_said_and_passes():
    lines = [f"{1000 * n}000,{n}" for n in range(300)]
    source = StreamSource(Fed(*(f"{line}\n".encode() for line in lines)), LineDecoder("time_us,a"))
    source.start()
    rows, codes = [], []
    while "unit_link_lost" not in codes:
        rows.append(source.read(0.05))
        codes += [event.code for event in source.events()]
    rows.append(source.read(0.0))
    assert codes.count("unit_time_unchecked") == 1
    assert len(np.concatenate(rows)) == 300
    # Lines with a checksum need no check.
    assert "times_damaged" not in StreamSource(Fed(), LineDecoder("time_us,a*")).counts()
