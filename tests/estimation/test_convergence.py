"""The integrated rate comes to the analytic attitude, with the order that the documentation states."""

import importlib.util
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "docs" / "results"
_spec = importlib.util.spec_from_file_location("convergence", ROOT / "benches" / "convergence.py")
convergence = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(convergence)
MOTIONS = convergence.motions()


@pytest.fixture(scope="module")
def every():
    """The convergence of each motion."""
    return {name: convergence.converge(motion) for name, motion in MOTIONS.items()}


@pytest.mark.parametrize("name", MOTIONS)
def test_the_error_falls_with_the_second_power_of_the_interval(name, every):
    found = every[name]
    assert found.order == pytest.approx(2.0, abs=0.02)
    # At the paper's rate the integration is not what limits anything: 0.01 deg over ten turns.
    assert found.error_rad[convergence.RATES_HZ.index(200)] < np.deg2rad(0.01)
    assert found.error_rad[-1] < 1e-7


@pytest.mark.parametrize("name", MOTIONS)
def test_the_midpoint_is_of_second_order_too(name, every):
    errors = every[name].midpoint_error_rad
    order = np.polyfit(np.log(convergence.RATES_HZ[2:]), -np.log(errors[2:]), 1)[0]
    assert order == pytest.approx(2.0, abs=0.02)


def test_the_page_shows_these_figures(every):
    """To one unit of the last digit shown: another processor may round otherwise."""
    page = (RESULTS / "convergence.md").read_text(encoding="utf-8")
    rows = [line.strip("| ").split(" | ") for line in page.splitlines() if line.startswith("| ")]
    heads = [k for k, row in enumerate(rows) if row[0].startswith("rate, Hz")]
    fourth, midpoint = rows[heads[0] + 1 : heads[1]], rows[heads[1] + 1 :]
    for k, row in enumerate(midpoint):
        assert [float(value) for value in row[1:]] == pytest.approx(
            [c.midpoint_error_rad[k] for c in every.values()], rel=0.01
        )
    shown = {row[0]: [float(value) for value in row[1:]] for row in fourth}
    assert [name for name in shown if name != "**order**"] == [str(rate) for rate in convergence.RATES_HZ]
    for k, rate_hz in enumerate(convergence.RATES_HZ):
        assert shown[str(rate_hz)] == pytest.approx([c.error_rad[k] for c in every.values()], rel=0.01)
    assert shown["**order**"] == pytest.approx([c.order for c in every.values()], abs=0.01)


def test_the_figure_has_a_line_for_each_motion():
    figure = ElementTree.parse(RESULTS / "convergence.svg").getroot()
    lines = figure.findall("{http://www.w3.org/2000/svg}polyline")
    assert len(lines) == len(MOTIONS)
    assert all(len(line.attrib["points"].split()) == len(convergence.RATES_HZ) for line in lines)
