"""`imucal fleet run`: calibrates the recordings of many units and writes the results to a store."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from click.exceptions import Exit

import imucal.cli.completion as completion
from imucal.cli.live_page import LivePage
from imucal.cli.options import (
    MIN_REST_S,
    MODEL,
    ClockOption,
    ExcludeSaturated,
    GravityOption,
    GravitySigmaOption,
    HeightOption,
    HoldOption,
    JsonPath,
    LatitudeOption,
    LimitsPath,
    MinRest,
    ModelOption,
    Require,
    Required,
    effect_option,
    options_of,
    unit_option,
)
from imucal.cli.output import NO_RESULT, POOR_VERDICT, Output, prepare_report, require_apart
from imucal.cli.parameters import argument, option
from imucal.cli.reading import Reading, reading_options
from imucal.cli.working import Stage, working
from imucal.errors import InputError

if TYPE_CHECKING:
    from imucal.fleet.fleet import Fleet
    from imucal.fleet.job import Job
    from imucal.fleet.run import Tally
    from imucal.limits.limits import Limits

__all__ = ["run"]

SCHEMA: Final = "imucal.fleet-run/1"
# Interval, s, at which a watched folder is checked. A file whose size and modification time have not changed
# during one interval counts as complete.
WATCH_S: Final = 2.0
# Maximum number of printed warnings about recordings that belong to several serial numbers. The JSON document
# lists all such recordings.
MOST_SAME: Final = 10


@dataclass(frozen=True)
class Calibrating:
    """Options of the calibration of each unit; the fields are the arguments of `imucal.calibrate`."""

    gravity_mps2: GravityOption = None
    gravity_sigma_mps2: GravitySigmaOption = None
    latitude_deg: LatitudeOption = None
    height_m: HeightOption = None
    clock_ppm: ClockOption = None
    min_rest_s: MinRest = MIN_REST_S
    exclude_saturated: ExcludeSaturated = False
    effects: Annotated[
        list[str] | None,
        effect_option("Also estimate this effect; may be repeated.", completion.effects_to_estimate, MODEL),
    ] = None
    model: ModelOption = "full"
    hold: HoldOption = None
    unit: Annotated[str | None, unit_option("Unit file, as in `imucal calibrate`.")] = None

    @property
    def given(self) -> dict[str, Any]:
        """The options that the user has given, as arguments of `imucal.calibrate`."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value for name, value in values.items() if value is not None}


@options_of("calibrating", Calibrating)
@reading_options
def run(
    store: Annotated[
        Path, argument(metavar="STORE", help="Store, one file; it is made if it does not exist.")
    ],
    reading: Reading,
    calibrating: Calibrating,
    recordings: Annotated[
        list[str] | None,
        argument(
            metavar="PATTERN|MANIFEST",
            help="Recordings, folders or patterns such as 'day/*.csv'; or a manifest with the columns "
            "serial, date, station, operator, batch, files (separated by ;), control and role.",
        ),
    ] = None,
    names: Annotated[
        str | None,
        option(
            "--names",
            metavar="PATTERN",
            help="Pattern of the paths, such as '{date}/{serial}-{role}.csv'. Fields: serial, date, station, "
            "operator, batch, role; a file with the role `control` is a control recording.",
        ),
    ] = None,
    limits: LimitsPath = None,
    gap: Annotated[bool, option("--gap", help="Also search for a missing effect of each unit.")] = False,
    workers: Annotated[
        int | None, option("--workers", help="Processes on this computer; one per processor if not given.")
    ] = None,
    scheduler: Annotated[
        str | None,
        option("--scheduler", metavar="tcp://HOST:PORT", help="Dask scheduler, instead of --workers."),
    ] = None,
    shard: Annotated[
        str | None, option("--shard", metavar="I/N", help="Only the units of part I of N, for batch queues.")
    ] = None,
    watch: Annotated[
        Path | None,
        option("--watch", metavar="FOLDER", help="Also take new files of this folder, until Ctrl-C."),
    ] = None,
    retry: Annotated[bool, option("--retry", help="Compute units again that have no result.")] = False,
    time_limit_s: Annotated[
        float | None,
        option("--time-limit-s", metavar="S", help="A unit that takes longer than this has no result."),
    ] = None,
    report: Annotated[
        Path | None,
        option(
            "--report",
            metavar="PAGE",
            help="Also write the page of `imucal fleet report`, every 10 s during the run and at its end; "
            "needs plotly.",
        ),
    ] = None,
    require: Require = Required.incomplete,
    json: JsonPath = None,
) -> None:
    """Calibrate the recordings of many units into a store; only new recordings are processed.

    A unit is not computed again if the store has a row with the same file contents, options and version of
    imucal. A run that was killed continues when it is started again. The exit code is 1 if a unit has no
    result, else 2 if a unit is poor.

    Example: imucal fleet run units.sqlite run.csv control.csv

    Example: imucal fleet run units.sqlite manifest.csv --limits limits.json --workers 2

    Example: imucal fleet run units.sqlite --watch incoming --report fleet.html
    """
    import imucal
    from imucal.document.date import now
    from imucal.fleet.manifest import shard_of

    if not recordings and watch is None:
        raise InputError("no recording is given: give files, a folder, a manifest, or --watch FOLDER")
    if watch is not None and (not watch.is_dir() or shard is not None):
        raise InputError(f"--watch {watch}: give a folder that exists, and no --shard with it")
    require_apart([store, limits], {"--json": json, "--report": report})
    prepare_report(report)
    part = None if shard is None else shard_of(shard)
    fleet = imucal.Fleet(store)
    given: dict[str, Any] = {
        "limits": None if limits is None else imucal.Limits.load(limits),
        "gap": gap,
        "read": {field.name: getattr(reading, field.name) for field in fields(reading)},
        "calibrate": calibrating.given,
        "workers": workers,
        "scheduler": scheduler,
        "retry": retry,
        "time_limit_s": time_limit_s,
    }
    out = Output(json)
    start_s = time.monotonic()
    tally = None
    live = None if report is None else LivePage(store, report, limits)
    try:
        if recordings:
            jobs, count = _jobs(out, recordings, names, part)
            with working("calibrating", count) as stage:
                tally = fleet.run(jobs, total=count, tell=_Teller(stage, live).tell, **given)
        if watch is not None:
            tally = _watched(out, fleet, watch, names, tally, given, live)
    finally:
        if live is not None:
            live.close()
    if report is not None:
        _write_page(out, report, fleet, given["limits"])
    if tally is not None:
        same = fleet.same_recordings()
        out.document(
            {
                "schema": SCHEMA,
                **tally.to_dict(),
                "same_recordings": same,
                "imucal_version": imucal.__version__,
                "date": now(),
            }
        )
        elapsed_s = time.monotonic() - start_s
        _finish(out, tally, elapsed_s, require, store, same)


def _write_page(out: Output, page: Path, fleet: Fleet, limits: Limits | None) -> None:
    from imucal.report import write_fleet_page

    try:
        write_fleet_page(page, fleet, limits=limits)
    except InputError as error:
        # The error does not end the command, because the results of the run are valid without the page.
        out.line(f"{page} is not written: {error}")
        return
    out.line(f"page written to {page}")


def _jobs(
    out: Output, recordings: list[str], names: str | None, part: tuple[int, int] | None
) -> tuple[Iterable[Job], int]:
    """The jobs (one measurement of a unit each) and their number.

    Also prints how serial numbers are derived from file names.
    """
    from imucal.fleet.manifest import count_of_manifest, is_manifest, jobs_of_manifest, shard
    from imucal.fleet.naming import files_of, naming_of

    if len(recordings) == 1 and is_manifest(recordings[0]):
        count = count_of_manifest(recordings[0])
        jobs: Iterable[Job] = jobs_of_manifest(recordings[0])
    else:
        naming = naming_of(names)
        found = naming.jobs(files_of(recordings))
        out.line(f"{len(found)} units; {naming.words(found[0])}")
        jobs, count = found, len(found)
    if part is not None:
        jobs, count = shard(jobs, part), len(range(part[0] - 1, count, part[1]))
    return jobs, count


class _Teller:
    """Counts units on the display during a run, and prints a line for each unit without a result."""

    def __init__(self, stage: Stage, live: LivePage | None) -> None:
        self._live = live
        self._stage, self._start_s, self._told, self._without = stage, time.monotonic(), 0, 0

    def tell(self, job: Job, verdict: str, code: str | None, message: str | None) -> None:
        """Count a finished unit, and print a line if the unit failed or was skipped."""
        from imucal.cli.as_typed import as_typed
        from imucal.cli.streams import printable

        self._told += 1
        if verdict in ("failed", "poisoned", "skipped"):
            self._without += verdict != "skipped"
            self._stage.line(printable(as_typed(f"{job.serial}: {verdict}: [{code}] {message}")))
        rate = self._told / max(time.monotonic() - self._start_s, 1e-3)
        self._stage(f"{rate:.3g} units/s, {self._without} without a result")
        self._stage.step()
        if self._live is not None:
            self._live.step()


def _watched(
    out: Output,
    fleet: Fleet,
    folder: Path,
    names: str | None,
    tally: Tally | None,
    given: dict[str, Any],
    live: LivePage | None,
) -> Tally:
    """Process the files of a folder as they appear, until the user interrupts."""
    from imucal.fleet.job import path_text
    from imucal.fleet.naming import files_of, naming_of
    from imucal.fleet.run import Tally as NewTally

    naming, total = naming_of(names), tally or NewTally()
    before: dict[str, tuple[int, int]] = {}
    taken: dict[str, tuple[int, int]] = {}
    out.line(f"watching {folder}; end with Ctrl-C")
    try:
        while True:
            found = {name: _state(name) for name in files_of([str(folder)], or_none=True)}
            ready = [n for n, state in found.items() if before.get(n) == state and taken.get(n) != state]
            before = found
            if ready:
                folders = {str(Path(name).parent) for name in ready}
                # If a folder has new files, all files of this folder are considered, because a new control
                # recording may belong to a calibration recording that appeared earlier.
                together = [name for name in found if str(Path(name).parent) in folders]
                new = {path_text(name) for name in ready}
                jobs = [
                    job
                    for job in naming.jobs(together, with_lone_controls=False)
                    if new & {*job.files, *job.control}
                ]
                taken |= {name: found[name] for name in together}
                with working("calibrating", len(jobs)) as stage:
                    fleet.run(jobs, total=len(jobs), tell=_Teller(stage, live).tell, tally=total, **given)
                out.line(f"{total.units} units, {total.failed + total.poisoned} without a result")
            if live is not None:
                live.step()
            time.sleep(WATCH_S)
    except KeyboardInterrupt:
        return total


def _state(name: str) -> tuple[int, int]:
    try:
        state = Path(name).stat()
    except OSError:
        return 0, 0
    return state.st_size, state.st_mtime_ns


def _finish(
    out: Output,
    tally: Tally,
    elapsed_s: float,
    require: Required,
    store: Path,
    same: Sequence[Sequence[str]],
) -> None:
    counts = tally.to_dict()
    order = ("good", "incomplete", "poor", "failed", "poisoned")
    out.table(("verdict", "units"), [(name, str(tally.verdicts[name])) for name in order])
    if tally.codes:
        out.table(("without a result", "units"), [(code, str(n)) for code, n in counts["codes"].items()])
    rate = f", {tally.done / elapsed_s:.3g} units/s" if tally.done else ""
    out.line(
        f"{tally.units} units: {tally.done} computed in {elapsed_s:.1f} s{rate}, {tally.skipped} were in the "
        f"store, {tally.unreadable} could not be read"
    )
    for serials in same[:MOST_SAME]:
        out.line(f"warning: {' and '.join(serials)} have the same recording, so a serial number is wrong")
    if len(same) > MOST_SAME:
        out.line(f"warning: {len(same) - MOST_SAME} more recordings have several serial numbers, see --json")
    if tally.verdicts["poor"]:
        out.line(
            f"`imucal fleet list {store} --verdict poor` lists the poor units, and "
            f"`imucal fleet show {store} SERIAL` prints the reasons"
        )
    out.line(f"verdict: {tally.verdict}")
    if tally.verdict == "no_result":
        raise Exit(NO_RESULT)
    if tally.verdict == "poor" or (tally.verdict == "incomplete" and require == "good"):
        raise Exit(POOR_VERDICT)
