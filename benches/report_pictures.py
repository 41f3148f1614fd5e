"""Screenshots of reports for the documentation, in docs/pictures.

report.png, report-phone.png   the report of a calibration
gap-closing.png                the report of a search: the move with the largest residual
"""

import shutil
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright

import imucal
from imucal.report import write_calibration_page, write_gap_page

FOLDER = Path(__file__).parent.parent / "docs/pictures"
DESKTOP = {"viewport": {"width": 1000, "height": 800}}
PHONE = {"viewport": {"width": 390, "height": 900}, "is_mobile": True, "has_touch": True}
GAP = {"viewport": {"width": 900, "height": 790}, "device_scale_factor": 1.25}


def main() -> None:
    """Simulate, calibrate, search, write the reports, and take screenshots of their tabs."""
    run, control = (imucal.simulate("random", seed=seed).recording for seed in (1, 2))
    result = imucal.calibrate(run, control=control, serial_number="0042")
    effect = {"gyro_g_sensitivity": 3e-4}
    recordings = [
        imucal.simulate("random", seed=seed, rate_hz=100, effects=effect).recording for seed in (1, 2)
    ]
    gap = imucal.find_gap(recordings[0], control=recordings[1])
    FOLDER.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        calibrated, searched = Path(folder) / "report.html", Path(folder) / "gap.html"
        write_calibration_page(calibrated, result)
        write_gap_page(searched, gap, recordings=recordings[0], control=recordings[1])
        arguments = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=arguments)
        for name, file, tab, scheme, device in (
            ("report.png", calibrated, "Propagated gravity", "light", DESKTOP),
            ("report-phone.png", calibrated, "Coverage", "dark", PHONE),
            ("gap-closing.png", searched, "Summary", "light", GAP),
        ):
            page = browser.new_context(offline=True, color_scheme=scheme, **device).new_page()
            page.goto(file.as_uri())
            page.get_by_role("tab", name=tab).click()
            page.wait_for_timeout(500)
            page.screenshot(path=FOLDER / name)
        browser.close()


if __name__ == "__main__":
    main()
