"""The commands that judge a store: tables, documents, CSV and exit codes."""

import csv
import hashlib
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import imucal
from imucal.cli import main
from planted_fleet import planted_fleet
from stored_fleet import stored


@pytest.fixture(scope="module")
def planted():
    return planted_fleet(seed=1, units=300, dates=2, drifting=6, odd=2, shift=3.0, drift_per_month=4.0)


@pytest.fixture(scope="module")
def store(planted, tmp_path_factory):
    path = tmp_path_factory.mktemp("store") / "units.sqlite"
    stored(path, planted.measurements)
    return path


def run(tmp_path, *words):
    """Exit code, document and rows of the CSV file of a command."""
    code = main(
        ["fleet", *map(str, words), "--json", str(tmp_path / "out.json"), "--csv", str(tmp_path / "out.csv")]
    )
    with (tmp_path / "out.csv").open() as file:
        rows = list(csv.DictReader(file))
    return code, json.loads((tmp_path / "out.json").read_text()), rows


def test_a_store_gives_back_its_measurements(planted, store):
    found = imucal.Fleet(store).measurements(covariances=True)
    assert len(found) == len(planted.measurements)
    # In order of their dates and serial numbers.
    order = np.lexsort((planted.measurements.serials, planted.measurements.dates))
    assert np.array_equal(
        found.values_si[:, found.names.index("gyro_bias_x")], planted.measurements.values_si[order, 0]
    )


def test_drift(planted, store, tmp_path, capsys):
    code, document, rows = run(tmp_path, "drift", store, "--all")
    assert code == 2 and document["verdict"] == "poor" and document["schema"] == "imucal.fleet-drift/1"
    assert {row["serial number"] for row in rows} == planted.drifting
    assert {row["parameter"] for row in rows} == {"accel_bias_x"}
    text = capsys.readouterr().out
    assert "station A on 2026-01-10 is shifted: gyro_bias_z" in text
    assert "verdict: poor; 6 of 300 units drift" in text
    serial = min(planted.drifting)
    code, document, rows = run(tmp_path, "drift", store, serial)
    assert code == 2 and len(rows) == 6
    assert "degrees of freedom" in capsys.readouterr().out
    assert main(["fleet", "drift", str(store)]) == 1
    assert "give the serial number of one unit, or --all" in capsys.readouterr().err


def test_a_quiet_unit_among_all(planted, store, tmp_path):
    quiet = next(s for s in planted.measurements.serials if s not in planted.drifting)
    code, document, _ = run(tmp_path, "drift", store, quiet)
    assert code == 0 and document["verdict"] == "good"


def test_spc(store, tmp_path, capsys):
    code, document, rows = run(tmp_path, "spc", store)
    assert code == 2
    assert [(s["station"], s["day"]) for s in document["shifts"]] == [("A", "2026-01-10")]
    assert {row["station"] for row in rows} == {"A", "B"}
    assert "verdict: poor; 1 shift of a station" in capsys.readouterr().out
    code, document, _ = run(tmp_path, "spc", store, "--station", "B")
    assert code == 0 and {chart["station"] for chart in document["charts"]} == {"B"}


def test_outliers(planted, store, tmp_path):
    code, document, rows = run(tmp_path, "outliers", store)
    assert code == 2
    assert {unit["serial"] for unit in document["units"] if unit["is_odd"]} == planted.odd
    assert {row["serial number"] for row in rows[:2]} == planted.odd
    assert len(rows) == 300


def test_capability(store, tmp_path, capsys):
    limits = imucal.Limits((imucal.ParameterLimit("gyro_bias_*", "rad/s", -0.008, 0.008),))
    limits.save(tmp_path / "limits.json")
    words = ("capability", store, "--limits", tmp_path / "limits.json", "-o", tmp_path / "proposed.json")
    code, document, rows = run(tmp_path, *words)
    printed = capsys.readouterr().out
    assert code == 2 and "3 of 3 indices Ppk are below 1" in printed
    row = next(row for row in document["rows"] if row["name"] == "gyro_bias_x")
    # The printed table has the units of datasheets; the CSV file and the document have SI units.
    cells = next(line.split() for line in printed.splitlines() if line.startswith("gyro_bias_x"))
    assert cells[-1] == "deg/s"
    assert float(cells[2]) == pytest.approx(np.degrees(row["spread"]["spread"]), rel=1e-3)
    assert row["indices"]["ppk"]["low"] < row["indices"]["ppk"]["value"] < 1.0
    assert (
        float(next(r for r in rows if r["parameter"] == "gyro_bias_x")["out_true"]) == row["out_true"] > 0.05
    )
    assert len(imucal.Limits.load(tmp_path / "proposed.json").parameters) == 6
    code, document, _ = run(tmp_path, "capability", store)
    assert code == 0 and all(row["indices"] is None for row in document["rows"])


def test_grr(tmp_path, capsys):
    units, operators, repeats = 6, 2, 3
    base = planted_fleet(seed=2, units=units * operators * repeats, dates=1, drifting=0, odd=0).measurements
    unit, operator = np.repeat(np.arange(units), operators * repeats), np.tile([0, 1], units * repeats)
    random = np.random.default_rng(2)
    values = np.linspace(-1, 1, units)[unit, None] * 10 * base.sigmas_si + base.sigmas_si * random.normal(
        size=base.values_si.shape
    )
    study = replace(
        base,
        serials=np.array([f"U{k}" for k in unit]),
        operators=np.array(["ann", "bob"])[operator],
        roles=np.full(len(base), "grr"),
        values_si=values,
    )
    stored(tmp_path / "units.sqlite", study)
    code, document, rows = run(tmp_path, "grr", tmp_path / "units.sqlite", "--role", "grr")
    assert code == 0
    assert (document["units"], document["operators"], document["repeats"]) == (6, 2, 3)
    assert len(rows) == 6 and all(int(row["ndc"]) >= 5 for row in rows)
    assert all(0.5 < float(row["repeatability / stated"]) < 1.6 for row in rows)
    printed = capsys.readouterr().out
    assert "6 units x 2 operators x 3 repeats" in printed
    cells = next(line.split() for line in printed.splitlines() if line.startswith("gyro_bias_x"))
    bias = next(row for row in rows if row["parameter"] == "gyro_bias_x")
    assert cells[-1] == "deg/s"
    assert float(cells[1]) == pytest.approx(np.degrees(float(bias["repeatability"])), rel=1e-3)
    assert main(["fleet", "grr", str(tmp_path / "units.sqlite"), "--by", "station"]) in (0, 1, 2)


@pytest.mark.slow
def test_gap(tmp_path, capsys):
    """Twelve units with an effect of one sigma each: no unit shows it, all together do."""
    program = imucal.Program.random(seed=3, moves=24, hold_s=3.0)
    for unit in range(12):
        effect = {"gyro_g_sensitivity": [7e-6] * 9}
        simulation = imucal.simulate(program, effects=effect, seed=unit, rate_hz=100.0)
        imucal.write(simulation.recording, tmp_path / f"unit-{unit}.parquet")
    store = tmp_path / "units.sqlite"
    imucal.Fleet(store).run([tmp_path / f"unit-{unit}.parquet" for unit in range(12)], workers=1)
    names = ("gyro_g_sensitivity", "accel_scale_cubic", "gyro_bias_drift")
    effects = [word for name in names for word in ("--effect", name)]
    code, document, rows = run(tmp_path, "gap", store, *effects, "--workers", 2)
    assert code == 0 and document["verdict"] == "named"
    (found,) = document["effects"]
    assert found["name"] == "gyro_g_sensitivity" and found["alone"] == 0 and found["units"] == 12
    for row in rows:
        assert float(row["mean"]) == pytest.approx(7e-6, abs=5 * float(row["1 sigma"]))
    printed = capsys.readouterr().out
    assert "gyro_g_sensitivity: significant over 12 units together, in 0 units alone" in printed


@pytest.mark.slow
def test_certificate_as_pdf(store, tmp_path, capsys, monkeypatch):
    page = tmp_path / "unit.pdf"
    words = ["fleet", "certificate", str(store), "U00000", "-o", str(page)]
    if shutil.which("chromium") or shutil.which("google-chrome"):
        assert main(words) == 0
        assert page.read_bytes().startswith(b"%PDF-")
        page.unlink()
    monkeypatch.setenv("PATH", str(tmp_path))
    assert main(words) == 1
    assert "write unit.html, open it, and choose Print > Save as PDF" in capsys.readouterr().err
    assert not page.exists()


def test_report_and_certificate(store, tmp_path, capsys):
    assert main(["fleet", "report", str(store), "-o", str(tmp_path / "fleet.html")]) == 0
    assert f"page written to {tmp_path / 'fleet.html'}" in capsys.readouterr().out
    assert (tmp_path / "fleet.html").stat().st_size < 5e6
    words = ["fleet", "certificate", str(store), "U00000", "-o", str(tmp_path / "unit.html")]
    assert main([*words, "--json", str(tmp_path / "unit.json")]) == 0
    digest = json.loads((tmp_path / "unit.json").read_text())["sha256"]
    page = (tmp_path / "unit.html").read_text()
    assert digest in page and "Unit U00000" in page and "batch" in page
    # The limits that decide the verdict are identified like the recordings.
    limits = tmp_path / "limits.json"
    imucal.Limits((imucal.ParameterLimit("gyro_bias_*", "rad/s", -1.0, 1.0),)).save(limits)
    assert main([*words, "--limits", str(limits)]) == 0
    page = (tmp_path / "unit.html").read_text()
    assert "limits.json" in page and hashlib.sha256(limits.read_bytes()).hexdigest() in page
    assert main(["fleet", "certificate", str(store), "nobody", "-o", str(tmp_path / "none.html")]) == 1
    assert "no calibration of unit 'nobody'" in capsys.readouterr().err


def test_the_program_of_the_page_writes_a_calibration_and_a_c_header_of_each_unit(
    planted, store, tmp_path, monkeypatch
):
    page = (Path(__file__).resolve().parents[2] / "docs/fleet.md").read_text(encoding="utf-8")
    section = page.partition("## A calibration or a C header of each unit\n")[2].partition("\n## ")[0]
    (program,) = re.findall(r"^```python\n(.*?)^```$", section, re.MULTILINE | re.DOTALL)
    shutil.copy(store, tmp_path / "units.sqlite")
    monkeypatch.chdir(tmp_path)
    exec(program)
    serials = set(planted.measurements.serials)
    assert {path.stem for path in tmp_path.glob("*.json")} == serials
    assert {path.stem for path in tmp_path.glob("*.h")} == serials


def test_an_output_does_not_overwrite_the_store(store, capsys):
    assert main(["fleet", "outliers", str(store), "--csv", str(store)]) == 1
    assert "would overwrite a file that this command reads" in capsys.readouterr().err
