import html.parser
import re
import sys

import numpy as np
import pytest

from imucal import report
from imucal.errors import ImucalError
from imucal.report.tables import rounded_to

PARAMETERS = [
    {"name": "accel_bias_x", "value": -0.418743, "std": 0.000162, "unit": "m/s^2"},
    {"name": "gyro_sensitivity_xx", "value": 0.97713, "std": 0.00011, "unit": "1"},
]
TRUTH = {"accel_bias_x": -0.41859, "gyro_sensitivity_xx": 0.9771}
BEFORE = {"gravity_norm_rms_mps2": 0.31, "gravity_direction_rms_deg": 3.2}
AFTER = {"gravity_norm_rms_mps2": 0.00042, "gravity_direction_rms_deg": 0.061}


def carried(rests=46):
    angle = np.linspace(0.0, 7.0, rests)
    measured = 9.80665 * np.column_stack([np.sin(angle), np.cos(angle) * 0.6, np.cos(angle) * 0.8])
    drift = np.linspace(0.0, 1.0, rests)[:, None]
    return {
        "rest_time_s": 2.5 + 7.0 * np.arange(rests),
        "measured": measured,
        "carried_uncalibrated": measured + drift * [4.0, -3.0, 2.0],
        "carried_calibrated": measured + drift * [0.02, -0.01, 0.015],
    }


class Page(html.parser.HTMLParser):
    """What a browser would make of the file: unclosed elements, addresses to load, text."""

    VOID = frozenset({"meta", "br", "img", "hr", "link", "input"})

    def __init__(self, text):
        super().__init__()
        self.open, self.loads, self.counts, self.words = [], [], {}, []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.counts[tag] = self.counts.get(tag, 0) + 1
        self.loads += [value for name, value in attrs if name in ("src", "href") and value]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open and self.open.pop() == tag

    def handle_data(self, data):
        if not self.open or self.open[-1] not in ("script", "style"):
            self.words.append(data)

    @property
    def text(self):
        return " ".join(" ".join(self.words).split())


def calibration_page(path, **changes):
    arguments = {
        "title": "Unit 0042",
        "verdict": "Good: the control record agrees.",
        "parameters": PARAMETERS,
        "truth": TRUTH,
        "control_before": BEFORE,
        "control_after": AFTER,
        **carried(),
    }
    report.write_calibration_page(path, **{**arguments, **changes})
    return path.read_text(encoding="utf-8")


def test_calibration_page_holds_verdict_tables_and_the_three_figures(tmp_path):
    text = calibration_page(tmp_path / "report.html")
    page = Page(text)
    assert page.open == []
    assert page.counts["table"] == 2
    assert page.counts["figure"] == 3
    for words in (
        "Good: the control record agrees.",
        "carried over a move is off by 0.061 deg rms, without calibration by 3.2 deg",
        "accel_bias_x -0.41874 0.00016 m/s² -0.41859 -0.9",
    ):
        assert words in page.text


def test_page_is_self_contained_and_holds_plotly_once(tmp_path):
    text = calibration_page(tmp_path / "report.html")
    assert Page(text).loads == []
    assert "default-src 'none'" in text
    assert len(re.findall(r"\* plotly\.js v", text)) == 1


def test_page_without_figures_needs_no_plotly(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "plotly", None)
    monkeypatch.setitem(sys.modules, "plotly.graph_objects", None)
    report.write_page(tmp_path / "short.html", "Short", [report.Section("One", text="Two.")])
    assert (tmp_path / "short.html").stat().st_size < 10_000
    with pytest.raises(ImucalError, match=re.escape('pip install "imucal-rs[report]"')):
        calibration_page(tmp_path / "report.html")
    assert not (tmp_path / "report.html").exists()


def test_text_from_outside_is_escaped(tmp_path):
    hostile = "<script>alert(1)</script>"
    parameters = [{"name": hostile, "value": 1.0, "std": 0.1, "unit": hostile}]
    text = calibration_page(tmp_path / "report.html", title=hostile, verdict=hostile, parameters=parameters)
    assert hostile not in text
    assert Page(text).open == []


def test_figure_shows_the_axis_asked_for():
    data = carried()
    for column, axis in enumerate("xyz"):
        figure = report.carried_gravity_figure(axis, **data)
        by_name = {trace.name: np.asarray(trace.y) for trace in figure.data}
        np.testing.assert_array_equal(by_name["measured"], data["measured"][:, column])
        np.testing.assert_array_equal(
            by_name["carried, uncalibrated"], data["carried_uncalibrated"][:, column]
        )
        np.testing.assert_array_equal(by_name["carried, calibrated"], data["carried_calibrated"][:, column])
        expected = data["carried_calibrated"][:, column] - data["measured"][:, column]
        np.testing.assert_array_equal(by_name["calibrated minus measured"], expected)


def test_curves_differ_in_colour_and_in_marker():
    traces = report.carried_gravity_figure("x", **carried()).data[:3]
    assert len({trace.marker.color for trace in traces}) == 3
    assert len({trace.marker.symbol for trace in traces}) == 3


def test_figure_refuses_arrays_that_do_not_fit():
    data = carried()
    with pytest.raises(ValueError, match=r"46 rests has shape \(45, 3\)"):
        report.carried_gravity_figure("x", **{**data, "measured": data["measured"][1:]})


def test_judgement_table_shows_a_dash_for_what_is_not_known():
    page = Page(report.judgement_table({}, {"gravity_norm_rms_mps2": 0.00042}))
    assert page.text.endswith("rms error, m/s² - 0.00042")


def test_parameter_without_a_sigma_has_none():
    page = Page(report.parameter_table([{"name": "b", "value": 0.25, "std": None, "unit": "1"}], {"b": 0.5}))
    assert page.text.endswith("b 0.25 - 1 0.5 -")


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (-0.0350123, 2.7e-5, "-0.035012"),
        (33124.18264, 1.23, "33124.2"),
        (33124.18264, 123.0, "33124"),
        (1.0, 0.0, "1"),
        (1.0, float("nan"), "1"),
    ],
)
def test_value_has_the_decimals_that_its_sigma_supports(value, std, text):
    assert rounded_to(value, std) == text
