"""What is published: metadata, links that work outside of the repository, and workflows."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
WORKSPACE = tomllib.loads((ROOT / "Cargo.toml").read_text(encoding="utf-8"))["workspace"]["package"]
REPOSITORY = PROJECT["urls"]["Repository"]
WORKFLOWS = sorted((ROOT / ".github/workflows").glob("*.yml"))
CRATES = ("imucal-core", "imucal")


def test_links_of_the_readme_work_outside_of_the_repository():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    targets = re.findall(r"\]\(([^)]+)\)", readme) + re.findall(r"^\[[^\]]+\]: (\S+)$", readme, re.MULTILINE)
    assert targets and all(target.startswith(("https://", "#")) for target in targets)
    for target in targets:
        if target.startswith(f"{REPOSITORY}/"):
            kind, _, path = target.removeprefix(f"{REPOSITORY}/").partition("/main/")
            found = ROOT / path.partition("#")[0]
            assert found.is_dir() if kind == "tree" else found.is_file(), target
    used = set(re.findall(r"\]\[([^\]]+)\]", readme))
    assert used == set(re.findall(r"^\[([^\]]+)\]: ", readme, re.MULTILINE))


def test_addresses_agree():
    assert WORKSPACE["repository"] == REPOSITORY
    assert WORKSPACE["homepage"] == PROJECT["urls"]["Homepage"]
    assert WORKSPACE["authors"] == [author["name"] for author in PROJECT["authors"]]
    for name in ("CITATION.cff", "packaging/conda/recipe.yaml", ".github/ISSUE_TEMPLATE/config.yml"):
        text = (ROOT / name).read_text(encoding="utf-8")
        for address in re.findall(r"https://github\.com/[\w.-]+/[\w.-]+", text):
            assert address == REPOSITORY, name


def test_versions_agree_in_the_files_beside_the_code():
    version = WORKSPACE["version"]
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"] == version
    recipe = yaml.safe_load((ROOT / "packaging/conda/recipe.yaml").read_text())
    assert recipe["context"]["version"] == version
    # The recipe requires what the package requires.
    needs = {re.sub(r"[ >=].*", "", need) for need in recipe["requirements"]["run"]} - {"python"}
    assert needs == {re.sub(r"[>=].*", "", need) for need in PROJECT["dependencies"]}


def test_every_supported_python_is_tested_and_declared():
    versions = ["3.10", "3.11", "3.12", "3.13", "3.14"]
    tests = yaml.safe_load((ROOT / ".github/workflows/tests.yml").read_text())
    matrix = tests["jobs"]["python"]["strategy"]["matrix"]
    assert matrix["python"] == versions
    assert {"ubuntu", "macos", "windows"} <= {name.split("-")[0] for name in matrix["os"]}
    declared = [c.rpartition(" ")[2] for c in PROJECT["classifiers"] if re.search(r"Python :: 3\.\d+$", c)]
    assert declared == versions


def test_wheels_are_built_for_every_platform():
    text = (ROOT / ".github/workflows/release.yml").read_text()
    for target in ("x86_64-unknown-linux-gnu", "aarch64-unknown-linux-gnu", "x86_64-unknown-linux-musl"):
        assert target in text
    for word in ("manylinux2014", "manylinux_2_28", "musllinux", "apple-darwin", "pc-windows-msvc", "3.14t"):
        assert word in text
    release = yaml.safe_load(text)
    assert "attest-build-provenance" in text and "gh-action-pypi-publish" in text
    assert release["jobs"]["publish"]["if"] == "startsWith(github.ref, 'refs/tags/v')"


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_workflows_have_no_more_rights_than_they_need(path):
    workflow = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert workflow["permissions"] == {"contents": "read"}
    assert "pull_request_target" not in path.read_text(encoding="utf-8")


def test_workflows_pass_actionlint():
    program = shutil.which(
        "actionlint", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    )
    if program is None:
        pytest.skip("actionlint is not installed")
    done = subprocess.run([program, *map(str, WORKFLOWS)], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stdout


def test_reports_of_wrong_results_ask_for_the_inspection():
    form = yaml.safe_load((ROOT / ".github/ISSUE_TEMPLATE/result.yml").read_text(encoding="utf-8"))
    (field,) = [item for item in form["body"] if item.get("id") == "inspect"]
    assert "inspect" in field["attributes"]["label"] and "--json" in field["attributes"]["label"]
    assert field["validations"]["required"]


@pytest.mark.parametrize("crate", CRATES)
def test_crates_contain_what_a_reader_needs(crate):
    cargo = shutil.which("cargo")
    if cargo is None:
        pytest.skip("cargo is not on PATH")
    arguments = ["package", "--list", "--allow-dirty", "--offline", "-p", crate]
    done = subprocess.run([cargo, *arguments], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    files = done.stdout.splitlines()
    assert {"README.md", "LICENSE-MIT", "LICENSE-APACHE", "src/lib.rs"} <= set(files)
    assert any(name.startswith("examples/") for name in files)
    for name in ("LICENSE-MIT", "LICENSE-APACHE"):
        # Whole texts, not links to those of the repository.
        assert (ROOT / "rust" / crate / name).read_text() == (ROOT / name).read_text()
    manifest = tomllib.loads((ROOT / "rust" / crate / "Cargo.toml").read_text(encoding="utf-8"))["package"]
    assert manifest["metadata"]["docs"]["rs"]["all-features"]


@pytest.mark.slow
def test_threads_give_the_same_bits():
    script = ROOT / "tests/package/threads.py"
    done = subprocess.run([sys.executable, script, "8"], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.startswith("8 recordings in 8 threads")
