"""Rates and their confidence intervals."""

from collections.abc import Iterable
from dataclasses import dataclass

from scipy.stats import beta

LEVEL = 0.95


@dataclass(frozen=True)
class Rate:
    """So many of so many, with the interval of Clopper and Pearson."""

    hits: int
    of: int

    @staticmethod
    def count(flags: Iterable[bool | None]) -> "Rate":
        """How many are true of those that are not None."""
        known = [flag for flag in flags if flag is not None]
        return Rate(sum(known), len(known))

    @property
    def value(self) -> float:
        return self.hits / self.of if self.of else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        tail = (1.0 - LEVEL) / 2.0
        low = float(beta.ppf(tail, self.hits, self.of - self.hits + 1)) if self.hits else 0.0
        high = float(beta.ppf(1.0 - tail, self.hits + 1, self.of - self.hits)) if self.hits < self.of else 1.0
        return low, high

    def __str__(self) -> str:
        if not self.of:
            return "-"
        low, high = self.interval
        return f"{100 * self.value:.1f} % ({self.hits}/{self.of}; {100 * low:.1f}..{100 * high:.1f})"
