"""The page of reason codes has every code of the sources and no other, and the command explains each."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from imucal.cli.codes import CODES, code_text, codes_markdown, kind_of

ROOT = Path(__file__).resolve().parents[2]
LISTED = {code for entries in CODES.values() for code in entries}
# Codes where findings, reasons and failures are made.
IN_RUST = re.compile(
    r"(?:Finding::(?:error|warning)|\bfault|mount_fault|kind)\(\s*\"([a-z0-9_]+)\""
    r"|\bcode: \"([a-z0-9_]+)\""
    r"|Self::\w+ \{ \.\. \} => \"([a-z_]+)\",$",
    re.MULTILINE,
)
IN_PYTHON = re.compile(
    r"(?m)(?:Finding\(|remark\(\s*[\w.]+,)\s*(?:code=)?\"([a-z0-9_]+)\""
    r"|\bcode = \"([a-z_]+)\"|Error, \"([a-z_]+)\"\)|, \"(bug)\"\)"
    r"|Outcome\(\w+, \"failed\", \"([a-z_]+)\""
    r"|^(?:FILE_MISSING|TIME_LIMIT): Final = \"([a-z_]+)\"$"
    r"|: use imucal evaluate \[([a-z_]+)\]"
)
UNIT_TESTS = re.compile(r"#\[cfg\(test\)\]\s*mod tests \{")
# Places where the severity of a finding is in the same expression as its code.
SEVERITY_IN_RUST = re.compile(r"Finding::(error|warning)\(\s*\"([a-z0-9_]+)\"")
SEVERITY_IN_PYTHON = re.compile(
    r"Finding\(\s*(?:code=)?\"([a-z0-9_]+)\",\s*(?:severity=)?\"(error|warning)\"|\b(remark)\(\s*[\w.]+,\s*\"([a-z_]+)\""
)
# Codes of findings whose severity is a variable or is changed after the finding is made.
SEVERITY_BY_VARIABLE = {
    "accel_saturation": {"error", "warning"},
    "clock_irregular": {"error", "warning"},
    "gravity_sign": {"error", "warning"},
    "gyro_saturation": {"error", "warning"},
    "non_finite": {"error", "warning"},
    "samples_duplicated": {"error", "warning"},
}
# Files that choose among several codes by a variable, and those of their codes that stand nowhere else.
BY_VARIABLE = {
    "check/gains.rs": set(),
    "check/independence.rs": set(),
    "check/rails.rs": {"accel_saturation", "gyro_saturation"},
    "gap/clock.rs": set(),
    "gap/mount.rs": set(),
    "noise.rs": {"noise_filtered", "noise_model", "recording_short"},
    "noise/steps.rs": {"step", "steps_cut"},
}


def rust_sources():
    """Path below rust/imucal/src, and the text without its unit tests."""
    folder = ROOT / "rust/imucal/src"
    for path in folder.rglob("*.rs"):
        yield str(path.relative_to(folder)), UNIT_TESTS.split(path.read_text(encoding="utf-8"))[0]


def test_every_code_of_the_sources_is_listed_and_no_other():
    found = set().union(*BY_VARIABLE.values())
    for _, text in rust_sources():
        found |= {code for match in IN_RUST.findall(text) for code in match if code}
    for path in (ROOT / "python/imucal").rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        found |= {code for match in IN_PYTHON.findall(text) for code in match if code}
    assert found == LISTED


def test_the_kind_of_a_finding_is_its_severity_in_the_sources():
    found = {code: set(kinds) for code, kinds in SEVERITY_BY_VARIABLE.items()}
    for _, text in rust_sources():
        for severity, code in SEVERITY_IN_RUST.findall(text):
            found.setdefault(code, set()).add(severity)
    for path in (ROOT / "python/imucal").rglob("*.py"):
        for code, severity, _, warned in SEVERITY_IN_PYTHON.findall(path.read_text(encoding="utf-8")):
            found.setdefault(code or warned, set()).add(severity or "warning")
    assert len(found) > 40
    listed = {code: kind_of(code, heading) for heading, entries in CODES.items() for code in entries}
    assert {code: " or ".join(sorted(kinds)) for code, kinds in found.items()} == {
        code: kind for code, kind in listed.items() if code in found
    }


def test_files_that_choose_a_code_by_a_variable_are_known():
    files = {
        name
        for name, text in rust_sources()
        if re.search(r"Finding::(?:error|warning)\(code\b", text) and name != "finding.rs"
    }
    assert files == set(BY_VARIABLE)


def test_the_page_is_that_of_the_table():
    page = (ROOT / "docs/codes.md").read_text(encoding="utf-8")
    assert page == codes_markdown(), (
        "write codes_markdown() of imucal.cli.codes to docs/codes.md: it has changed"
    )


@pytest.mark.parametrize("code", sorted(LISTED))
def test_an_entry_says_cause_and_cure(code):
    text = code_text(code)
    assert re.fullmatch(rf"{code} \(.+\): .+\n  cause: .+\.\n  what to do: .+\.", text)
    assert "](" not in text


def test_help_explains_a_code():
    command = [sys.executable, "-m", "imucal", "help", "gyro_units"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0
    assert done.stdout.startswith("gyro_units (Units): error\n  cause: ")


def test_an_unknown_code_is_an_error():
    assert code_text("no_such_code") is None
