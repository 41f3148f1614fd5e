"""Time from a clone of the project to a C header: `make first-steps`, to docs/results/first-steps.md.

Clones the project, installs the clone into an empty environment, and runs the commands of docs/index.md in
order. Packages in the caches of pip and cargo are not downloaded again.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
REPORT = ROOT / "docs" / "results" / "first-steps.md"
PAGE = Path("docs") / "index.md"
COMMAND = re.compile(r"^\$ (.+)$", re.MULTILINE)
HEADER = "unit_0042.h"
LIMIT_S = 300.0


def main() -> int:
    rows: list[tuple[str, float]] = []
    with tempfile.TemporaryDirectory() as folder:
        clone, environment = Path(folder) / "imucal", Path(folder) / "venv"
        path = f"{environment / 'bin'}{os.pathsep}{os.environ['PATH']}"
        # The clone is built in its own folder, also if this project's build folder is set elsewhere.
        variables = {k: v for k, v in os.environ.items() if k != "CARGO_TARGET_DIR"} | {"PATH": path}
        installing = [
            ("git clone", ["git", "clone", "--quiet", str(ROOT), str(clone)]),
            ("python -m venv", [sys.executable, "-m", "venv", str(environment)]),
            ('pip install ".[report]"', ["pip", "install", "--quiet", f"{clone}[report]"]),
        ]
        using = [
            (line, ["sh", "-c", line]) for line in COMMAND.findall((ROOT / PAGE).read_text(encoding="utf-8"))
        ]
        for words, command in installing + using:
            start_s = time.monotonic()
            subprocess.run(command, cwd=folder, env=variables, check=True, stdout=subprocess.DEVNULL)
            rows.append((words, time.monotonic() - start_s))
            print(f"{rows[-1][1]:7.1f} s  {words}", flush=True)
        assert (Path(folder) / HEADER).stat().st_size > 0
    total_s = sum(seconds for _, seconds in rows)
    REPORT.write_text(page(rows, total_s), encoding="utf-8")
    print(f"{total_s:7.1f} s in all, written to {REPORT.relative_to(ROOT)}")
    return int(total_s > LIMIT_S)


def page(rows: list[tuple[str, float]], total_s: float) -> str:
    table = "\n".join(f"| `{words}` | {seconds:.1f} |" for words, seconds in rows)
    verdict = "met" if total_s <= LIMIT_S else "missed"
    return f"""# From a clone to a C header

Written by `make first-steps`: the time that a machine with {os.cpu_count()} cores takes for the commands
of [First steps](../index.md). The clone is compiled; packages come from the caches of pip and cargo.

| command | s |
| --- | ---: |
{table}
| all | {total_s:.1f} |

The aim of {LIMIT_S:.0f} s is {verdict}.
"""


if __name__ == "__main__":
    sys.exit(main())
