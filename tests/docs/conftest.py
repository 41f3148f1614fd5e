"""Fixtures for tests of the pages."""

from functools import partial

import pytest

import page_steps


@pytest.fixture(scope="session")
def run_page(programs):
    """Run the steps of a page (`page_steps.run_page`)."""
    return partial(page_steps.run_page, programs)
