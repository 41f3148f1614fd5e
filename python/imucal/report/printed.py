"""Conversion of a page to PDF by an installed browser without a window."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Final

from imucal.document.atomic import write_atomically
from imucal.errors import InputError

__all__ = ["write_pdf"]

# Names of browsers that can print a page as PDF. The options are the same for all of them.
BROWSERS: Final = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "chrome",
    "msedge",
)
# Time limit of the browser, s.
LONGEST_S: Final = 120.0


def write_pdf(path: str | Path, page: str) -> None:
    """Print an HTML page as PDF, atomically.

    Raises InputError if no browser is installed, if the browser fails, or if the file cannot be written.
    """
    browser = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if browser is None:
        raise InputError(
            f"{path}: no browser was found that prints the page as PDF ({', '.join(BROWSERS)}): write "
            f"{Path(path).with_suffix('.html').name}, open it, and choose Print > Save as PDF"
        )
    with tempfile.TemporaryDirectory(prefix="imucal-") as folder:
        html, pdf = Path(folder, "page.html"), Path(folder, "page.pdf")
        html.write_text(page, encoding="utf-8")
        options = ["--headless", "--disable-gpu", "--no-first-run", f"--user-data-dir={folder}/profile"]
        # The sandbox is switched off for the user root, because Chromium does not start as root with its
        # sandbox.
        if hasattr(os, "geteuid") and os.geteuid() == 0:
            options.append("--no-sandbox")
        command = [browser, *options, "--no-pdf-header-footer", f"--print-to-pdf={pdf}", html.as_uri()]
        try:
            ended = subprocess.run(command, capture_output=True, timeout=LONGEST_S, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise InputError(f"{path}: {browser} does not print the page: {error}") from error
        if not pdf.is_file():
            raise InputError(f"{path}: {browser} ended with {ended.returncode} and printed no page")
        with write_atomically(path) as file:
            file.write(pdf.read_bytes())
