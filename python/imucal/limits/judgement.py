"""Judgement of one unit: the value, the limit and the outcome of each check.

    A check passes if low <= value <= high. The standard deviation of the value has no effect.

A parameter within 2 sigma of its limit also gets a warning, because a repeated measurement may be on the
other side.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from imucal.calibration.verdict import VERDICTS, Verdict
from imucal.document.plain import without_nan
from imucal.document.source import Source

__all__ = ["Check", "Judgement", "VerdictCheck"]

NEAR_SIGMAS: Final = 2.0


@dataclass(frozen=True)
class Check:
    """The check of one value against its limit.

    what       a parameter, "std of" a parameter, a figure of a set of recordings, or "effects not allowed"
    value      in `unit`; None if it does not exist
    low, high  minimum and maximum; None for a side without a limit
    std        standard deviation of a parameter, None if not known
    problem    reason why the check fails for any value, such as a missing control recording
    """

    what: str
    value: float | None
    low: float | None = None
    high: float | None = None
    unit: str = ""
    std: float | None = None
    problem: str = ""

    @property
    def passed(self) -> bool:
        """Whether the value is within its limits. A value equal to a limit passes; NaN fails."""
        if self.problem or self.value is None:
            return False
        least = -math.inf if self.low is None else self.low
        most = math.inf if self.high is None else self.high
        return least <= self.value <= most

    @property
    def used(self) -> float:
        """The share of the permitted deviation that the value uses; infinite without a value.

        Checks are sorted by this number. In a range it is 0 in the middle and 1 at the ends. For a maximum
        alone it is value / maximum. For a minimum alone it is 0 if the check passes, and minimum / value if
        it fails.
        """
        if self.problem or self.value is None or math.isnan(self.value):
            return math.inf
        if self.low is not None and self.high is not None:
            return abs(2 * self.value - self.low - self.high) / (self.high - self.low)
        if self.high is not None:
            return self.value / self.high if self.high else 0.0
        if self.passed:
            return 0.0
        return (self.low or 0.0) / self.value if self.value > 0 else math.inf

    @property
    def reason(self) -> str:
        """The reason why the check fails; empty if it passes."""
        if self.passed:
            return ""
        if self.problem or self.value is None:
            return self.problem or f"{self.what} has no value"
        below = self.low is not None and self.value < self.low
        limit = self.low if below else self.high
        return f"{self._against(limit)}, {'below' if below else 'above'} its limit {limit:.10g}"

    @property
    def warning(self) -> str:
        """The warning if the value is within 2 sigma of a limit; otherwise empty."""
        if self.problem or self.value is None or not self.std:
            return ""
        for limit in (self.low, self.high):
            if limit is not None and abs(self.value - limit) < NEAR_SIGMAS * self.std:
                sigmas = abs(self.value - limit) / self.std
                return (
                    f"{self._against(limit)}, {sigmas:.1f} sigma from its limit {limit:.10g}, so "
                    "another measurement may be on the other side of the limit"
                )
        return ""

    @property
    def value_text(self) -> str:
        """The value as text for a table; "-" if it does not exist."""
        return "-" if self.value is None else f"{self.value:.7g}"

    @property
    def limit_text(self) -> str:
        """The limit as text, such as "0.1 to 0.2" or "at most 2"."""
        if self.low is not None and self.high is not None:
            return f"{self.low:.10g} to {self.high:.10g}"
        return f"at least {self.low:.10g}" if self.low is not None else f"at most {self.high:.10g}"

    def _against(self, limit: float | None) -> str:
        """A clause with the value, its unit, and enough digits to distinguish the value from its limit."""
        same = self.value_text == f"{limit:.7g}"
        unit = "" if self.unit == "1" else f" {self.unit}".rstrip()
        return f"{self.what} is {self.value if same else self.value_text}{unit}"

    def to_dict(self) -> dict[str, Any]:
        """The check as a JSON object. The field `used` is null if `Check.used` is infinite."""
        limit = {"min": self.low, "max": self.high}
        return {
            "what": self.what,
            "value": without_nan(self.value),
            "std": self.std,
            "unit": self.unit,
            "limit": {side: number for side, number in limit.items() if number is not None},
            "used": without_nan(self.used),
            "passed": self.passed,
            "reason": self.reason,
            "warning": self.warning,
        }


@dataclass(frozen=True)
class VerdictCheck(Check):
    """The check of a verdict against the worst permitted verdict. Values: 0 good, 1 incomplete, 2 poor."""

    @staticmethod
    def of(limit: Verdict, verdict: Verdict, reasons: Sequence[str]) -> VerdictCheck:
        """The check of `verdict`, which has these `reasons`, against the worst permitted `limit`."""
        value, high = VERDICTS.index(verdict), VERDICTS.index(limit)
        why = f": {reasons[0]}" if reasons else ""
        problem = f"the verdict is {verdict}, {limit} is required{why}" if value > high else ""
        return VerdictCheck("verdict", float(value), None, float(high), problem=problem)

    @property
    def used(self) -> float:
        """0 if the check passes, and infinite if it fails; a verdict has no distance to its limit."""
        return 0.0 if self.passed else math.inf

    @property
    def value_text(self) -> str:
        """The name of the verdict."""
        return VERDICTS[int(self.value or 0)]

    @property
    def limit_text(self) -> str:
        """The worst permitted verdict, as text."""
        return f"at least {VERDICTS[int(self.high or 0)]}"


@dataclass(frozen=True)
class Judgement:
    """All checks of one unit, in the order of the limits; `source` is the file of the limits."""

    checks: tuple[Check, ...]
    source: Source | None = None

    @property
    def passed(self) -> bool:
        """Whether every check passes."""
        return all(check.passed for check in self.checks)

    @property
    def failed(self) -> tuple[Check, ...]:
        """The failed checks, the worst first."""
        return tuple(check for check in self.by_use if not check.passed)

    @property
    def by_use(self) -> tuple[Check, ...]:
        """The checks, the worst first: failed before passed checks, both in descending order of `used`."""
        return tuple(sorted(self.checks, key=lambda check: (check.passed, -check.used)))

    @property
    def reasons(self) -> tuple[str, ...]:
        """The reasons why the unit fails, the worst first; empty if it passes."""
        # Equal reasons are listed once, because several limits may lack the same set of recordings.
        return tuple(dict.fromkeys(check.reason for check in self.failed))

    def applied(self, verdict: Verdict, reasons: Sequence[str]) -> tuple[Verdict, tuple[str, ...]]:
        """Add failed checks to a verdict and its reasons: the verdict is poor if any check has failed."""
        return verdict if self.passed else "poor", (*self.reasons, *reasons)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings for parameters within 2 sigma of a limit."""
        return tuple(check.warning for check in self.by_use if check.warning)

    def summary(self) -> str:
        """Failed checks, warnings, and the number of checks, as plain text."""
        lines = [f"fail: {reason}" for reason in self.reasons]
        lines += [f"warning: {warning}" for warning in self.warnings]
        return "\n".join([*lines, self.count])

    @property
    def count(self) -> str:
        """A clause with the number of passed checks, the number of all checks, and the limits file."""
        kept = len(self.checks) - len(self.failed)
        of = f" of {self.source.path}" if self.source else ""
        return f"{kept} of {len(self.checks)} limits{of} are kept"

    def to_dict(self) -> dict[str, Any]:
        """The section `judgement` of the JSON documents."""
        return {
            "passed": self.passed,
            "limits": None
            if self.source is None
            else {"path": self.source.path, "sha256": self.source.sha256},
            "reasons": list(self.reasons),
            "warnings": list(self.warnings),
            "checks": [check.to_dict() for check in self.checks],
        }
