"""A document that was edited by hand in one place is refused, or the test says why that place stands alone.

Every number, text, name and order of a document of each kind is changed, one at a time (hand_edits.py).
"""

import json
import re
from pathlib import Path

import pytest

import imucal
from hand_edits import edits_of
from imucal.cli import main

REPORT = "a figure of the run; the file has nothing to compute it from"
SAMPLES = "a property of the samples, which are in another file"
FIGURE = "a figure of a sensor or a stand, within the bounds of any"
LIMIT = "what a user asks for, within what a sensor can be"
ORIGIN = "where the data came from; the file does not have the data"

# Edits that load: a pattern of paths, a pattern of edits, and why nothing in the document contradicts them.
ALONE = {
    "calibration": [
        (r"\$\.(calibration|control)_set\.\w+", "double|thousand|huge|null", REPORT),
        (r"\$\.fit\.(accelerometer|gyroscope|joint)\.\w+", "double|thousand|huge|null", REPORT),
        (r"\$\.fit\.joint\.scales\.\w+", "null", "a kind of residual that the run does not have is null"),
        (r"\$\.fit\.noise_alone", "", "null without degrees of freedom"),
        (r"\$\.fit\.bias_instability_radps", "number", "checked if it is a list"),
        (r"\$\.fit\.tremor_deg\[0\]", "number", REPORT),
        (r"\$\.fit\.rest_thresholds\[0\]\.\w+(\[\d\])?", "double|thousand|huge|null|swap.*|reverse", REPORT),
        (r"\$\.noise\.\w+", "double", "noise of a sensor may be twice as large"),
        (r"\$\.provenance\.(control_)?files(\[0\])?", "delete|none|twice", ORIGIN),
        (r"\$\.provenance\.(control_)?files\[0\]\.path", "other text|reversed text|empty", "any file name"),
        (r"\$\.provenance\.(date|imucal_version|operator)", "empty", "empty is not known"),
        (r"\$\.provenance\.operator", "delete|other text", "any name; older files have none"),
        (r"\$\.provenance\.(imported|composed_of)", "delete", "older files have none"),
        (r"\$\.serial_number", "other text|null", "any name"),
        (r"\$\.(reference_temperature_degc|axes)", "delete", "older files have none"),
        (r"\$\.references", "delete", "files of other programs have none"),
        (r"\$\.references\.\w+", "number", "what the user gives about gravity and the clock"),
    ],
    "unit": [
        (r"\$\.(name|description|accelerometer\.part|gyroscope\.part)", ".* text|empty", "any words"),
        (r"\$\.sources\.\w+", ".* text|empty", "any words"),
        (r"\$\.(\w+\.)+(note|source)", "delete|.* text|empty", "any words; not every figure has a source"),
        (r"\$\.(accelerometer|gyroscope|spread)\.\w+", "delete|null", "a figure may be unknown"),
        (r"\$\.spread", "delete|null", "a unit may have no spread"),
        (r"\$\.(\w+\.)+value(\[\d\])*", "sign|double|thousand|reverse|swap.*", FIGURE),
        (r"\$\.sources\.\w+", "delete|rename", "not every source is used"),
        (r"\$\.(\w+\.)+unit", "", FIGURE),
        (r"\$\.spread\.\w+\.limit", "", FIGURE),
    ],
    "limits": [
        (r"\$\.description", "delete|.* text|empty", "any words"),
        (r"\$\.(parameters|\w+_set|effects|held_out)", "delete|none", "every limit is optional"),
        (r"\$\.(parameters|\w+_set)\.\w+\*?", "delete", "every limit is optional"),
        (r"\$\.parameters\..*\.(min|max)", "sign|double|thousand|huge", LIMIT),
        (r"\$\.parameters\..*\.max_std", "delete|double|thousand|huge", LIMIT),
        (r"\$\.\w+_set\.\w+\.(min|max)", "double|thousand", LIMIT),
        (r"\$\.effects", "twice|reverse|swap", "a list of names"),
        (r"\$\.effects\[0\]", "delete", "any effects may be permitted"),
    ],
    "program": [
        (r"\$\.steps(\[\d\])?", "delete|reverse|swap.*|twice", "any motion within the bounds"),
        (
            r"\$\.steps\[\d\]\.\w+(\[\d\])?",
            "sign|one|double|thousand|reverse|swap.*",
            "any motion within the bounds",
        ),
        (r"\$\.stand", "delete", "a perfect stand"),
        (r"\$\.stand\.\w+", "delete|none", "an error that the stand does not have"),
        (r"\$\.stand\.\w+(\[\d\])?", "sign|one|double|thousand|reverse|swap.*|number|null", FIGURE),
        (r"\$\.stand\.encoder_effects\[\d\]", "delete", FIGURE),
        (r"\$\.stand\.encoder_effects\[\d\]\.values(\[\d\])?", "sign|double|thousand|reverse|swap.*", FIGURE),
        (r"\$\.stand\.encoder_effects\[\d\]\.shape", "delete", "null without a shape"),
    ],
    "stand limits": [
        (r"\$\.description", "delete|.* text|empty", "any words"),
        (
            r"\$\.(settle_s|min_rest_s|minutes)",
            "delete|null|one|double|thousand|number",
            "a limit of its own",
        ),
        (r"\$\.axes(\[\d\])?", "null|reverse|swap.*|number", "any motor may be missing"),
        (r"\$\.axes\[\d\]\.\w+", "delete|null|double|thousand|number", "a limit of its own"),
        (r"\$\.axes\[\d\]\.range_deg\[\d\]", "double|thousand", "a limit of its own"),
        (r"\$\.forbidden_deg.*", "delete|none|twice|sign|double|thousand", "any zone without the start"),
    ],
    "truth": [
        (r"\$\.setup\.(seed|rate_hz|\w+_share|clock_\w+)", "one|double|thousand", SAMPLES),
        (r"\$\.has_temperature", "negate", SAMPLES),
    ],
}


def require_refused_or_alone(kind, document, load, left_out=r"(?!)"):
    """Each edit is refused by FormatError, whose message names a place that was edited, or is in ALONE.

    left_out   pattern of the places that are not edited
    """
    load(document)
    loaded, unnamed = [], []
    for edit in edits_of(document, left_out):
        try:
            load(edit.document)
        except imucal.FormatError as error:
            # A missing or wrong item may be reported by its list, a missing field by its object.
            places = re.sub(r"\[\d+\]|^\$\.", "", edit.path).split(".")
            message = re.sub(r"\[\d+\]", "", str(error))
            if places[-1] not in message and ".".join(places[:-1]) not in message:
                unnamed.append((edit.path, edit.what, str(error)))
        else:
            loaded.append((edit.path, edit.what))
    assert unnamed == []
    alone = [
        [place for place in loaded if re.fullmatch(where, place[0]) and re.fullmatch(what, place[1])]
        for where, what, _ in ALONE[kind]
    ]
    assert [place for place in loaded if not any(place in places for places in alone)] == []


def of_file(folder, read):
    """A function that reads a document by its file."""

    def load(document):
        path = folder / "edited.json"
        path.write_text(json.dumps(document))
        return read(path)

    return load


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A run, and a calibration with an effect and figures of a control recording."""
    place = tmp_path_factory.mktemp("edits")
    for seed in ("1", "2"):
        run = ["random", "--unit", "paper", "--seed", seed, "--moves", "20", "--rate-hz", "100"]
        assert main(["simulate", *run, "-o", f"{place}/run-{seed}.csv"]) == 0
    words = ["--control", f"{place}/run-2.csv", "--effect", "gyro_g_sensitivity", "--serial-number", "0042"]
    assert main(["calibrate", f"{place}/run-1.csv", *words, "-o", f"{place}/cal.json"]) == 0
    return place


def test_a_calibration(folder):
    document = json.loads((folder / "cal.json").read_text())
    assert document["control_set"] is not None and document["covariance"] is not None
    # All entries of a few rows of the covariance and of the table, which are 900 and 120 numbers.
    left_out = (
        r"\$\.covariance\.matrix\[(?!(0|13)\])\d+\](\[\d+\])?"
        r"|\$\.covariance\.matrix\[\d+\]\[([1-9]|1[^3]|2\d)\]"
        r"|\$\.(covariance\.names|parameters|effects\[0\]\.parameters)\[(?!(0|8|25)\])\d+\].*"
    )
    require_refused_or_alone("calibration", document, imucal.Calibration.from_dict, left_out)


@pytest.mark.parametrize("digits", [7, 9])
def test_a_calibration_rounded_by_hand_is_read(folder, tmp_path, digits):
    """Significant digits; a rounded matrix and a rounded table still agree."""

    def rounded(value):
        if isinstance(value, float):
            return float(f"{value:.{digits}g}")
        if isinstance(value, dict):
            return {key: rounded(item) for key, item in value.items()}
        return [rounded(item) for item in value] if isinstance(value, list) else value

    document = json.loads((folder / "cal.json").read_text())
    (tmp_path / "cal.json").write_text(json.dumps(rounded(document)))
    imucal.Calibration.load(tmp_path / "cal.json")
    # The matrices alone, with nine decimals: what a person copies into the file from a table.
    for sensor in ("accelerometer", "gyroscope"):
        rows = document[sensor]["T"]
        document[sensor]["T"] = [[round(number, 9) for number in row] for row in rows]
    (tmp_path / "cal.json").write_text(json.dumps(document))
    imucal.Calibration.load(tmp_path / "cal.json")


def test_a_calibration_that_contradicts_itself_is_not_saved(tmp_path):
    skew = imucal.Triad([[1, 0.05, 0], [0, 1, 0], [0, 0, 1]], [0, 0, 0])
    with pytest.raises(
        imucal.InputError, match=r"accelerometer\.T\[1\]\[0\] is 0\.0, but .*T\[0\]\[1\] is 0\.05"
    ):
        imucal.Calibration(skew, skew).save(tmp_path / "cal.json")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", imucal.unit_names())
def test_a_unit(name, tmp_path):
    document = json.loads((Path(imucal.__file__).parent / "rig" / "shipped" / f"{name}.json").read_text())
    require_refused_or_alone("unit", document, of_file(tmp_path, imucal.Unit.read))


def test_limits(tmp_path):
    document = {
        "schema": "imucal.limits/1",
        "description": "what the customer accepts",
        "parameters": {
            "gyro_bias_*": {"unit": "rad/s", "min": -0.05, "max": 0.05, "max_std": 1e-4},
            "accel_sensitivity_xx": {"unit": "1", "min": 0.97, "max": 1.03},
            "gyro_g_sensitivity_xx": {"unit": "rad/s/(m/s^2)", "min": -1e-4, "max": 2e-4},
        },
        "calibration_set": {"chi2_per_dof": {"max": 2.0}, "rests": {"min": 20}},
        "control_set": {"gravity_direction_rms_deg": {"max": 0.1}},
        "effects": ["gyro_g_sensitivity"],
    }
    require_refused_or_alone("limits", document, of_file(tmp_path, imucal.Limits.load))


def test_a_program(tmp_path):
    program = imucal.Program.random(seed=1, moves=2)
    imucal.Program(program.steps, imucal.Stand.cheap(1)).write(tmp_path / "program.json")
    document = json.loads((tmp_path / "program.json").read_text())
    require_refused_or_alone("program", document, of_file(tmp_path, imucal.Program.read))


def test_stand_limits(tmp_path):
    motor = {
        "max_rate_dps": 90,
        "max_acceleration_dps2": 300,
        "range_deg": [-180, 170],
        "cable_wrap_deg": None,
    }
    document = {
        "schema": "imucal.stand-limits/1",
        "description": "the stand in the cellar",
        "axes": [None, {**motor, "cable_wrap_deg": 400}, motor],
        "settle_s": 0.5,
        "min_rest_s": 2,
        "minutes": 30,
        "forbidden_deg": [{"axis_2": [80, 100], "axis_3": [-10, 20]}],
    }
    require_refused_or_alone("stand limits", document, of_file(tmp_path, imucal.StandLimits.read))


def test_a_truth(tmp_path):
    # Each edit that leaves the setup alone simulates the run, so the run is short.
    run = ["random", "--unit", "paper", "--seed", "1", "--moves", "3", "--rate-hz", "100"]
    outputs = ["-o", f"{tmp_path}/run.csv", "--truth", f"{tmp_path}/truth.json"]
    assert main(["simulate", *run, *outputs]) == 0
    document = json.loads((tmp_path / "truth.json").read_text())
    # The setup is a unit file, a program and effects, each with a test of its own.
    left_out = r"\$\.setup\.(motion|unit|temperature|effects|gravity).*|.*\[(7|13)\].*"
    require_refused_or_alone("truth", document, of_file(tmp_path, imucal.repeat), left_out)
