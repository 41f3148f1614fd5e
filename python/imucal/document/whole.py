"""Checks of integer arguments for the compiled library, which accepts only non-negative integers."""

from __future__ import annotations

from numbers import Integral
from typing import Any, Final

from imucal.errors import InputError

__all__ = ["check_count", "check_seed", "check_threads", "is_whole"]

LARGEST_SEED: Final = 2**64 - 1
LARGEST_COUNT: Final = 2**31 - 1


def is_whole(value: Any) -> bool:
    """Whether a value is of an integer type, including NumPy integers. False for a float such as 2.0."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def check_seed(seed: int) -> None:
    """Raise InputError unless `seed` is an integer from 0 to 2^64 - 1."""
    if not is_whole(seed) or not 0 <= seed <= LARGEST_SEED:
        raise InputError(f"seed is {seed!r}: a whole number from 0 to 2^64 - 1 is needed")


def check_count(count: int, what: str) -> None:
    """Raise InputError, which names `what`, unless `count` is an integer from 1 to 2^31 - 1."""
    if not is_whole(count) or not 1 <= count <= LARGEST_COUNT:
        raise InputError(f"{what} is {count!r}: a whole number, one or more, is needed")


def check_threads(threads: int | None) -> None:
    """Raise InputError unless `threads` is a positive integer, or None for all processors."""
    if threads is not None:
        check_count(threads, "threads")
