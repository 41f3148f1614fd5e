"""A document that was edited by hand in one place is refused, or the test says why that place stands alone.

Every number, text, name and order of a document of each kind is changed, one at a time (hand_edits.py).
"""

import json
import re

import pytest

import imucal
from hand_edits import edits_of
from imucal.cli import main

REPORT = "a figure of the run; the file has nothing to compute it from"
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
        (r"\$\.serial_number", "other text|null", "any name"),
        (r"\$\.reference_temperature_degc", "delete", "older files have none"),
    ],
}


def require_refused_or_alone(kind, document, load, edits=None):
    """Each edit is refused by FormatError, whose message names a place that was edited, or is in ALONE."""
    load(document)
    loaded, unnamed = [], []
    for edit in edits or edits_of(document):
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


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A run with its truth, and a calibration with an effect and figures of a control recording."""
    place = tmp_path_factory.mktemp("edits")
    for seed in ("1", "2"):
        run = ["random", "--unit", "paper", "--seed", seed, "--moves", "20", "--rate-hz", "100"]
        truth = ["--truth", f"{place}/truth-{seed}.json"]
        assert main(["simulate", *run, "-o", f"{place}/run-{seed}.csv", *truth]) == 0
    words = ["--control", f"{place}/run-2.csv", "--effect", "gyro_g_sensitivity", "--serial-number", "0042"]
    assert main(["calibrate", f"{place}/run-1.csv", *words, "-o", f"{place}/cal.json"]) == 0
    return place


def test_a_calibration(folder):
    document = json.loads((folder / "cal.json").read_text())
    assert document["control_set"] is not None and document["covariance"] is not None
    # All entries of a few rows of the covariance and of the table, which are 900 and 120 numbers.
    left_out = re.compile(
        r"\$\.covariance\.matrix\[(?!(0|13)\])\d+\](\[\d+\])?"
        r"|\$\.covariance\.matrix\[\d+\]\[([1-9]|1[^3]|2\d)\]"
        r"|\$\.(covariance\.names|parameters|effects\[0\]\.parameters)\[(?!(0|8|25)\])\d+\].*"
    )
    edits = [edit for edit in edits_of(document) if not left_out.fullmatch(edit.path)]
    require_refused_or_alone("calibration", document, imucal.Calibration.from_dict, edits)


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
