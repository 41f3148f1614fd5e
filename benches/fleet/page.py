"""The page docs/results/fleet.md."""

from statistics import median
from typing import Any

from fleet import storage as store
from fleet.speed import DASK, LOOP, ONE, PROFILED, ROUNDS, TWO, TWO_LOOPS, WAYS

__all__ = ["page"]


def page(log: dict[str, Any], kill_units: int) -> str:
    """The page of the figures of all parts."""
    parts = ("planted", "speed", "storage", "poisoned", "kills")
    planted, speed, storage, poisoned, kills = (log[part] for part in parts)
    first, second = planted["runs"]
    tiny, large = speed["rates"]["tiny"], speed["rates"]["large"]
    rates = "\n".join(
        f"| {way} | {median(tiny['ways'][way]):.1f} | {median(large['ways'][way]):.1f} |" for way in WAYS
    )
    queries = "\n".join(f"| {name} | {1e3 * value:.0f} ms |" for name, value in storage["queries"].items())
    statistics = "\n".join(f"| {name} | {value:.1f} s |" for name, value in storage["statistics"].items())
    rows = ", ".join(f"{count} {verdict}" for verdict, count in sorted(poisoned["rows"].items()))
    is_alone = poisoned["serials"] == [poisoned["planted"]]
    small, large_memory = (size / 1e6 for size in poisoned["memory"])
    lines = "\n".join(
        f"| {row['what']} | {row['kills']} | {row['runs']} | {row['lost']} | {row['completed']} |"
        for row in kills["rows"]
    )
    two, loops, dask, profiled = (
        [_ratio(each["ways"], way, to) for each in (tiny, large)]
        for way, to in ((TWO, ONE), (TWO_LOOPS, LOOP), (DASK, TWO), (PROFILED, TWO))
    )
    early, late = (size / 1e6 for size in storage["memory"])
    return f"""# Many units

This page, written by `make fleet`, reports runs of `imucal fleet run` over simulated units, on
{speed["processors"]} processors. The load of the machine before each part is given, because times are true
only on an idle one.

## What is planted and what is found

{planted["units"]} units with {first["units"]} recordings of 50 s at 25 Hz (`benches/fleet/simulated.py`):
two stations, three operators, five batches, monthly measurements of some units and a gauge study. The
second run computes {second["done"]} units and skips {second["skipped"]}; {second["unreadable"]} files cannot
be read.

{planted["table"]}

Together {planted["missed"]} are missed, and there are {planted["false"]} false alarms.

## Units per second

The load before the measurement was {speed["load"]:.1f}. The start of the processes is included, except that
of the Dask cluster. Tiny recordings have {tiny["size"] / 1e3:.0f} kB ({tiny["units"]} units), large ones
{large["size"] / 1e6:.1f} MB ({large["units"]} units). Each figure is the median of {ROUNDS} rounds. Ratios
are taken within each round, because the speed of the machine changes from round to round; the smallest and
the largest follow in brackets.

| | tiny, units/s | large, units/s |
|---|---|---|
{rates}

| ratio | tiny | large |
|---|---|---|
| 2 processes to 1 process | {two[0]} | {two[1]} |
| two plain loops that share nothing to one | {loops[0]} | {loops[1]} |
| Dask to 2 processes | {dask[0]} | {dask[1]} |
| Dask with a profiler to 2 processes | {profiled[0]} | {profiled[1]} |

Two plain loops show what the two processors of this machine give. Dask starts the profiler by default in
each worker (docs/fleet.md says how to turn it off).

## A large store

{storage["rows"]} synthetic results are stored in {storage["elapsed_s"]:.1f} s (load
{storage["load"]:.1f}), in transactions of 50 that are on the disk when they end. The file has
{storage["size"] / 1e6:.0f} MB. The memory of the process is {early:.0f} MB after a tenth of the results and
{late:.0f} MB after all.

| query, best of {store.ROUNDS} | time |
|---|---|
{queries}

The statistics of all units, and the report page, which has {storage["page"] / 1e6:.1f} MB:

| command | time |
|---|---|
{statistics}

## A poisoned file

One of {poisoned["units"]} recordings ends each process that reads it by a segmentation fault. The store then
has {rows}; the poisoned row is {"the planted one" if is_alone else "**not** the planted one alone"}. The run
takes {poisoned["elapsed_s"]:.1f} s, and {poisoned["without_s"]:.1f} s without this file. A second run
computes {poisoned["again"]} units. The memory of the parent is {small:.0f} MB after a tenth of the units and
{large_memory:.0f} MB after all.

## Kills

Runs of {kill_units} units whose processes end by SIGKILL at random moments. Lost are units that were told and
are not in the store, and rows that are there twice or in part. After each kill a further run completes the
store.

| killed | kills | runs | lost | completed |
|---|---|---|---|---|
{lines}

The full disk is a limit of 200 kB of each file that the run writes.
"""


def _ratio(ways: dict[str, list[float]], way: str, to: str) -> str:
    each = [one / other for one, other in zip(ways[way], ways[to], strict=True)]
    return f"{median(each):.2f} ({min(each):.2f} to {max(each):.2f})"
