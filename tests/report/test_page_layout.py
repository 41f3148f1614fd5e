"""The layout of the reports in a browser: widths of screens, overlaps, contrast, and pages on paper."""

import re

import numpy as np
import pytest

import imucal
from children import HANGS_S
from chromium import ARGUMENTS, CHROMIUM, sync_api
from imucal.report import (
    write_calibration_page,
    write_gap_page,
    write_inspection_page,
    write_noise_page,
)

pytestmark = pytest.mark.slow

WIDTHS = (360, 768, 1600)
MOST_PAGES = 6
NAMES = ("calibration", "gap", "inspection", "noise")

# Pairs of overlapping texts of a figure, and texts outside of it. Boxes of text are larger than its letters
# by about 2 pixels.
OVERLAPS = """() => {
  const out = [];
  for (const plot of document.querySelectorAll(".plot")) {
    if (!plot.offsetParent) continue;
    const frame = plot.getBoundingClientRect();
    const texts = [...plot.querySelectorAll("text")]
      .filter((text) => text.textContent.trim() && !text.closest(".hoverlayer"))
      .map((text) => ({ words: text.textContent, box: text.getBoundingClientRect() }))
      .filter(({ box }) => box.width > 0);
    texts.forEach((a, i) => {
      if (a.box.left < frame.left - 1 || a.box.right > frame.right + 1) out.push([plot.id, a.words]);
      texts.slice(i + 1).forEach((b) => {
        const x = Math.min(a.box.right, b.box.right) - Math.max(a.box.left, b.box.left);
        const y = Math.min(a.box.bottom, b.box.bottom) - Math.max(a.box.top, b.box.top);
        if (x > 2 && y > 3) out.push([plot.id, a.words, b.words]);
      });
    });
  }
  return out;
}"""
# Colours of text and of the nearest background behind it, for all visible texts of the page outside figures.
COLOURS = """() => {
  const seen = new Set();
  for (const element of document.querySelectorAll("main *")) {
    const own = [...element.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim());
    if (!own || !element.offsetParent || element.closest(".plot, script")) continue;
    let behind = element;
    while (behind && /, 0\\)$/.test(getComputedStyle(behind).backgroundColor)) behind = behind.parentElement;
    const paper = getComputedStyle(behind ?? document.body).backgroundColor;
    seen.add(`${getComputedStyle(element).color}|${paper}`);
  }
  return [...seen];
}"""


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """Folder with a page of each kind, of a unit with a hidden effect and a temperature."""
    folder = tmp_path_factory.mktemp("pages")
    effect = {"gyro_g_sensitivity": 1e-3}
    run, control = (
        imucal.simulate("random", seed=seed, rate_hz=50, effects=effect, temperature=30.0).recording
        for seed in (1, 2)
    )
    result = imucal.calibrate(run, control=control, serial_number="0042")
    write_calibration_page(folder / "calibration.html", result)
    found = imucal.find_gap(run, control=control, candidates=["gyro_g_sensitivity", "gyro_scale_quadratic"])
    write_gap_page(folder / "gap.html", found, recordings=run, control=control)
    write_inspection_page(folder / "inspection.html", imucal.inspect(run), run)
    still = imucal.simulate(imucal.Static(120.0), rate_hz=50, seed=3).recording
    write_noise_page(folder / "noise.html", imucal.noise(still))
    return folder


@pytest.fixture(scope="module")
def opened(pages):
    """Show a page, which is opened once, in a theme; after the tests, none has written an error."""
    errors, known = [], {}
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=[*ARGUMENTS])

        def open_it(name, scheme="light"):
            if name not in known:
                page = browser.new_context(offline=True, color_scheme=scheme).new_page()
                page.set_default_timeout(1000 * HANGS_S)
                page.on("console", lambda m: errors.append(m.text) if m.type == "error" else None)
                page.on("pageerror", lambda error: errors.append(str(error)))
                page.goto((pages / f"{name}.html").as_uri())
                known[name] = page
            page = known[name]
            page.emulate_media(color_scheme=scheme)
            page.locator(f"html[data-theme={scheme}]").wait_for()
            return page

        yield open_it
        browser.close()
    assert errors == []


def each_tab(page):
    """Open each tab in turn; a page of one tab has no buttons."""
    for tab in page.get_by_role("tab").all() or [None]:
        if tab is not None:
            tab.click()
        # Figures are resized a tenth of a second after their tab is shown.
        page.wait_for_timeout(300)
        yield tab


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("width", WIDTHS)
def test_nothing_overlaps_at_any_width(opened, name, width):
    page = opened(name)
    page.set_viewport_size({"width": width, "height": 900})
    overlaps = []
    for _ in each_tab(page):
        # On a busy computer, figures are resized later.
        page.wait_for_function("width => document.documentElement.scrollWidth <= width", arg=width)
        overlaps += page.evaluate(OVERLAPS)
    assert overlaps == []


def luminance(colour):
    parts = np.array([float(part) for part in re.findall(r"[\d.]+", colour)[:3]]) / 255
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return linear @ [0.2126, 0.7152, 0.0722]


@pytest.mark.parametrize("name", ["calibration", "gap"])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_has_contrast(opened, name, scheme):
    page = opened(name, scheme)
    for _ in each_tab(page):
        for pair in page.evaluate(COLOURS):
            high, low = sorted(map(luminance, pair.split("|")), reverse=True)
            # WCAG 2.2, 1.4.3.
            assert (high + 0.05) / (low + 0.05) >= 4.5, pair


@pytest.mark.parametrize("name", NAMES)
def test_paper_is_a4_and_at_most_six_pages(opened, name):
    page = opened(name)
    made = page.pdf(prefer_css_page_size=True)
    assert 1 <= len(re.findall(rb"/Type\s*/Page[^s]", made)) <= MOST_PAGES
    width, height = map(float, re.search(rb"/MediaBox\s*\[0 0 ([\d.]+) ([\d.]+)", made).groups())
    assert (width, height) == pytest.approx((595, 842), abs=2)
    # The serial number and the number of the page are in the margin.
    styles = page.locator("style").first.text_content()
    assert ("0042" in styles) == (name == "calibration")
    assert "counter(page)" in styles
