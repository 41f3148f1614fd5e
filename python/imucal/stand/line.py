"""One unit on the line: run, control run, calibration, verdict, export, in a folder of its own."""

from __future__ import annotations

import dataclasses
import errno
import os
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import imucal._core as _core
from imucal.calibration.calibration import require_serial_number
from imucal.document.json_document import now, write_json
from imucal.document.source import open_large
from imucal.errors import ImucalError, InputError
from imucal.exporting import FORMATS, Export, export, find_format
from imucal.io import read
from imucal.limits.limits import Limits
from imucal.rig.motion import Program
from imucal.stand.driver import Driver, Source
from imucal.stand.programs import in_another_order, ranges_deg, require_determined
from imucal.stand.recorder import Done, Moment, record
from imucal.stand.verdict import Assessment, Reason, assess
from imucal.units import STANDARD_GRAVITY_MPS2

__all__ = ["Order", "Outcome", "calibrate_unit"]

SCHEMA: Final = "imucal.stand-result/1"
MOST_FOLDERS: Final = 10_000


@dataclass(frozen=True)
class Order:
    """What is to be done with a unit.

    program       what the run is made of, and its name for the result
    seed          of the program, if it was drawn
    control_seed  of the control program, if it was drawn
    exports       names of formats
    control       what the control run is made of; None: the poses of `program` in an order that
                  `control_seed` draws, along the path of `program`, for no other is known to be free
    control_name  the name of `control` for the result
    driver        what moves the stand, for the result
    """

    program: Program
    program_name: str = "random"
    seed: int = 1
    control_seed: int = 2
    serial_number: str | None = None
    operator: str = ""
    limits: Limits | None = None
    exports: tuple[str, ...] = ()
    gravity_mps2: float = STANDARD_GRAVITY_MPS2
    control: Program | None = None
    control_name: str = "own poses"
    driver: str | None = None

    @property
    def programs(self) -> dict[str, Program]:
        """What the stand runs, by the names of the runs: run, control."""
        control = self.control or in_another_order(self.program, self.control_seed)
        return {"run": self.program, "control": control}

    def __post_init__(self) -> None:
        require_serial_number(self.serial_number)
        for name in self.exports:
            if find_format(name).needs_noise:
                raise InputError(
                    f"{name} is about noise, which a stand does not measure: record the unit at rest for "
                    "an hour, and use `imucal export --noise`"
                )


@dataclass(frozen=True, eq=False)
class Outcome:
    """What came of it.

    verdict  passed, failed or no_result
    reasons  why it is not passed, by name
    folder   where everything is
    exports  what was written, by format
    not_written  why a file that the verdict allows could not be written, by its format or its name
    sha256   of the recordings, by their paths
    date     when it was judged, ISO 8601
    """

    order: Order
    verdict: str
    reasons: tuple[Reason, ...]
    folder: Path
    runs: Mapping[str, Done]
    assessment: Assessment | None = None
    calibration: Path | None = None
    exports: Mapping[str, tuple[Path, Export]] = dataclasses.field(default_factory=dict)
    not_written: Mapping[str, str] = dataclasses.field(default_factory=dict)
    sha256: Mapping[str, str] = dataclasses.field(default_factory=dict)
    date: str = dataclasses.field(default_factory=now)

    def to_dict(self) -> dict[str, Any]:
        """The document of `imucal stand calibrate --json`, and result.json in the folder."""
        result = self.assessment.result if self.assessment else None
        return {
            "schema": SCHEMA,
            "date": self.date,
            "imucal_version": str(_core.__version__),
            "verdict": self.verdict,
            "reasons": [dataclasses.asdict(reason) for reason in self.reasons],
            "driver": self.order.driver,
            "serial_number": self.order.serial_number,
            "operator": self.order.operator,
            "program": self.order.program_name,
            "seed": self.order.seed,
            "control_program": self.order.control_name,
            "control_seed": self.order.control_seed,
            "range_deg": {name: ranges_deg(program) for name, program in self.order.programs.items()},
            "folder": str(self.folder),
            "runs": {name: done.to_dict() for name, done in self.runs.items()},
            "recordings": [{"path": path, "sha256": digest} for path, digest in self.sha256.items()],
            "calibration": None if self.calibration is None else str(self.calibration),
            "exports": [
                {"format": name, "output": str(path), "lost": list(written.lost)}
                for name, (path, written) in self.exports.items()
            ],
            "not_written": dict(self.not_written),
            "result": None if result is None else result.to_dict(),
        }


def calibrate_unit(
    order: Order,
    equipment: Callable[[Program, int], tuple[Driver, Source]],
    folder: str | os.PathLike[str],
    *,
    view: Callable[[Path], AbstractContextManager[Callable[[Moment], None] | None]],
) -> Outcome:
    """Take a unit through its programs and judge it.

    equipment  the driver and the source for a program and the seed of simulated noise
    folder     a folder for each unit is made in it; one that is there is left alone, and another one made
    view       a live view of the run that is written to a file, run.csv or control.csv

    Raises ImucalError if the equipment cannot start, InputError for a program that does not determine all
    parameters and for exports that the unit's data do not allow. What fails once there is a recording is in
    the outcome, and in result.json after an interrupt, too.
    """
    require_determined(order.program, order.program_name)
    own = _folder_for(order, Path(folder))
    runs: dict[str, Done] = {}
    try:
        return _kept(_taken_through(order, equipment, own, runs, view))
    except (ImucalError, KeyboardInterrupt) as error:
        # The folder of a unit that has sent nothing would only be in the way of the next try.
        if not any(own.iterdir()):
            own.rmdir()
            raise
        if isinstance(error, KeyboardInterrupt):
            _kept(Outcome(order, "no_result", (Reason("run_interrupted", "interrupted"),), own, runs))
            raise
        return _kept(Outcome(order, "no_result", (Reason("run_error", str(error)),), own, runs))


def _taken_through(
    order: Order,
    equipment: Callable[[Program, int], tuple[Driver, Source]],
    own: Path,
    runs: dict[str, Done],
    view: Callable[[Path], AbstractContextManager[Callable[[Moment], None] | None]],
) -> Outcome:
    """The runs, into `runs` as they are done, and the verdict."""
    programs = order.programs
    assessment: Assessment | None = None
    for name, seed in (("run", order.seed), ("control", order.control_seed)):
        program, output = programs[name], own / f"{name}.csv"
        driver, source = equipment(program, seed)
        _require_exports(order, source.columns)
        about = {"serial_number": order.serial_number, "operator": order.operator, "run": name, "seed": seed}
        with view(output) as watch:
            runs[name] = record(driver, source, output, steps=len(program.steps), about=about, watch=watch)
        if not runs[name].good or runs[name].output is None:
            message = runs[name].message or "the unit has sent no sample"
            reason = Reason(f"run_{runs[name].state}", f"{name}: {message}")
            return Outcome(order, "no_result", (reason,), own, runs)
        recordings = [read(own / f"{done}.csv") for done in runs]
        assessment = assess(
            recordings[0],
            recordings[1] if len(recordings) > 1 else None,
            list(programs.values()),
            gravity_mps2=order.gravity_mps2,
            serial_number=order.serial_number,
            limits=order.limits if len(recordings) > 1 else None,
        )
        # A unit that gives no calibration needs no control run.
        if assessment.result is None:
            break
    assert assessment is not None
    return _with_files(order, assessment, own, runs)


def _with_files(order: Order, assessment: Assessment, own: Path, runs: Mapping[str, Done]) -> Outcome:
    """The verdict, and the files that it allows."""
    passed = assessment.judged and not assessment.reasons
    verdict = "passed" if passed else "failed" if assessment.judged else "no_result"
    if assessment.result is None:
        return Outcome(order, verdict, assessment.reasons, own, runs, assessment)
    calibration = dataclasses.replace(
        assessment.result.calibration,
        provenance=dataclasses.replace(assessment.result.calibration.provenance, operator=order.operator),
    )
    # Nobody must take the calibration of a unit that failed for that of one to be shipped.
    path = own / ("calibration.json" if passed else "rejected.json")
    not_written: dict[str, str] = {}
    try:
        calibration.save(path)
    except ImucalError as error:
        not_written[path.name] = str(error)
    exports: dict[str, tuple[Path, Export]] = {}
    for name in order.exports if passed else ():
        target = own / f"{name}{find_format(name).suffix}"
        try:
            written = export(calibration, name)
            written.save(target)
        except ImucalError as error:
            not_written[name] = str(error)
        else:
            exports[name] = (target, written)
    saved = None if path.name in not_written else path
    return Outcome(order, verdict, assessment.reasons, own, runs, assessment, saved, exports, not_written)


def _require_exports(order: Order, columns: Sequence[str]) -> None:
    """Refuse formats that take no raw counts for a unit that sends them: before it is run, not after it."""
    if not any(column.endswith("_lsb") for column in columns):
        return
    unfit = [name for name in order.exports if not find_format(name).takes_counts]
    if unfit:
        fit = [name for name, form in FORMATS.items() if form.takes_counts]
        raise InputError(
            f"the unit sends raw counts, and {' and '.join(unfit)} "
            f"{'corrects' if len(unfit) == 1 else 'correct'} samples that are in SI units already: leave it "
            f"out, or export to one of {', '.join(fit)}"
        )


def _kept(outcome: Outcome) -> Outcome:
    """The outcome, with result.json in its folder; a verdict is not lost where that cannot be written."""
    paths = [done.output for done in outcome.runs.values() if done.output is not None]
    digests = {path: open_large(path).sha256 for path in paths}
    outcome = dataclasses.replace(outcome, sha256=digests)
    try:
        write_json(outcome.to_dict(), outcome.folder / "result.json")
    except ImucalError as error:
        return dataclasses.replace(outcome, not_written={**outcome.not_written, "result.json": str(error)})
    return outcome


def _folder_for(order: Order, folder: Path) -> Path:
    """A new folder, by the serial number; a second try of a unit gets one of its own."""
    name = re.sub(r"[^\w.+-]", "_", order.serial_number or "unit").lstrip(".") or "unit"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for number in range(1, MOST_FOLDERS):
            own = folder / (name if number == 1 else f"{name}-{number}")
            try:
                own.mkdir()
                return own
            except FileExistsError:
                continue
            except OSError as error:
                if error.errno != errno.ENAMETOOLONG:
                    raise
                raise InputError(
                    f"the serial number has {len(name)} characters, which is too long for the folder that is "
                    "named by it: give a shorter one"
                ) from error
    except OSError as error:
        raise InputError(f"{folder} cannot be written: {error.strerror}: give another folder (-o)") from error
    raise ImucalError(f"{folder} has {MOST_FOLDERS} folders of unit {name}: remove some")
