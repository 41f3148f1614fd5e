"""A pool of processes, each bound to one processor, so that their threads do not compete."""

import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor
from multiprocessing.sharedctypes import Synchronized

__all__ = ["pool_of"]


def pool_of(count: int | None) -> ProcessPoolExecutor:
    """A pool with this number of processes, by default the number of processors."""
    return ProcessPoolExecutor(count, initializer=_take_one, initargs=(multiprocessing.Value("i", 0),))


def _take_one(turn: "Synchronized[int]") -> None:
    with turn.get_lock():
        own = turn.value
        turn.value += 1
    if hasattr(os, "sched_setaffinity"):
        allowed = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {allowed[own % len(allowed)]})
