"""The licences of the crates in the wheel: permitted, and with their texts in the package."""

import importlib.metadata
import importlib.util
import shutil
from pathlib import Path

import pytest

_spec = importlib.util.spec_from_file_location("licences", Path(__file__).with_name("licences.py"))
licences = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(licences)

pytestmark = pytest.mark.skipif(shutil.which("cargo") is None, reason="cargo names the crates")


def test_every_licence_is_permitted():
    for name, _, expression, _ in licences.crates():
        assert licences.chosen(expression), name


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("Apache-2.0 OR MIT", ["MIT"]),
        ("MIT/Apache-2.0", ["MIT"]),
        ("(MIT OR Apache-2.0) AND Unicode-3.0", ["MIT", "Unicode-3.0"]),
    ],
)
def test_a_permitted_alternative_is_chosen(expression, expected):
    assert licences.chosen(expression) == expected


@pytest.mark.parametrize("expression", ["GPL-3.0", "", "MIT AND GPL-3.0-only"])
def test_other_licences_are_refused(expression):
    with pytest.raises(ValueError, match="is not permitted"):
        licences.chosen(expression)


def test_the_notice_is_that_of_the_locked_crates():
    assert licences.NOTICE.read_text(encoding="utf-8") == licences.notice(), (
        "run python tests/package/licences.py --write"
    )


def test_every_crate_has_its_text():
    assert "contain no text" not in licences.notice()


def test_the_package_contains_the_notice():
    names = [file.name for file in importlib.metadata.files("imucal-rs") or []]
    assert "THIRD_PARTY_LICENSES" in names
