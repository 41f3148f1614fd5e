"""Temperature sampled more slowly than the sensors: each reading is held until the next reading."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from imucal.recording.recording import Recording

__all__ = ["LONGEST_HELD_S", "hold_temperature"]

# Maximum time for which a temperature reading is held, s. Even during warm-up the temperature changes only by
# some hundredths of a kelvin in this time.
LONGEST_HELD_S: Final = 10.0


def hold_temperature(
    pieces: Iterable[Recording], *, longest_s: float = LONGEST_HELD_S
) -> Iterator[Recording]:
    """The pieces of a recording, with missing temperatures (NaN) replaced by the last reading before them.

    longest_s  maximum time for which a reading is held, s; later samples stay NaN. Samples before the first
               reading of the first piece get this reading if it follows within `longest_s`.
    """
    last_s, last_degc = np.nan, np.nan
    for number, piece in enumerate(pieces):
        if piece.temperature_degc is None or not len(piece):
            yield piece
            continue
        time_s = np.concatenate([[last_s], piece.time_s])
        degc = np.concatenate([[last_degc], piece.temperature_degc])
        is_known = np.isfinite(degc)
        source = np.maximum.accumulate(np.where(is_known, np.arange(len(degc)), 0))
        if number == 0 and is_known.any():
            first = int(is_known.argmax())
            source[:first] = first
        is_near = np.abs(time_s - time_s[source]) <= longest_s
        held = np.where(is_near, degc[source], np.nan)
        last_s, last_degc = time_s[source[-1]], degc[source[-1]]
        yield replace(piece, temperature_degc=held[1:])
