"""Screenshots of a report for the documentation: docs/pictures/report.png and report-phone.png."""

import shutil
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright

import imucal
from imucal.report import write_calibration_page

FOLDER = Path(__file__).parent.parent / "docs/pictures"
DESKTOP = {"viewport": {"width": 1000, "height": 800}}
PHONE = {"viewport": {"width": 390, "height": 900}, "is_mobile": True, "has_touch": True}


def main() -> None:
    """Simulate, calibrate, write the report, and take screenshots of two of its tabs."""
    run, control = (imucal.simulate("random", seed=seed).recording for seed in (1, 2))
    result = imucal.calibrate(run, control=control, serial_number="0042")
    FOLDER.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        page_file = Path(folder) / "report.html"
        write_calibration_page(page_file, result)
        arguments = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=arguments)
        for name, tab, scheme, device in (
            ("report.png", "Propagated gravity", "light", DESKTOP),
            ("report-phone.png", "Coverage", "dark", PHONE),
        ):
            page = browser.new_context(offline=True, color_scheme=scheme, **device).new_page()
            page.goto(page_file.as_uri())
            page.get_by_role("tab", name=tab).click()
            page.wait_for_timeout(500)
            page.screenshot(path=FOLDER / name)
        browser.close()


if __name__ == "__main__":
    main()
