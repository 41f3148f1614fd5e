"""What the pages in docs/results share: sections, each of which its own program replaces, and the machine."""

import os
import platform
from pathlib import Path

__all__ = ["machine_name", "write_section"]


def write_section(report: Path, title: str, heading: str, body: str) -> None:
    """Replace the section `heading` by `body`, or append it; `title` is the heading of a new report."""
    text = report.read_text(encoding="utf-8") if report.exists() else f"# {title}\n"
    start, *sections = text.split("\n## ")
    kept = {section.split("\n", 1)[0]: section.strip() for section in sections}
    kept[heading] = f"{heading}\n\n{body.strip()}"
    report.parent.mkdir(parents=True, exist_ok=True)
    report.write_text("\n\n## ".join([start.strip(), *kept.values()]) + "\n", encoding="utf-8")
    print(f"## {heading}\n\n{body.strip()}\n\nwritten to {report}\n")


def machine_name() -> str:
    """Name of the processor, and number of its cores."""
    model = platform.processor() or platform.machine()
    try:
        info = Path("/proc/cpuinfo").read_text(encoding="utf-8")
        model = next(
            line.split(":", 1)[1].strip() for line in info.splitlines() if line.startswith("model name")
        )
    except (OSError, StopIteration):
        pass
    return f"{model}, {os.cpu_count()} cores"
