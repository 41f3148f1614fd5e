"""Whole numbers on their way to the compiled library, which takes none below zero."""

from __future__ import annotations

from numbers import Integral
from typing import Any, Final

from imucal.errors import InputError

__all__ = ["check_count", "check_seed", "check_threads", "is_whole"]

LARGEST_SEED: Final = 2**64 - 1
LARGEST_COUNT: Final = 2**31 - 1


def is_whole(value: Any) -> bool:
    """Whether this is a whole number: NumPy's are, a float is none, whatever its value."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def check_seed(seed: int) -> None:
    """Refuse what is no seed, with InputError."""
    if not is_whole(seed) or not 0 <= seed <= LARGEST_SEED:
        raise InputError(f"seed is {seed!r}: a whole number from 0 to 2^64 - 1 is needed")


def check_count(count: int, what: str) -> None:
    """Refuse what is no count of something, with InputError."""
    if not is_whole(count) or not 1 <= count <= LARGEST_COUNT:
        raise InputError(f"{what} is {count!r}: a whole number, one or more, is needed")


def check_threads(threads: int | None) -> None:
    """Refuse what is no number of threads, with InputError; None takes all processors."""
    if threads is not None:
        check_count(threads, "threads")
