"""The pages do what they say: their commands and programs run, and print what is shown below them.

Reasons of a verdict are read from the docstring of `imucal.stand.verdict`, which lists them, and the packet
format of a page is read by `PacketFormat`.
"""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from imucal.stand.packet import PacketFormat
from page_steps import assert_prints

ROOT = Path(__file__).resolve().parents[2]
LINK = re.compile(r"\]\((?!https?://)([^)#]+)[^)]*\)")
PAGES = [
    "README.md",
    "CONTRIBUTING.md",
    "CHANGELOG.md",
    *(str(path.relative_to(ROOT)) for path in sorted((ROOT / "docs").rglob("*.md"))),
]


@pytest.mark.slow
def test_readme_runs(run_page, tmp_path):
    assert run_page("README.md", tmp_path) >= 7
    for name in ("run.csv", "truth.json", "unit-0042.json", "report.html", "corrected.csv"):
        assert (tmp_path / name).stat().st_size > 0


def test_readme_has_the_figures_of_the_comparison():
    rows = {
        page: [
            [cell.strip(" *") for cell in line.strip("|").split("|")]
            for line in (ROOT / page).read_text(encoding="utf-8").splitlines()
            if line.startswith("|") and line.rstrip("|").rsplit("|", 1)[-1].strip()[:1].isdigit()
        ]
        for page in ("README.md", "docs/comparison.md")
    }
    shown = [row[-2:] for row in rows["README.md"]]
    assert len(shown) == 4
    assert [pair for pair in shown if pair not in [row[-2:] for row in rows["docs/comparison.md"]]] == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("page", "number_of_steps"),
    [
        ("index.md", 7),
        ("hand-held.md", 10),
        ("raw-counts.md", 7),
        ("one-sensor.md", 9),
        ("gyroscope-alone.md", 15),
        ("means.md", 5),
        ("few-poses.md", 5),
        ("thermal.md", 16),
        ("plan.md", 8),
        ("faces.md", 5),
        ("phone.md", 3),
    ],
)
def test_page_prints_what_it_shows(run_page, page, number_of_steps, tmp_path):
    assert run_page(f"docs/{page}", tmp_path) == number_of_steps


def test_page_of_firmware_shows_its_example():
    program = (ROOT / "rust/imucal-core/examples/correct_on_the_device.rs").read_text(encoding="utf-8")
    page = (ROOT / "docs/embedded.md").read_text(encoding="utf-8")
    shown = re.findall(r"^```rust\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    assert len(shown) == 2
    assert all(block in program for block in shown)


def test_page_of_firmware_has_the_dependencies_that_an_exported_module_is_built_with():
    page = (ROOT / "docs/embedded.md").read_text(encoding="utf-8")
    [shown] = re.findall(r"^```toml\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    built = (ROOT / "tests/export_rust/Cargo.toml").read_text(encoding="utf-8")
    shown = "".join(line for line in shown.splitlines(keepends=True) if not line.startswith("#"))
    assert shown.replace("../imucal/rust", "../../rust") in built


@pytest.mark.slow
def test_tutorial_prints_what_it_shows(run_page, tmp_path, data_file):
    for name in ("xsens_acc.mat", "xsens_gyro.mat"):
        shutil.copy(data_file(f"xsens_mti/{name}"), tmp_path)
    assert run_page("docs/tutorial-xsens.md", tmp_path) == 7


@pytest.mark.slow
def test_page_of_simulation_prints_what_it_shows(run_page, tmp_path):
    assert run_page("docs/simulation.md", tmp_path) == 7


@pytest.mark.slow
def test_page_of_the_production_line_prints_what_it_shows(run_page, tmp_path):
    page = (ROOT / "docs/production-line.md").read_text(encoding="utf-8")
    script = ROOT / "examples/production_line.sh"
    shown = re.search(r"^```sh\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)[1]
    assert script.read_text(encoding="utf-8").endswith(shown)
    shutil.copy(script, tmp_path)
    limits = re.search(r"^```json\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)[1]
    (tmp_path / "limits.json").write_text(limits)
    assert run_page("docs/production-line.md", tmp_path) == 10


@pytest.mark.slow
def test_page_of_the_stand_prints_what_it_shows(run_page, tmp_path):
    assert run_page("docs/stand.md", tmp_path) == 5
    page = (ROOT / "docs/stand.md").read_text(encoding="utf-8")
    (tmp_path / "packet.json").write_text(
        re.findall(r"^```json\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)[0]
    )
    form = PacketFormat.read(tmp_path / "packet.json")
    assert {field.name for field in form.fields} > {"sequence", "time_us", "accel_x_lsb", "temp_degc"}
    # Every reason that the line gives is in the table.
    from imucal.stand import verdict

    codes = re.findall(r"^([a-z_]+)(?:NAME)?  ", verdict.__doc__, re.MULTILINE)
    assert len(codes) == 12
    assert all(f"`{code}" in page for code in codes)


@pytest.mark.slow
def test_page_of_the_gap_prints_what_it_shows(run_page, tmp_path):
    assert run_page("docs/gap.md", tmp_path) == 11


@pytest.mark.slow
def test_page_of_noise_prints_what_it_shows(run_page, tmp_path):
    assert run_page("docs/noise.md", tmp_path) == 4


@pytest.mark.slow
def test_page_of_exports_prints_what_it_shows(run_page, tmp_path):
    assert run_page("docs/export.md", tmp_path) == 11


@pytest.mark.slow
def test_page_of_reports_prints_what_it_shows(run_page, tmp_path):
    assert run_page("docs/report.md", tmp_path) == 5
    assert (tmp_path / "unit-0042.html").stat().st_size > 0
    assert (tmp_path / "coverage.html").stat().st_size > 0


@pytest.mark.slow
def test_page_of_effects_is_the_catalogue_and_runs(run_page, tmp_path):
    written = tmp_path / "effects.md"
    subprocess.run(
        [sys.executable, "-m", "imucal.cli", "effects", "--markdown", written],
        check=True,
        capture_output=True,
    )
    page = ROOT / "docs/effects.md"
    assert page.read_text(encoding="utf-8") == written.read_text(encoding="utf-8"), (
        "run `imucal effects --markdown docs/effects.md`"
    )
    assert run_page("docs/effects.md", tmp_path) == 2


@pytest.mark.slow
def test_page_of_an_own_effect_is_its_example(run_page, tmp_path):
    shutil.copy(ROOT / "examples/own_effect.py", tmp_path)
    assert run_page("docs/own-effect.md", tmp_path) == 1
    program = (tmp_path / "own_effect.py").read_text(encoding="utf-8")
    page = (ROOT / "docs/own-effect.md").read_text(encoding="utf-8")
    shown = [line.strip() for line in page.splitlines() if line.startswith("    ")]
    missing = [line for line in shown if line not in program]
    assert len(shown) > 15
    assert not missing


def test_a_page_that_shows_something_else_is_found():
    printed = "a 1.0000 m\nb\nc\n"
    assert_prints(printed, ["a 1.0000 m", "...", "c"], "page")
    for shown in (
        ["a 1.0001 m", "b", "c"],
        ["a 1.0 n", "b", "c"],
        ["a 1.0 m"],
        ["a 1.0 m", "c"],
        ["...", "d"],
    ):
        with pytest.raises(AssertionError):
            assert_prints(printed, shown, "page")


@pytest.mark.parametrize("page", PAGES)
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
