"""What import and help load: counted, for a time is never the same twice."""

import ast
import inspect
import json
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import cloudpickle
import numpy as np
import pytest

import imucal
import imucal.cli.options as cli_options


def loaded(code):
    """Names of the modules that a new interpreter has after `code`."""
    script = f"import sys\n{code}\nprint('\\n' + ' '.join(sys.modules))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    return set(done.stdout.splitlines()[-1].split())


def test_import_loads_nothing_but_the_package():
    new = loaded("import imucal") - loaded("")
    assert not {"numpy", "pyarrow", "click", "rich", "imucal._core"} & new
    own = {name for name in new if name.startswith("imucal")}
    assert own == {"imucal", "imucal.data_frame", "imucal.notebook"}


def test_help_loads_neither_arrays_nor_decoration():
    code = "from imucal.cli import main\nmain(['--help'])"
    assert not {"numpy", "pyarrow", "rich", "imucal._core", "imucal.estimation"} & loaded(code)


NAMES = "time_ms,accel_x_mps2,accel_y_mps2,accel_z_mps2,gyro_x_radps,gyro_y_radps,gyro_z_radps"
# Libraries that are installed with imucal or next to it, and that a calibration does not need.
UNUSED = {"pandas", "polars", "pydantic", "typer", "matplotlib", "scipy", "plotly", "rich"}


def test_reading_a_file_does_not_load_arrows_functions(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(f"{NAMES}\n1,2,3,4,5,6,7\n2,2,,4,5,6,7\n")
    new = loaded(f"import imucal\nimucal.read({str(path)!r})")
    assert "pyarrow.lib" in new
    assert not {"pyarrow.compute", *UNUSED} & new


def test_reading_a_file_of_plain_numbers_does_not_load_arrow(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(f"{NAMES}\n1,2,3,4,5,6,7\n2,2,3,4,5,6,7\n")
    assert not {"pyarrow", *UNUSED} & loaded(f"import imucal\nimucal.read({str(path)!r})")


def test_a_calibration_loads_what_it_needs(tmp_path):
    path = tmp_path / "run.csv"
    imucal.write(imucal.simulate("random", seed=1, rate_hz=50.0).recording, path)
    new = loaded(f"from imucal.cli import main\nmain(['calibrate', {str(path)!r}])")
    assert {"numpy", "imucal._core", "imucal.cli.commands.calibrate"} <= new
    assert not {"pyarrow", "imucal.report", "imucal.gap.find", *UNUSED} & new
    others = {name for name in new if name.startswith("imucal.cli.commands.")}
    assert others == {"imucal.cli.commands.calibrate"}


# What a calibration without effects, control recordings, held parameters and output files does not need.
PARTS_UNUSED = {
    *("calibration.file", "document.atomic", "document.json_document", "effects.effect", "effects.formula"),
    *("estimation.evaluate", "estimation.means", "estimation.priors", "limits.judgement", "rig.unit"),
}
LIBRARIES_UNUSED = {"csv", "difflib", "gzip", "json", "subprocess", "tempfile", "traceback", "zipfile"}
# Creating a dataclass takes about half a millisecond, and compiling a pattern about a quarter. The numbers
# are those of this calibration; a larger number needs a reason.
MOST_DATACLASSES, MOST_PATTERNS = 36, 4
COUNTED = """
import dataclasses, json, re
own = [module for name, module in sys.modules.items() if name.startswith("imucal")]
values = {id(value): value for module in own for value in vars(module).values()}.values()
dataclasses_made = [v for v in values if isinstance(v, type) and dataclasses.is_dataclass(v)]
patterns = [value for value in values if isinstance(value, re.Pattern)]
print(json.dumps([len(dataclasses_made), len(patterns)]))
"""


@pytest.mark.parametrize("files", [1, 2])
def test_a_calibration_does_not_load_what_it_does_not_need(tmp_path, files):
    recording = imucal.simulate("random", seed=1, rate_hz=50.0).recording
    paths = [tmp_path / "acc.txt", tmp_path / "gyro.txt"] if files == 2 else [tmp_path / "run.csv"]
    options = ["--format", "imu_tk", "--accel-unit", "m/s^2", "--gyro-unit", "rad/s"] if files == 2 else []
    if files == 2:
        for path, samples in zip(paths, (recording.specific_force, recording.angular_rate), strict=True):
            np.savetxt(path, np.column_stack([recording.time_s, samples]))
    else:
        imucal.write(recording, paths[0])
    calibrating = f"from imucal.cli import main\nmain({['calibrate', *map(str, paths), *options]!r})"
    new = loaded(calibrating) - loaded("")
    assert not {f"imucal.{name}" for name in PARTS_UNUSED} & new
    assert not LIBRARIES_UNUSED & new
    readers = {f"imucal.io.{form.reader.partition('.')[0]}" for form in imucal.io.FORMATS.values()}
    of_text = {f"imucal.io.{name}" for name in ("canonical", "euroc", "imu_tk", "sensor_files")}
    assert new & readers <= of_text
    script = f"import sys\n{calibrating}\n{COUNTED}"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    dataclasses_made, patterns = json.loads(done.stdout.splitlines()[-1])
    assert 20 < dataclasses_made <= MOST_DATACLASSES
    assert 0 < patterns <= MOST_PATTERNS


@pytest.mark.parametrize("given", [None, "3"])
def test_a_command_has_one_thread_of_linear_algebra_unless_the_environment_says_otherwise(monkeypatch, given):
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    if given is not None:
        monkeypatch.setenv("OPENBLAS_NUM_THREADS", given)
    script = (
        "import os, sys; from imucal.cli import main; before = dict(os.environ)\n"
        # Called as a function, it does not change the environment of its caller.
        "main(['--version']); assert os.environ == before\n"
        "assert 'numpy' not in sys.modules\n"
        "sys.argv = ['imucal', '--version']; main(); print(os.environ['OPENBLAS_NUM_THREADS'])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == (given or "1")


@pytest.mark.parametrize("option", ["--help", "--version"])
def test_the_list_of_commands_loads_no_command(option):
    new = loaded(f"from imucal.cli import main\nmain([{option!r}])")
    assert not {name for name in new if name.startswith("imucal.cli.commands.")}
    assert not {"numpy", "pyarrow", *UNUSED} & new


def test_every_public_name_can_be_loaded_and_stands_once():
    stub = ast.parse(Path(imucal.__file__).with_suffix(".pyi").read_text())
    imports = [node for node in stub.body if isinstance(node, ast.ImportFrom)]
    names = [alias.asname for node in imports for alias in node.names]
    assert sorted(names) == imucal.__all__ == sorted(dir(imucal))
    for name in names:
        assert getattr(imucal, name) is not None
    assert not hasattr(imucal, "no_such_name")


def test_no_public_name_is_that_of_a_module():
    """Python binds each module that it loads in its package, which would replace a function of that name."""
    package = Path(imucal.__file__).parent
    modules = {path.stem for path in package.iterdir() if path.suffix == ".py" or path.is_dir()}
    exported = {name for name in imucal.__all__ if not isinstance(getattr(imucal, name), ModuleType)}
    assert len(exported) > 50
    assert exported & modules == set()
    assert type(imucal) is ModuleType


def test_folders_are_attributes():
    assert "csv" in imucal.io.FORMATS
    assert "gyro_g_sensitivity" in {effect.name for effect in imucal.effects.catalogue()}


def test_a_function_that_uses_the_package_can_be_sent_to_another_process(tmp_path):
    path = tmp_path / "run.csv"
    names = "time_s,accel_x_mps2,accel_y_mps2,accel_z_mps2,gyro_x_radps,gyro_y_radps,gyro_z_radps"
    path.write_text(f"{names}\n0,1,2,3,4,5,6\n1,1,2,3,4,5,6\n")
    sent = tmp_path / "function.pickle"
    sent.write_bytes(cloudpickle.dumps(lambda name: len(imucal.read(name))))
    code = (
        "import pickle, pathlib\n"
        f"function = pickle.loads(pathlib.Path({str(sent)!r}).read_bytes())\n"
        f"assert function({str(path)!r}) == 2"
    )
    assert "imucal.io" in loaded(code)


def test_the_default_in_help_is_that_of_the_library():
    parameters = inspect.signature(imucal.calibrate).parameters
    assert parameters["min_rest_s"].default == cli_options.MIN_REST_S
    assert parameters["max_iterations"].default == cli_options.MAX_ITERATIONS
