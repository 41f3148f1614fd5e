"""Reading of damaged files, each in a process of its own whose result, time and memory are recorded.

A process is forked after the libraries are loaded, so a case takes milliseconds. Formats that imucal reads in
a child process are read with the limits of that child; a crash or a reached limit then counts as `contained`,
because imucal reports it as an error of the file. In all other cases it is a fault.
"""

import faulthandler
import os
import resource
import signal
import time
import traceback
from collections import Counter, defaultdict
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass, field

import imucal
from imucal.io import FORMATS
from imucal.io.faults import faults_named
from imucal.io.isolated import limits_for, size_of
from imucal.io.isolated_child import limit_process
from mutations import mutated

# A case is a fault above these limits: processor time, s; memory in addition to that before the case, bytes,
# as a constant and a multiple of the size of the file.
MOST_S = 10.0
MOST_BYTES, MOST_PER_BYTE = 200_000_000, 10
# Length of the first message of a forked process: its largest resident memory before it reads the file, KiB.
DIGITS = 16
# Time after which a case is ended, s.
HANGS_S = 120.0
LOADERS = {
    "calibration": imucal.Calibration.load,
    "program": imucal.Program.read,
    "stand": imucal.Stand.read,
    "stand_limits": imucal.StandLimits.read,
    "unit": imucal.Unit.read,
    "limits": imucal.Limits.load,
}
READ, REFUSED, CONTAINED, FAULT = "read", "refused", "contained", "fault"


@dataclass(frozen=True)
class Outcome:
    """What became of a case; `reason` explains a fault."""

    result: str
    reason: str = ""
    processor_s: float = 0.0
    memory_bytes: int = 0


@dataclass
class Tally:
    """Results of all cases of one seed."""

    counts: Counter = field(default_factory=Counter)
    slowest_s: float = 0.0
    most_bytes: int = 0
    faults: list = field(default_factory=list)

    def add(self, number, outcome):
        self.counts[outcome.result] += 1
        self.slowest_s = max(self.slowest_s, outcome.processor_s)
        self.most_bytes = max(self.most_bytes, outcome.memory_bytes)
        if outcome.result == FAULT:
            self.faults.append((number, outcome.reason))


def preload():
    """Load the libraries of all formats, which the forked processes share."""
    import h5py
    import mcap.reader
    import pymavlink.DFReader
    import pyulog
    import rosbags.rosbag1
    import rosbags.rosbag2
    import scipy.io

    return h5py, mcap, pymavlink, pyulog, rosbags, scipy


def rounds(seeds, folder, first, count=None, end_s=None):
    """Damage and read each seed in turn, with random numbers from `first` on.

    Yields the number of the next round and the tallies by name after each round.
    """
    tallies = defaultdict(Tally)
    number = first
    while (count is None or number < first + count) and (end_s is None or time.monotonic() < end_s):
        for seed in seeds:
            tallies[seed.name].add(number, case(seed, folder, number))
        number += 1
        yield number, tallies


def case(seed, folder, number):
    """Damage a seed with one random number, and read it; number None reads it as it is."""
    target = seed.damaged or seed.path
    before = target.read_bytes()
    content = before
    if number is not None:
        content = mutated(before, f"{seed.name} {number}", is_text=seed.is_text, is_json=seed.is_json)
    if seed.damaged is not None:
        # In a folder with other files.
        target.write_bytes(content)
        try:
            return _outcome(seed, seed.path)
        finally:
            target.write_bytes(before)
    path = folder / f"case{target.suffix}"
    path.write_bytes(content)
    return _outcome(seed, path)


def _outcome(seed, path):
    is_isolated = seed.kind in FORMATS and FORMATS[seed.kind].isolated
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        os.write(writing, b"%*d" % (DIGITS, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss))
        os._exit(_read(seed, path, is_isolated, writing))
    os.close(writing)
    with os.fdopen(reading, "rb") as stream:
        before_kib = int(stream.read(DIGITS))
        reason = stream.read().decode(errors="replace")
    _, status, usage = os.wait4(child, 0)
    processor_s = usage.ru_utime + usage.ru_stime
    memory_bytes = (usage.ru_maxrss - before_kib) * 1024
    code = os.waitstatus_to_exitcode(status)
    figures = {"processor_s": processor_s, "memory_bytes": memory_bytes}
    if processor_s > MOST_S or memory_bytes > MOST_BYTES + MOST_PER_BYTE * size_of([path]):
        return Outcome(FAULT, f"{processor_s:.1f} s, {memory_bytes / 1e6:.0f} MB", **figures)
    if code in (0, 1):
        return Outcome((READ, REFUSED)[code], reason, **figures)
    if is_isolated and code != 2:
        return Outcome(CONTAINED, f"ended with {code}", **figures)
    return Outcome(FAULT, reason or f"ended with {code}", **figures)


def _read(seed, path, is_isolated, writing):
    """In the forked process: 0 if the file was read, 1 if it was refused, 2 for another exception."""
    # A crash of a library is a result here.
    faulthandler.disable()
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_REAL, HANGS_S)
    with suppress(OSError):
        quiet = os.open(os.devnull, os.O_WRONLY)
        os.dup2(quiet, 1)
        os.dup2(quiet, 2)
    second = [seed.options["second"]] if "second" in seed.options else []
    options = {name: value for name, value in seed.options.items() if name not in ("second", "load")}
    try:
        with redirect_stdout(None), redirect_stderr(None):
            if "load" in seed.options:
                LOADERS[seed.options["load"]](path)
            elif is_isolated:
                limits = limits_for(size_of([path]))
                limit_process(limits.memory_bytes, limits.processor_s)
                with faults_named([path], FORMATS[seed.kind].title):
                    FORMATS[seed.kind].read(path, **options)
            else:
                imucal.read(path, *second, format=seed.kind, **options)
    except imucal.ImucalError as error:
        message = str(error)
        # Any message must be one that can be printed.
        with suppress(OSError):
            os.write(writing, message.encode("utf-8", "backslashreplace"))
        return 1
    except BaseException:
        os.write(writing, traceback.format_exc()[-2000:].encode("utf-8", "backslashreplace"))
        return 2
    return 0
