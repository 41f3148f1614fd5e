"""Serial port of a GRBL controller: a thread receives lines, stamps each on arrival, and queries the status.

The thread continues while the recording waits for the disk or the processor, so that the times of the
reports do not depend on the load of the computer.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, Final

from imucal.stand.clock import Clock
from imucal.stand.link import LinkLostError

__all__ = ["GOLDEN", "HOLD", "RESET", "RESUME", "STATUS", "GrblPort"]

# Single-character commands, which the controller executes at once, even if they arrive within a line.
RESET, HOLD, RESUME, STATUS = b"\x18", b"!", b"~", b"?"
# Shortest interval between two status queries, s. Angles between two reports are interpolated linearly, which
# at an acceleration of 1000 deg/s^2 gives an error of 0.2 deg with this interval.
QUERY_S: Final = 0.04
# Relative variation of the intervals between queries. Some controllers and ports have a fixed cycle (20 ms in
# a simulator, 16 ms in a USB converter). With equal intervals, all reports could have the same delay, and no
# undelayed report would correct the instants of the others (grbl_times.py).
SPREAD: Final = 0.25
# Golden ratio minus 1. Its multiples modulo 1, which vary the intervals, are evenly distributed from 0 to 1.
GOLDEN: Final = 0.618
# Length of the longest report, characters. The rate of queries is limited, so that reports of this length use
# at most a third of the capacity of the serial line.
REPORT_LENGTH: Final = 90
# Longest wait for a byte, s. After the wait the thread checks whether a query is due.
WAIT_S: Final = 0.01
# A line without a line end that is longer than this number of characters counts as damaged, because no line
# of GRBL is longer.
LONGEST: Final = 512
# If more than this number of consecutive reports seem late by one query interval, one query counts as lost.
LOST_AFTER: Final = 4
# A query counts as lost if the next report arrives later than the shortest delay plus this time, s, and a
# later query is waiting for an answer.
LOST_S: Final = 0.25
# Timeout for the end of a thread, s.
JOIN_S: Final = 1.0


class GrblPort:
    """A port with its listening thread. Methods except `close` raise LinkLostError once the device is gone.

    queries     whether the thread sends status queries
    shortest_s  shortest time between a query and its report, s; None until the driver has measured it
    """

    def __init__(self, port: str, baud: int, open_port: Callable[[str, int], Any], clock: Clock) -> None:
        self.name = port
        self.queries = True
        self.shortest_s: float | None = None
        self.baud, self._open_port, self._clock = baud, open_port, clock
        self._query_s = max(QUERY_S, 3 * REPORT_LENGTH * 10 / baud)
        self._port: Any = None
        self._lost: str | None = None
        self._lines: deque[tuple[float, float | None, str]] = deque()
        # Host times of the unanswered queries.
        self._asked: deque[float] = deque()
        self._shifted = 0
        # Lock for writing, because a status query of the thread must not be written in the middle of a line.
        self._writing = threading.Lock()
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def is_open(self) -> bool:
        """Whether the port is open on the host."""
        return self._port is not None and self._lost is None

    def open(self) -> None:
        """Open or reopen the port and start to listen."""
        self.close()
        self._lines.clear()
        self.forget_queries()
        self._lost = None
        self._port = self._open_port(self.name, self.baud)
        self._port.timeout = WAIT_S
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._listen, args=(self._closing,), daemon=True)
        self._thread.start()

    def send(self, data: bytes) -> None:
        """Send all bytes."""
        port = self._port
        if port is None or self._lost is not None:
            raise LinkLostError(f"{self.name} is lost: {self._lost or 'it is closed'}")
        try:
            with self._writing:
                port.write(data)
        # Any exception is caught, because for a lost device pyserial also raises exceptions of other modules,
        # such as termios.
        except Exception as error:
            self._lost = str(error)
            raise LinkLostError(f"{self.name} is lost: {error}") from None

    def received(self) -> Sequence[tuple[float, float | None, str]]:
        """Complete lines since the last call: host time of arrival, host time of the query, and text."""
        lines = []
        while self._lines:
            lines.append(self._lines.popleft())
        if not lines and self._lost is not None:
            raise LinkLostError(f"{self.name} is lost: {self._lost}")
        return lines

    def forget_queries(self) -> None:
        """Forget the unanswered queries."""
        self._asked.clear()

    def close(self) -> None:
        """Close the port. This never raises an exception."""
        self._closing.set()
        if self._port is not None:
            with suppress(Exception):
                self._port.cancel_read()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(JOIN_S)
        if self._port is not None:
            # pyserial may raise when it closes a port whose device is gone.
            with suppress(Exception):
                self._port.close()
        self._port = self._thread = self._lost = None

    def _listen(self, closing: threading.Event) -> None:
        port, left, queried_s, count = self._port, b"", -self._query_s, 0
        try:
            while not closing.is_set():
                data = port.read(1)
                now_s = self._clock.now_s()
                if data:
                    data += port.read(port.in_waiting) if port.in_waiting else b""
                    *lines, left = (left + data).split(b"\n")
                    if len(left) > LONGEST:
                        lines, left = [*lines, left], b""
                    for line in lines:
                        text = line.decode("ascii", "replace").strip()
                        if text:
                            asked_s = self._query_of(now_s) if text.endswith(">") else None
                            self._lines.append((now_s, asked_s, text))
                interval_s = self._query_s * (1.0 + SPREAD * (count * GOLDEN % 1.0))
                if self.queries and now_s - queried_s >= interval_s and not closing.is_set():
                    queried_s, count = now_s, count + 1
                    self._asked.append(now_s)
                    with self._writing:
                        port.write(STATUS)
        except Exception as error:
            self._lost = str(error)

    def _query_of(self, now_s: float) -> float | None:
        """Host time of the query that a report answers. Queries are answered in order, but may be lost."""
        shortest_s = self.shortest_s
        if shortest_s is None or not self._asked:
            return None

        def next_is_old_enough() -> bool:
            return len(self._asked) > 1 and now_s - self._asked[1] > 0.8 * shortest_s

        while now_s - self._asked[0] > shortest_s + LOST_S and next_is_old_enough():
            self._asked.popleft()
        # After the loss of a single query, each later answer is assigned to the query before its own and
        # therefore seems late by one interval.
        seems_late = now_s - self._asked[0] > shortest_s + 0.75 * self._query_s
        self._shifted = self._shifted + 1 if seems_late and next_is_old_enough() else 0
        if self._shifted > LOST_AFTER:
            self._shifted = 0
            self._asked.popleft()
        return self._asked.popleft()
