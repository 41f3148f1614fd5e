"""Noise of a unit at rest: Allan deviations as another program has them, figures as they were simulated.

The files of noise figures are made by functions (`kalibr_yaml`, `unit_of_noise`), because the command has no
recording in memory.
"""

import dataclasses
import json
import re

import allantools
import numpy as np
import pytest
import yaml

import imucal
from imucal.cli import main
from imucal.noise_analysis.files import kalibr_yaml, unit_of_noise
from imucal.plot import allan

RATE_HZ = 100.0
DENSITY, INSTABILITY, WALK = 1e-3, 5e-4, 1e-4
LSB = 2.0**-12


def still(duration_s=1200.0, seed=1, lsb=None, density=DENSITY, instability=INSTABILITY, walk=WALK):
    bits = None if lsb is None else 24
    sensor = imucal.Sensor(
        noise_density=density,
        bias_instability=instability,
        random_walk=np.full(3, walk),
        lsb=lsb,
        bits=bits,
    )
    unit = imucal.Unit(sensor, sensor)
    return imucal.simulate(imucal.Static(duration_s), unit=unit, rate_hz=RATE_HZ, seed=seed).recording


@pytest.fixture(scope="module")
def recording():
    return still()


@pytest.fixture(scope="module")
def found(recording):
    return imucal.noise(recording)


def replaced(recording, rows=slice(None), **columns):
    values = {name: getattr(recording, name)[rows] for name in ("time_s", "specific_force", "angular_rate")}
    return imucal.Recording(**{**values, **columns}, name="changed")


# --- Allan deviations


def series(kind, n):
    white = np.random.default_rng(4).standard_normal(n)
    return {"white": white, "walk": np.cumsum(white), "biased": 9.80665 + 1e-3 * white}[kind]


@pytest.mark.parametrize("kind", ["white", "walk", "biased"])
@pytest.mark.parametrize("taus", ["octave", "decade"])
def test_deviations_are_those_of_allantools(kind, taus):
    values = series(kind, 200_001)
    expected_taus, expected, _, _ = allantools.oadev(values, rate=RATE_HZ, data_type="freq", taus=taus)
    for threads in (1, 2):
        found_taus, deviations = imucal.allan_deviation(values, RATE_HZ, taus, threads=threads)
        np.testing.assert_allclose(found_taus, expected_taus, rtol=1e-12)
        np.testing.assert_allclose(deviations, expected, rtol=1e-10)


@pytest.mark.slow
def test_deviations_at_given_times_are_those_of_allantools():
    values = series("white", 3_000_000)
    wanted = np.unique(np.round(np.geomspace(1, 1e6, 30))) / RATE_HZ
    _, expected, _, _ = allantools.oadev(values, rate=RATE_HZ, data_type="freq", taus=wanted)
    _, deviations = imucal.allan_deviation(values, RATE_HZ, wanted)
    np.testing.assert_allclose(deviations, expected, rtol=1e-10)


def test_deviations_of_a_recording_are_those_of_allantools(recording, found):
    for sensor, rows in (("accel", recording.specific_force), ("gyro", recording.angular_rate)):
        for k, axis in enumerate(found.triad(sensor)):
            # A rest is whole blocks: the recording may be a few samples longer.
            values = rows[: found.samples, k]
            _, expected, _, _ = allantools.oadev(values, rate=RATE_HZ, data_type="freq", taus=axis.taus_s)
            np.testing.assert_allclose(axis.deviations, expected, rtol=1e-10)


def test_any_memory_order_and_type_gives_the_same(recording):
    rows = recording.angular_rate
    taus, expected = imucal.allan_deviation(rows[:, 1].copy(), RATE_HZ)
    assert imucal.allan_deviation(rows, RATE_HZ)[1][:, 1].tolist() == expected.tolist()
    assert imucal.allan_deviation(rows[:, 1], RATE_HZ)[1].tolist() == expected.tolist()
    assert imucal.allan_deviation(np.asfortranarray(rows), RATE_HZ)[1][:, 1].tolist() == expected.tolist()
    assert imucal.allan_deviation(rows[::-1][:, 1], RATE_HZ)[1].shape == taus.shape
    np.testing.assert_allclose(
        imucal.allan_deviation(rows[:, 1].astype(np.float32), RATE_HZ)[1], expected, rtol=1e-4
    )
    assert imucal.allan_deviation([1, 2, 4], 1.0)[1] == [np.sqrt(1.25)]
    assert imucal.allan_deviation([], 1.0)[1].shape == (0,)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([1.0, np.nan, 2.0], 1.0), "value 1 is not finite"),
        ((["a"], 1.0), "cannot be made an array"),
        ((np.zeros((2, 2, 2)), 1.0), "give \\(N,\\) or \\(N, C\\)"),
        (([1.0, 2.0], 0.0), "rate_hz is 0"),
        (([1.0, 2.0], 1.0, [2.0]), "average of 2 samples"),
        (([1.0, 2.0], 1.0, [1e20]), "average of 3 samples"),
        ((np.zeros((3, 0)), 1.0), "give \\(N,\\) or \\(N, C\\)"),
        (([1.0, 2.0], 1.0, [0.1]), "average of 0 samples"),
        (([1.0, 2.0], 1.0, [np.nan]), "finite averaging times"),
        (([1.0, 2.0], 1.0, "all"), "give octave, decade"),
    ],
)
def test_bad_series_are_refused(arguments, message):
    with pytest.raises(imucal.InputError, match=message):
        imucal.allan_deviation(*arguments)


@pytest.mark.parametrize("threads", [0, -1, 2.0, True, "2", float("nan")])
def test_no_number_of_threads_is_refused(threads, recording):
    with pytest.raises(imucal.InputError, match=r"threads is .*: a whole number, one or more"):
        imucal.allan_deviation([1.0, 2.0], 1.0, threads=threads)
    with pytest.raises(imucal.InputError, match=r"threads is .*: a whole number, one or more"):
        imucal.noise(recording, threads=threads)


# --- figures


def test_bands_hold_the_truth():
    """Eighteen axes, three figures: 54 bands of 95 %. Fewer than 46 hold one time in 1000."""
    inside = 0
    for seed in (2, 3, 4):
        for axis in imucal.noise(still(seed=seed)).axes.values():
            truths = (
                (axis.noise_density, DENSITY),
                (axis.bias_instability, INSTABILITY),
                (axis.random_walk, WALK),
            )
            for figure, truth in truths:
                inside += figure.low <= truth <= figure.high
                if figure.value is not None:
                    assert abs(figure.value - truth) < 4.5 * figure.std
    assert inside >= 46


@pytest.mark.slow
def test_bands_of_the_deviations_hold_the_true_ones():
    """White noise, a thousand points by and large; neighbours hang together, so the share is taken widely."""
    inside = []
    for seed in range(5, 15):
        for axis in imucal.noise(still(duration_s=300.0, seed=seed, instability=0.0, walk=0.0)).axes.values():
            true = DENSITY / np.sqrt(axis.taus_s)
            inside += ((axis.low <= true) & (true <= axis.high)).tolist()
    assert 0.92 < np.mean(inside) < 0.98


def test_quantisation_of_increments_is_found():
    steps = np.random.default_rng(1).standard_normal((120_001, 3))
    q, density = 2e-4, 1e-3
    white = np.random.default_rng(2).standard_normal((120_000, 3)) * density * np.sqrt(RATE_HZ)
    rate = white + q * RATE_HZ * np.diff(steps, axis=0)
    time = np.arange(120_000) / RATE_HZ
    force = np.random.default_rng(3).standard_normal((120_000, 3)) * 1e-2 + [0, 0, 9.80665]
    for axis in imucal.noise(imucal.Recording(time, force, rate)).triad("gyro"):
        for figure, truth in ((axis.quantisation, q), (axis.noise_density, density)):
            assert abs(figure.value - truth) < 4.5 * figure.std
            assert figure.std < 0.02 * truth
        assert axis.quantisation.unit == "rad/s s"


def test_filtered_noise_is_fitted_where_the_filter_leaves_it():
    sensor = imucal.Sensor(noise_density=DENSITY, filter_hz=10.0)
    run = imucal.simulate(imucal.Static(1200.0), unit=imucal.Unit(sensor, sensor), rate_hz=RATE_HZ, seed=1)
    found = imucal.noise(run.recording)
    for axis in found.axes.values():
        assert axis.shortest_period_s > 0.5
        assert abs(axis.misfit) < 5
        figure = axis.noise_density
        assert figure.value == pytest.approx(DENSITY, abs=4.0 * figure.std)
        assert figure.std < 0.03 * DENSITY


def test_a_coarse_converter_gives_a_bound():
    found = imucal.noise(still(lsb=3.0 * DENSITY * np.sqrt(RATE_HZ), instability=0.0, walk=0.0))
    finding = next(f for f in found.findings if f.code == "noise_below_lsb")
    assert "one count over sqrt(12)" in str(finding)
    assert (found.verdict, len(found.reasons)) == ("poor", 1)
    for axis in found.axes.values():
        assert axis.is_below_lsb
        assert axis.noise_density.value is None
        assert axis.noise_density.high > axis.lsb / np.sqrt(12 * RATE_HZ)


def test_a_constant_has_no_bound(recording):
    rate, force = np.full((len(recording), 3), 1e-3), np.full((len(recording), 3), 5.66)
    constant = replaced(recording, angular_rate=rate, specific_force=force)
    found = imucal.noise(constant)
    axis = found.axes["gyro_y"]
    assert (axis.lsb, axis.is_below_lsb, axis.noise_density.high) == (0.0, True, np.inf)
    assert "gyro_y noise_density not known" in found.summary()
    assert found.to_dict()["axes"]["gyro_y"]["noise_density"]["high"] is None
    with pytest.raises(imucal.InputError, match="constant"):
        kalibr_yaml(found)


def test_the_summary_and_the_document_say_all(found):
    text = found.summary()
    assert "gyro_z random_walk" in text
    assert "m/s^2/s/sqrt(Hz)" in text
    document = json.loads(json.dumps(found.to_dict()))
    axis = document["axes"]["accel_x"]
    assert document["schema"] == "imucal.noise/1"
    assert axis["noise_density"]["value"] == found.axes["accel_x"].noise_density.value
    assert len(axis["deviations"]) == len(axis["low"]) == len(axis["taus_s"]) > 12


# --- recordings that will not do


def codes(found):
    return [finding.code for finding in found.findings]


def test_faults_are_named(recording):
    force = recording.specific_force.copy()
    force[700, 1] = np.nan
    cases = {
        "non_finite": replaced(recording, specific_force=force),
        "empty": imucal.Recording([], np.zeros((0, 3)), np.zeros((0, 3))),
    }
    for code, bad in cases.items():
        with pytest.raises(imucal.InputError, match=code):
            imucal.noise(bad)


def test_the_longest_stretch_without_lost_or_repeated_samples_is_used(recording):
    n = len(recording)
    lost = replaced(recording, np.r_[0:5000, 5200:n])
    repeated = np.r_[0:5000, np.repeat(np.arange(5000, 5200), 2), 5200 : n - 200]
    for changed, start_s, code in (
        (lost, 52.0, "samples_missing"),
        (replaced(recording, repeated, time_s=recording.time_s), 54.0, "samples_duplicated"),
    ):
        found = imucal.noise(changed)
        assert found.start_s == pytest.approx(start_s, abs=0.1)
        assert found.end_s == pytest.approx(recording.time_s[-1], abs=0.1)
        assert {"recording_interrupted", code} <= set(codes(found))
        assert found.verdict == "good"
    # A few lost samples in a long recording change nothing.
    few = imucal.noise(replaced(recording, np.delete(np.arange(n), [30_000, 90_000])))
    assert few.samples == pytest.approx(n - 2, abs=20)
    assert "recording_interrupted" not in codes(few)


def test_a_stretch_that_is_too_short_is_refused(recording):
    keep = np.delete(np.arange(6000), np.arange(500, 6000, 500))
    with pytest.raises(imucal.InputError, match=r"longest part without lost .* 1000 are needed"):
        imucal.noise(replaced(recording, keep))


def test_late_samples_are_not_missing(recording):
    late = recording.time_s.copy()
    late[700::900] += 0.8 / RATE_HZ
    found = imucal.noise(replaced(recording, time_s=late))
    assert found.samples == pytest.approx(len(recording), abs=20)
    assert not {"samples_missing", "recording_interrupted"} & set(codes(found))


# --- steps and drifts


def shifted(recording, shift):
    """The recording with a change of the mean of accelerometer y and gyroscope x, rad/s and m/s^2."""
    force, rate = recording.specific_force.copy(), recording.angular_rate.copy()
    force[:, 1] += shift
    rate[:, 0] -= shift
    return replaced(recording, specific_force=force, angular_rate=rate)


@pytest.fixture(scope="module")
def quiet():
    return still(duration_s=400.0, seed=3, instability=0.0, walk=1e-5)


def test_a_step_is_reported_and_cut_on_request(quiet):
    bumped = shifted(quiet, 4e-3 * (quiet.time_s > 251.3))
    found = imucal.noise(bumped)
    assert (found.verdict, codes(found)[0]) == ("poor", "step")
    [step] = found.steps
    assert step.time_s == pytest.approx(251.3, abs=1.0)
    assert set(step.sizes) == {"accel_y", "gyro_x"}
    for name, sign in (("accel_y", 1.0), ("gyro_x", -1.0)):
        assert step.sizes[name].size == pytest.approx(sign * 4e-3, abs=4.5 * step.sizes[name].std)
    assert "accel_y 0.4" in found.summary()
    cut = imucal.noise(bumped, cut_steps=True)
    assert (cut.verdict, cut.steps, len(cut.cut_steps)) == ("good", (), 1)
    assert cut.end_s < 251.3
    assert json.loads(json.dumps(cut.to_dict()))["cut_steps"][0]["sizes"]["gyro_x"]["size"] < 0
    for axis in ("accel_y", "gyro_x"):
        walks = [result.axes[axis].random_walk for result in (found, cut)]
        assert walks[0].value > 5e-5
        assert walks[1].low <= 1e-5 <= walks[1].high


def test_standard_deviations_of_a_step_and_of_a_drift_are_those_of_least_squares():
    """The noise is estimated from 1024 means. With this seed the estimate agrees with the truth to 2 %."""
    white = still(duration_s=200.0, seed=8, instability=0.0, walk=0.0)
    count = len(white)
    rate = white.angular_rate.copy()
    rate[8000:, 0] += 4e-3
    rate[:, 1] += 1e-2 * np.arange(count) / count
    found = imucal.noise(replaced(white, angular_rate=rate))
    [step], [drift] = found.steps, found.drifts
    assert (set(step.sizes), drift.axis) == ({"gyro_x"}, "gyro_y")
    of_sample = DENSITY * np.sqrt(RATE_HZ)
    of_step = of_sample * np.sqrt(1 / step.sample + 1 / (count - step.sample))
    assert step.sizes["gyro_x"].std == pytest.approx(of_step, rel=0.03)
    assert drift.size.std == pytest.approx(of_sample * np.sqrt(12 / count), rel=0.03)


def test_noise_and_warming_up_are_no_steps(quiet, recording):
    assert not imucal.noise(quiet).steps
    wandering = imucal.noise(recording)
    assert not wandering.steps
    assert not wandering.drifts
    warm = imucal.noise(shifted(quiet, 2e-2 * (1.0 - np.exp(-quiet.time_s / 120.0))))
    assert not warm.steps
    assert {"accel_y", "gyro_x"} <= {drift.axis for drift in warm.drifts}
    assert "drift" in codes(warm)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "most_wrong"),
    [("white", 0), ("flicker", 0), ("walk", 0), ("strong walk", 0), ("step", 0), ("heating", 1)],
)
def test_confusion_of_noise_steps_and_heating(kind, most_wrong):
    """Six runs of each kind; `make accuracy` counts many more (docs/results/noise.md)."""
    noise = {"flicker": (3e-4, 0.0), "walk": (0.0, 1e-4), "strong walk": (0.0, 1e-3), "step": (0.0, 2e-5)}
    instability, walk = noise.get(kind, (0.0, 0.0))
    wrong = 0
    for seed in range(100, 106):
        run = still(duration_s=300.0, seed=seed, instability=instability, walk=walk)
        at_s = 30.0 + 240.0 * np.random.default_rng(seed).random()
        shape = {
            "step": 5e-3 * (run.time_s > at_s),
            "heating": 1e-2 * (1.0 - np.exp(-run.time_s / at_s)),
        }
        found = imucal.noise(shifted(run, shape.get(kind, 0.0 * run.time_s)))
        expected = {"step": (True, False), "heating": (False, True)}.get(kind, (False, False))
        wrong += (bool(found.steps), bool(found.drifts)) != expected
        wrong += kind == "step" and len(found.steps) == 1 and abs(found.steps[0].time_s - at_s) > 2.0
    assert wrong <= most_wrong


# --- figures that no sensor has


def test_degrees_read_as_radians_are_named_with_their_count():
    count = 1.0 / 131.0
    rng = np.random.default_rng(5)
    degrees = np.round(0.05 * rng.standard_normal((6000, 3)) / count) * count
    force = 0.02 * rng.standard_normal((6000, 3)) + [0, 0, 9.81]
    time_s = np.arange(6000) / RATE_HZ
    wrong = imucal.noise(imucal.Recording(time_s, force, degrees))
    finding = next(f for f in wrong.findings if f.code == "noise_implausible")
    assert finding.columns == ("gyro_x", "gyro_y", "gyro_z")
    assert "gyro_x_dps" in finding.way_out
    assert "1/131" in finding.way_out
    assert "noise_implausible" in codes(imucal.inspect(imucal.Recording(time_s, force, degrees)))
    right = imucal.Recording(time_s, force, np.deg2rad(degrees))
    assert "noise_implausible" not in codes(imucal.noise(right))
    assert "noise_implausible" not in codes(imucal.inspect(right))


@pytest.mark.parametrize(
    ("shaken_mps2", "says"), [(1.05, "never rests$"), (0.4, "gyro_x_dps.*; or, .* never rests$")]
)
def test_a_unit_that_never_rests_is_not_called_a_wrong_unit(shaken_mps2, says):
    rng = np.random.default_rng(6)
    force = shaken_mps2 * rng.standard_normal((6000, 3)) + [0, 0, 9.81]
    rate = 0.3 * rng.standard_normal((6000, 3))
    found = imucal.noise(imucal.Recording(np.arange(6000) / RATE_HZ, force, rate)).findings
    way_out = {
        f.columns[0]: f.way_out.partition(": hold it")[0] for f in found if f.code == "noise_implausible"
    }
    assert re.search(says, way_out["gyro_x"])
    if "accel_x" in way_out:
        assert way_out["accel_x"] == "the unit never rests"


def test_tremor_of_a_hand_is_not_noise_of_the_sensor():
    held = imucal.simulate(imucal.Tumble(3, poses=15, hold_s=3.0, tremor_deg=0.2), seed=3).recording
    assert "noise_implausible" not in codes(imucal.inspect(held))
    assert "noise_implausible" not in codes(imucal.calibrate(held))
    # A hand does not hide a wrong unit.
    degrees = imucal.Recording(held.time_s, held.specific_force, np.rad2deg(held.angular_rate))
    assert "noise_implausible" in codes(imucal.inspect(degrees))


def test_a_short_rest_is_refused_and_a_moving_record_remarked():
    run = imucal.simulate("random", seed=1, rate_hz=100.0).recording
    with pytest.raises(imucal.InputError, match=r"longest rest, from .* 1000 are needed"):
        imucal.noise(run)
    faster = imucal.simulate("random", seed=1, rate_hz=400.0).recording
    found = imucal.noise(faster)
    assert [f.code for f in found.findings][:1] == ["recording_moves"]
    assert found.axes["gyro_x"].bias_instability.value is None


# --- for other programs


def test_kalibr_reads_the_largest_axis(found):
    text = kalibr_yaml(found, rostopic="/imu's")
    read = yaml.safe_load(text)
    assert read["rostopic"] == "/imu's"
    assert read["update_rate"] == pytest.approx(RATE_HZ, rel=1e-6)
    for name, sensor in (("accelerometer", "accel"), ("gyroscope", "gyro")):
        for figure in ("noise_density", "random_walk"):
            largest = max(getattr(axis, figure).value for axis in found.triad(sensor))
            assert read[f"{name}_{figure}"] == pytest.approx(largest, rel=1e-8)
    assert "maximum-likelihood" in text.splitlines()[0]


def test_kalibr_gets_a_bound_for_what_is_not_seen():
    found = imucal.noise(still(duration_s=100.0, instability=0.0, walk=0.0))
    text = kalibr_yaml(found)
    assert "not detected on any axis" in text
    assert yaml.safe_load(text)["gyroscope_random_walk"] == pytest.approx(
        max(axis.random_walk.high for axis in found.triad("gyro")), rel=1e-8
    )


def test_counts_are_identified_in_counts_and_not_exported(recording):
    counts = imucal.Recording(
        recording.time_s,
        np.round(recording.specific_force / LSB),
        np.round(recording.angular_rate / LSB),
        accel_unit="lsb",
        gyro_unit="lsb",
    )
    found = imucal.noise(counts)
    figure = found.axes["gyro_x"].noise_density
    assert figure.unit == "lsb/sqrt(Hz)"
    assert figure.value * LSB == pytest.approx(DENSITY, abs=4.5 * figure.std * LSB)
    with pytest.raises(imucal.InputError, match="raw counts"):
        kalibr_yaml(found)


def test_a_unit_file_simulates_the_same_noise(found, tmp_path):
    path = tmp_path / "unit.json"
    unit_of_noise(found).write(path)
    unit = imucal.Unit.read(path)
    again = imucal.noise(imucal.simulate(imucal.Static(1200.0), unit=unit, rate_hz=RATE_HZ, seed=9).recording)
    figure = again.axes["gyro_x"].noise_density
    assert figure.value == pytest.approx(unit.gyroscope.noise_density, abs=4.5 * figure.std)
    assert unit.gyroscope.random_walk.tolist() == [a.random_walk.value for a in found.triad("gyro")]


def test_the_figure_shows_points_bands_and_model(found):
    figure = allan(found, "gyro")
    points = [trace for trace in figure.data if trace.mode == "markers"]
    assert [trace.name for trace in points] == ["x", "y", "z"]
    axis = found.axes["gyro_z"]
    deg_h = 3600.0 * np.degrees(1.0)
    np.testing.assert_allclose(points[2].y, deg_h * axis.deviations)
    np.testing.assert_allclose(points[2].y + points[2].error_y.array, deg_h * axis.high)
    models = [trace for trace in figure.data if trace.mode == "lines" and trace.showlegend is False]
    assert len(models) == 3
    assert "deg/h" in figure.layout.yaxis.title.text


@pytest.mark.slow
def test_the_command_writes_everything_it_is_asked_for(recording, tmp_path, capsys):
    paths = {name: tmp_path / name for name in ("still.parquet", "n.json", "n.html", "imu.yaml", "unit.json")}
    imucal.write(recording, paths["still.parquet"])
    options = [
        "--json",
        "n.json",
        "--report",
        "n.html",
        "--kalibr",
        "imu.yaml",
        "--unit-profile",
        "unit.json",
    ]
    arguments = [str(paths.get(option, option)) for option in options]
    assert main(["noise", str(paths["still.parquet"]), *arguments, "--rostopic", "/imu7"]) == 0
    shown = capsys.readouterr().out
    assert "gyro_x noise_density" in shown
    assert "95 % from" in shown
    assert "verdict: good" in shown
    assert json.loads(paths["n.json"].read_text())["samples"] == pytest.approx(len(recording), abs=10)
    assert yaml.safe_load(paths["imu.yaml"].read_text())["rostopic"] == "/imu7"
    assert imucal.Unit.read(paths["unit.json"]).name == "unit"
    page = paths["n.html"].read_text(encoding="utf-8")
    assert "Allan deviation" in page
    assert "bias instability" in page


def test_a_result_is_frozen(found):
    with pytest.raises(dataclasses.FrozenInstanceError):
        found.samples = 0
