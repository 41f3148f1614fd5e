"""`imucal fleet gap`: searches for an effect that is missing in the sensor model of many units."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated, Any

import imucal.cli.completion as completion
from imucal.cli.fleet_selection import CsvPath, Selection, StorePath, selection_options, store_of, write_table
from imucal.cli.options import JsonPath, effect_option
from imucal.cli.output import Output
from imucal.cli.parameters import option
from imucal.cli.working import working
from imucal.errors import ImucalError, InputError

if TYPE_CHECKING:
    from concurrent.futures import Executor

__all__ = ["gap"]


@selection_options
def gap(
    store: StorePath,
    effect: Annotated[
        list[str] | None,
        effect_option("Effect to search; may be repeated. Default: the whole catalogue.", completion.effects),
    ] = None,
    units: Annotated[int, option("--units", help="Largest number of units whose recordings are read.")] = 50,
    workers: Annotated[int | None, option("--workers", help="Processes on this computer.")] = None,
    scheduler: Annotated[
        str | None, option("--scheduler", metavar="tcp://HOST:PORT", help="Dask scheduler to use instead.")
    ] = None,
    csv: CsvPath = None,
    json: JsonPath = None,
    selection: Selection = Selection(),  # noqa: B008
) -> None:
    """Search for a missing effect over all units together.

    Fits each effect to the recordings of each unit, and tests the mean and the spread of its parameters over
    the units. This test detects effects that are too small to be detected in a single unit. The verdict is
    `named` or `nothing_missing`.

    Example: imucal fleet gap units.sqlite --effect gyro_g_sensitivity --units 200
    """
    fleet = store_of(store, csv=csv, json=json)
    with working("fitting effects") as stage, _executor(workers, scheduler) as executor:
        result = fleet.gap(effects=effect, units=units, executor=executor, step=stage.step, **selection.given)
    headings = ("effect", "parameter", "mean", "1 sigma", "spread", "noise of a unit", "unit")
    rows = [
        (e.name, p.name, p.mean, p.mean_std, p.spread, p.noise, p.unit)
        for e in result.effects or result.ranking[:1]
        for p in e.parameters
    ]
    write_table(csv, headings, rows)
    out = Output(json)
    verdict = "named" if result.effects else "nothing_missing"
    out.document(result.to_dict() | {"verdict": verdict})
    out.table(
        ("effect", "units", "significant alone", "statistic", "dof", "p"),
        [
            (e.name, str(e.units), str(e.alone), f"{e.statistic:.4g}", str(e.dof), f"{e.p_value:.2g}")
            for e in result.ranking[:8]
        ],
    )
    if result.effects:
        out.table(headings, [[f"{v:.3g}" if isinstance(v, float) else v for v in row] for row in rows])
    for found in result.effects:
        beside = f", beside {', '.join(found.beside)}" if found.beside else ""
        rivals = f"; {', '.join(found.rivals)} explain the units as well" if found.rivals else ""
        out.line(
            f"{found.name}: significant over {found.units} units together, in {found.alone} units "
            f"alone{beside}{rivals}"
        )
    for cluster in result.clusters:
        out.line(f"{cluster.effect}: a group of {len(cluster.serials)} units, such as {cluster.serials[0]}")
    if result.unread:
        out.line(f"{result.unread} units have recordings that determine no effect, or that cannot be read")
    out.line(f"verdict: {verdict}; {result.units} units were searched")


@contextmanager
def _executor(workers: int | None, scheduler: str | None) -> Iterator[Executor | None]:
    """Yield an executor of processes on this computer or of a Dask scheduler; None for a single process."""
    if scheduler is not None:
        try:
            from distributed import Client
        except ImportError as error:
            raise ImucalError(
                f'--scheduler needs Dask, which cannot be imported ({error}): pip install "imucal-rs[fleet]"'
            ) from None
        try:
            make: Any = Client
            client = make(scheduler, timeout=10)
        except (OSError, TimeoutError, ValueError) as error:
            raise InputError(f"there is no scheduler at {scheduler}: {error}") from None
        with client:
            yield client.get_executor()
        return
    if workers is not None and workers < 1:
        raise InputError(f"--workers is {workers}: give 1 or more")
    from imucal.fleet.local import processors

    count = workers or processors()
    if count == 1:
        yield None
        return
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor

    # Processes are spawned and not forked, because Arrow and the progress display have threads, and a forked
    # process inherits their locks but not the threads.
    with ProcessPoolExecutor(count, mp_context=multiprocessing.get_context("spawn")) as executor:
        yield executor
