"""Recordings in which the search once named an effect that the unit does not have."""

import json

import numpy as np
import pytest

import imucal
from imucal.cli import main
from raw_text import module_of


def searched(capsys, tmp_path, *words):
    """The document and the output of `imucal gap`."""
    document = tmp_path / "gap.json"
    assert main(["gap", *map(str, words), "--json", str(document)]) in (0, 2)
    return json.loads(document.read_text()), "".join(capsys.readouterr())


def test_rounding_is_named_first_and_no_effect(case_file, capsys, tmp_path):
    """A linear unit whose readings are rounded: once "named: gyro_scale_asymmetry"."""
    paths = [case_file(name) for name in ("lsb-gap-names/gq4_1.csv", "lsb-gap-names/gq4_2.csv")]
    document, said = searched(capsys, tmp_path, paths[0], "--control", paths[1])
    assert document["verdict"] in ("unknown", "nothing_missing")
    assert document["effects"] == []
    assert "explains the gap" not in said
    # The means differ between the sessions by up to 0.024 deg/s. Rounding leaves 0.04 deg/s in each.
    assert "biases moved between sessions" not in said
    first, second = said.splitlines()[:2]
    assert first == f"verdict: {document['verdict']}"
    assert second.startswith("warning: gq4_1.csv: gyro_x has a step of 1 lsb and noise of 0.20 steps")
    assert "[noise_below_lsb]" in second


@pytest.mark.parametrize(
    ("name", "sensor"), [("lsb-gap-names/a8_1.csv", "accel"), ("lsb-gap-names/lsm2000.csv", "gyro")]
)
def test_rounding_is_no_random_walk(case_file, capsys, tmp_path, name, sensor):
    """Eight bits of an accelerometer were once called a random walk of its bias."""
    document, said = searched(capsys, tmp_path, case_file(name))
    assert document["verdict"] == "nothing_missing"
    assert document["effects"] == []
    assert f"{sensor}_x has a step of 1 lsb" in said and "[noise_below_lsb]" in said


def test_the_headline_says_what_its_figures_say(case_file, capsys, tmp_path):
    """Residuals 18 times the noise of which an effect explains 1 %: once "explains the gap"."""
    document, said = searched(capsys, tmp_path, case_file("gap_headline/log.csv"))
    assert said.splitlines()[0] == "verdict: unknown"
    assert document["verdict"] == "unknown"
    assert "18.2 x noise" in said
    assert "0 % of the gap closed" in said
    assert "gyro_g_sensitivity was selected but rejected" in said
    assert "explains the gap" not in said


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("lsb_per_dps", "noise_dps"), [(1 / 0.07, 0.012), (4, 0.0573)])
def test_no_effect_is_named_on_a_linear_unit_in_counts(case_file, lsb_per_dps, noise_dps, seed):
    """The pairs of tgap.py, of which it found an effect named in 5 of 10."""
    program = case_file("lsb-gap-names/tgap.py").read_text()
    assert str(noise_dps) in program
    sim = module_of(case_file("lsb-gap-names/sim.py"))
    bias = np.radians(np.random.default_rng(100 + seed).uniform(-1, 1, 3))
    pair = []
    for number, poses in ((1, 20), (2, 14)):
        both = 10 * seed + number
        time_s, attitude, rate = sim.motion(sim.randrots(poses, both), 3, 1.5, 100)
        force, rate = sim.sensor(
            sim.body(attitude),
            rate,
            Ta=sim.TA,
            ba=sim.BA,
            Tg=sim.TG,
            bg=bias,
            na=0.01,
            ng=np.radians(noise_dps),
            seed=both,
        )
        counts = np.rint(force * 2048 / sim.G), np.rint(np.degrees(rate) * lsb_per_dps)
        pair.append(imucal.Recording(time_s, *counts, accel_unit="lsb", gyro_unit="lsb"))
    result = imucal.find_gap(pair[0], control=pair[1])
    assert result.verdict in ("nothing_missing", "unknown")
    assert result.effects == ()
