"""The README does what it says: its `console` and `python` blocks run, in order, in one empty folder."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
BLOCK = re.compile(r"^```(console|python)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\((?!https?://)([^)#]+)[^)]*\)")


def steps(markdown):
    """Argument lists for a shell command per `$` line, and for a Python program per python block."""
    for language, text in BLOCK.findall(markdown):
        if language == "python":
            yield [sys.executable, "-c", text]
        else:
            commands = [line.removeprefix("$ ") for line in text.splitlines() if line.startswith("$ ")]
            yield from (["sh", "-c", command] for command in commands)


def test_readme_runs(tmp_path):
    beside_python = str(Path(sys.executable).parent)
    environment = {**os.environ, "PATH": beside_python + os.pathsep + os.environ["PATH"]}
    ran = 0
    for step in steps((ROOT / "README.md").read_text(encoding="utf-8")):
        done = subprocess.run(
            step, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=120
        )
        assert done.returncode == 0, f"{step[-1]}\n{done.stdout}\n{done.stderr}"
        ran += 1
    assert ran >= 7
    for name in ("run.csv", "truth.json", "unit-0042.json", "report.html", "corrected.csv"):
        assert (tmp_path / name).stat().st_size > 0


@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md", "docs/model.md", "docs/tutorial-xsens.md"])
def test_links_within_the_project_lead_somewhere(page):
    path = ROOT / page
    for target in LINK.findall(path.read_text(encoding="utf-8")):
        assert (path.parent / target).exists(), f"{page} links to {target}"


def test_every_equation_that_code_cites_is_in_the_model():
    numbers = set(
        re.findall(r"^## \((\d+)\)", (ROOT / "docs/model.md").read_text(encoding="utf-8"), re.MULTILINE)
    )
    cited = {}
    for source in [*ROOT.glob("rust/**/*.rs"), *ROOT.glob("python/**/*.py")]:
        for citation in re.findall(
            r"model\.md ((?:\(\d+\)(?:, | to | and )?)+)", source.read_text(encoding="utf-8")
        ):
            for number in re.findall(r"\d+", citation):
                cited.setdefault(number, source)
    missing = {number: source for number, source in cited.items() if number not in numbers}
    assert not missing
