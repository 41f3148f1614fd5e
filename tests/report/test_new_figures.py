"""Figures of the pages against the results and recordings that they show."""

from dataclasses import replace

import numpy as np
import pytest

import imucal
from imucal import plot, report
from imucal.effects.meaning import meaning_of
from imucal.gap.laws.law import Curve, Law
from imucal.plot.noise import FLAT, marks, slopes
from imucal.plot.recording import envelope, saturated_samples
from imucal.plot.shares import candidate_probabilities
from imucal.units import datasheet

G = 9.80665
MG = 1e3 / G
EFFECT = {"gyro_g_sensitivity": 1e-3}


@pytest.fixture(scope="module")
def runs():
    return [imucal.simulate("random", seed=s, rate_hz=50, effects=EFFECT).recording for s in (1, 2)]


@pytest.fixture(scope="module")
def gap(runs):
    candidates = ["gyro_g_sensitivity", "gyro_scale_quadratic"]
    return imucal.find_gap(runs[0], control=runs[1], candidates=candidates)


@pytest.fixture(scope="module")
def motion(gap, runs):
    return imucal.own_motion(gap, runs[0], control=runs[1])


def test_the_move_that_disagrees_most_is_shown_measured_and_predicted(gap, motion, runs):
    signals = motion.signals
    moves = [(False, m) for m in gap.fits["before"].moves]
    moves += [(True, m) for m in gap.fits["before"].control.moves]
    moves = [
        (of, move) for of, move in moves if move.excluded is None and move.direction_error_deg is not None
    ]
    is_control, worst = max(moves, key=lambda m: m[1].direction_error_deg / m[1].direction_sigma_deg)
    of = runs[1] if is_control else runs[0]
    assert signals.is_control == is_control
    assert (signals.start_s, signals.end_s) == tuple(of.time_s[[worst.first, worst.last]])
    # The measured signal is the corrected one, and the prediction at the end misses it by the residual.
    rows = np.searchsorted(of.time_s, signals.time_s)
    corrected = gap.fits["before"].calibration.apply_recording(of)
    np.testing.assert_allclose(signals.measured_before, corrected.specific_force[rows])
    at_end = np.searchsorted(signals.time_s, signals.end_s)
    predicted = signals.predicted_before[at_end]
    measured = signals.measured_before[at_end:].mean(axis=0)
    angle = np.degrees(np.arccos(predicted @ measured / np.linalg.norm(predicted) / np.linalg.norm(measured)))
    assert angle == pytest.approx(worst.direction_error_deg, rel=0.35)
    np.testing.assert_allclose(np.linalg.norm(signals.predicted_after, axis=1), G, rtol=1e-6)

    def rms(values):
        return np.sqrt(np.mean(values[at_end:] ** 2))

    assert rms(signals.residual_after) < 0.2 * rms(signals.residual_before)
    drawn = {trace.name: np.asarray(trace.y) for trace in plot.move_signals(signals).data}
    axis = int(np.argmax(np.abs(signals.residual_before[at_end:].mean(axis=0))))
    np.testing.assert_array_equal(drawn["measured"], signals.measured_after[:, axis])
    np.testing.assert_array_equal(drawn["predicted without effects"], signals.predicted_before[:, axis])
    np.testing.assert_array_equal(drawn["residual with effects"], signals.residual_after[:, axis])


def test_residuals_have_the_sign_of_the_error_of_the_corrected_rate(gap, runs):
    """A calibration whose gyroscope biases are too small by 1 deg/s corrects too little by that."""
    clean = imucal.simulate("random", seed=3, rate_hz=50).recording
    result = imucal.calibrate(clean)
    calibration = result.calibration
    bias = calibration.gyroscope.bias.copy()
    bias -= calibration.gyroscope.sensitivity @ np.radians([1.0, 1.0, 1.0])
    wrong = replace(calibration, gyroscope=imucal.Triad(calibration.gyroscope.sensitivity, bias))
    fits = {"before": replace(result, calibration=wrong), "after": result}
    motion = imucal.own_motion(replace(gap, fits=fits), clean)
    rates = motion.rests.rate_before
    np.testing.assert_allclose(np.degrees(rates.mean(axis=0)), [1.0, 1.0, 1.0], atol=0.02)
    # The axis of a move is within 32 deg of one of the body, and residuals are along the axis of the move.
    errors = np.degrees(motion.moves.error_before)
    assert len(errors) and (errors > 0.2).all() and (errors < 1.75).all()
    assert np.median(errors) == pytest.approx(1.2, abs=0.4)
    assert np.abs(np.degrees(motion.moves.error_after)).max() < 0.1


def test_residuals_at_rests_are_those_of_the_corrected_recordings(gap, motion, runs):
    rests = motion.rests
    own = [r for r in gap.fits["after"].rests if r.excluded is None]
    assert (~rests.is_control).sum() == len(own)
    corrected = gap.fits["after"].calibration.apply_recording(runs[0])
    expected = [corrected.angular_rate[r.first : r.end].mean(axis=0) for r in own]
    np.testing.assert_allclose(rests.rate_after[: len(own)], expected, atol=1e-15)
    errors = [r.norm_error_mps2 for r in own]
    np.testing.assert_allclose(rests.norm_after[: len(own)], errors, atol=2e-5)
    shown = plot.dependences(motion)
    assert {one.residual for one in shown} >= {f"rate at rest about {a}, deg/s" for a in "xyz"}
    assert all(one.share >= 0.3 for one in shown)
    figure = plot.residual_against(shown[:1])
    drawn = {trace.name: trace for trace in figure.data}
    first = shown[0]
    np.testing.assert_array_equal(drawn["without effects"].x, first.at[~first.is_control])
    np.testing.assert_array_equal(drawn["with effects, control"].y, first.after[first.is_control])
    with pytest.raises(imucal.InputError, match="no residual depends"):
        plot.residual_against([])


def test_own_motion_needs_the_recordings_of_the_search(gap, runs):
    with pytest.raises(imucal.InputError, match="is not among the recordings"):
        imucal.own_motion(gap, imucal.simulate("random", seed=7, rate_hz=50).recording)
    with pytest.raises(imucal.InputError, match="there is no fit"):
        imucal.own_motion(imucal.Gap("data_fault"), runs[0])


def test_the_waterfall_closes_the_gap_by_the_shares_of_the_result(gap):
    closed = gap.effects[0]["closed"]
    steps = plot.waterfall_steps(gap)
    assert set(steps) == {kind for kind, share in closed.items() if share is not None}
    for kind, own in steps.items():
        assert own[0] == ("gyro_g_sensitivity", closed[kind])
        assert sum(share for _, share in own) == pytest.approx(1.0)
    for trace, kind in zip(plot.waterfall(gap).data, steps, strict=True):
        assert list(trace.x[:2]) == [100.0, -100.0 * closed[kind]]
    with pytest.raises(imucal.InputError, match="no effect closes"):
        plot.waterfall(imucal.Gap("unknown"))


def test_sizes_and_probabilities_are_those_of_the_result(gap):
    parameters = gap.effects[0]["parameters"]
    wide, narrow = plot.effect_sizes(gap).data
    factor = np.degrees(G)
    assert list(wide.x) == pytest.approx([factor * p["value"] for p in parameters])
    assert list(narrow.error_x.array) == pytest.approx([factor * p["std"] for p in parameters])
    assert list(wide.error_x.array) == pytest.approx([1.96 * factor * p["std"] for p in parameters])
    first, second = 3.0, 1.0
    ranking = tuple(
        {**gap.ranking[0], "name": n, "log_bayes_factor": v} for n, v in (("a", first), ("b", second))
    )
    shares = candidate_probabilities(replace(gap, ranking=ranking))
    total = np.exp(first) + np.exp(second) + 1.0
    expected = {"a": np.exp(first) / total, "b": np.exp(second) / total, "no effect": 1.0 / total}
    assert shares == pytest.approx(expected)
    assert list(plot.probabilities(replace(gap, ranking=ranking)).data[0].x) == pytest.approx(
        [100 * share for share in expected.values()]
    )


def test_a_probable_candidate_that_was_not_added_is_said_to_be_none(gap, tmp_path):
    def caption(found):
        report.write_gap_page(tmp_path / "gap.html", found)
        text = (tmp_path / "gap.html").read_text(encoding="utf-8")
        return text.partition("Probability that a candidate")[2].partition("<")[0]

    assert "No candidate was added" not in caption(gap)
    other = replace(gap, verdict="unknown", effects=())
    assert caption(other).endswith(" No candidate was added to the model.")
    law = Law("gyro_law_f", "gyro: k*f", "gyroscope", ("f",), (), 1.0, 1.0, {}, (), None)
    assert caption(replace(other, laws=(law,))).endswith(
        " No candidate was added to the model: a law describes the residuals."
    )


def test_a_law_is_drawn_with_the_residuals_on_it(motion):
    at = (-G, 0.0, G)
    zero = (0.0, 0.0, 0.0)
    curve = Curve("f", at, {"x": (1e-3, 0.0, -1e-3), "y": zero, "z": zero}, dict.fromkeys("xyz", zero))
    law = Law("gyro_law_f", "gyro: k*f", "gyroscope", ("f",), (), 1.0, 1.0, {}, (), curve)
    points = plot.law_points(motion, law)
    force, error = points["x"]
    inside = np.abs(motion.rests.up[:, 0]) <= 1.0
    np.testing.assert_allclose(force, G * motion.rests.up[inside, 0])
    np.testing.assert_allclose(error, motion.rests.rate_after[inside, 0] - 1e-3 * force / G, atol=1e-12)
    drawn = {trace.name: trace for trace in plot.law(law, points).data if trace.name}
    np.testing.assert_allclose(drawn["x, measured"].x, force / G)
    np.testing.assert_allclose(drawn["x, measured"].y, np.degrees(error))
    assert plot.law_points(motion, replace(law, curve=None)) == {}


def test_every_effect_of_the_catalogue_has_a_meaning():
    for effect in imucal.effects.catalogue():
        meaning = meaning_of(effect.name)
        assert meaning is not None, f"{effect.name} lacks an entry in effects/meaning.py"
        assert all(text.endswith(".") for text in (meaning.what, meaning.cause, meaning.remedy))
    assert meaning_of("my_own_effect") is None


def test_no_tick_for_a_model_that_misses_something(gap, tmp_path):
    def mark(found):
        report.write_gap_page(tmp_path / "gap.html", found)
        text = (tmp_path / "gap.html").read_text(encoding="utf-8")
        return text.split('class="mark" aria-hidden="true">')[1][0]

    assert mark(gap) == "+"
    left = replace(gap.remainder, kind="unknown", description="rates vary", matters=False)
    assert mark(replace(gap, remainder=left)) == "◐"
    assert mark(replace(gap, remainder=replace(left, matters=True))) == "◐"
    assert mark(replace(gap, verdict="unknown", effects=(), remainder=left)) == "✘"
    assert mark(replace(gap, verdict="nothing_missing", effects=())) == "✔"


@pytest.fixture(scope="module")
def result(runs):
    return imucal.calibrate(runs[0], control=runs[1], serial_number="0042")


def test_the_sphere_shows_the_norm_of_gravity_before_and_after(result):
    used = [rest for rest in result.rests if rest.excluded is None]
    before, after = plot.norms_before_and_after(result)
    raw = np.linalg.norm([rest.mean_specific_force for rest in used], axis=1)
    np.testing.assert_allclose(before, raw / G)
    np.testing.assert_allclose(after, [1.0 + rest.norm_error_mps2 / G for rest in used])
    figure, factor = plot.sphere_before_and_after(result)
    drawn = {trace.name: trace for trace in figure.data if trace.name}
    for name, norms in (("before", before), ("after", after)):
        radius = np.linalg.norm([drawn[name].x, drawn[name].y, drawn[name].z], axis=0)
        np.testing.assert_allclose(radius, 1.0 + factor * (norms - 1.0), atol=3e-4)


def test_counts_have_one_scale_before_the_calibration(runs):
    scale, zero = 400.0, 32768.0
    raw = imucal.Recording(
        runs[0].time_s,
        np.round(zero + scale * runs[0].specific_force),
        np.round(zero + 4000.0 * runs[0].angular_rate),
        accel_unit="lsb",
        gyro_unit="lsb",
    )
    before, after = plot.norms_before_and_after(imucal.calibrate(raw))
    assert np.abs(before - 1.0).max() < 0.12
    assert np.abs(after - 1.0).max() < 1e-3


def test_the_histogram_counts_residuals_in_standard_deviations(result):
    figure = plot.histogram(result)
    bars = [trace for trace in figure.data if trace.type == "bar"]
    for bar, items, error, sigma in (
        (bars[0], result.rests, "norm_error_mps2", "norm_sigma_mps2"),
        (bars[1], result.moves, "direction_error_deg", "direction_sigma_deg"),
    ):
        ratios = np.array([getattr(i, error) / getattr(i, sigma) for i in items if i.excluded is None])
        assert sum(bar.y) == len(ratios)
        width = bar.width[0] if np.ndim(bar.width) else bar.width
        for centre, count in list(zip(bar.x, bar.y, strict=True))[1:-1]:
            own = (ratios >= centre - width / 2) & (ratios < centre + width / 2)
            assert count == own.sum()
    curve = next(trace for trace in figure.data if trace.name == "noise alone")
    area = np.sum(0.5 * (curve.y[1:] + curve.y[:-1]) * np.diff(curve.x))
    assert area == pytest.approx(0.5 * sum(bars[0].y), rel=0.01)


def test_correlations_are_those_of_the_covariance(result):
    calibration = result.calibration
    heat = plot.correlations(calibration).data[0]
    std = np.sqrt(np.diag(calibration.covariance))
    expected = calibration.covariance / np.outer(std, std)
    np.testing.assert_allclose(np.asarray(heat.z)[::-1], expected)
    assert list(heat.y)[::-1] == list(heat.x)
    for first, second, rho in plot.largest_correlations(calibration):
        i, k = (calibration.covariance_names.index(name) for name in (first, second))
        assert rho == expected[i, k] and abs(rho) > 0.5


def test_the_matrix_of_parameters_is_in_units_of_datasheets(result, tmp_path):
    report.write_calibration_page(tmp_path / "r.html", result)
    text = (tmp_path / "r.html").read_text(encoding="utf-8")
    summary = text.split('id="summary"')[1].split("</section>")[0]
    assert "accelerometer bias, mg" in summary and "gyroscope scale error, ppm" in summary
    bias = next(p for p in result.parameters if p.name == "accel_bias_x")
    assert f"{MG * bias.value:.2f}"[:6] in summary
    assert datasheet(bias.name, bias.unit).unit == "mg"


def clipped():
    run = imucal.simulate("random", seed=1, rate_hz=50, temperature=30.0).recording
    rate = np.clip(run.angular_rate, -1.2, 1.2)
    return imucal.Recording(
        run.time_s, run.specific_force, rate, temperature_degc=run.temperature_degc, name="clipped"
    )


def test_signals_of_a_recording_have_rests_saturation_and_temperature():
    recording = clipped()
    seen = imucal.inspect(recording)
    assert any(finding.code == "gyro_saturation" for finding in seen.findings)
    figure = plot.recording_signals(recording, seen)
    drawn = [trace for trace in figure.data if trace.mode == "lines"]
    assert len(drawn) == 7
    assert np.max(drawn[0].y) == pytest.approx(recording.specific_force[:, 0].max() / G)
    assert np.min(drawn[3].y) == pytest.approx(np.degrees(recording.angular_rate[:, 0].min()))
    shaded = [(shape.x0, shape.x1) for shape in figure.layout.shapes]
    assert sorted(shaded) == sorted((rest.start_s, rest.end_s) for rest in seen.rests)
    at, values = saturated_samples(recording, seen, "gyro")
    assert len(at) and set(np.abs(values)) == {1.2}
    assert len(saturated_samples(recording, seen, "accel")[0]) == 0
    crosses = next(trace for trace in figure.data if trace.name == "saturated")
    np.testing.assert_allclose(np.abs(np.asarray(crosses.y, dtype=float)), np.degrees(1.2))


def test_excluded_rests_are_shaded_in_another_tone():
    seen = imucal.inspect(clipped())
    rests = (replace(seen.rests[0], excluded="not steady"), *seen.rests[1:])
    figure = plot.recording_signals(clipped(), replace(seen, rests=rests))
    colours = {shape.fillcolor for shape in figure.layout.shapes if shape.x0 == rests[0].start_s}
    others = {shape.fillcolor for shape in figure.layout.shapes if shape.x0 != rests[0].start_s}
    assert len(colours) == len(others) == 1 and colours != others
    assert "not steady" in replace(seen, rests=rests)._repr_html_()


def test_an_envelope_keeps_the_extremes():
    time = np.arange(100_000.0)
    values = np.sin(time / 500.0)
    values[54_321], values[7] = 9.0, np.nan
    at, own = envelope(time, values)
    assert len(own) <= 1400
    assert (at[np.argmax(own)], own.max()) == (54_321.0, 9.0)
    assert np.all(np.diff(at) > 0)
    assert len(envelope(time[:50], values[:50])[0]) == 49


def test_recordings_and_inspections_show_themselves_in_notebooks():
    recording = clipped()
    html = recording._repr_html_().replace("<wbr>", "")
    assert "gyro_x" in html and "-1.2" in html and "temperature" in html
    assert (
        "A calibration would refuse this recording: gyro_saturation."
        in imucal.inspect(recording)._repr_html_()
    )


def test_the_page_of_recordings_has_a_tab_for_each(tmp_path):
    good = imucal.simulate("random", seed=2, rate_hz=50).recording
    both = [clipped(), good]
    inspections = [imucal.inspect(recording) for recording in both]
    report.write_inspection_page(tmp_path / "r.html", inspections, both)
    text = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert text.count('<section class="tab"') == 2
    assert "1 of 2 recordings determine all parameters." in text
    with pytest.raises(imucal.InputError, match="2 inspections of 1 recordings"):
        report.write_inspection_page(tmp_path / "r.html", inspections, good)


def test_noise_figures_are_marked_on_their_slopes():
    noise = imucal.noise(imucal.simulate(imucal.Static(60.0), rate_hz=50, seed=1).recording)
    axes = noise.triad("gyro")
    walk, instability = 1e-6, 2e-5
    figures = {
        "random_walk": replace(axes[0].random_walk, value=walk, std=1e-7),
        "bias_instability": replace(axes[0].bias_instability, value=instability, std=1e-6),
    }
    made = tuple(replace(axis, **figures) for axis in axes)
    assert marks(made[0])["N"] == (1.0, made[0].noise_density.value)
    assert marks(made[0])["K"] == (3.0, walk)
    assert marks(made[0])["B"][1] == pytest.approx(0.664 * instability, rel=1e-3)
    for letter, slope in (("N", -0.5), ("B", 0.0), ("K", 0.5)):
        at, values = slopes(made)[letter]
        assert np.diff(np.log(values)) / np.diff(np.log(at)) == pytest.approx(slope, abs=1e-9)
    at, values = slopes(made)["K"]
    assert values[0] == pytest.approx(walk * np.sqrt(at[0] / 3.0))
    assert pytest.approx(0.664, abs=5e-4) == FLAT
    shown = plot.allan(
        replace(noise, axes={**noise.axes, **dict(zip(("gyro_x", "gyro_y", "gyro_z"), made, strict=True))}),
        "gyro",
    )
    names = [trace.name for trace in shown.data if trace.showlegend is not False]
    assert names[:3] == [
        "slope −1/2: white noise N",
        "slope 0: bias instability B",
        "slope +1/2: random walk K",
    ]
    stars = {trace.name: trace for trace in shown.data if trace.marker.symbol == "star"}
    assert len(stars) == 9
    assert stars["K of z"].y[0] == pytest.approx(np.degrees(walk) * 3600.0)
    # Each letter stands once, also where the x axis lacks a figure.
    lacking = replace(made[0], bias_instability=replace(made[0].bias_instability, value=None))
    axes = dict(zip(("gyro_x", "gyro_y", "gyro_z"), (lacking, *made[1:]), strict=True))
    shown = plot.allan(replace(noise, axes={**noise.axes, **axes}), "gyro")
    letters = [trace.text[0] for trace in shown.data if trace.marker.symbol == "star"]
    assert sorted(filter(None, letters)) == ["B", "K", "N"]


def test_a_soak_is_drawn_over_temperature_and_time():
    time = np.arange(0.0, 4000.0)
    degc = 25.0 + 20.0 * np.sin(time / 600.0)
    random = np.random.default_rng(1)
    rate = 1e-3 * (degc[:, None] - 25.0) * [1.0, -0.5, 0.2] / 10 + random.normal(size=(len(time), 3)) * 1e-5
    force = np.array([0.0, 0.0, G]) + random.normal(size=(len(time), 3)) * 1e-4
    found = imucal.soak(imucal.Recording(time, force, rate, temperature_degc=degc))
    sensor = found.gyroscope
    over = {trace.name: trace for trace in plot.soak(found, sensor).data[:2]}
    np.testing.assert_array_equal(over["measured"].x, found.temperature_degc)
    np.testing.assert_allclose(over["model"].y, np.degrees(sensor.fitted - sensor.constant)[:, 0])
    in_time = {trace.name: trace for trace in plot.soak(found, sensor, "time").data[:2]}
    np.testing.assert_allclose(in_time["one cubic"].y, np.degrees(sensor.mean - sensor.cubic)[:, 0])
