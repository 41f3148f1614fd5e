"""Computes the jobs of a fleet that have no outcome in the store.

A task is a group of jobs that one process computes. An outcome is stored before it is counted. If a process
ends without an answer, its task is divided in halves until single jobs remain. A single job is tried again
while no other job runs. If the process ends without an answer in every attempt, the job gets the verdict
`poisoned`. Repeated attempts are needed, because a process may also be killed from outside, by a person or
for lack of memory.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, Final

from imucal.errors import ImucalError
from imucal.fleet.job import UNREAD, Job, KeyedJob, Options, keyed, unread
from imucal.fleet.local import Ended, Pool
from imucal.fleet.outcome import TRANSIENT, Outcome
from imucal.fleet.store import Known, Store
from imucal.fleet.task import FILE_MISSING, Task, failure_of

__all__ = ["Tally", "run_jobs"]

# Number of jobs per task, without and with the search for missing effects. A calibration takes about 20 ms,
# so with 50 jobs the overhead of a task, a few ms, is small. A search takes seconds, so a task with a search
# has fewer jobs. A task must not take minutes, because a run that was killed repeats its unfinished tasks.
PER_TASK: Final = 50
PER_TASK_WITH_GAP: Final = 5
# In a small fleet, the jobs are divided into at least this number of tasks per process. With fewer tasks,
# some processes would be idle while the last tasks run.
TASKS_PER_PROCESS: Final = 4
# Number of attempts to compute a job while no other job runs. If all attempts fail, the recording of the job
# counts as poisoned.
TRIES_ALONE: Final = 3


@dataclass
class Tally:
    """Counts of the units of a run.

    done        number of units computed in this run, including those without a result
    skipped     number of units in the store from an earlier run
    unreadable  number of units whose files could not be read, so that they were not computed
    verdicts    numbers of `good`, `incomplete`, `poor`, `failed` and `poisoned` units, including units from
                earlier runs
    codes       numbers of failures by their code
    """

    done: int = 0
    skipped: int = 0
    unreadable: int = 0
    verdicts: Counter[str] = field(default_factory=Counter)
    codes: Counter[str] = field(default_factory=Counter)

    @property
    def units(self) -> int:
        """The number of all jobs of the run."""
        return self.done + self.skipped + self.unreadable

    @property
    def failed(self) -> int:
        """Number of units without a result, excluding poisoned units."""
        return self.verdicts["failed"]

    @property
    def poisoned(self) -> int:
        """Number of units whose recording crashes every process that reads it."""
        return self.verdicts["poisoned"]

    @property
    def verdict(self) -> str:
        """The worst verdict; no_result if a unit has no result."""
        if self.failed or self.poisoned:
            return "no_result"
        return next((each for each in ("poor", "incomplete") if self.verdicts[each]), "good")

    def to_dict(self) -> dict[str, Any]:
        """The JSON document of `imucal fleet run --json`."""
        return {
            "verdict": self.verdict,
            "units": self.units,
            "done": self.done,
            "skipped": self.skipped,
            "unreadable": self.unreadable,
            "failed": self.failed,
            "poisoned": self.poisoned,
            "verdicts": {name: self.verdicts[name] for name in ("good", "incomplete", "poor")},
            "codes": dict(self.codes.most_common()),
        }


Tell = Callable[[Job, str, "str | None", "str | None"], None]


def run_jobs(
    store: Store,
    jobs: Iterable[Job],
    options: Options,
    make_pool: Callable[[], Pool],
    *,
    total: int | None = None,
    retry: bool = False,
    tell: Tell | None = None,
    tally: Tally | None = None,
) -> Tally:
    """Compute the jobs that are not in the store.

    make_pool  function that creates the pool; it is called when the first job has to be computed
    total      number of jobs, if known; it determines the size of tasks
    retry      whether to compute again the jobs that have no result
    tell       callback for each job with its verdict, and code and message of a failure
    tally      counts of earlier runs, to which the counts of this run are added, even if it is interrupted

    Raises ImucalError if the store cannot be written or the pool is lost. After such an error, the store
    contains all outcomes that were reported to `tell`.
    """
    run = _Run(store, options, make_pool, total, retry, tell or (lambda *_: None), tally or Tally())
    return run.of(jobs)


class _Run:
    def __init__(
        self,
        store: Store,
        options: Options,
        make_pool: Callable[[], Pool],
        total: int | None,
        retry: bool,
        tell: Tell,
        tally: Tally,
    ) -> None:
        self._store, self._options, self._text = store, options, options.text
        self._make_pool, self._total, self._retry, self._tell = make_pool, total, retry, tell
        self._tally, self._before = tally, tally.done
        self._pool: Pool | None = None
        self._halves: deque[Task] = deque()
        self._suspects: deque[Task] = deque()
        self._in_pool = 0
        # Keys of the jobs in the pool. With these keys, a recording that a manifest lists twice is computed
        # only once.
        self._pending: set[str] = set()

    def of(self, jobs: Iterable[Job]) -> Tally:
        new = self._tasks(jobs)
        try:
            while True:
                self._fill(new)
                if self._in_pool:
                    self._take()
                elif self._suspects:
                    self._try_alone(self._suspects.popleft())
                else:
                    return self._tally
        except ImucalError as error:
            raise type(error)(
                f"{error}; {self._tally.done - self._before} outcomes of this run are in the store"
            ) from None
        finally:
            if self._pool is not None:
                self._pool.close()

    def _fill(self, new: Iterator[Task]) -> None:
        """Submit tasks up to the capacity of the pool."""
        while self._pool is None or self._in_pool < self._pool.capacity:
            task = self._halves.popleft() if self._halves else next(new, None)
            if task is None:
                return
            self._submit(task)

    def _submit(self, task: Task) -> Pool:
        if self._pool is None:
            self._pool = self._make_pool()
        self._pool.submit(task)
        self._in_pool += 1
        return self._pool

    def _take(self) -> None:
        if self._pool is None:
            return
        task, answer = self._pool.next()
        self._in_pool -= 1
        if not isinstance(answer, Ended):
            self._put(answer)
            if len(answer) < len(task):
                # One job exceeded the time limit and ended the task. The jobs after it form a new task.
                self._halves.append(Task(task.jobs[len(answer) :], task.options))
        elif len(task) > 1:
            half = len(task) // 2
            self._halves += [Task(part, task.options) for part in (task.jobs[:half], task.jobs[half:])]
        else:
            self._suspects.append(task)

    def _try_alone(self, task: Task) -> None:
        ends = []
        for _ in range(TRIES_ALONE):
            _, answer = self._submit(task).next()
            self._in_pool -= 1
            if not isinstance(answer, Ended):
                self._put(answer)
                return
            ends.append(answer.how)
        message = _poisoned(ends)
        for each in task.jobs:
            found = each if isinstance(each, KeyedJob) else self._keyed(each)
            if found is not None:
                self._put([Outcome(found, "poisoned", "poisoned", message)])

    def _tasks(self, jobs: Iterable[Job]) -> Iterator[Task]:
        """Yield tasks, which are groups of the jobs that have to be computed."""
        waiting: list[Job | KeyedJob] = []
        jobs = iter(jobs)
        while block := list(islice(jobs, PER_TASK)):
            # If the store is new, all jobs are new, so the parent process need not read the files to compute
            # keys. With a time limit the parent computes the keys, because a process that exceeds the limit
            # returns no key.
            is_new = self._options.time_limit_s is None and self._store.is_new
            waiting += block if is_new else self._new_ones(block)
            size = self._task_size()
            while len(waiting) >= size:
                yield Task(tuple(waiting[:size]), self._options)
                del waiting[:size]
        if waiting:
            yield Task(tuple(waiting), self._options)

    def _task_size(self) -> int:
        most = PER_TASK_WITH_GAP if self._options.gap else PER_TASK
        if self._total is None:
            return most
        if self._pool is None:
            self._pool = self._make_pool()
        return max(1, min(most, self._total // (TASKS_PER_PROCESS * self._pool.processes)))

    def _new_ones(self, jobs: Sequence[Job]) -> list[KeyedJob]:
        """Select the jobs without an outcome in the store. Outcomes in the store are counted and reported."""
        readable = [each for job in jobs if (each := self._keyed(job)) is not None]
        known = self._store.known([each.key for each in readable])
        again = [key for key, found in known.items() if self._is_tried_again(found)]
        if again:
            self._store.forget(again)
        old = [each for each in readable if each.key in known.keys() - set(again)]
        if old:
            self._store.describe(old)
        for each in old:
            found = known[each.key]
            self._tally.skipped += 1
            self._count(each.job, found.verdict, found.code, found.message)
        new = []
        for each in readable:
            if each.key in known.keys() - set(again):
                continue
            if each.key in self._pending:
                self._skip(each.job)
                continue
            self._pending.add(each.key)
            new.append(each)
        return new

    def _is_tried_again(self, found: Known) -> bool:
        if found.code in TRANSIENT:
            return True
        return self._retry and found.verdict in ("failed", "poisoned")

    def _keyed(self, job: Job) -> KeyedJob | None:
        """The job with its key. If a file cannot be read, the failure is stored and the result is None."""
        try:
            return keyed(job, self._text)
        except ImucalError as error:
            code, message = failure_of(error)
            if not all(Path(path).exists() for path in (*job.files, *job.control)):
                code = FILE_MISSING
            self._store.put([Outcome(unread(job, self._text), "failed", code, message)], self._text)
            self._tally.unreadable += 1
            self._count(job, "failed", code, message)
            return None

    def _put(self, outcomes: Sequence[Outcome]) -> None:
        is_new = self._store.is_new
        stored = self._store.put(outcomes, self._text)
        for outcome, was_new in zip(outcomes, stored, strict=True):
            job, key = outcome.keyed.job, outcome.keyed.key
            self._pending.discard(key)
            if is_new and not was_new:
                self._skip(job)
                continue
            if key.startswith(UNREAD):
                self._tally.unreadable += 1
            else:
                self._tally.done += 1
            self._count(job, outcome.verdict, outcome.code, outcome.message)

    def _skip(self, job: Job) -> None:
        self._tally.skipped += 1
        self._tell(job, "skipped", "given_twice", "the same files are given twice for this unit")

    def _count(self, job: Job, verdict: str, code: str | None, message: str | None) -> None:
        self._tally.verdicts[verdict] += 1
        if code is not None:
            self._tally.codes[code] += 1
        self._tell(job, verdict, code, message)


def _poisoned(ends: Sequence[str]) -> str:
    how = " and ".join(dict.fromkeys(end for end in ends if end))
    return (
        f"each process that reads this recording ends{f' {how}' if how else ''} without an answer, in "
        f"{len(ends)} attempts when nothing else runs: it crashes, or needs more memory than there is"
    )
