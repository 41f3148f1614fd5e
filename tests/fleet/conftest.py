"""Fixtures for tests of many units."""

import pytest

from small_fleet import write_small_fleet


@pytest.fixture(scope="session")
def small_fleet(tmp_path_factory):
    """The folder of a small fleet (`small_fleet.write_small_fleet`)."""
    folder = tmp_path_factory.mktemp("fleet")
    write_small_fleet(folder)
    return folder
