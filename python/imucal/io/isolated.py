"""Reading of files in a child process with limited memory and time.

Libraries of binary formats trust the lengths and offsets in a file. A damaged file can make them allocate
gigabytes, loop for ever, or crash the process. In a child process such a failure becomes an error for this
file only.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from imucal.document.plain import plain
from imucal.errors import FormatError
from imucal.io.faults import WAY_OUT, shown_names
from imucal.io.passing import BrokenFrameError, recordings_in
from imucal.recording.recording import Recording

__all__ = ["Limits", "limits_for", "read_in_child", "size_of"]

# A child process may allocate MEMORY_BYTES after its start, for libraries and small files, plus
# MEMORY_PER_BYTE times the size of the files in bytes. A ROS message has about the same size in memory as in
# the file. An array of a compressed file is several times larger in memory than in the file, and its
# conversion needs twice this memory.
MEMORY_BYTES: Final = 100_000_000
MEMORY_PER_BYTE: Final = 10
# A child process may use PROCESSOR_S of processor time, s, for libraries and small files, plus
# PROCESSOR_S_PER_BYTE times the size of the files in bytes. The slowest library reads some megabytes per
# second.
PROCESSOR_S: Final = 6.0
PROCESSOR_S_PER_BYTE: Final = 4e-6
# Maximum duration of a child process, as a multiple of its maximum processor time. It allows for waiting for
# the disk and for a busy computer.
DURATION: Final = 20.0
# Python program of the child process. It sets the module search path of the parent process, so that both
# processes import the same libraries.
START: Final = (
    "import json, sys; request = json.loads(sys.stdin.readline()); sys.path[:] = request['search_path']; "
    "from imucal.io.isolated_child import serve; serve(request)"
)
# Environment variables of the child that restrict libraries to one thread, because each thread would reserve
# memory.
ONE_THREAD: Final = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "ARROW_IO_THREADS": "1",
    "ARROW_DEFAULT_MEMORY_POOL": "system",
}


@dataclass(frozen=True)
class Limits:
    """Limits of a child process: memory in bytes, processor time and duration in s."""

    memory_bytes: int
    processor_s: int
    duration_s: float


def limits_for(size: int) -> Limits:
    """The limits for files of this total size, bytes."""
    processor_s = PROCESSOR_S + PROCESSOR_S_PER_BYTE * size
    return Limits(int(MEMORY_BYTES + MEMORY_PER_BYTE * size), round(processor_s), DURATION * processor_s)


def read_in_child(
    paths: Sequence[str | os.PathLike[str]], format: str, title: str, options: Mapping[str, Any]
) -> Iterator[Recording] | None:
    """The recording in these files, in pieces, read by a child process; None if no child can be started.

    Raises the errors of the format's reader, and FormatError if the child exceeds its limits or crashes.
    """
    if not Path(sys.executable or "").name.lower().startswith(("python", "pypy")):
        # If the interpreter is embedded in another program, the executable is that program and must not be
        # started again.
        return None
    limits = limits_for(size_of(paths))
    request = {
        "search_path": sys.path,
        "format": format,
        "paths": [os.fspath(path) for path in paths],
        "options": plain(options),
        "memory_bytes": limits.memory_bytes,
        "processor_s": limits.processor_s,
    }
    try:
        child = subprocess.Popen(
            [sys.executable, "-I", *(["-B"] if sys.dont_write_bytecode else []), "-c", START],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            # Messages that libraries print about damaged files are discarded, because this module raises its
            # own error.
            stderr=subprocess.DEVNULL,
            env={**os.environ, **ONE_THREAD},
        )
    except OSError:
        return None
    return _received(child, request, limits, f"{shown_names(paths)} cannot be read as {title}")


def _received(
    child: subprocess.Popen[bytes], request: dict[str, Any], limits: Limits, what: str
) -> Iterator[Recording]:
    assert child.stdin is not None and child.stdout is not None
    late = threading.Event()

    def stop() -> None:
        late.set()
        child.kill()

    timer = threading.Timer(limits.duration_s, stop)
    timer.daemon = True
    timer.start()
    try:
        with suppress(BrokenPipeError):
            child.stdin.write(json.dumps(request).encode() + b"\n")
            child.stdin.close()
        yield from recordings_in(child.stdout, limits.memory_bytes)
    except BrokenFrameError:
        code = child.wait()
        raise FormatError(f"{what}: {_reason(code, limits, late.is_set())}: {WAY_OUT}") from None
    finally:
        timer.cancel()
        child.kill()
        child.wait()
        child.stdout.close()


def _reason(code: int, limits: Limits, is_late: bool) -> str:
    """The reason why a child ended without a result; `code` is its exit code."""
    if is_late:
        return f"its library took more than {limits.duration_s:.0f} s"
    if code == -getattr(signal, "SIGXCPU", 0):
        return f"its library took more than {limits.processor_s} s of processor time"
    if code < 0:
        with suppress(ValueError):
            return f"its library has crashed ({signal.Signals(-code).name})"
    return f"its library has ended with the code {code}"


def size_of(paths: Sequence[str | os.PathLike[str]]) -> int:
    """Total size of the files, including those in a folder, bytes.

    The size of an inaccessible file counts as 0.
    """
    total = 0
    for path in map(Path, paths):
        with suppress(OSError, ValueError):
            files = path.iterdir() if path.is_dir() else [path]
            total += sum(file.stat().st_size for file in files if file.is_file())
    return total
