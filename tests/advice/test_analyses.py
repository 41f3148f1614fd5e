"""Advice of the noise analysis, of the search for effects and of the readers, followed to the letter."""

import dataclasses
import re

import numpy as np
import pytest
from advice import findings_of, of_code, outcome_of, run

import imucal
from changes import truth_of
from imucal.rig.unit import unit_of

RATE_HZ = 100.0
DENSITY = 1e-3


def still(duration_s=900.0, seed=1, **fields):
    """A unit at rest whose sensors have white noise, bias instability and random walk."""
    given = {"noise_density": DENSITY, "bias_instability": 3e-4, "random_walk": np.full(3, 1e-5), **fields}
    sensor = imucal.Sensor(**given)
    motion = imucal.Static(duration_s)
    return imucal.simulate(motion, unit=imucal.Unit(sensor, sensor), rate_hz=RATE_HZ, seed=seed).recording


def codes_of(found):
    return {finding.code for finding in found.findings}


def require_density(found, density=DENSITY):
    for axis in found.axes.values():
        figure = axis.figures["noise_density"]
        assert figure.low * 0.98 < density < figure.high * 1.02, figure


def test_a_moved_unit_is_recorded_again_at_rest():
    recording = still()
    rates = recording.angular_rate.copy()
    rates[80_000:80_400] += 0.5 * np.sin(np.arange(400) / 20)[:, None]
    bumped = dataclasses.replace(recording, angular_rate=rates)
    found = imucal.noise(bumped)
    assert of_code("recording_moves") in codes_of(found)
    require_density(found)
    again = imucal.noise(recording)
    assert "recording_moves" not in codes_of(again)
    require_density(again)


def test_a_short_recording_is_made_longer():
    short = imucal.noise(still(20.0))
    assert of_code("recording_short") in codes_of(short)
    long = imucal.noise(still(3600.0, bias_instability=1e-3))
    assert "recording_short" not in codes_of(long)
    for axis in long.axes.values():
        figure = axis.figures["bias_instability"]
        assert figure.low < 1e-3 < figure.high


def test_noise_below_a_count_is_recorded_at_a_higher_resolution():
    coarse = imucal.noise(still(lsb=0.1, bits=24))
    assert of_code("noise_below_lsb") in codes_of(coarse)
    fine = imucal.noise(still(lsb=1e-3, bits=24))
    assert "noise_below_lsb" not in codes_of(fine)
    require_density(fine)


def test_filtered_noise_needs_nothing():
    found = imucal.noise(still(filter_hz=20.0))
    assert of_code("noise_filtered") in codes_of(found)
    require_density(found)


def test_a_unit_whose_temperature_varies_is_recorded_at_a_constant_one():
    recording = still()
    warm = 2e-2 * np.sin(2 * np.pi * recording.time_s / 200.0)[:, None]
    found = imucal.noise(dataclasses.replace(recording, angular_rate=recording.angular_rate + warm))
    assert of_code("noise_model") in codes_of(found)
    again = imucal.noise(recording)
    assert "noise_model" not in codes_of(again)
    require_density(again)


def with_rate(recording, added):
    return dataclasses.replace(recording, angular_rate=recording.angular_rate + added)


def stepped(recording):
    """The recording with a step of the gyroscope's bias at two thirds."""
    return with_rate(recording, np.where(recording.time_s > 600.0, 0.02, 0.0)[:, None])


def test_a_step_is_left_out_or_recorded_again():
    white = still(bias_instability=0.0, random_walk=np.zeros(3))
    found = imucal.noise(stepped(white))
    assert codes_of(found) & {of_code("step"), of_code("steps_cut")}, found.findings
    advice = " ".join(f.way_out for f in found.findings if f.code in ("step", "steps_cut"))
    assert re.search("again|exclude|part", advice), advice
    require_density(imucal.noise(white))


def test_a_unit_that_warms_up_is_recorded_when_it_is_warm():
    white = still(bias_instability=0.0, random_walk=np.zeros(3))
    warming = with_rate(white, 0.05 * np.exp(-white.time_s / 200.0)[:, None])
    found = imucal.noise(warming)
    assert of_code("drift") in codes_of(found), found.findings
    assert "drift" not in codes_of(imucal.noise(white))
    require_density(imucal.noise(white))


def test_an_interrupted_recording_gives_the_noise_of_its_longest_part():
    recording = still()
    rows = np.r_[0:30_000, 32_000 : len(recording)]
    found = imucal.noise(recording.rows(np.isin(np.arange(len(recording)), rows)))
    assert of_code("recording_interrupted") in codes_of(found), found.findings
    require_density(found)


@pytest.mark.parametrize(
    ("code", "bias", "density"),
    [(of_code("noise_implausible"), 0.0, 1e-4), (of_code("bias_implausible"), 3.0, 1e-4)],
)
def test_numbers_in_another_unit_are_named_after_it(code, bias, density):
    right = with_rate(
        still(noise_density=density, bias_instability=0.0, random_walk=np.zeros(3)), np.radians(bias)
    )
    wrong = dataclasses.replace(right, angular_rate=np.degrees(right.angular_rate))
    findings = [f for f in imucal.noise(wrong).findings if f.code == code]
    assert findings and "gyro_x_dps" in findings[0].way_out, findings
    again = dataclasses.replace(wrong, angular_rate=np.radians(wrong.angular_rate))
    assert code not in codes_of(imucal.noise(again))


@pytest.mark.parametrize(
    ("read", "unit"), [(lambda degc: degc + 273.15, "temp_k"), (lambda degc: degc * 1.8 + 32 + 200, "temp_")]
)
def test_temperatures_in_another_unit_are_named_after_it(read, unit):
    good = run().recording
    degc = np.full(len(good), 25.0)
    findings = findings_of(dataclasses.replace(good, temperature_degc=read(degc)))
    [finding] = [f for f in findings if f.code == of_code("temperature_implausible")]
    assert unit in finding.way_out, finding
    right = dataclasses.replace(good, temperature_degc=degc)
    assert outcome_of(right, truth_of(run())) == "truth"


def test_counts_of_a_temperature_need_their_scale(tmp_path):
    recording = run().recording
    header = COLUMNS + ",temp_lsb"
    rows = [f"{row},{-3920 + k % 3}" for k, row in enumerate(rows_of(recording))]
    raw = imucal.read(text(tmp_path, [header, *rows]))
    assert of_code("temperature_raw") in [f.code for f in raw.findings]
    scaled = imucal.read(text(tmp_path, [header, *rows]), temp_scale="1/340,36.53")
    assert scaled.temperature_degc == pytest.approx(25.0, abs=0.1)
    assert outcome_of(scaled, truth_of(run())) == "truth"


# --- parameters that a calibration determines poorly


def diagnosed(recording, effect):
    """The result, and the advice of its diagnoses by code, one sentence for each diagnosis."""
    result = imucal.calibrate(recording, effects=[effect])
    advice = {}
    for diagnosis in result.diagnosis:
        advice[diagnosis.code] = advice.get(diagnosis.code, "") + diagnosis.way_out + ". "
    return result, advice


def require_truth(result, simulated):
    truth = {p.name: p.value for p in simulated.truth.calibration.parameters}
    for parameter in result.parameters:
        error = parameter.value - truth.get(parameter.name, 0.0)
        assert abs(error) < 5 * parameter.std, parameter


@pytest.mark.parametrize(
    ("code", "effect", "says"),
    [
        (of_code("traded_off"), "accel_scale_asymmetry", "rests with each axis up, down and between"),
        (of_code("flat"), "gyro_bias_drift", "rests early and late"),
    ],
)
def test_the_motion_in_the_advice_determines_the_parameter(code, effect, says):
    _, few = diagnosed(run().recording, effect)
    assert says in few[code]
    longer = imucal.simulate("random", seed=3, rate_hz=100.0)
    result, more = diagnosed(longer.recording, effect)
    assert len(more.get(code, "")) <= len(few[code])
    require_truth(result, longer)


def test_a_time_constant_beyond_the_recording_needs_a_longer_one():
    slow = [imucal.EffectValues("gyro_bias_warmup", [0.02, -0.01, 0.015], shape=300.0)]
    program = imucal.Program.random(seed=1, moves=18, hold_s=1.5)
    short = imucal.simulate(program, unit="paper", rate_hz=100, seed=1, effects=slow)
    _, few = diagnosed(short.recording, "gyro_bias_warmup")
    assert "until the sensors have settled" in few[of_code("at_bound")]
    settled = [imucal.EffectValues("gyro_bias_warmup", [0.02, -0.01, 0.015], shape=30.0)]
    long = imucal.simulate("random", seed=1, rate_hz=100.0, effects=settled)
    result, more = diagnosed(long.recording, "gyro_bias_warmup")
    assert "at_bound" not in more
    require_truth(result, long)


@pytest.mark.slow
def test_a_tremor_that_is_taken_for_noise_is_recorded_faster():
    hand = imucal.Tumble(seed=1, poses=25, tremor_deg=0.1)
    slow = imucal.calibrate(imucal.simulate(hand, seed=1, rate_hz=50).recording)
    [finding] = [f for f in slow.findings if f.code == of_code("noise_overestimated")]
    assert "100 Hz or more" in finding.way_out
    fast = imucal.simulate(hand, seed=1, rate_hz=100)
    assert outcome_of(fast.recording, truth_of(fast)) == "truth"


# --- faults that only the fit shows


def random_run(**arguments):
    return imucal.simulate("random", seed=21, rate_hz=100.0, **arguments).recording


def loud_in_motion():
    unit = unit_of("paper")
    sensors = {
        name: dataclasses.replace(getattr(unit, name), noise_in_motion=2.0)
        for name in ("accelerometer", "gyroscope")
    }
    run = random_run(unit=dataclasses.replace(unit, **sensors))
    return dataclasses.replace(run, stand_rad=None)


FIRM = imucal.Stand(
    mount_rotation_deg=(0.8, -1.1, 0.6),
    base_tilt_deg=(0.4, -0.3),
    non_orthogonality_deg=(0.3, -0.4),
    encoder_noise_deg=0.005,
)
SPOILT = {
    of_code("mount_slip"): lambda: random_run(stand=FIRM, effects={"mount_slip": np.radians(1.5)}),
    of_code("noise_grows_in_motion"): loud_in_motion,
}


@pytest.mark.slow
@pytest.mark.parametrize("code", SPOILT)
def test_what_only_the_fit_shows_is_recorded_again(code):
    found = imucal.find_gap(SPOILT[code]())
    assert found.verdict == "data_fault"
    assert code in {finding.code for finding in found.findings}
    assert imucal.find_gap(random_run(stand=FIRM)).verdict == "nothing_missing"


# --- readers


def text(folder, lines, name="run.csv"):
    path = folder / name
    path.write_text("\n".join(lines) + "\n")
    return path


def rows_of(recording):
    g = 9.80665
    columns = np.column_stack([recording.time_s, recording.specific_force / g, recording.angular_rate])
    return [",".join(f"{value:.9g}" for value in row) for row in columns]


HEADER = "Time (s),Acc X (g),Acc Y (g),Acc Z (g),Gyr X (rad/s),Gyr Y (rad/s),Gyr Z (rad/s)"
COLUMNS = "time_s,accel_x_g,accel_y_g,accel_z_g,gyro_x_radps,gyro_y_radps,gyro_z_radps"


def test_a_header_that_is_wrong_is_overruled_by_columns(tmp_path):
    rows = rows_of(run().recording)
    right = imucal.read(text(tmp_path, [HEADER, *rows]))
    assert [f.code for f in right.findings] == [of_code("read_by_header")]
    assert outcome_of(right, truth_of(run())) == "truth"
    # The header says m/s^2 for numbers in g, and the advice is to give the right columns.
    with pytest.raises(imucal.FormatError, match="correct the unit in the header"):
        imucal.read(text(tmp_path, [HEADER.replace("(g)", "(m/s^2)"), *rows]))
    given = imucal.read(text(tmp_path, rows), columns=COLUMNS)
    assert outcome_of(given, truth_of(run())) == "truth"


def test_lines_that_were_left_out_are_removed_from_the_file(tmp_path):
    rows = rows_of(run().recording)
    noted = [COLUMNS, *rows[:3000], "# battery changed", *rows[3000:]]
    found = imucal.read(text(tmp_path, noted))
    codes = [f.code for f in found.findings]
    cleaned = imucal.read(text(tmp_path, [COLUMNS, *rows]))
    assert codes in ([of_code("lines_left_out")], [])
    assert np.array_equal(found.specific_force, cleaned.specific_force)
    assert outcome_of(cleaned, truth_of(run())) == "truth"


def test_sensors_with_their_own_time_stamps(tmp_path):
    """The advice is to record both at the same instants; the resampled run is right as well."""
    recording = run().recording
    fine = imucal.simulate(
        imucal.Program.random(seed=1, moves=18, hold_s=1.5), unit="paper", rate_hz=200, seed=1
    ).recording

    def lines(values, first):
        columns = np.column_stack([fine.time_s, values])[first::2]
        return ["\t".join(f"{value:.9g}" for value in row) for row in columns]

    accel = text(tmp_path, lines(fine.specific_force, 0), "acc.mat")
    gyro = text(tmp_path, lines(fine.angular_rate, 1), "gyro.mat")
    found = imucal.read(accel, gyro, format="imu_tk", accel_unit="m/s^2", gyro_unit="rad/s")
    assert [f.code for f in found.findings] == [of_code("resampled")]
    assert not outcome_of(found, truth_of(run())).startswith("wrong")
    assert outcome_of(recording, truth_of(run())) == "truth"


def sentences(recording, with_sums):
    """The samples as $VNIMU sentences: magnetometer, accelerometer, gyroscope, temperature and pressure."""
    lines = []
    for force, rate in zip(recording.specific_force, recording.angular_rate, strict=True):
        numbers = ",".join(f"{value:+.7f}" for value in (0.2, 0.0, 0.4, *force, *rate, 25.0, 101.3))
        body = f"VNIMU,{numbers}"
        total = 0
        for byte in body.encode():
            total ^= byte
        lines.append(f"${body}*{total:02X}" if with_sums else f"${body}*XX")
    return lines


def test_sentences_are_recorded_with_check_sums(tmp_path):
    recording = run().recording
    without_sums = imucal.read(text(tmp_path, sentences(recording, False), "a.txt"), rate_hz=100.0)
    assert of_code("checksums_missing") in [f.code for f in without_sums.findings]
    with_sums = imucal.read(text(tmp_path, sentences(recording, True), "b.txt"), rate_hz=100.0)
    assert "checksums_missing" not in [f.code for f in with_sums.findings]
    for found in (without_sums, with_sums):
        assert outcome_of(found, truth_of(run())) == "truth"
