"""`imucal.diff`: false alarms as rare as said, moves found, and pairs that cannot be compared refused."""

import dataclasses
import json

import numpy as np
import pytest
from scipy import stats

import imucal
from imucal.calibration.frame import in_frame
from imucal.cli import main

ACCELEROMETER = imucal.Triad(
    [[0.9804, 0.0012, 0.0055], [0.0012, 0.9727, 0.0043], [0.0055, 0.0043, 0.9921]], [-0.42, 0.24, 0.39]
)
GYROSCOPE = imucal.Triad(
    [[0.9771, 0.0097, -0.0060], [-0.0084, 1.0309, -0.0031], [0.0087, 0.0036, 1.0030]], [-0.035, 0.0042, 0.001]
)
EXACT = imucal.Calibration(ACCELEROMETER, GYROSCOPE)
NAMES = tuple(parameter.name for parameter in EXACT.parameters)
VALUES = np.array([parameter.value for parameter in EXACT.parameters])
SYMMETRIC = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def covariance(seed, size=21):
    """Correlated, with standard deviations of very different size."""
    random = np.random.default_rng(seed)
    mixing = np.eye(size) + 0.4 * random.normal(size=(size, size))
    std = 10.0 ** random.uniform(-6, -3, size)
    product = mixing @ mixing.T
    root = np.sqrt(np.diag(product))
    return product / np.outer(root, root) * np.outer(std, std)


def calibration(values, covariance, **options):
    """The calibration with these 21 parameters, in their order."""
    force = np.zeros((3, 3))
    for value, (i, j) in zip(values[3:9], SYMMETRIC, strict=True):
        force[i, j] = force[j, i] = value
    return imucal.Calibration(
        imucal.Triad(force, values[:3]),
        imucal.Triad(values[12:].reshape(3, 3), values[9:12]),
        covariance=covariance,
        covariance_names=NAMES,
        **options,
    )


COVARIANCES = covariance(1), covariance(2)
BEFORE = calibration(VALUES, COVARIANCES[0])


@pytest.mark.slow
def test_an_unmoved_unit_is_called_moved_as_rarely_as_said():
    random = np.random.default_rng(3)
    roots = [np.linalg.cholesky(c) for c in COVARIANCES]
    found = []
    for _ in range(600):
        pair = [
            calibration(VALUES + root @ random.normal(size=21), c)
            for root, c in zip(roots, COVARIANCES, strict=True)
        ]
        found.append(imucal.diff(*pair, sigmas=2.0))
    # 4.55 % at 2 sigma; the two tests see the same differences in part, so it may be somewhat less.
    alarms = sum(f.verdict == "moved" for f in found)
    rate = 2 * stats.norm.sf(2.0)
    assert found[0].false_alarm == pytest.approx(rate)
    low, high = stats.binom.ppf([1e-4, 1 - 1e-4], len(found), [0.7 * rate, rate])
    assert low <= alarms <= high
    assert stats.kstest([f.p_value for f in found], "uniform").pvalue > 1e-3
    sigmas = np.array([[c.sigmas for c in f.changes] for f in found])
    assert sigmas.std() == pytest.approx(1.0, abs=0.05)


def test_the_joint_statistic_is_that_of_scipy():
    after = calibration(VALUES + 1e-5 * np.arange(21), COVARIANCES[1])
    found = imucal.diff(BEFORE, after)
    change = 1e-5 * np.arange(21)
    expected = change @ np.linalg.solve(sum(COVARIANCES), change)
    assert found.chi2 == pytest.approx(expected, rel=1e-6)
    assert found.dof == 21
    assert found.p_value == pytest.approx(stats.chi2.sf(expected, 21), rel=1e-6)


@pytest.mark.parametrize("k", range(21))
def test_a_parameter_that_has_moved_is_named_with_its_sigmas(k):
    std = np.sqrt(COVARIANCES[0][k, k] + COVARIANCES[1][k, k])
    moved = VALUES.copy()
    moved[k] += 7.5 * std
    found = imucal.diff(BEFORE, calibration(moved, COVARIANCES[1]))
    assert [c.name for c in found.moved] == [NAMES[k]]
    assert found.changes[k].sigmas == pytest.approx(7.5, rel=1e-6)
    assert found.reasons[0].startswith(f"{NAMES[k]} has moved by ")
    assert "7.5 sigma (the limit is 4.00)" in found.reasons[0]


def test_a_move_that_no_parameter_shows_is_seen_by_all_of_them():
    # Along what both know best each parameter moves less than its own sigma.
    std = np.sqrt(np.diag(sum(COVARIANCES)))
    values, vectors = np.linalg.eigh(sum(COVARIANCES) / np.outer(std, std))
    change = 12 * np.sqrt(values[0]) * vectors[:, 0] * std
    found = imucal.diff(BEFORE, calibration(VALUES + change, COVARIANCES[1]))
    assert not found.moved
    assert found.verdict == "moved"
    assert found.chi2 == pytest.approx(144, rel=1e-6)
    assert found.reasons[0].startswith("all parameters jointly: chi2 is 144 with 21 degrees of freedom")


def effect(std, **options):
    """The unit with a g-sensitivity that is known to `std`."""
    values = np.linspace(-3e-4, 3e-4, 9)
    full = np.zeros((30, 30))
    full[:21, :21], full[21:, 21:] = COVARIANCES[1], std**2 * np.eye(9)
    known = calibration(VALUES, COVARIANCES[1], **options)
    with_effect = dataclasses.replace(
        known,
        effects=(imucal.EffectValues("gyro_g_sensitivity", values),),
        covariance=None,
        covariance_names=(),
    )
    names = tuple(parameter.name for parameter in with_effect.parameters)
    return dataclasses.replace(with_effect, covariance=full, covariance_names=names)


def test_an_effect_of_one_of_them_is_zero_in_the_other():
    found = imucal.diff(BEFORE, effect(1e-3))
    assert found.verdict == "same"
    assert len(found.changes) == 30
    assert found.notes == (
        "only the second calibration contains gyro_g_sensitivity: it counts as zero in the other calibration",
    )
    found = imucal.diff(effect(1e-5), BEFORE)
    assert {c.name for c in found.moved} == {
        f"gyro_g_sensitivity_{entry}" for entry in ("xx", "xy", "xz", "yx", "yz", "zx", "zy", "zz")
    }
    assert found.changes[21].after == 0.0 and found.changes[21].before == -3e-4


def test_a_time_constant_is_compared_where_both_have_one():
    def warm(tau, std, name="gyro_bias_warmup"):
        unit = dataclasses.replace(
            BEFORE,
            effects=(imucal.EffectValues(name, [1e-3, 0, 0], tau),),
            covariance=None,
            covariance_names=(),
        )
        full = np.zeros((25, 25))
        full[:21, :21], full[21:, 21:] = COVARIANCES[0], np.diag([1e-3] * 3 + [std]) ** 2
        names = tuple(parameter.name for parameter in unit.parameters)
        return dataclasses.replace(unit, covariance=full, covariance_names=names)

    assert [c.name for c in imucal.diff(warm(80.0, 1.0), warm(95.0, 1.0)).moved] == ["gyro_bias_warmup_tau"]
    assert "gyro_bias_warmup_tau" not in [c.name for c in imucal.diff(BEFORE, warm(80.0, 1.0)).changes]


COUNTS = imucal.Calibration(
    imucal.Triad(ACCELEROMETER.sensitivity * 418, [0, 0, 0]), GYROSCOPE, accel_unit="lsb"
)


def test_other_raw_units_are_refused():
    message = r"accelerometer is in m/s\^2 in the first and lsb in the second calibration: calibrate both"
    with pytest.raises(imucal.InputError, match=message):
        imucal.diff(BEFORE, COUNTS)


@pytest.mark.parametrize("moved", [False, True])
def test_another_frame_or_other_axes_make_no_difference(moved):
    """Calibrations of one unit in another frame, and with other axes, against one in the symmetric frame."""
    after = calibration(VALUES + 8 * np.sqrt(np.diag(sum(COVARIANCES))) * moved, COVARIANCES[1])
    expected = imucal.diff(BEFORE, after)
    frd = np.diag([1.0, -1.0, -1.0])
    signs = np.concatenate(([1, -1, -1], [1, 1, 1, -1, -1, 1], [1, -1, -1], [1, -1, -1, -1, 1, 1, -1, 1, 1]))
    in_frd = dataclasses.replace(
        calibration(signs * [p.value for p in after.parameters], np.outer(signs, signs) * COVARIANCES[1]),
        axes="frd",
    )
    np.testing.assert_allclose(
        in_frd.accelerometer.sensitivity, frd @ after.accelerometer.sensitivity @ frd, rtol=0, atol=1e-15
    )
    for other in (in_frame(after, "triangular"), in_frd):
        found = imucal.diff(BEFORE, other)
        assert found.verdict == expected.verdict == ("moved" if moved else "same")
        assert [c.name for c in found.changes] == [c.name for c in expected.changes]
        np.testing.assert_allclose(
            [c.sigmas for c in found.changes], [c.sigmas for c in expected.changes], rtol=1e-4, atol=1e-4
        )
        assert found.chi2 == pytest.approx(expected.chi2, rel=1e-4, abs=1e-4)
        assert "compared in the symmetric frame" in found.notes[0]


def imported(missing, **changes):
    return dataclasses.replace(
        EXACT,
        provenance=imucal.Provenance(imported=imucal.Imported("kalibr", "Kalibr", "f", missing=missing)),
        **changes,
    )


def test_a_calibration_without_standard_deviations_is_listed_and_not_judged(tmp_path, capsys):
    found = imucal.diff(BEFORE, imported(("accel_bias", "gyro_scale")))
    assert found.verdict == "unknown" and found.p_value is None and not found.moved
    names = [c.name for c in found.changes]
    assert "accel_bias_x" not in names and "gyro_sensitivity_xx" not in names
    assert "gyro_bias_x" in names and "gyro_sensitivity_xy" in names
    assert {c.std for c in found.changes} == {None} and {c.sigmas for c in found.changes} == {None}
    assert any("Kalibr, does not state accel_bias_x" in note for note in found.notes)
    assert any("no standard deviation of any parameter" in note for note in found.notes)
    BEFORE.save(tmp_path / "a.json")
    imported(("covariance",)).save(tmp_path / "b.json")
    document = tmp_path / "d.json"
    words = ["diff", str(tmp_path / "a.json"), str(tmp_path / "b.json"), "--json", str(document)]
    assert main(words) == 2
    assert "verdict: unknown; no parameter has a standard deviation" in capsys.readouterr().out
    found = json.loads(document.read_text())
    assert found["joint"] is None and found["parameters"][0]["std"] is None


def test_an_accelerometer_alone_is_compared_with_that_of_both_sensors():
    alone = dataclasses.replace(
        calibration(VALUES, COVARIANCES[1]),
        gyroscope=None,
        covariance=COVARIANCES[1][:9, :9],
        covariance_names=NAMES[:9],
    )
    for pair in ((BEFORE, alone), (alone, BEFORE)):
        found = imucal.diff(*pair)
        assert [c.name for c in found.changes] == list(NAMES[:9])
        assert (found.verdict, found.dof) == ("same", 9)
        assert any(
            "has no gyroscope, so only the accelerometers are compared" in note for note in found.notes
        )
    moved = calibration(VALUES + 8 * np.sqrt(np.diag(sum(COVARIANCES))), COVARIANCES[0])
    assert imucal.diff(moved, alone).verdict == "moved"


def test_parameters_with_a_standard_deviation_are_tested():
    """One that only one of them lacks is left out of the test, and the others are tested."""
    kept = [k for k in range(21) if NAMES[k] != "accel_bias_y"]
    partly = dataclasses.replace(
        calibration(VALUES, COVARIANCES[1]),
        covariance=COVARIANCES[1][np.ix_(kept, kept)],
        covariance_names=tuple(NAMES[k] for k in kept),
    )
    found = imucal.diff(BEFORE, partly)
    assert (found.verdict, found.dof) == ("same", 20)
    assert [c.name for c in found.changes if c.std is None] == ["accel_bias_y"]
    assert any("no standard deviation of accel_bias_y: listed" in note for note in found.notes)


def test_calibrations_that_are_exact_differ_by_nothing_that_chance_explains():
    exact = dataclasses.replace(BEFORE, covariance=np.zeros_like(BEFORE.covariance))
    difference = imucal.diff(exact, exact)
    assert (difference.chi2, difference.dof) == (0.0, 0)


def test_a_limit_that_is_none_is_refused():
    for sigmas in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(imucal.InputError, match="sigmas is"):
            imucal.diff(BEFORE, BEFORE, sigmas=sigmas)


def test_what_the_pair_has_in_common_is_noted():
    source = imucal.Source("run.csv", "5e" * 32)
    one = dataclasses.replace(BEFORE, provenance=imucal.Provenance(files=(source,)), serial_number="41")
    two = dataclasses.replace(one, serial_number="42", gravity_mps2=9.81)
    notes = imucal.diff(one, two).notes
    assert notes[0] == "the serial numbers differ: 41 and 42"
    assert notes[1].startswith("gravity was 9.80665 and 9.81 m/s^2")
    assert notes[2].startswith("both were made of run.csv")


def test_the_command_ends_with_0_for_the_same_and_2_for_moved(tmp_path, capsys):
    """Two runs of one unit, and one of it after a knock that has moved its accelerometer's bias by 5 mg."""
    program = imucal.Program.random(seed=4, moves=15)
    paper = imucal.Unit.named("paper")
    bias = paper.accelerometer.bias + np.array([0.05, 0, 0])
    knocked = dataclasses.replace(paper, accelerometer=dataclasses.replace(paper.accelerometer, bias=bias))
    for name, unit, seed in (("may", paper, 11), ("june", paper, 12), ("july", knocked, 13)):
        run = imucal.simulate(program, unit=unit, rate_hz=100, seed=seed)
        imucal.calibrate(run.recording).calibration.save(tmp_path / f"{name}.json")
    files = [str(tmp_path / f"{name}.json") for name in ("may", "june", "july")]
    assert main(["diff", *files[:2], "--json", str(tmp_path / "same.json")]) == 0
    assert "verdict: same" in capsys.readouterr().out
    assert main(["diff", files[0], files[2], "--json", str(tmp_path / "moved.json")]) == 2
    out = capsys.readouterr().out
    assert "verdict: moved; accel_bias_x has moved by 0.0" in out
    (line,) = (line for line in out.splitlines() if line.startswith("accel_bias_x"))
    assert line.rstrip().endswith("MOVED")
    document = json.loads((tmp_path / "moved.json").read_text())
    (moved,) = (p for p in document["parameters"] if p["moved"])
    assert moved["name"] == "accel_bias_x"
    assert moved["difference"] == pytest.approx(0.05, abs=5 * moved["std"])
    assert json.loads((tmp_path / "same.json").read_text())["joint"]["degrees_of_freedom"] == 21
    assert main(["diff", files[0], files[2], "--sigmas", "0"]) == 1
    assert "sigmas is 0.0" in capsys.readouterr().err
