"""Acceptance limits of a unit.

    limits = imucal.Limits.load("limits.json")
    result = imucal.calibrate(recording, control=control).judged_by(limits)

For parameters, a limit is a range or a maximum standard deviation. For a set of recordings, a limit is a
maximum figure of merit or a minimum number of rests or moves. A limit can also be a list of permitted
effects, or the worst permitted verdict. A missing value fails its limit.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from imucal.calibration.calibration import Calibration
from imucal.calibration.figures import Figures
from imucal.calibration.verdict import Verdict
from imucal.document.json_document import read_json, write_json
from imucal.document.plain import plain
from imucal.document.source import Source, open_file
from imucal.effects.definition import UserEffect
from imucal.errors import InputError
from imucal.limits.file import NO_LIMIT, REQUIRED, document_of, fields_of
from imucal.limits.judgement import Check, Judgement, VerdictCheck
from imucal.limits.limit import FigureLimit, ParameterLimit

__all__ = ["Limits"]


class CalibrationRun(Protocol):
    """The attributes of a calibration result that are checked against limits."""

    @property
    def calibration(self) -> Calibration:
        """The calibration."""

    @property
    def held_out(self) -> object:
        """Figures of the cross-validation on held-out rests and moves; None without cross-validation."""


@dataclass(frozen=True)
class Limits:
    """Acceptance limits of a unit. If several limits match a parameter, all of them apply.

    effects      names of the permitted effects; None permits all
    verdict      worst permitted verdict, `good` or `incomplete`; None permits all
    description  purpose of the limits, as text
    source       file from which the limits were read
    """

    parameters: tuple[ParameterLimit, ...] = ()
    figures: tuple[FigureLimit, ...] = ()
    effects: tuple[str, ...] | None = None
    verdict: Verdict | None = None
    description: str = ""
    source: Source | None = None

    def __post_init__(self) -> None:
        if not self.parameters and not self.figures and self.effects is None and self.verdict is None:
            raise InputError(NO_LIMIT)
        if self.verdict not in (None, *REQUIRED):
            raise InputError(f"verdict is {self.verdict!r}: give {' or '.join(REQUIRED)}, or leave it out")

    def judge(
        self,
        unit: CalibrationRun | Calibration,
        *,
        control_set: Figures | None = None,
        verdict: tuple[Verdict, tuple[str, ...]] | None = None,
    ) -> Judgement:
        """Check a calibration or a result of `calibrate`. Only a result can have held-out figures.

        control_set  figures of merit on other recordings, which replace those of the control set; None: the
                     figures in the calibration
        verdict      verdict and reasons on these other recordings; None: the verdict of the calibration
        """
        calibration = unit if isinstance(unit, Calibration) else unit.calibration
        sets = {
            "calibration_set": calibration.calibration_set,
            "control_set": calibration.control_set if control_set is None else plain(control_set),
            "held_out": None if isinstance(unit, Calibration) else plain(unit.held_out),
        }
        checks = [check for limit in self.parameters for check in limit.checks(calibration)]
        checks += [limit.check(sets[limit.of]) for limit in self.figures]
        if self.effects is not None:
            extra = [values.name for values in calibration.effects if values.name not in self.effects]
            allowed = ", ".join(self.effects) or "none"
            problem = f"the calibration has {', '.join(extra)}; permitted effects: {allowed}" if extra else ""
            checks.append(Check("effects not allowed", float(len(extra)), None, 0, problem=problem))
        if self.verdict is not None:
            checks.append(VerdictCheck.of(self.verdict, *(verdict or calibration.judged)))
        return Judgement(tuple(checks), self.source)

    @staticmethod
    def load(path: str | os.PathLike[str], *, user_effects: Sequence[UserEffect] = ()) -> Limits:
        """Read a limits file, schema imucal.limits/1.

        user_effects  user-defined effects that the limits may name

        Raises InputError if it cannot be read, and FormatError with the field if it is not a limits file.
        """
        return Limits(**fields_of(read_json(path), user_effects), source=open_file(path).source)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the limits file, atomically. Raises InputError if it cannot be written."""
        write_json(self.to_dict(), path)

    def to_dict(self) -> dict[str, Any]:
        """The fields of the file."""
        return document_of(self.parameters, self.figures, self.effects, self.verdict, self.description)
