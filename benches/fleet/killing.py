"""Runs of a fleet whose processes are killed, and what must then be in the store.

A run tells each unit after its outcome is stored. After any kill, all told units are in the store, none is
there twice, and a further run completes.
"""

import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import imucal

__all__ = ["Run", "check", "start", "workers_of"]

PARENT = """
import sys, imucal
store, manifest, workers, scheduler, total, limit_s = sys.argv[1:7]
where = {"scheduler": scheduler} if scheduler else {"workers": int(workers)}
told = 0
def memory():
    # VmHWM begins with this program; ru_maxrss would include the process that started it.
    peak = next(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM"))
    print("memory", 1024 * int(peak), flush=True)
def tell(job, verdict, code, message):
    global told
    print("told", job.serial, verdict, flush=True)
    told += 1
    if told == int(total) // 10:
        memory()
limit_s = float(limit_s) or None
tally = imucal.Fleet(store).run(manifest, total=int(total), tell=tell, time_limit_s=limit_s, **where)
print("done", tally.done, tally.skipped, flush=True)
memory()
"""


@dataclass
class Run:
    """A run in a process of its own, with the units that it has told."""

    process: subprocess.Popen
    output: Path

    @property
    def told(self) -> list[str]:
        # A killed process may leave the beginning of a line.
        lines = [
            line.split() for line in self.output.read_text().splitlines(keepends=True) if line.endswith("\n")
        ]
        return [words[1] for words in lines if words[:1] == ["told"]]

    def wait_for(self, told: int, timeout_s: float = 60.0) -> None:
        """Wait until this number of units is told, or the run ends."""
        end_s = time.monotonic() + timeout_s
        while len(self.told) < told and self.process.poll() is None and time.monotonic() < end_s:
            time.sleep(0.01)

    def wait(self, timeout_s: float = 300.0) -> int:
        return self.process.wait(timeout_s)


def start(
    store: Path,
    manifest: Path,
    *,
    workers: int = 2,
    scheduler: str = "",
    total: int = 0,
    start_files: Path | None = None,
    limit_bytes: int | None = None,
    time_limit_s: float = 0.0,
) -> Run:
    """Start a run.

    start_files  folder of a sitecustomize.py for its processes
    limit_bytes  largest size of a file that it may write, as with a full disk
    time_limit_s longest time of one unit, s; 0 for none
    """

    def limited() -> None:
        if limit_bytes is not None:
            import resource

            resource.setrlimit(resource.RLIMIT_FSIZE, (limit_bytes, limit_bytes))

    environment = dict(os.environ)
    if start_files is not None:
        before = environment.get("PYTHONPATH")
        environment["PYTHONPATH"] = os.pathsep.join([str(start_files), *([before] if before else [])])
    output = store.with_name(f"{store.name}.{random.randrange(1 << 40):x}.out")
    words = [sys.executable, "-c", PARENT, str(store), str(manifest), str(workers), scheduler]
    words += [str(total), str(time_limit_s)]
    with output.open("wb") as file:
        process = subprocess.Popen(
            words, stdout=file, stderr=subprocess.STDOUT, env=environment, preexec_fn=limited
        )
    return Run(process, output)


def workers_of(parent: int) -> list[int]:
    """The children of a process, by /proc."""
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdecimal():
            try:
                fields = (folder / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if int(fields[1]) == parent:
                found.append(int(folder.name))
    return found


def kill(process: int) -> bool:
    """Kill a process; whether it was there."""
    try:
        os.kill(process, signal.SIGKILL)
    except ProcessLookupError:
        return False
    return True


def check(store: Path, told: list[str]) -> int:
    """Check a store after a kill; returns the number of rows. Raises AssertionError for a fault."""
    fleet = imucal.Fleet(store)
    if not store.exists():
        assert not told
        return 0
    assert fleet.query("PRAGMA integrity_check")[1] == [("ok",)]
    rows = fleet.query("SELECT serial, recording FROM units JOIN jobs ON jobs.unit = units.id")[1]
    assert len(set(rows)) == len(rows), "a recording is stored twice"
    assert set(told) <= {serial for serial, _ in rows}, "a unit was told and is not stored"
    results = fleet.query("SELECT count(*) FROM jobs WHERE verdict IN ('good', 'incomplete', 'poor')")[1][0][
        0
    ]
    complete = fleet.query("SELECT count(*) FROM results JOIN documents USING (job)")[1][0][0]
    assert results == complete, "a row is stored in part"
    return len(rows)
