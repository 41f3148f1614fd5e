"""The child process of `imucal.io.isolated`: limits itself, reads the files, and writes the recordings."""

from __future__ import annotations

import os
import signal
from contextlib import suppress
from pathlib import Path
from typing import Any

from imucal.errors import ImucalError
from imucal.io.faults import faults_named, too_large
from imucal.io.formats import FORMATS
from imucal.io.passing import write_end, write_error, write_recording

__all__ = ["limit_process", "serve"]


def serve(request: dict[str, Any]) -> None:
    """Read the requested files and write the recordings to standard output; see `imucal.io.passing`."""
    # Interrupts are ignored, because the parent handles Ctrl-C and ends this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with os.fdopen(os.dup(1), "wb") as stream:
        # Standard output is redirected, because messages printed by libraries must not reach the stream.
        os.dup2(2, 1)
        limit_process(request["memory_bytes"], request["processor_s"])
        known, paths, options = FORMATS[request["format"]], request["paths"], request["options"]
        error: ImucalError | None = None
        try:
            with faults_named(paths, known.title):
                for piece in known.pieces(*paths, **options):
                    write_recording(piece, stream)
        except ImucalError as failure:
            error = failure
        except MemoryError:
            # The memory limit is lifted first. Otherwise there would be no memory for the error message.
            _free_memory()
            error = too_large(paths, known.title)
        _free_memory()
        if error is None:
            write_end(stream)
        else:
            write_error(error, stream)
        stream.flush()
    # `os._exit` skips the clean-up code of the libraries, which can crash after a damaged file was read.
    os._exit(0)


def limit_process(memory_bytes: int, processor_s: int) -> None:
    """Limit memory, processor time and file size of this process, if the operating system supports it."""
    try:
        import resource
    except ImportError:
        return  # Windows; the parent limits the duration.
    limits = {
        resource.RLIMIT_CORE: 0,
        resource.RLIMIT_CPU: processor_s,
        # The size of written files is limited, because rosbags decompresses a bag with compressed files to a
        # temporary file.
        resource.RLIMIT_FSIZE: memory_bytes,
    }
    with suppress(OSError, ValueError, IndexError):
        pages = int(Path("/proc/self/statm").read_text().split()[5])
        limits[resource.RLIMIT_DATA] = pages * resource.getpagesize() + memory_bytes
    for kind, value in limits.items():
        _, most = resource.getrlimit(kind)
        allowed = value if most == resource.RLIM_INFINITY else min(value, most)
        with suppress(OSError, ValueError):
            # Only the soft limit is changed. A process that reaches its soft limit of processor time receives
            # SIGXCPU, which identifies the cause; at the hard limit it would receive SIGKILL.
            resource.setrlimit(kind, (allowed, most))


def _free_memory() -> None:
    """Lift the memory limit, because writing the end of the stream needs a few bytes."""
    with suppress(ImportError, OSError, ValueError):
        import resource

        _, most = resource.getrlimit(resource.RLIMIT_DATA)
        resource.setrlimit(resource.RLIMIT_DATA, (most, most))
