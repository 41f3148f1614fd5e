"""A copy of the installed package with the switches of a sample."""

from __future__ import annotations

import random
import shutil
from pathlib import Path

import imucal
from mutants.given import IN_PYTHON, given_sites
from mutants.python_sites import PATTERN, python_sites, with_switch
from mutants.sites import MOST, REACHED, SWITCH, Site, applied

__all__ = ["AREAS", "PythonCopy", "installed_copy"]

# Folders whose code decides about results, files of a calibration or exit codes.
AREAS = (
    "calibration",
    "capture",
    "cli",
    "document",
    "effects",
    "estimation",
    "exporting",
    "fleet",
    "gap",
    "importing",
    "io",
    "limits",
    "noise_analysis",
    "planning",
    "recording",
)
MODULE = f'''"""Switch of deliberate errors."""

import mmap
import os

_NUMBER = int(os.environ.get("{SWITCH}") or 0)
_REACHED = bytearray({MOST})
if os.environ.get("{REACHED}"):
    with open(os.environ["{REACHED}"], "r+b") as _file:
        _REACHED = mmap.mmap(_file.fileno(), 0)


def is_on(number):
    """Whether the error with this number is on."""
    _REACHED[number] = 1
    return number == _NUMBER
'''


class PythonCopy:
    """The copy in `folder`, for PYTHONPATH; `sites` are the drawn errors by number."""

    def __init__(self, folder: Path) -> None:
        self.package = installed_copy(folder)
        self.sites: dict[int, Site] = {}

    def write(self, seed: int, count: int) -> None:
        """Draw `count` errors and write their switches."""
        chance = random.Random(seed)
        sources = {
            path.relative_to(self.package.parent).as_posix(): path.read_bytes()
            for area in AREAS
            for path in sorted((self.package / area).rglob("*.py"))
        }
        drawn = [site for name, source in sources.items() for site in python_sites(name, source, chance)]
        self.sites = dict(enumerate(random.Random(seed).sample(drawn, count), 1))
        self.sites |= given_sites(IN_PYTHON, sources)
        for name in {site.path for site in self.sites.values()}:
            within = {n: site for n, site in self.sites.items() if site.path == name}
            at_import = [n for n, site in within.items() if site.at_import]
            text = with_switch(applied(sources[name], within, PATTERN), at_import)
            compile(text, name, "exec")
            (self.package.parent / name).write_text(text)
        (self.package / "_mutant.py").write_text(MODULE)


def installed_copy(folder: Path) -> Path:
    """A new copy of the installed package in `folder`, which a path of Python may name."""
    shutil.rmtree(folder, ignore_errors=True)
    installed = Path(imucal.__file__).parent
    shutil.copytree(installed, folder / "imucal", ignore=shutil.ignore_patterns("__pycache__"))
    # Programs find the version of the package in its description.
    for path in installed.parent.glob("imucal_rs-*.dist-info"):
        shutil.copytree(path, folder / path.name)
    return folder / "imucal"
