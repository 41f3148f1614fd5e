"""Reports as HTML pages: what they contain, and that they are safe, small and readable.

Pages are also made from parts (`write_page`, tables, thinning of curves, the style), because no result has
values that are hostile, empty or wide enough to test them.
"""

import html.parser
import json
import re
import sys
from dataclasses import replace

import numpy as np
import pytest

import imucal
from imucal import plot, report
from imucal.cli import main
from imucal.plot import style
from imucal.plot.thinning import evenly, thinned
from imucal.report.page import Tab, Verdict, write_page
from imucal.report.tables import figures_table, item_list, parameter_table, rounded_to

MOST_BYTES = 6_000_000
MG = 1e3 / 9.80665
HOSTILE = "<script>alert(1)</script>"
MOTION = {"description": "turn by heat", "program": {"schema": "imucal.program/1", "steps": []}}


@pytest.fixture(scope="module")
def runs():
    return [imucal.simulate("random", seed=seed, rate_hz=50).recording for seed in (1, 2)]


@pytest.fixture(scope="module")
def result(runs):
    limits = imucal.Limits((imucal.ParameterLimit("gyro_bias_*", "rad/s", -0.02, 0.02, 1e-3),))
    return imucal.calibrate(runs[0], control=runs[1], serial_number="0042").judged_by(limits)


@pytest.fixture(scope="module")
def gap():
    both = [
        imucal.simulate("random", seed=seed, rate_hz=50, effects={"gyro_g_sensitivity": 1e-3}).recording
        for seed in (1, 2)
    ]
    candidates = ["gyro_g_sensitivity", "gyro_scale_quadratic"]
    return imucal.find_gap(both[0], control=both[1], candidates=candidates)


@pytest.fixture(scope="module")
def noise():
    return imucal.noise(imucal.simulate(imucal.Static(60.0), rate_hz=50, seed=1).recording)


class Page(html.parser.HTMLParser):
    """What a browser would make of the file: unclosed elements, addresses to load, text."""

    VOID = frozenset({"meta", "br", "wbr", "img", "hr", "link", "input"})

    def __init__(self, text):
        super().__init__()
        self.open, self.loads, self.ids, self.counts, self.words = [], [], [], {}, []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.counts[tag] = self.counts.get(tag, 0) + 1
        self.loads += [value for name, value in attrs if name in ("src", "href") and value]
        self.ids += [value for name, value in attrs if name == "id"]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open and self.open.pop() == tag

    def handle_data(self, data):
        if not self.open or self.open[-1] not in ("script", "style"):
            self.words.append(data)

    @property
    def text(self):
        return " ".join("".join(self.words).split())


def page_of(write, path, *arguments, **options):
    write(path, *arguments, **options)
    assert path.stat().st_size < MOST_BYTES
    text = path.read_text(encoding="utf-8")
    page = Page(text)
    assert page.open == []
    assert page.loads == []
    assert len(set(page.ids)) == len(page.ids)
    assert "default-src 'none'" in text
    assert len(re.findall(r"\* plotly\.js v", text)) == 1
    return page


@pytest.mark.slow
def test_the_page_of_a_calibration_has_verdict_tables_and_figures(result, tmp_path):
    page = page_of(report.write_calibration_page, tmp_path / "report.html", result)
    assert page.counts["figure"] == 3 + 1 + 2 + 3 + 1 + 4
    gyro = next(p for p in result.parameters if p.name == "gyro_bias_x")
    for words in (
        "Calibration of unit 0042",
        f"Poor: {result.reasons[0]}",
        f"rms error of {result.control_set.gravity_direction_rms_deg:.2g} deg",
        f"gyro_bias_x{rounded_to(np.rad2deg(gyro.value), np.rad2deg(gyro.std))}",
    ):
        assert words in page.text
    good = replace(result, judgement=None, verdict="good", reasons=(), control=None)
    page = page_of(report.write_calibration_page, tmp_path / "alone.html", good)
    assert "give one with --control" in page.text
    assert page.counts["figure"] == 3 + 2 + 1 + 2


def test_known_truth_stands_beside_the_parameters(result, tmp_path):
    truth = {p.name: p.value + 2 * p.std for p in result.parameters}
    page = page_of(report.write_calibration_page, tmp_path / "r.html", result, title="Made", truth=truth)
    assert page.text.count("-2.0") >= len(truth)


@pytest.mark.parametrize(
    ("verdict", "words"),
    [
        ("named", "Missing from the model: gyro_g_sensitivity. On the control recordings"),
        ("ambiguous", "Missing from the model: gyro_g_sensitivity, or earth_rate; these recordings cannot"),
        ("unknown", "it is not in the catalogue. gyro_bias varies. What"),
        ("stochastic", "A bias fluctuates randomly"),
        ("nothing_missing", "No missing effect is detectable in these recordings."),
        ("data_fault", "fix it and record again"),
    ],
)
def test_the_page_of_a_gap_says_its_verdict(gap, tmp_path, verdict, words):
    assert gap.verdict == "named"
    other = replace(
        gap,
        verdict=verdict,
        effects=gap.effects if verdict in ("named", "ambiguous") else (),
        ambiguous_with=("earth_rate",) if verdict == "ambiguous" else (),
        next_motion=MOTION if verdict == "ambiguous" else None,
        generic={"description": "gyro_bias varies"} if verdict == "unknown" else None,
    )
    page = page_of(report.write_gap_page, tmp_path / "gap.html", other)
    assert words.removesuffix(" What") in page.text
    assert ("turn by heat" in page.text) == (verdict == "ambiguous")


def test_a_gap_in_refused_recordings_has_a_page(runs, tmp_path):
    force = runs[0].specific_force.copy()
    force[1000:1400] = np.nan
    broken = imucal.Recording(runs[0].time_s, force, runs[0].angular_rate)
    found = imucal.find_gap(broken)
    assert found.verdict == "data_fault"
    report.write_gap_page(tmp_path / "gap.html", found)
    text = Page((tmp_path / "gap.html").read_text()).text
    assert "The data have a fault" in text
    assert str(found.findings[0]) in text


def test_where_it_disagrees_is_shown_if_it_is_known(gap, tmp_path):
    channel = {"channel": "rest_rate", "axis": "x", "unit": "rad/s", "rms": 9.27e-3, "noise_rms": 1.99e-4}
    channel |= {"times_noise": 46.7, "times_noise_after": 0.906, "stands_out": True}
    rest = {"recording": "run.csv", "index": 32, "times_noise": 76.1, "norm_error_mps2": 5.96e-5}
    depends = [{"channel": "rest_rate", "axis": "x", "on": "gravity", "share": 0.99, "p_value": 1e-62}]
    shown = replace(gap)
    move = {"recording": "run.csv", "index": 7, "times_noise": 30.0, "direction_error_deg": 1.4}
    move["left_out"] = True
    where = {"channels": [channel], "rests": [rest], "moves": [move], "turns_about": "z", "depends": depends}
    object.__setattr__(shown, "where", where)
    page = page_of(report.write_gap_page, tmp_path / "gap.html", shown)
    assert "rate at rest about x0.5310.0114deg/s46.70.906significant" in page.text
    assert "run.csv, rest 32760.00608" in page.text
    assert "Moves with significant residuals, all of them rotations about z" in page.text
    assert "run.csv, move 7, excluded301.4" in page.text
    assert "rate at rest about xgravity99 %1e-62" in page.text
    before, after = plot.disagreement(shown).data[:2]
    assert (list(before.x), list(after.x)) == ([46.7], [0.906])


@pytest.mark.slow
def test_a_page_of_a_very_long_recording_stays_small(result, tmp_path):
    count = 20_000
    random = np.random.default_rng(1)
    times = np.arange(count) * 1.8

    def many(items, error):
        pool = [replace(items[k % len(items)], recording=60 * "a") for k in range(count)]
        return [
            replace(item, **{error: float(x)})
            for item, x in zip(pool, random.normal(size=count), strict=True)
        ]

    rests, moves = many(result.rests, "norm_error_mps2"), many(result.moves, "direction_error_deg")
    rests[17_003] = replace(rests[17_003], norm_error_mps2=40.0)
    rests[9_001] = replace(rests[9_001], excluded="contradicts the others")
    gravity = {name: random.normal(size=(count, 3)) for name in ("measured", "uncalibrated", "calibrated")}
    carried = replace(result.control.carried[0], time_s=times, **gravity)
    control = replace(result.control, rests=rests, moves=moves, carried=3 * (carried,))
    long = replace(result, rests=rests, moves=moves, control=control)
    page = page_of(report.write_calibration_page, tmp_path / "long.html", long)
    assert f"{plot.MOST} of {count} are drawn" in page.text
    assert "a double click also shows the excluded ones" in page.text
    points = {trace.name: list(trace.x) for trace in plot.rest_residuals(long).data}
    assert 17_003 in points["used"]
    assert points["excluded"] == [9_001]


def test_thinning_keeps_the_worst_and_spreads_the_others():
    importance = np.zeros(10_000)
    importance[[17, 4711]] = 1.0
    importance[5000] = np.nan
    kept = thinned(importance, 100)
    assert {0, 17, 4711, 9999} <= set(kept)
    assert len(kept) <= 100
    assert max(np.diff([k for k in kept if k >= 50])) < 10_000 / 45
    assert thinned(importance[:50], 100) == list(range(50))
    assert evenly(9, 3) == [0, 4, 8]
    assert evenly(2, 3) == [0, 1]
    assert evenly(0, 3) == []


def test_page_without_figures_needs_no_plotly(tmp_path, monkeypatch, capsys, result):
    monkeypatch.setitem(sys.modules, "plotly", None)
    monkeypatch.setitem(sys.modules, "plotly.graph_objects", None)
    write_page(tmp_path / "short.html", "Short", [Tab("One", ("<p>Two.</p>",))], Verdict("good", "Good."))
    assert (tmp_path / "short.html").stat().st_size < 20_000
    with pytest.raises(imucal.ImucalError, match=re.escape('pip install "imucal-rs[report]"')):
        report.write_calibration_page(tmp_path / "report.html", result)
    # It is said before any work is done: there is no such recording.
    for command in ("calibrate", "gap", "noise", "evaluate cal.json"):
        arguments = [*command.split(), "none.csv", "--report", str(tmp_path / "report.html")]
        assert main(arguments) == 1
        assert 'pip install "imucal-rs[report]"' in capsys.readouterr().err
    assert not (tmp_path / "report.html").exists()


def test_text_from_outside_is_escaped(result, tmp_path):
    hostile = replace(
        result,
        calibration=replace(result.calibration, serial_number=HOSTILE),
        rests=tuple(replace(rest, recording=HOSTILE) for rest in result.rests),
        reasons=(HOSTILE,),
    )
    page_of(report.write_calibration_page, tmp_path / "report.html", hostile)
    assert HOSTILE not in (tmp_path / "report.html").read_text()
    assert HOSTILE not in hostile._repr_html_()
    assert HOSTILE not in item_list([HOSTILE])


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_propagated_gravity_is_that_of_the_axis(result, axis):
    carried, column = result.control.carried[0], "xyz".index(axis)
    by_name = {
        trace.name: np.asarray(trace.y) for trace in plot.propagated_gravity(result.control, axis).data
    }
    for name, key in (
        ("measured", "measured"),
        ("propagated, uncalibrated", "uncalibrated"),
        ("propagated, calibrated", "calibrated"),
    ):
        np.testing.assert_array_equal(by_name[name], getattr(carried, key)[:, column])
    difference = (carried.calibrated - carried.measured)[:, column]
    np.testing.assert_array_equal(by_name["calibrated minus measured"], difference)


def test_figures_say_what_they_cannot_show(result, gap):
    with pytest.raises(imucal.InputError, match="there is no recording 1: 1 were evaluated"):
        plot.propagated_gravity(result.control, "x", 1)
    with pytest.raises(imucal.InputError, match="axis is 'w': give x, y or z"):
        plot.propagated_gravity(result.control, "w")
    refused = imucal.Gap("data_fault")
    for figure in (plot.ranking, plot.before_and_after, plot.disagreement):
        with pytest.raises(imucal.InputError, match=r"faults of the data|recordings were refused"):
            figure(refused)


def test_every_series_has_a_colour_and_a_marker_of_its_own(result, gap, noise):
    for figure in (
        plot.propagated_gravity(result.control, "x"),
        plot.limits(result.judgement),
        plot.coverage(result),
        plot.before_and_after(gap),
        plot.allan(noise, "gyro"),
    ):
        series = [
            trace
            for trace in figure.data
            if "markers" in (getattr(trace, "mode", None) or "") and trace.showlegend is not False
        ]
        assert len(series) >= 2
        assert len({trace.marker.color for trace in series}) == len(series)
        assert len({trace.marker.symbol for trace in series}) == len(series)


def luminance(colour):
    """Relative luminance, WCAG 2.2."""
    parts = np.array(list(bytes.fromhex(colour[1:]))) / 255
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return linear @ [0.2126, 0.7152, 0.0722]


def contrast(colours, theme):
    """Contrast of two colours in a theme, WCAG 2.2: 3 for graphics (1.4.11), 4.5 for text (1.4.3)."""
    a, b = sorted(luminance(theme.get(c, c)) for c in colours)
    return (b + 0.05) / (a + 0.05)


@pytest.mark.parametrize("theme", [{}, style.DARK], ids=["light", "dark"])
def test_colours_stand_out_from_the_paper(theme):
    for colour in (style.BLUE, style.VERMILION, style.GREEN, style.GREY):
        assert contrast((colour, style.PAPER), theme) >= 3
    assert contrast((style.INK, style.PAPER), theme) >= 4.5


@pytest.mark.parametrize("theme", [{}, style.DARK], ids=["light", "dark"])
def test_text_in_bars_stands_out_from_them(gap, theme):
    [bars] = plot.probabilities(gap).data
    for colour in set(bars.marker.color):
        assert contrast((colour, bars.insidetextfont.color), theme) >= 4.5


def test_the_page_has_the_colours_of_its_figures_in_both_themes(tmp_path):
    write_page(tmp_path / "p.html", "P", [Tab("T", ("",))], Verdict("good", "Good."))
    text = (tmp_path / "p.html").read_text()
    css = dict(re.findall(r"--(ink|paper): (#\w+)", text.split("data-theme")[0]))
    assert css == {"ink": style.INK, "paper": style.PAPER}
    dark = json.loads(re.search(r'id="dark">(.*?)</script>', text)[1])
    css = dict(re.findall(r"--(ink|paper): (#\w+)", text.split('[data-theme="dark"]')[1]))
    assert css == {"ink": dark[style.INK], "paper": dark[style.PAPER]}


def test_notebooks_show_verdict_and_numbers(result, gap, noise):
    for shown, words in (
        (result, f"Poor: {result.reasons[0]}"),
        (result.calibration, "Calibration of unit 0042, symmetric frame"),
        (result.control, "Good: the calibration holds on these recordings."),
        (gap, "Missing from the model: gyro_g_sensitivity."),
        (noise, "gyro_x noise density"),
    ):
        page = Page(shown._repr_html_())
        assert page.open == []
        assert words in page.text
        assert page.counts["table"] >= 1
    parameter = result.parameters[0]
    shown = rounded_to(MG * parameter.value, MG * parameter.std)
    assert shown in Page(result._repr_html_()).text


def test_the_json_of_a_calibration_has_what_its_page_shows(result):
    document = result.to_dict()
    assert document["control"] == result.control.to_dict()
    assert replace(result, control=None).to_dict()["control"] is None


def test_a_figure_that_is_not_known_is_a_dash():
    page = Page(figures_table({"before": {}, "after": {"gravity_norm_rms_mps2": 0.00042}, "none": None}))
    assert page.text.endswith("rms, mg-0.04283")


def test_parameter_without_a_sigma_has_none():
    page = Page(parameter_table([imucal.Parameter("b", 0.25, None, "1")], {"b": 0.5}))
    assert page.text.endswith("b25-%50-")


def test_long_lists_are_cut_and_say_so():
    page = Page(item_list([f"item {k}" for k in range(100)]))
    assert "item 38 item 39 and 60 more, see --json" in page.text


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
