"""The reports in a browser: headless Chromium, network off, checked against the JSON of the same commands.

The colours come from `imucal.plot.style` and the expected JSON from `plain`: what is tested is that the
browser shows them.
"""

import json

import numpy as np
import pytest

import imucal
from children import HANGS_S
from chromium import ARGUMENTS, CHROMIUM, sync_api
from imucal.cli import main
from imucal.document.plain import plain
from imucal.plot.style import DARK, PAPER
from imucal.report import write_gap_page
from imucal.units import datasheet

pytestmark = pytest.mark.slow

DEVICES = {
    "desktop": {"viewport": {"width": 1200, "height": 900}},
    "phone": {"viewport": {"width": 390, "height": 844}, "is_mobile": True, "has_touch": True},
}
EFFECT = {"gyro_g_sensitivity": 3e-4}
MOST_BYTES = 6_000_000
MG = 1e3 / 9.80665


@pytest.fixture(scope="module")
def reports(tmp_path_factory):
    """Folder with the report, HTML and JSON, of each command."""
    folder = tmp_path_factory.mktemp("reports")
    for name, seed in (("run", 1), ("control", 2)):
        run = imucal.simulate("random", seed=seed, rate_hz=100, effects=EFFECT)
        imucal.write(run.recording, folder / f"{name}.parquet")
    still = imucal.simulate(imucal.Static(120.0), rate_hz=100, seed=3).recording
    imucal.write(still, folder / "still.parquet")
    limit = imucal.ParameterLimit("gyro_bias_*", "rad/s", -0.02, 0.02, 1e-3)
    imucal.Limits((limit,)).save(folder / "limits.json")

    def run_it(name, expected, *arguments):
        given = [str(folder / a) if a.endswith((".parquet", ".json")) else a for a in arguments]
        outputs = ["--report", str(folder / f"{name}.html"), "--json", str(folder / f"{name}-result.json")]
        assert main([*given, *outputs]) == expected

    calibrated = ["calibrate", "run.parquet", "--control", "control.parquet", "--limits", "limits.json"]
    # The bias of the paper's gyroscope is beyond these limits, about x.
    run_it("calibrate", 2, *calibrated, "-o", "cal.json", "--effect", "gyro_g_sensitivity")
    run_it("evaluate", 0, "evaluate", "cal.json", "control.parquet")
    run_it("gap", 0, "gap", "run.parquet", "--control", "control.parquet")
    run_it("noise", 0, "noise", "still.parquet")
    return folder


@pytest.fixture(scope="module")
def browser():
    with sync_api.sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=CHROMIUM, args=[*ARGUMENTS])
        yield running
        running.close()


@pytest.fixture(scope="module")
def heard():
    """What the console and the network heard of all pages."""
    return {"errors": [], "requests": []}


@pytest.fixture(scope="module")
def opened(browser, reports, heard):
    """Open a report in a theme and on a device; a page that is open already is used again."""
    pages = {}

    def open_it(name, scheme="light", device="desktop"):
        if (name, device) not in pages:
            page = browser.new_context(offline=True, color_scheme=scheme, **DEVICES[device]).new_page()
            page.set_default_timeout(1000 * HANGS_S)
            page.on("console", lambda m: heard["errors"].append(m.text) if m.type == "error" else None)
            page.on("pageerror", lambda error: heard["errors"].append(str(error)))
            page.on("request", lambda request: heard["requests"].append(request.url))
            page.goto((reports / f"{name}.html").as_uri())
            pages[name, device] = page
        page = pages[name, device]
        page.emulate_media(color_scheme=scheme)
        page.locator(f"html[data-theme={scheme}]").wait_for()
        return page

    return open_it


@pytest.fixture(autouse=True)
def quiet(heard):
    """After each test: no error in the console, and nothing was asked of a network."""
    yield
    assert heard["errors"] == []
    assert [url for url in heard["requests"] if not url.startswith(("file:", "data:", "blob:"))] == []


def result_of(reports, name):
    return json.loads((reports / f"{name}-result.json").read_text())


def tabs(page):
    return page.get_by_role("tab").all()


def open_tab(page, heading):
    page.get_by_role("tab", name=heading, exact=True).click()
    return page.get_by_role("tabpanel", name=heading, exact=True)


def traces_of(page, figure):
    """Traces of a figure of the open tab as the browser holds them: name, mode, x, y, z, and error bars."""
    return page.evaluate(
        """id => document.getElementById(`figure-${id}`)._fullData.map(trace => ({
             name: trace.name,
             mode: trace.mode,
             x: Array.from(trace.x),
             y: Array.from(trace.y),
             z: trace.type === "scatter3d" ? Array.from(trace.z) : null,
             error: trace.error_x?.array ? Array.from(trace.error_x.array) : null,
           }))""",
        figure,
    )


def drawn(page, figure):
    """The same by name."""
    return {trace["name"]: trace for trace in traces_of(page, figure)}


def rows(panel):
    """Rows of the tables of a tab, cell by cell."""
    return panel.locator("tbody tr").evaluate_all(
        "rows => rows.map(row => [...row.children].map(cell => cell.textContent))"
    )


def same(shown, number):
    """A printed number is the number, to half a unit of its last digit."""
    digits, _, exponent = shown.partition("e")
    decimals = len(digits.partition(".")[2])
    return abs(float(shown) - number) <= 0.501 * 10.0 ** (int(exponent or 0) - decimals)


@pytest.mark.parametrize("name", ["calibrate", "evaluate", "gap", "noise"])
def test_every_tab_opens_and_shows_its_figures(opened, reports, name):
    assert (reports / f"{name}.html").stat().st_size < MOST_BYTES
    page = opened(name)
    assert len(tabs(page)) >= 3
    for tab in tabs(page):
        tab.click()
        panels = [panel for panel in page.locator(".tab").all() if panel.is_visible()]
        assert [panel.get_attribute("id") for panel in panels] == [tab.get_attribute("aria-controls")]
        for plot in panels[0].locator(".plot").all():
            box = plot.locator(".main-svg").first.bounding_box()
            assert box["width"] > 800
            assert box["height"] > 150


def test_tabs_follow_the_keyboard(opened):
    page = opened("noise")
    open_tab(page, "Accelerometer")
    page.keyboard.press("ArrowRight")
    assert page.get_by_role("tab", name="Gyroscope").get_attribute("aria-selected") == "true"
    assert page.locator("#gyroscope").is_visible()
    assert not page.locator("#accelerometer").is_visible()


def test_the_sphere_turns_and_keeps_its_turn_in_the_dark(opened):
    page = opened("calibrate")
    open_tab(page, "Coverage")
    eye = """() => {
        const camera = document.getElementById("figure-coverage")._fullLayout.scene._scene.getCamera();
        return [camera.eye.x, camera.eye.y, camera.eye.z];
    }"""
    before = np.array(page.evaluate(eye))
    page.locator("#figure-coverage").scroll_into_view_if_needed()
    box = page.locator("#figure-coverage canvas").first.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 120, y + 40, steps=4)
    page.mouse.up()
    turned = np.array(page.evaluate(eye))
    assert np.linalg.norm(turned - before) > 0.1
    page.get_by_role("button", name="Dark colours").click()
    assert page.locator("html").get_attribute("data-theme") == "dark"
    np.testing.assert_allclose(page.evaluate(eye), turned, atol=1e-6)
    page.get_by_role("button", name="Light colours").click()


def test_the_sphere_shows_which_way_was_up(opened, reports):
    page, result = opened("calibrate"), result_of(reports, "calibrate")
    open_tab(page, "Coverage")
    points = drawn(page, "coverage")
    # Each point is the calibrated mean of a rest, computed here from the JSON alone.
    sensitivity, bias = (np.array(result["accelerometer"][name]) for name in ("T", "bias"))
    raw = np.array([rest["mean_specific_force"] for rest in result["rests"]])
    up = (raw - bias) @ np.linalg.inv(sensitivity).T
    measured = np.array(result["control"]["carried"][0]["measured"])
    for name, expected in (("rests", up), ("control rests", measured)):
        shown = np.column_stack([points[name][axis] for axis in "xyz"])
        expected = expected / np.linalg.norm(expected, axis=1, keepdims=True)
        np.testing.assert_allclose(shown, expected, atol=1e-12)
    nearest = [("xyz"[k], row[k] > 0) for row in up for k in [int(np.argmax(np.abs(row)))]]
    counts = [[axis, *(str(nearest.count((axis, above))) for above in (True, False))] for axis in "xyz"]
    assert rows(page.locator("#coverage")) == counts


def test_the_page_of_a_calibration_shows_its_json(opened, reports):
    page, result = opened("calibrate"), result_of(reports, "calibrate")
    assert page.locator(".verdict").text_content().strip().startswith("✘Poor: " + result["reasons"][0])
    open_tab(page, "Residuals")
    for items, key, factor in (("rests", "norm_error_mps2", MG), ("moves", "direction_error_deg", 1.0)):
        for of, document in (("calibration", result), ("control", result["control"])):
            used = [(i, item) for i, item in enumerate(document[items]) if item["excluded"] is None]
            trace = drawn(page, f"{of}-{items}")["used"]
            assert trace["x"] == [i for i, _ in used]
            assert trace["y"] == pytest.approx([factor * item[key] for _, item in used], rel=1e-12)
    open_tab(page, "Propagated gravity")
    carried = result["control"]["carried"][0]
    for column, axis in enumerate("xyz"):
        traces = drawn(page, f"carried-0-{axis}")
        for name, key in (
            ("measured", "measured"),
            ("propagated, uncalibrated", "uncalibrated"),
            ("propagated, calibrated", "calibrated"),
        ):
            assert traces[name]["x"] == carried["time_s"]
            assert traces[name]["y"] == [row[column] for row in carried[key]]


def test_parameters_are_those_of_the_json(opened, reports):
    page, result = opened("calibrate"), result_of(reports, "calibrate")
    parameters = {p["name"]: p for p in result["parameters"]}
    scales = {name: datasheet(name, p["unit"]) for name, p in parameters.items()}
    panel = open_tab(page, "Parameters")
    table = {row[0].removesuffix(" − 1"): row for row in rows(panel)[: len(parameters)]}
    assert list(table) == list(parameters)
    for name, row in table.items():
        assert same(row[1], scales[name].shown(parameters[name]["value"]))
        assert same(row[2], scales[name].factor * parameters[name]["std"])
        assert row[3].replace("µ", "u").replace("²", "^2") == scales[name].unit
    shown = {
        name: (x, sigma)
        for panel in traces_of(page, "parameters")
        for name, x, sigma in zip(panel["y"], panel["x"], panel["error"], strict=True)
    }
    assert sorted(shown) == sorted(parameters)
    for name, p in parameters.items():
        expected = (scales[name].shown(p["value"]), scales[name].factor * p["std"])
        assert shown[name] == pytest.approx(expected, rel=1e-9)
    bars = {n: x for panel in traces_of(page, "sigmas") for n, x in zip(panel["y"], panel["x"], strict=True)}
    assert bars == pytest.approx({name: scales[name].factor * p["std"] for name, p in parameters.items()})


def test_limits_are_drawn_where_the_json_says(opened, reports):
    page, result = opened("calibrate"), result_of(reports, "calibrate")
    checks = {check["what"]: check for check in result["judgement"]["checks"]}
    cells = {row[0]: row for row in rows(open_tab(page, "Limits"))}
    assert {what: row[4] for what, row in cells.items()} == {
        what: "pass" if check["passed"] else "FAIL" for what, check in checks.items()
    }
    assert all(same(row[1], checks[what]["value"]) for what, row in cells.items())
    traces = drawn(page, "limits")
    assert traces["failed"]["y"] == [what for what, check in checks.items() if not check["passed"]]
    assert sorted(traces["passed"]["y"] + traces["failed"]["y"]) == sorted(checks)
    for trace in traces.values():
        for what, x, sigma in zip(trace["y"], trace["x"], trace["error"], strict=True):
            limit = checks[what]["limit"]
            if "min" in limit:
                half = (limit["max"] - limit["min"]) / 2
                position = (checks[what]["value"] - limit["min"]) / half - 1
                assert x == pytest.approx(np.clip(position, -1.5, 1.5))
                assert sigma == pytest.approx(checks[what]["std"] / half)
            else:
                assert x == pytest.approx(checks[what]["value"] / limit["max"])


def test_the_page_of_an_evaluation_shows_its_json(opened, reports):
    page, result = opened("evaluate"), result_of(reports, "evaluate")
    table = {row[0]: row[1:] for row in rows(open_tab(page, "Summary"))}
    for words, key in (
        ("gravity direction propagated over one move, rms error, deg", "gravity_direction_rms_deg"),
        ("|f| − g at rest, rms, mg", "gravity_norm_rms_mps2"),
        ("χ² per degree of freedom (1: noise only)", "chi2_per_dof"),
    ):
        for shown, when in zip(table[words], ("before", "after"), strict=True):
            expected = result["control_set"][when][key] * (MG if key.endswith("_mps2") else 1.0)
            assert float(shown) == pytest.approx(expected, rel=6e-4)
    open_tab(page, "Residuals")
    expected = [MG * rest["norm_error_mps2"] for rest in result["rests"]]
    assert drawn(page, "control-rests")["used"]["y"] == pytest.approx(expected, rel=1e-12)


def test_hovering_over_a_residual_tells_of_its_rest(opened, reports):
    page, result = opened("evaluate"), result_of(reports, "evaluate")
    open_tab(page, "Residuals")
    box = page.locator("#figure-control-rests .points path").nth(7).bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    words = page.locator("#figure-control-rests .hoverlayer .hovertext").text_content()
    assert "rest 7 of control.parquet" in words
    assert f"{result['rests'][7]['start_s']:.2f} s to" in words


def test_the_page_of_a_gap_shows_its_json(opened, reports):
    page, result = opened("gap"), result_of(reports, "gap")
    assert result["verdict"] == "named"
    assert "Missing from the model: gyro_g_sensitivity." in page.locator(".verdict").text_content()
    ranked = {score["name"]: score["log_bayes_factor"] for score in result["ranking"]}
    assert [row[0] for row in rows(open_tab(page, "Evidence"))] == list(ranked)
    bars = drawn(page, "ranking")
    assert bars["added to the model"]["y"] == ["gyro_g_sensitivity"]
    for bar in bars.values():
        assert bar["x"] == [ranked[name] for name in bar["y"]]
    open_tab(page, "Before and after")
    points = [trace for trace in traces_of(page, "change") if trace["mode"] == "markers"]
    assert [(trace["name"], trace["x"]) for trace in points] == [
        (when, [factor * result[of][when][name] for of in ("control_set", "calibration_set")])
        for name, factor in (
            ("chi2_per_dof", 1.0),
            ("gravity_norm_rms_mps2", MG),
            ("gravity_direction_rms_deg", 1.0),
        )
        for when in ("before", "after")
    ]


def test_the_page_of_noise_shows_its_json(opened, reports):
    page, result = opened("noise"), result_of(reports, "noise")
    for sensor, heading in (("accel", "Accelerometer"), ("gyro", "Gyroscope")):
        open_tab(page, heading)
        traces = drawn(page, f"allan-{sensor}")
        for axis in "xyz":
            assert traces[axis]["x"] == result["axes"][f"{sensor}_{axis}"]["taus_s"]
            factor = 3600 * np.degrees(1.0) if sensor == "gyro" else 1e3 * MG
            expected = [factor * y for y in result["axes"][f"{sensor}_{axis}"]["deviations"]]
            assert traces[axis]["y"] == pytest.approx(expected, rel=1e-12)
    table = {row[0]: row for row in rows(open_tab(page, "Figures"))}
    density = result["axes"]["gyro_y"]["noise_density"]
    shown = table["gyro_y noise density"]
    assert same(shown[1], density["value"])
    assert [float(cell) for cell in shown[3:5]] == pytest.approx([density["low"], density["high"]], rel=6e-3)


def test_paper_is_white_and_has_all_tabs(opened):
    page = opened("noise", "dark")
    seen = "[...document.querySelectorAll('.tab')].map(tab => !tab.hidden)"
    assert page.evaluate(seen).count(True) == 1
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert all(page.evaluate(seen))
    looks = page.evaluate(
        """[...document.querySelectorAll(".plot")]
             .map(plot => [plot._fullLayout.width, plot._fullLayout.paper_bgcolor])"""
    )
    assert looks == [[330, PAPER], [330, PAPER]]
    page.evaluate("dispatchEvent(new Event('afterprint'))")
    assert page.evaluate(seen).count(True) == 1
    assert page.locator("html").get_attribute("data-theme") == "dark"


@pytest.mark.parametrize("device", list(DEVICES))
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("name", ["calibrate", "gap"])
def test_pages_fit_the_screen_in_both_themes(opened, name, scheme, device):
    page = opened(name, scheme, device)
    colour = PAPER if scheme == "light" else DARK[PAPER]
    expected = "rgb({}, {}, {})".format(*bytes.fromhex(colour[1:]))
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == expected
    for tab in tabs(page):
        tab.click()
        width, held = page.evaluate("[document.documentElement.scrollWidth, innerWidth]")
        assert width <= held
        figures = page.locator(".plot:visible").evaluate_all(
            "plots => plots.map(plot => plot._fullLayout.paper_bgcolor)"
        )
        assert set(figures) <= {colour}


def test_a_page_of_refused_recordings_is_one_quiet_tab(opened, reports):
    fault = imucal.Gap(
        "data_fault", effects=({"name": "clipped", "parameters": ()},), notes=("rest 7 clips",)
    )
    write_gap_page(reports / "fault.html", fault)
    page = opened("fault", "dark")
    assert tabs(page) == []
    assert page.locator(".tab").is_visible()
    assert "rest 7 clips" in page.locator("main").text_content()
    page.get_by_role("button", name="Light colours").click()
    assert page.locator("html").get_attribute("data-theme") == "light"


def test_the_next_motion_is_saved_as_a_program(opened, reports):
    program = imucal.Program.random(seed=1, moves=3).to_dict()
    effect = {"name": "earth_rate", "parameters": ()}
    motion = {"description": "turn about the vertical", "program": program}
    rival = ("gyro_g_sensitivity",)
    write_gap_page(
        reports / "next.html", imucal.Gap("ambiguous", (effect,), ambiguous_with=rival, next_motion=motion)
    )
    page = opened("next")
    assert "turn about the vertical" in open_tab(page, "Next motion").text_content()
    with page.expect_download() as download:
        page.get_by_role("button", name="Save next-motion.json").click()
    assert download.value.suggested_filename == "next-motion.json"
    assert json.loads(download.value.path().read_text()) == plain(program)
