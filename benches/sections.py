"""Sections of the reports in docs/results: each program replaces its own section and keeps the others."""

from pathlib import Path

__all__ = ["write_section"]


def write_section(report: Path, title: str, heading: str, body: str) -> None:
    """Replace the section `heading` by `body`, or append it; `title` is the heading of a new report."""
    text = report.read_text(encoding="utf-8") if report.exists() else f"# {title}\n"
    start, *sections = text.split("\n## ")
    kept = {section.split("\n", 1)[0]: section.strip() for section in sections}
    kept[heading] = f"{heading}\n\n{body.strip()}"
    report.parent.mkdir(parents=True, exist_ok=True)
    report.write_text("\n\n## ".join([start.strip(), *kept.values()]) + "\n", encoding="utf-8")
    print(f"## {heading}\n\n{body.strip()}\n\nwritten to {report}\n")
