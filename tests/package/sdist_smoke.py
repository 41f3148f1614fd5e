"""Run by `make test-sdist` in an environment that holds the package built from its sdist, and nothing else.

Plain Python, because pytest is not there.
"""

import subprocess
import sys
from importlib import metadata, resources
from pathlib import Path

import imucal
import imucal._core

assert metadata.version("imucal-rs") == imucal.__version__, "package and module disagree on the version"
assert (resources.files("imucal") / "py.typed").is_file(), "py.typed is not in the package"
assert {path.name for path in metadata.files("imucal-rs") or []} >= {"LICENSE-MIT", "LICENSE-APACHE"}
assert len(imucal.unit_names()) == 7, "the unit files are not in the package"
assert len(imucal.simulate("static", unit="random:bmi088", rate_hz=10, seed=1).recording) == 600

command = Path(sys.executable).with_name("imucal")
subprocess.run([command, "--help"], check=True, stdout=subprocess.DEVNULL)
print("installed from the sdist:", imucal.__file__)
