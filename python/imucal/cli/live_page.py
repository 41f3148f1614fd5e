"""The HTML page of a fleet, which a separate process writes repeatedly during a run."""

from __future__ import annotations

import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Final

__all__ = ["RELOAD_S", "LivePage"]

# Interval at which the browser reloads the page, and minimum interval between two writings of the page, s.
RELOAD_S: Final = 10.0
# Largest share of the time of a run during which the page may be written. The share is limited because
# writing occupies a processor that the run could use. Writing the page of a store with 100,000 units takes a
# minute.
SHARE: Final = 0.2


class LivePage:
    """Writes the page of a store in a separate process, at most every ten seconds.

    store, page, limits   as for `imucal fleet report`
    """

    def __init__(self, store: Path, page: Path, limits: Path | None) -> None:
        self._words = [
            *(sys.executable, "-m", "imucal", "fleet", "report", str(store), "-o", str(page)),
            *(() if limits is None else ("--limits", str(limits))),
        ]
        self._process: subprocess.Popen[bytes] | None = None
        self._started_s = self._next_s = time.monotonic()

    def step(self) -> None:
        """If the last page is old enough, start a process that writes a new one. Called after each unit."""
        now_s = time.monotonic()
        if self._process is not None and self._process.poll() is not None:
            self._process = None
            self._next_s = self._started_s + max(RELOAD_S, (now_s - self._started_s) / SHARE)
        if self._process is None and now_s >= self._next_s:
            self._started_s = now_s
            # The output of this process is discarded. Until the store contains a calibration, the process
            # prints an error message, which is expected.
            self._process = subprocess.Popen(
                [*self._words, "--reload", f"{RELOAD_S:g}"],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                # The process gets a separate session, so that Ctrl-C in a terminal reaches only the run,
                # which then ends this process.
                start_new_session=True,
            )

    def close(self) -> None:
        """End the process that writes the page."""
        if self._process is not None:
            with suppress(OSError):
                self._process.kill()
            self._process.wait()
            self._process = None
