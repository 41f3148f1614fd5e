"""Soaks and sweeps of a unit at rest in one pose, made without the product's simulator."""

import json

import numpy as np
import pytest

import imucal
from imucal.cli.app import main
from imucal.gap.temperature_history import TemperatureHistory

DEG = np.pi / 180.0


def sweep(seed, rate=None, force=None, tau_s=60.0, span_k=(30.0, 10.0)):
    """Readings at rest, 1200 s at 10 Hz; `rate` and `force` are functions of temperature and lagged one."""
    random = np.random.default_rng(seed)
    time_s = np.arange(12_000) / 10.0
    degc = 25.0 + span_k[0] * np.sin(time_s / 190.0) + span_k[1] * np.sin(time_s / 50.0)
    lagged, value = np.empty_like(degc), degc[0]
    for k, now in enumerate(degc):
        value += 0.1 / (tau_s + 0.1) * (now - value)
        lagged[k] = value
    zeros = np.zeros((len(degc), 3))
    return imucal.Recording(
        time_s,
        [0.3, -0.2, 9.7]
        + (zeros if force is None else force(degc, lagged))
        + random.normal(0, 0.01, zeros.shape),
        [1e-3, 0, -1e-3]
        + (zeros if rate is None else rate(degc, lagged))
        + random.normal(0, 1e-3, zeros.shape),
        temperature_degc=degc + random.normal(0, 0.02, len(degc)),
    )


def test_the_duration_of_a_soak_does_not_depend_on_its_first_time():
    time_s = np.linspace(700.0, 1900.0, 100)
    assert TemperatureHistory(time_s, np.linspace(20.0, 60.0, 100)).duration_s == 1200.0


def test_a_lag_is_found_with_its_time_constant():
    k = np.array([2e-4, -1e-4, 3e-4])
    found = imucal.soak(sweep(1, rate=lambda _, lagged: k * (lagged[:, None] - 25.0)))
    names = [term.name for term in found.gyroscope.terms]
    assert names == ["gyro_bias_temperature", "gyro_bias_temperature_lag"]
    linear, lag = found.gyroscope.terms
    assert lag.parameters["tau"] == pytest.approx(60.0, rel=0.1)
    assert abs(lag.parameters["tau"] - 60.0) < 5 * lag.std["tau"]
    np.testing.assert_allclose([linear.parameters[axis] for axis in "xyz"], k, rtol=0.05)
    np.testing.assert_allclose([lag.parameters[axis] for axis in "xyz"], k, rtol=0.1)
    assert (found.gyroscope.left < 0.5).all()
    assert found.accelerometer.terms == ()


def test_hysteresis_is_told_from_a_lag():
    k = np.array([2e-4, -1e-4, 3e-4])

    def loop(degc, _):
        behind, found = degc[0], np.empty_like(degc)
        for i, now in enumerate(degc):
            behind = max(now - 1.0, min(now + 1.0, behind))
            found[i] = now - behind
        return k * (degc - 25.0)[:, None] + 10.0 * k[::-1] * found[:, None]

    found = imucal.soak(sweep(4, rate=loop))
    names = [term.name for term in found.gyroscope.terms]
    assert names == ["gyro_bias_temperature", "gyro_bias_temperature_hysteresis"]
    size = [found.gyroscope.terms[1].parameters[axis] for axis in "xyz"]
    np.testing.assert_allclose(size, 10.0 * k[::-1], rtol=0.1)


def test_two_lags_are_found_with_their_time_constants():
    k = np.array([2e-3, -1e-3, 3e-3])

    def two(degc, lagged):
        slow, value = np.empty_like(degc), degc[0]
        for n, now in enumerate(degc):
            value += 0.1 / (200.0 + 0.1) * (now - value)
            slow[n] = value
        return k * ((lagged - 25.0) + (slow - degc))[:, None]

    found = imucal.soak(sweep(6, force=two, tau_s=20.0)).accelerometer
    assert [term.name.removeprefix("accel_bias_temperature") for term in found.terms] == ["", "_lag", "_lag"]
    fast, slow = found.terms[1:]
    for lag, tau_s in ((fast, 20.0), (slow, 200.0)):
        assert abs(lag.parameters["tau"] - tau_s) < 4 * lag.std["tau"] < tau_s
        np.testing.assert_allclose([lag.parameters[axis] for axis in "xyz"], k, rtol=0.2)
    assert (found.left < 0.5).all()
    assert found.described == "accel_bias_temperature, accel_bias_temperature_lag with 2 time constants"
    taus = {p.name: p.value for p in found.parameters if p.unit == "s"}
    assert taus == {
        "accel_bias_temperature_lag_tau": fast.parameters["tau"],
        "accel_bias_temperature_lag_tau (2)": slow.parameters["tau"],
    }


def test_a_real_sweep_is_described_by_two_lags(data_file):
    rows = np.genfromtxt(data_file("tofupilot_thermal/imu_raw_data.csv"), names=True)
    force, rate = (np.column_stack([rows[f"imu{kind}{axis}"] for axis in "xyz"]) for kind in ("acc", "gyro"))
    # The time stamps are not those of the sweep, so the rows are the time.
    time_s = np.arange(len(rows)) / 10.0
    found = imucal.soak(imucal.Recording(time_s, force, rate, temperature_degc=rows["imutemperature"]))
    for sensor in found.sensors:
        assert [term.name.rsplit("_", 1)[-1] for term in sensor.terms] == ["temperature", "lag", "lag"]
        assert (sensor.left < 0.4).all()


def test_a_search_in_one_pose_refers_to_the_soak():
    with pytest.raises(imucal.NotEnoughMotionError, match="use imucal soak"):
        imucal.find_gap(sweep(1))
    still = imucal.simulate(imucal.Static(duration_s=60.0), rate_hz=50, seed=1).recording
    with pytest.raises(imucal.NotEnoughMotionError) as raised:
        imucal.find_gap(still)
    assert "soak" not in str(raised.value)


def test_the_degree_is_that_of_the_reading():
    def cubic(degc, _):
        d = (degc - 25.0)[:, None]
        return [2e-3, 1e-3, -1e-3] * d + [1e-5, 2e-5, -1e-5] * d**2 + [4e-7, -3e-7, 5e-7] * d**3

    def linear(degc, _):
        return [1e-4, -1e-4, 2e-4] * (degc - 25.0)[:, None]

    found = imucal.soak(sweep(3, rate=linear, force=cubic))
    assert [(t.name, len(t.parameters)) for t in found.gyroscope.terms] == [("gyro_bias_temperature", 3)]
    assert [(t.name, len(t.parameters)) for t in found.accelerometer.terms] == [("accel_bias_temperature", 9)]


def test_a_constant_reading_has_no_effect():
    for seed in range(3):
        found = imucal.soak(sweep(10 + seed))
        assert [found.gyroscope.terms, found.accelerometer.terms] == [(), ()]


def test_the_command_writes_what_it_prints(tmp_path, capsys):
    pytest.importorskip("plotly")
    imucal.write(
        sweep(1, rate=lambda _, lagged: [2e-4, -1e-4, 3e-4] * (lagged[:, None] - 25.0)), tmp_path / "s.csv"
    )
    document, page = tmp_path / "soak.json", tmp_path / "soak.html"
    words = ["soak", tmp_path / "s.csv", "--report", page, "--json", document]
    assert main([str(word) for word in words]) == 0
    printed = capsys.readouterr().out
    assert "gyroscope: gyro_bias_temperature, gyro_bias_temperature_lag" in printed
    sensor = json.loads(document.read_text())["sensors"][0]
    assert [term["name"] for term in sensor["terms"]][1] == "gyro_bias_temperature_lag"
    assert max(sensor["left_of_a_cubic"]) < 0.5
    assert "one cubic" in page.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda r: imucal.Recording(r.time_s, r.specific_force, r.angular_rate), "needs a temperature"),
        (lambda r: sweep(1, span_k=(0.3, 0.1)), "record a soak over 2 K or more"),
        (
            lambda r: sweep(1, force=lambda degc, _: (degc > 30.0)[:, None] * [9.0, 0, 0]),
            "the unit was moved",
        ),
    ],
)
def test_what_is_no_soak_is_refused(change, message):
    with pytest.raises(imucal.InputError, match=message):
        imucal.soak(change(sweep(1)))
