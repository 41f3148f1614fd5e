"""The pages as a site: it builds without a warning, needs nothing from elsewhere, and leaves nothing out."""

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

import effects_gallery
import imucal
from site_search import SiteSearch

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
SPEC = importlib.util.spec_from_file_location("site_hooks", ROOT / "docs/site_hooks.py")
site_hooks = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(site_hooks)


# What people search for, and the page that answers it.
QUERIES = {
    "C header": "embedded",
    "firmware": "embedded",
    "apply in Python": "index",
    "install": "index",
    "why refused": "codes",
    "incomplete": "codes",
    "gyro_units": "codes",
    "datasheet units": "faq",
    "how accurate": "faq",
    "chi2": "faq",
    "g-sensitivity": "faq",
    "phone recording": "phone",
    "accelerometer alone": "one-sensor",
    "gyroscope alone": "gyroscope-alone",
    "mean readings": "means",
    "compare with Kalibr": "comparison",
    "imu_tk": "comparison",
    "500 units": "fleet",
    "production line": "production-line",
    "temperature": "thermal",
    "which poses": "plan",
    "box": "faces",
    "frames": "frames",
    "FRD": "frames",
    "raw counts": "raw-counts",
    "OpenVINS": "estimators",
    "VINS": "estimators",
    "inflate noise": "estimators",
    "Allan deviation": "noise",
    "bias instability": "noise",
    "ROS bag": "formats",
    "stand": "stand",
    "formulas": "formulas",
    "own effect": "own-effect",
}


def build(folder, *options):
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--site-dir", str(folder), *options]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    done = build(folder)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return folder


def test_every_page_is_in_the_site(site):
    pages = [path.relative_to(ROOT / "docs").with_suffix(".html") for path in (ROOT / "docs").rglob("*.md")]
    assert len(pages) > 25
    assert [page for page in pages if not (site / page).is_file()] == []


def test_nothing_is_loaded_from_elsewhere(site):
    loaded = re.compile(r"<(?:script|img|iframe|link)\b[^>]*(?:src|href)=\"?(https?:)?//[^\">]+")
    imported = re.compile(r"(?:@import|url\()\s*[\"']?(?:https?:)?//[^)\"']+")
    for path in site.rglob("*.html"):
        assert not loaded.search(path.read_text(encoding="utf-8")), path
    for path in site.rglob("*.css"):
        assert not imported.search(path.read_text(encoding="utf-8")), path


@pytest.fixture(scope="module")
def search(site):
    return SiteSearch(site)


@pytest.mark.parametrize("query", QUERIES)
def test_the_first_result_of_a_search_is_the_page_that_answers_it(query, search):
    first = search.pages(query)[:1]
    assert [found.split(".html")[0] for found in first] == [QUERIES[query]]


def test_formulas_are_typeset_without_a_script(site):
    page = (site / "formulas.html").read_text(encoding="utf-8")
    text = re.sub(r"<(code|script|style)\b.*?</\1>", "", page, flags=re.DOTALL)
    assert page.count('display="block"') > 10
    assert page.count('display="inline"') > 20
    assert "$" not in text
    assert "@block" not in text


def test_every_public_name_is_explained(site):
    page = (site / "api.html").read_text(encoding="utf-8")
    headings = set(re.findall(r'<h3 id="imucal\.(?:\w+\.)*(\w+)"', page))
    names = {name for name in imucal.__all__ if not isinstance(getattr(imucal, name), ModuleType)}
    assert names - {"__version__"} - headings == set()


def test_every_command_is_shown(site):
    page = (site / "commands.html").read_text(encoding="utf-8")
    for command in ("calibrate", "gap", "limits check"):
        assert f"Usage: imucal {command}" in page
    assert page.count("Example: imucal") >= 13


def test_columns_of_a_docstring_become_a_list():
    docstring = (
        "What.\n\nname, other   one\n              more <b>\nthird  two\n\n    formula = a  b\n\nLast."
    )
    assert site_hooks.definitions(docstring).split("\n") == [
        "What.",
        "",
        "`name`, `other`",
        ":   one more &lt;b>",
        "",
        "`third`",
        ":   two",
        "",
        "",
        "    formula = a  b",
        "",
        "Last.",
    ]


def test_lists_and_tables_read_as_elsewhere():
    page = "Text\n* one\n  goes on\n\n      code\n\nText\n\n| `\\|a\\|` |\n```\n* no item\n```"
    assert site_hooks.like_github(page) == (
        "Text\n\n* one\n    goes on\n\n        code\n\nText\n\n| `|a|` |\n```\n* no item\n```"
    )


def test_pictures_of_the_effects_are_those_of_the_catalogue():
    drawn = effects_gallery.pictures()
    folder = ROOT / "docs/effects"
    assert {path.stem for path in folder.iterdir()} == set(drawn)
    assert set(drawn) == {effect.name for effect in imucal.effects.catalogue()}
    for name, svg in drawn.items():
        kept = (folder / f"{name}.svg").read_text(encoding="utf-8")
        assert len(kept) < 60_000
        assert same_picture(kept, svg), f"run `make docs-figures`: {name} has changed"


def same_picture(one, other):
    """The same but for the last digit, which another processor may round differently."""
    number = re.compile(r"-?\d+\.\d")
    if number.sub("#", one) != number.sub("#", other):
        return False
    pairs = zip(number.findall(one), number.findall(other), strict=True)
    return all(abs(float(a) - float(b)) < 0.15 for a, b in pairs)
