"""Maximum resident memory of this process. `ru_maxrss` would include the process that started it."""

import re
from pathlib import Path


def peak_bytes() -> int:
    """Maximum resident memory since the start of the process or the last reset, bytes."""
    status = Path("/proc/self/status").read_text()
    return int(re.search(r"VmHWM:\s+(\d+) kB", status)[1]) * 1024  # type: ignore[index]


def reset_peak() -> None:
    """Let the maximum begin again with the present resident memory."""
    Path("/proc/self/clear_refs").write_text("5")
