"""A unit on a production line: run, control run, calibration, verdict and export. Each unit has a folder."""

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
from imucal.calibration.provenance import require_serial_number
from imucal.calibration.verdict import Verdict
from imucal.document.date import now
from imucal.document.json_document import write_json
from imucal.document.source import open_large
from imucal.errors import ImucalError, InputError
from imucal.exporting import FORMATS, Export, export, find_format
from imucal.io import read
from imucal.limits.limits import Limits
from imucal.rig.motion import Program
from imucal.stand.driver import Driver, Source
from imucal.stand.programs import in_another_order, ranges_deg, require_determined
from imucal.stand.recorder import Done, Moment, record
from imucal.stand.resuming import Interrupted
from imucal.stand.verdict import Assessment, Reason, assess
from imucal.units import STANDARD_GRAVITY_MPS2

__all__ = ["Order", "Outcome", "calibrate_unit", "resume_unit"]

SCHEMA: Final = "imucal.stand-result/1"
# Maximum number of folders for one serial number.
MOST_FOLDERS: Final = 10_000


@dataclass(frozen=True)
class Order:
    """The task for one unit.

    program       motion of the run
    program_name  name of the program in the result
    seed          seed of the program, if it is random
    control_seed  seed of the control program, if it is random
    exports       names of export formats
    gravity_mps2  local gravity
    control       motion of the control run. If None, the control run has the poses of `program` in a random
                  order, which `control_seed` determines. The motors follow the path of `program`, because
                  only this path is known to be free of obstacles
    control_name  name of the control program in the result
    driver        name of the driver in the result
    require       worst accepted verdict on the calibration
    resume        data that the journal stores so that an interrupted run can be resumed
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
    require: Verdict = "incomplete"
    resume: Mapping[str, Any] | None = None

    @property
    def programs(self) -> dict[str, Program]:
        """The programs of the calibration run (key `run`) and of the control run (key `control`)."""
        control = self.control or in_another_order(self.program, self.control_seed)
        return {"run": self.program, "control": control}

    def __post_init__(self) -> None:
        require_serial_number(self.serial_number)
        for name in self.exports:
            if find_format(name).needs_noise:
                raise InputError(
                    f"{name} needs noise figures, which a run on a stand does not provide: record the unit "
                    "at rest for an hour, and use `imucal export --noise`"
                )


@dataclass(frozen=True, eq=False)
class Outcome:
    """The result for one unit.

    verdict  passed, failed or no_result
    reasons  reasons for a verdict other than passed
    folder   folder that contains all files of the unit
    calibration  path of the saved calibration, None if there is none
    exports  exported files by format
    not_written  error messages by export format or file name, for files that the verdict permits but that
                 could not be written
    sha256   hashes of the recordings by path
    date     time of the verdict, ISO 8601
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
        """The document of `imucal stand calibrate --json` and of result.json in the folder."""
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
    """Run the programs of a unit, calibrate the unit, and judge it.

    equipment  function that returns the driver and the source for a program and the seed of simulated noise
    folder     parent of the unit's new folder; existing folders are not changed
    view       function that returns the live view of a run, given its output file, run.csv or control.csv

    Raises ImucalError if the equipment cannot start, and InputError for a program that does not determine all
    parameters and for exports that do not accept the unit's data. Failures after the first sample are
    reported in the outcome and in result.json. After an interrupt, result.json is also written.
    """
    require_determined(order.program, order.program_name)
    own = _folder_for(order, Path(folder))
    runs: dict[str, Done] = {}
    try:
        return _kept(_taken_through(order, equipment, own, runs, view))
    except (ImucalError, KeyboardInterrupt) as error:
        # Remove the folder if no sample has arrived, so that the next attempt gets the same name.
        if not any(own.iterdir()):
            own.rmdir()
            raise
        if isinstance(error, KeyboardInterrupt):
            _kept(Outcome(order, "no_result", (Reason("run_interrupted", "interrupted"),), own, runs))
            raise
        return _kept(Outcome(order, "no_result", (Reason("run_error", str(error)),), own, runs))


def resume_unit(
    order: Order,
    equipment: Callable[..., tuple[Driver, Source]],
    interrupted: Interrupted,
    *,
    view: Callable[[Path], AbstractContextManager[Callable[[Moment], None] | None]],
) -> Outcome:
    """Continue the interrupted run of a unit, do the remaining runs, and judge the unit."""
    own, runs = interrupted.output.parent, dict[str, Done]()
    if interrupted.output.name == "control.csv":
        steps = len(order.program.steps)
        run = own / "run.csv"
        runs["run"] = Done("completed", "", steps - 1, steps, len(read(run)), str(run))
    try:
        return _kept(_taken_through(order, equipment, own, runs, view, interrupted))
    except (ImucalError, KeyboardInterrupt) as error:
        if isinstance(error, KeyboardInterrupt):
            _kept(Outcome(order, "no_result", (Reason("run_interrupted", "interrupted"),), own, runs))
        raise


def _taken_through(
    order: Order,
    equipment: Callable[..., tuple[Driver, Source]],
    own: Path,
    runs: dict[str, Done],
    view: Callable[[Path], AbstractContextManager[Callable[[Moment], None] | None]],
    interrupted: Interrupted | None = None,
) -> Outcome:
    """Do the runs, add each run to `runs` when it ends, and judge the unit."""
    programs = order.programs
    assessment: Assessment | None = None
    for name, seed in (("run", order.seed), ("control", order.control_seed)):
        program, output = programs[name], own / f"{name}.csv"
        if name not in runs:
            resumed = interrupted if interrupted is not None and interrupted.output == output else None
            runs[name] = _recorded(order, name, program, seed, output, equipment, view, resumed)
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
            require=order.require if len(recordings) > 1 else "incomplete",
        )
        # Without a calibration there is nothing to evaluate on a control run.
        if assessment.result is None:
            break
    assert assessment is not None
    return _with_files(order, assessment, own, runs)


def _recorded(
    order: Order,
    name: str,
    program: Program,
    seed: int,
    output: Path,
    equipment: Callable[..., tuple[Driver, Source]],
    view: Callable[[Path], AbstractContextManager[Callable[[Moment], None] | None]],
    interrupted: Interrupted | None,
) -> Done:
    """Record one run, or continue it if it was interrupted."""
    about: dict[str, Any] = {
        "serial_number": order.serial_number,
        "operator": order.operator,
        "run": name,
        "seed": seed,
    }
    steps = len(program.steps)
    if interrupted is None:
        driver, source = equipment(program, seed)
        _require_exports(order, source.columns)
        about["resume"] = order.resume
        with view(output) as watch:
            return record(driver, source, output, steps=steps, about=about, watch=watch)
    clock = interrupted.clock
    driver, source = equipment(program, seed, resume=interrupted.progress, clock=clock)
    with view(output) as watch:
        return record(
            driver, source, output, steps=steps, watch=watch, resume=interrupted.logged, clock=clock
        )


def _with_files(order: Order, assessment: Assessment, own: Path, runs: Mapping[str, Done]) -> Outcome:
    """Save the calibration and the exports that the verdict permits."""
    passed = assessment.judged and not assessment.reasons
    verdict = "passed" if passed else "failed" if assessment.judged else "no_result"
    if assessment.result is None:
        return Outcome(order, verdict, assessment.reasons, own, runs, assessment)
    calibration = dataclasses.replace(
        assessment.result.calibration,
        provenance=dataclasses.replace(assessment.result.calibration.provenance, operator=order.operator),
    )
    # The file name of a failed unit differs, so that its calibration is not delivered by mistake.
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
    """If the unit sends raw counts, refuse exports that do not support them, before the run."""
    if not any(column.endswith("_lsb") for column in columns):
        return
    unfit = [name for name in order.exports if not find_format(name).takes_counts]
    if unfit:
        fit = [name for name, form in FORMATS.items() if form.takes_counts]
        raise InputError(
            f"the unit sends raw counts, but {' and '.join(unfit)} only "
            f"{'corrects' if len(unfit) == 1 else 'correct'} samples in SI units: leave it out, or export to "
            f"one of {', '.join(fit)}"
        )


def _kept(outcome: Outcome) -> Outcome:
    """Write result.json. If this fails, the outcome is still returned, with the error in `not_written`."""
    paths = [done.output for done in outcome.runs.values() if done.output is not None]
    digests = {path: open_large(path).sha256 for path in paths}
    outcome = dataclasses.replace(outcome, sha256=digests)
    try:
        write_json(outcome.to_dict(), outcome.folder / "result.json")
    except ImucalError as error:
        return dataclasses.replace(outcome, not_written={**outcome.not_written, "result.json": str(error)})
    return outcome


def _folder_for(order: Order, folder: Path) -> Path:
    """Create a folder named by the serial number, with a number appended if the folder already exists."""
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
                    f"the serial number has {len(name)} characters, which is too long for a folder name: "
                    "give a shorter one"
                ) from error
    except OSError as error:
        raise InputError(f"{folder} cannot be written: {error.strerror}: give another folder (-o)") from error
    raise ImucalError(f"{folder} has {MOST_FOLDERS} folders of unit {name}: remove some")
