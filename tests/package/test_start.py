"""What import and help load: counted, for a time is never the same twice."""

import ast
import subprocess
import sys
from pathlib import Path

import imucal


def loaded(code):
    """Names of the modules that a new interpreter has after `code`."""
    script = f"import sys\n{code}\nprint('\\n' + ' '.join(sys.modules))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    return set(done.stdout.splitlines()[-1].split())


def test_import_loads_nothing_but_the_package():
    new = loaded("import imucal") - loaded("")
    assert not {"numpy", "pyarrow", "typer", "rich", "imucal._core"} & new
    assert {name for name in new if name.startswith("imucal")} == {"imucal"}


def test_help_loads_neither_arrays_nor_decoration():
    code = "from imucal.cli import main\nmain(['--help'])"
    assert not {"numpy", "pyarrow", "rich", "imucal._core", "imucal.calibrate"} & loaded(code)


def test_reading_a_file_does_not_load_arrows_functions(tmp_path):
    path = tmp_path / "run.csv"
    names = "time_ms,accel_x_mps2,accel_y_mps2,accel_z_mps2,gyro_x_radps,gyro_y_radps,gyro_z_radps"
    path.write_text(f"{names}\n1,2,3,4,5,6,7\n2,2,,4,5,6,7\n")
    assert "pyarrow.compute" not in loaded(f"import imucal\nimucal.read({str(path)!r})")


def test_every_name_is_where_the_type_checker_looks_for_it():
    tree = ast.parse(Path(imucal.__file__).read_text())
    imports = {
        alias.name: node.module
        for block in tree.body
        if isinstance(block, ast.If)
        for node in block.body
        for alias in node.names
    }
    homes = {name: home for name, home in imucal._HOME.items() if name != "__version__"}
    assert imports == homes
    assert set(imucal.__all__) == set(imucal._HOME) == set(dir(imucal))


def test_a_function_stays_a_function_when_its_module_is_loaded():
    shared = [name for name, home in imucal._HOME.items() if home == f"imucal.{name}"]
    assert {"calibrate", "evaluate", "export", "noise", "plan", "simulate"} <= set(shared)
    for first in ("import imucal.{name}", "from imucal.{name} import *", "imucal.{name}"):
        lines = "\n".join(f"{first.format(name=name)}\nassert callable(imucal.{name})" for name in shared)
        loaded(f"import imucal\n{lines}")
    for name in imucal.__all__:
        assert getattr(imucal, name) is not None


def test_modules_are_still_attributes_and_nothing_else_is():
    assert "csv" in imucal.io.FORMATS
    assert not hasattr(imucal, "no_such_name")
