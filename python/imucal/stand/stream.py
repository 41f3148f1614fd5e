"""Samples of a real unit. Bytes are received in a thread and decoded, and lost samples are counted."""

from __future__ import annotations

import math
import queue
import threading
from collections.abc import Sequence
from typing import Final, Protocol

import numpy as np

import imucal.units as units
from imucal.arrays import FloatArray
from imucal.errors import ImucalError, InputError
from imucal.stand.clock import SYSTEM_CLOCK, Clock
from imucal.stand.continuation import WRAP_SHARE, Continuation
from imucal.stand.driver import Event
from imucal.stand.journal import Logged
from imucal.stand.link import Link, LinkLostError
from imucal.stand.time_check import TimeCheck, Timed

__all__ = ["StreamSource"]

# Pause before a lost link is opened again, s.
REOPEN_S: Final = 0.3
TICKS_PER_S: Final = {f"time_{unit}": ticks for unit, ticks in units.TICKS_PER_S.items()}
# Column name of a packet counter.
SEQUENCE: Final = "sequence"


class Decoder(Protocol):
    """Converts bytes to rows of numbers.

    wraps_at    value at which each column wraps, or None
    is_checked  whether a checksum proves that a row is intact
    """

    columns: tuple[str, ...]
    wraps_at: tuple[float | None, ...]
    is_checked: bool

    def feed(self, data: bytes) -> list[tuple[float, ...]]: ...

    def counts(self) -> dict[str, int]: ...

    @property
    def remark(self) -> str:
        """A sentence on the last data that could not be decoded; empty if all data were decoded."""


class StreamSource:
    """Reads a link in a separate thread, so that no bytes are lost while the main thread waits for the disk.

    rate_hz  sampling rate, Hz, for a unit that sends no time; with a column `sequence`, lost samples leave
             gaps in time

    Counters that wrap to zero are unwrapped. Times in text without a checksum are checked against the host
    clock, and rows with a damaged time are omitted. Raises InputError if the time of a sample cannot be
    determined.
    """

    def __init__(
        self,
        link: Link,
        decoder: Decoder,
        *,
        rate_hz: float | None = None,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        self._link, self._decoder, self._clock = link, decoder, clock
        names = decoder.columns
        self._time = next((i for i, name in enumerate(names) if name in TICKS_PER_S), None)
        self._sequence = names.index(SEQUENCE) if SEQUENCE in names else None
        if (self._time is None) == (rate_hz is None):
            raise InputError(
                f"the unit sends {', '.join(names)}: "
                + (
                    "name a column time_s, time_ms, time_us or time_ns, or give --sample-rate"
                    if rate_hz is None
                    else "the data contain a time, so leave the sample rate out"
                )
            )
        if rate_hz is not None and not rate_hz > 0:
            raise InputError(f"the sample rate is {rate_hz}: give a positive number, Hz")
        self._rate_hz = rate_hz
        # Index of the column from which the time is computed, or None, and its counts per second.
        self._counter = self._sequence if self._time is None else self._time
        self._per_s = TICKS_PER_S[names[self._time]] if self._time is not None else rate_hz or 1.0
        self._check = (
            TimeCheck(self._counter, self._per_s)
            if self._counter is not None
            and not decoder.is_checked
            and decoder.wraps_at[self._counter] is None
            else None
        )
        self._kept = [i for i in range(len(names)) if i != self._sequence]
        self.columns = (*(() if rate_hz is None else ("time_s",)), *(names[i] for i in self._kept))
        self._before: tuple[float, ...] | None = None
        self._last_sample_s = 0.0
        self._numbered = 0
        # Holds samples back after an interruption until their time is known; None at other times.
        self._continuation: Continuation | None = None
        self._shift = [0.0] * len(names)
        self._count = {
            "samples": 0,
            "packets_missing": 0,
            "packets_repeated": 0,
            "unit_restarts": 0,
            "counters_not_finite": 0,
        }
        self._events: list[Event] = []
        # Number of bytes received, decoded or not.
        self.bytes_received = 0
        self._arrived: queue.SimpleQueue[tuple[float, bytes | Event]] = queue.SimpleQueue()
        # Host time of arrival of each sample of the last `read`, s.
        self._arrivals: list[float] = []
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._receive, daemon=True)

    def start(self) -> None:
        """Open the link. Raises ImucalError on failure."""
        try:
            self._link.open()
        except LinkLostError as error:
            raise ImucalError(f"cannot connect to the unit: {error}") from None
        self._thread.start()

    def read(self, wait_s: float) -> FloatArray:
        """Samples since the last call, (N, columns). Waits at most `wait_s` seconds for the first sample."""
        rows: list[list[float]] = []
        self._arrivals = []
        try:
            at_s, arrived = self._clock.next_item(self._arrived, wait_s)
            while True:
                if isinstance(arrived, Event):
                    self._events.append(arrived)
                    # If the data contain neither time nor sequence number, the time is computed from the
                    # number of samples. The duration of the interruption must then be added to this time.
                    if arrived.code == "unit_link_back" and self._numbered and self._sequence is None:
                        self._interrupt((self._numbered - 1) / self._per_s, self._last_sample_s)
                else:
                    self.bytes_received += len(arrived)
                    for raw in self._decoder.feed(arrived):
                        self._take(self._checked(raw, at_s), rows)
                at_s, arrived = self._arrived.get_nowait()
        except queue.Empty:
            now_s = self._clock.now_s()
            if self._check is not None:
                self._take(self._check.overdue(now_s), rows)
            self._continue(now_s, rows)
        self._count["samples"] += len(rows)
        return np.array(rows, dtype=np.float64).reshape(-1, len(self.columns))

    def resume_after(self, logged: Logged) -> None:
        """Let the time stamps continue after the last sample of an interrupted run.

        The clock of the host gives the length of the interruption.
        """
        if len(logged.samples):
            self.continue_after(logged.samples[-1], float(logged.host_s[-1]))

    def continue_after(self, row: FloatArray, host_s: float) -> None:
        """Continue the time stamps after the sample `row`, (columns,), that arrived at host time `host_s`."""
        name = "time_s" if self._time is None else self._decoder.columns[self._time]
        self._interrupt(float(row[self.columns.index(name)]) / TICKS_PER_S[name], host_s)

    def arrivals(self) -> FloatArray:
        """Host time of arrival of each sample of the last `read`, (N,), s."""
        return np.array(self._arrivals, dtype=np.float64)

    def events(self) -> Sequence[Event]:
        """Events since the last call."""
        events, self._events = self._events, []
        return events

    def counts(self) -> dict[str, int]:
        """Counts of received, lost and damaged data by stable names."""
        checked = {} if self._check is None else {"times_damaged": self._check.damaged}
        return {**self._count, **checked, **self._decoder.counts()}

    @property
    def comes_back(self) -> bool:
        """Whether a lost link can be opened again."""
        return self._link.comes_back

    @property
    def hint(self) -> str:
        """Instruction that tells the user how to make the unit send data; empty if the link has none."""
        return self._link.hint

    @property
    def remark(self) -> str:
        """A sentence on the last data that could not be decoded; empty if all data were decoded."""
        return self._decoder.remark

    def close(self) -> None:
        """Stop reading and close the link."""
        self._closed.set()
        if self._thread.is_alive() and self._link.comes_back:
            self._thread.join(timeout=1.0)
        self._link.close()

    def _receive(self) -> None:
        while not self._closed.is_set():
            try:
                data = self._link.read()
                if data:
                    # The host time of arrival is recorded in this thread, because the main thread may be
                    # waiting for the disk.
                    self._put(data)
            except LinkLostError as error:
                if self._closed.is_set():
                    return
                self._put(Event("unit_link_lost", str(error)))
                if not self._link.comes_back or not self._reopened():
                    return
                self._put(Event("unit_link_back", f"{self._link.name} is open again"))

    def _put(self, item: bytes | Event) -> None:
        self._arrived.put((self._clock.now_s(), item))

    def _reopened(self) -> bool:
        while not self._closed.is_set():
            self._link.close()
            try:
                self._link.open()
                return True
            except LinkLostError:
                self._closed.wait(REOPEN_S)
        return False

    def _take(self, timed: Sequence[Timed], rows: list[list[float]]) -> None:
        """Convert decoded rows to samples; append these to `rows`, and their arrival times to `_arrivals`."""
        for raw, arrived_s in timed:
            if not self._are_finite(raw):
                self._count["counters_not_finite"] += 1
            elif self._continuation is not None:
                waiting = len(self._continuation.waiting)
                count = float(waiting) if self._counter is None else raw[self._counter]
                self._continuation.add((raw, arrived_s), count)
                self._continue(arrived_s, rows)
            else:
                self._add(raw, arrived_s, rows)

    def _add(self, raw: tuple[float, ...], arrived_s: float, rows: list[list[float]]) -> None:
        if row := self._sample(raw, arrived_s):
            rows.append(row)
            self._arrivals.append(arrived_s)

    def _checked(self, raw: tuple[float, ...], at_s: float) -> Sequence[Timed]:
        """The rows that are now known to be undamaged, with their host times of arrival.

        The new row `raw` may be held back until the next row confirms its time.
        """
        if self._check is None:
            return [(raw, at_s)]
        was_void = self._check.is_void
        passed = self._check.passed(raw, at_s)
        if self._check.is_void and not was_void:
            self._events.append(
                Event(
                    "unit_time_unchecked",
                    "the unit's clock and the clock of this computer differ in rate, so damaged times "
                    "cannot be detected: check the unit of the time column, or send lines with a checksum",
                )
            )
        return passed

    def _are_finite(self, raw: tuple[float, ...]) -> bool:
        return all(math.isfinite(raw[i]) for i in (self._time, self._sequence) if i is not None)

    def _sample(self, raw: tuple[float, ...], now_s: float) -> list[float] | None:
        """A sample with unwrapped counters; None for a repeated packet."""
        row = list(raw)
        for i in (self._time, self._sequence):
            if i is not None:
                row[i] = self._continued(i, raw[i], now_s)
        if self._sequence is not None and self._before is not None:
            step = row[self._sequence] - self._before[self._sequence]
            if step == 0:
                self._count["packets_repeated"] += 1
                return None
            self._count["packets_missing"] += max(int(step) - 1, 0)
        self._before, self._last_sample_s = tuple(row), now_s
        kept = [row[i] for i in self._kept]
        if self._rate_hz is None:
            return kept
        number = self._numbered if self._sequence is None else row[self._sequence]
        self._numbered += 1
        return [number / self._per_s, *kept]

    def _interrupt(self, last_s: float, host_s: float) -> None:
        """Hold new samples back until the time since the last sample (arrival at `host_s`) is known."""
        self._continuation = Continuation(
            last_s,
            host_s,
            per_s=self._per_s,
            turn=None if self._counter is None else self._decoder.wraps_at[self._counter],
            is_clock=self._time is not None,
        )

    def _continue(self, now_s: float, rows: list[list[float]]) -> None:
        """Append the samples that were held back to `rows`, once the time since the last sample is known."""
        found = self._continuation
        if found is None or (shift := found.shift(now_s)) is None:
            return
        self._continuation = None
        if self._time is not None:
            self._shift[self._time] = shift
        elif self._sequence is not None:
            self._shift[self._sequence] = round(shift)
        else:
            self._numbered = round(shift)
        for raw, arrived_s in found.waiting:
            self._add(raw, arrived_s, rows)

    def _continued(self, i: int, raw: float, now_s: float) -> float:
        """The value of a counter without its jumps at wraps to zero and at restarts of the unit."""
        value = raw + self._shift[i]
        if self._before is None or value >= self._before[i]:
            return value
        last, turn = self._before[i], self._decoder.wraps_at[i]
        if turn is not None and last - self._shift[i] >= WRAP_SHARE * turn and raw <= (1 - WRAP_SHARE) * turn:
            self._shift[i] += turn
            return raw + self._shift[i]
        # The unit has restarted. The duration of the restart is taken from the host clock, because the clock
        # of the unit did not run.
        if i == self._time:
            self._count["unit_restarts"] += 1
            self._events.append(
                Event("unit_restarted", f"the unit's clock fell from {last:g} to {value:g}: it has restarted")
            )
            elapsed = (now_s - self._last_sample_s) * TICKS_PER_S[self._decoder.columns[i]]
        else:
            elapsed = 1.0
        self._shift[i] = last + elapsed - raw
        return last + elapsed
