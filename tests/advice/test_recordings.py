"""Advice about recordings, followed to the letter, gives the truth or another refusal."""

import re

import numpy as np
import pytest
from advice import (
    Advised,
    advice_about,
    of_code,
    option_in,
    outcome_of,
    run,
    without,
)
from codes import codes, tested as with_a_test

import imucal
from changes import changed, force, rate, time, truth_of
from imucal import Recording

G = 9.80665


def again(_, __):
    """What follows is a new recording without the fault."""
    return run().recording


def nothing(recording, _):
    return recording


def zeros_in(values):
    """Every 700th row is zero."""
    return np.where(np.arange(len(values))[:, None] % 700 == 500, 0.0, values)


def with_options(*names):
    """The next attempt is the same, with the options in the advice."""
    return lambda recording, advice: (recording, {name: option_in(advice, name) for name in names})


def evenly(recording, advice):
    """The time column is left out, and the rate in the advice is given."""
    assert "columns='-," in advice
    return changed(recording, time_s=np.arange(len(recording)) / float(option_in(advice, "rate_hz")))


def evenly_at_the_configured_rate(recording, advice):
    """No rate is advised, but the one to which the sensor is set."""
    assert "columns='-," in advice and "rate_hz=RATE with the configured rate" in advice, advice
    assert "at least 3 pauses" in advice, advice
    return changed(recording, time_s=np.arange(len(recording)) / 100)


def counts(recording, accel=2000.0, gyro=7000.0, offset=0.0):
    return changed(
        recording,
        specific_force=np.round(recording.specific_force * accel) + offset,
        angular_rate=np.round(recording.angular_rate * gyro) + offset,
        accel_unit="lsb",
        gyro_unit="lsb",
    )


def jitter(sigma_s):
    return lambda t: np.sort(t + sigma_s * np.random.default_rng(0).normal(size=len(t)))


def late_gyroscope(r):
    return changed(
        r, time_s=r.time_s[60:], specific_force=r.specific_force[60:], angular_rate=r.angular_rate[:-60]
    )


def late(t):
    """Every 90th sample is stamped 12 ms late, and the next one 4 ms."""
    place = np.arange(len(t)) % 90
    return t + np.where(place == 40, 0.012, 0) + np.where(place == 41, 0.004, 0)


def bursts(t):
    return np.arange(len(t)) // 16 * 0.16 + np.arange(len(t)) % 16 * 1e-4


def sawtooth(t):
    """Steps of 11.25 ms, and one in nine of 0.5 ms: the median rate is 12 % too small."""
    return np.arange(len(t)) // 9 * 0.09 + np.r_[np.arange(8) * 0.01125, 0.07925][np.arange(len(t)) % 9]


def paused(stamps, pause_s):
    """Arrival times of a logger that pauses three times."""

    def stamp(t):
        packet = np.arange(len(t)) // 16
        return stamps(t) + pause_s * sum(packet >= packet[-1] * k // 4 for k in (1, 2, 3))

    return stamp


def tenths(t):
    return np.floor(t * 10 + 1e-6) / 10


def twice(values, every):
    return np.sort(np.r_[np.arange(len(values)), np.arange(50, len(values), every)])


def copied(every):
    return lambda r: Recording(
        r.time_s[twice(r.time_s, every)],
        r.specific_force[twice(r.time_s, every)],
        r.angular_rate[twice(r.time_s, every)],
        name="run",
    )


def in_one_tick(r):
    """Two samples to each stamp of a clock of 50 Hz."""
    return changed(r, time_s=np.floor(r.time_s * 50 + 1e-6) / 50)


def held(r):
    source = np.arange(len(r)) - (np.arange(len(r)) % 50 == 49)
    return changed(r, specific_force=r.specific_force[source], angular_rate=r.angular_rate[source])


def drop_repeated(recording, _):
    rows = np.hstack((recording.specific_force, recording.angular_rate))
    return without(recording, 1 + np.flatnonzero((rows[1:] == rows[:-1]).all(axis=1)))


def nan_at(rows):
    def change(values):
        values[rows, 0] = np.nan
        return values

    return change


def without_numbers(recording, _):
    return without(recording, ~np.isfinite(recording.angular_rate).all(axis=1))


def unwrapped(recording, _):
    steps = np.diff(recording.time_s, prepend=0.0)
    return changed(recording, time_s=recording.time_s + 16.384 * np.cumsum(steps < 0))


def shuffled(r):
    """Two blocks of rows are exchanged, as by a writer with two buffers."""
    order = np.r_[0:2000, 2500:3000, 2000:2500, 3000 : len(r)]
    return changed(
        r, time_s=r.time_s[order], specific_force=r.specific_force[order], angular_rate=r.angular_rate[order]
    )


def sorted_by_time(r, _):
    order = np.argsort(r.time_s)
    return changed(
        r, time_s=r.time_s[order], specific_force=r.specific_force[order], angular_rate=r.angular_rate[order]
    )


def cut_where_time_goes_back(r, _):
    return r.rows(np.arange(len(r)) < 1 + np.flatnonzero(np.diff(r.time_s) < 0)[0])


def subtracted(recording, _):
    def signed(values):
        return np.where(values > 32767, values - 65536, values)

    return changed(
        recording,
        specific_force=signed(recording.specific_force),
        angular_rate=signed(recording.angular_rate),
    )


ADVISED = [
    Advised(
        "sensors_not_together",
        "the gyroscope is 0.6 s late",
        late_gyroscope,
        "time stamps have the same zero",
        again,
    ),
    # Units
    Advised(
        "accel_units",
        "g as m/s^2",
        force(lambda f: f / G),
        "name the columns accel_x_g",
        lambda r, _: force(lambda f: f * G)(r),
    ),
    Advised(
        "accel_units",
        "mg as m/s^2",
        force(lambda f: f / G * 1e3),
        "accel_x_mg",
        lambda r, _: force(lambda f: f * G / 1e3)(r),
    ),
    Advised(
        "accel_units",
        "cm/s^2",
        force(lambda f: f * 100),
        "accel_x_cmps2",
        lambda r, _: force(lambda f: f / 100)(r),
    ),
    Advised(
        "accel_units",
        "counts",
        force(lambda f: f * 2000),
        "accel_x_lsb",
        lambda r, _: changed(r, accel_unit="lsb"),
        counts=(2000.0, 1.0),
    ),
    Advised(
        "accel_units", "gravity removed", force(lambda f: f * 0.01), "record the raw specific force", again
    ),
    Advised(
        "accel_units",
        "m/s^2 as g",
        lambda r: changed(force(lambda f: f * G)(r), column_units=("g", "radps")),
        "name the columns accel_x_mps2",
        lambda r, _: force(lambda f: f / G)(r),
    ),
    Advised(
        "accel_units",
        "sensors exchanged",
        lambda r: changed(r, specific_force=r.angular_rate, angular_rate=r.specific_force),
        "swapped",
        lambda r, _: changed(r, specific_force=r.angular_rate, angular_rate=r.specific_force),
    ),
    Advised("gyro_units", "deg/s as rad/s", rate(np.degrees), "gyro_x_dps", lambda r, _: rate(np.radians)(r)),
    Advised(
        "gyro_units", "converted twice", rate(np.radians), "multiply by 57", lambda r, _: rate(np.degrees)(r)
    ),
    Advised(
        "gyro_units",
        "counts as deg/s",
        lambda r: changed(rate(lambda w: w * 65.5)(r), column_units=("mps2", "dps")),
        "gyro_x_lsb",
        lambda r, _: changed(r, angular_rate=np.degrees(r.angular_rate), gyro_unit="lsb"),
        counts=(1.0, np.degrees(65.5)),
    ),
    Advised(
        "gyro_units",
        "half the rate",
        time(lambda t: t * 2),
        "time or the sample rate is wrong by this factor",
        lambda r, _: time(lambda t: t / 2)(r),
    ),
    Advised(
        "gains_differ",
        "one axis in other counts",
        lambda r: changed(counts(r), angular_rate=np.round(r.angular_rate * [7000, 7000, 16000])),
        "scaled separately",
        lambda r, _: changed(r, angular_rate=r.angular_rate * [1, 1, 7 / 16]),
        counts=(2000.0, 7000.0),
    ),
    # Time
    Advised(
        "clock_rate", "ms as s", time(lambda t: t * 1e3), "time_ms", lambda r, _: time(lambda t: t / 1e3)(r)
    ),
    Advised(
        "clock_rate",
        "s as ns",
        time(lambda t: t * 1e-9),
        "name it time_s|after its unit",
        lambda r, _: time(lambda t: t * 1e9)(r),
    ),
    Advised("clock_irregular", "stamps of packets", time(bursts), "rate_hz=", evenly),
    Advised("clock_irregular", "stamps on arrival", time(jitter(0.006)), "rate_hz=", evenly),
    Advised("clock_irregular", "jitter", time(jitter(0.0025)), "rate_hz=", evenly),
    Advised("clock_irregular", "samples in bursts", time(sawtooth), "rate_hz=", evenly),
    Advised("clock_irregular", "late samples", time(late), "nothing needs to be done", nothing),
    Advised("clock_irregular", "late samples, evenly", time(late), "rate_hz=", evenly),
    *(
        Advised(
            "clock_irregular",
            f"{name}, with pauses of {pause_s} s",
            time(paused(stamps, pause_s)),
            "rate_hz=RATE",
            evenly_at_the_configured_rate,
        )
        for name, stamps in (("packets", bursts), ("rounded to 0.1 s", tenths))
        for pause_s in (0.4, 2.5)
    ),
    Advised("time_not_increasing", "counter", time(lambda t: t % 16.384), "unwrap the counter", unwrapped),
    Advised("time_not_increasing", "shuffled", shuffled, "sort its rows", sorted_by_time),
    Advised(
        "time_not_increasing",
        "another run behind",
        lambda r: imucal.Recording(
            np.r_[r.time_s, r.time_s[:300]],
            np.vstack([r.specific_force, r.specific_force[:300]]),
            np.vstack([r.angular_rate, r.angular_rate[:300]]),
            name="run",
        ),
        "cut the recording there",
        cut_where_time_goes_back,
    ),
    Advised("samples_duplicated", "copies of rows", copied(60), "check the logger", nothing),
    Advised("samples_duplicated", "two samples in a tick", in_one_tick, "rate_hz=", evenly),
    Advised("samples_duplicated", "held samples", held, "drop the repeated rows", drop_repeated),
    Advised(
        "samples_missing",
        "one in 101",
        lambda r: without(r, np.arange(70, len(r), 101)),
        "nothing needs to be done",
        nothing,
    ),
    Advised("too_short", "two seconds", lambda r: r.between(0.0, 2.0), "record at least nine rests", again),
    Advised("empty", "no sample", lambda r: r.between(0.0, 0.0), "record rests in many poses", again),
    # Samples
    Advised("non_finite", "NaN", rate(nan_at(slice(300, 310))), "drop these rows", without_numbers),
    Advised(
        "value_impossible",
        "one sample of 1e153",
        rate(lambda w: np.where(np.arange(len(w))[:, None] == 3000, 1e153, w)),
        "leave out these rows",
        lambda r, _: without(r, 3000),
    ),
    Advised(
        "samples_zero",
        "rows of zeros for lost samples",
        lambda r: changed(
            r, specific_force=zeros_in(r.specific_force), angular_rate=zeros_in(r.angular_rate)
        ),
        "leave these rows out of the file",
        lambda r, _: without(r, np.flatnonzero(~r.specific_force.any(axis=1))),
    ),
    Advised(
        "samples_spiked",
        "three samples of 20 rad/s",
        rate(lambda w: w + 20.0 * np.isin(np.arange(len(w)), (700, 3000, 4100))[:, None]),
        "leave out their rows",
        lambda r, _: without(r, [700, 3000, 4100]),
    ),
    Advised(
        "columns_identical",
        "accel_x written twice",
        force(lambda f: f[:, [0, 0, 2]]),
        "a column was written or named twice",
        again,
    ),
    Advised("stuck_axis", "dead", rate(lambda w: w * [1, 0, 1]), "wiring|record|check", again),
    Advised(
        "counts_unsigned",
        "wrapped",
        lambda r: (
            lambda c: changed(c, specific_force=c.specific_force % 65536, angular_rate=c.angular_rate % 65536)
        )(counts(r)),
        "subtract 65536",
        subtracted,
        counts=(2000.0, 7000.0),
    ),
    Advised(
        "gyro_saturation",
        "cut off",
        rate(lambda w: np.clip(w, -1.5, 1.5)),
        "exclude_saturated=True",
        lambda r, _: (r, {"exclude_saturated": True}),
    ),
    Advised(
        "accel_saturation",
        "cut off",
        lambda r: counts(force(lambda f: np.clip(f, -8, 8))(r), accel=32767 / 8),
        "use a larger range",
        again,
    ),
    Advised("recordings_overlap", "twice", lambda r: [r, r], "give every recording once", again),
    Advised(
        "temperature_jump",
        "one sample",
        lambda r: changed(r, temperature_degc=np.where(np.arange(len(r)) == 5000, -40.0, 25.0)),
        "drop it",
        lambda r, _: changed(r),
    ),
    # Axes
    Advised(
        "gravity_sign",
        "FRD",
        lambda r: changed(r.with_axes("frd"), axes="x,y,z"),
        "axes='frd'",
        lambda r, _: r.with_axes("frd"),
    ),
    Advised(
        "gravity_sign",
        "FRD on a stand",
        lambda r: changed(r.with_axes("frd"), stand_rad=r.stand_rad, axes="x,y,z"),
        "^the motor angles show axes with z down",
        lambda r, advice: r.with_axes(option_in(advice, "axes")),
    ),
    Advised(
        "gravity_sign",
        "gravity reversed on a stand",
        lambda r: changed(r, specific_force=-r.specific_force, stand_rad=r.stand_rad),
        "^the motor angles show that the accelerometer",
        lambda r, advice: r.with_axes(option_in(advice, "axes")),
    ),
]


@pytest.mark.parametrize("case", ADVISED, ids=str)
def test_advice(case):
    good = run().recording
    spoilt = case.spoil(good)
    advice = advice_about(case.code, spoilt)
    assert re.search(case.says, advice), advice
    followed = case.follow(spoilt, advice)
    recordings, options = followed if isinstance(followed, tuple) else (followed, {})
    outcome = outcome_of(recordings, truth_of(run(), case.counts), **options)
    assert not outcome.startswith("wrong"), outcome


# Axes that reported columns may have: the matrix of each sensor's columns, and the columns are what it gives.
AXES = {
    "the sign of the gyroscope": ("x,y,z", "-x,-y,-z"),
    "x and z exchanged in both": ("z,y,x", "z,y,x"),
    "x and y exchanged in both": ("y,x,z", "y,x,z"),
    "y reversed in both": ("x,-y,z", "x,-y,z"),
    "gyro_z reversed": ("x,y,z", "x,y,-z"),
    "gyro_x and gyro_y exchanged": ("x,y,z", "y,x,z"),
    "gyro columns rotated": ("x,y,z", "z,x,y"),
    "gyroscope mounted upside down": ("x,y,z", "x,-y,-z"),
    "accel_x reversed": ("-x,y,z", "x,y,z"),
    "accel_y and accel_z exchanged": ("x,z,y", "x,y,z"),
    "gravity and gyro_y reversed": ("-x,-y,-z", "x,-y,z"),
    "gravity and the order of the gyroscope": ("-x,-y,-z", "z,x,y"),
}


def matrix(words):
    rows = np.zeros((3, 3))
    for row, word in enumerate(words.split(",")):
        rows[row, "xyz".index(word[-1])] = -1 if word[0] == "-" else 1
    return rows


@pytest.mark.parametrize("name", AXES)
def test_advice_about_axes(name):
    """The turn of the advice shows which cause it is, and the option of this cause gives the truth."""
    accel, gyro = (matrix(words) for words in AXES[name])
    good = run().recording
    spoilt = changed(
        good, specific_force=good.specific_force @ accel.T, angular_rate=good.angular_rate @ gyro.T
    )
    is_warning = name == "gyro columns rotated" or "order" in name
    code = of_code("axes_turned") if is_warning else of_code("left_handed_axes")
    advice = advice_about(code, spoilt)
    assert "two causes fit" in advice
    # The unit rests so that accel_z reads +1 g and is turned counter-clockwise as seen from above.
    up = accel.T @ [0, 0, 1]
    rates = gyro @ up
    column = re.search(r"If gyro_([xyz]) reads", advice).group(1)
    sign = "positive" if rates["xyz".index(column)] > 0 else "negative"
    part = re.search(
        rf"If gyro_{column} reads a {sign} rate, (.*?)(?=\. If gyro_|$)", advice, re.DOTALL
    ).group(1)
    options = re.findall(r"axes='([^']*)'", part)
    # Each axis of the drawing up: its accel column must read +1 g.
    right = [words for words in options if np.allclose(applied(words, accel), np.eye(3))]
    assert len(right) == 1, part
    outcome = outcome_of(spoilt.with_axes(right[0]), truth_of(run()))
    assert outcome == "truth", (right, outcome)


def applied(words, accel):
    unit = Recording(np.arange(3.0), accel.T, np.zeros((3, 3)))
    return unit.with_axes(words).specific_force.T


@pytest.mark.parametrize("reversed_gravity", [False, True])
def test_advice_about_gravity(reversed_gravity):
    """Without a stand the advice asks; the turn that it names tells z down from a reversed sign."""
    good = run().recording
    accel, gyro = (-np.eye(3), np.eye(3)) if reversed_gravity else [np.diag([1.0, -1.0, -1.0])] * 2
    spoilt = changed(
        good, specific_force=good.specific_force @ accel.T, angular_rate=good.angular_rate @ gyro.T
    )
    advice = advice_about("gravity_sign", spoilt)
    # In the first rest z is up; a counter-clockwise turn is a positive rate about it.
    is_negative = (gyro @ [0, 0, 1])[2] < 0
    asked, otherwise = advice.split("If gyro_z reads a positive rate")
    chosen = asked if is_negative else otherwise
    outcome = outcome_of(spoilt.with_axes(option_in(chosen, "axes")), truth_of(run()))
    assert outcome == "truth", outcome


def test_columns_of_other_lengths_are_refused_before_any_check():
    """The library's own finding, of_code("lengths_differ"), needs columns that a Recording cannot have."""
    good = run().recording
    with pytest.raises(imucal.InputError, match="rows but"):
        Recording(good.time_s[:-1], good.specific_force, good.angular_rate)


def test_every_finding_has_a_test_of_its_advice():
    assert codes() - with_a_test() == set()
