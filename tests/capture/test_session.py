"""The engine of a guided recording, driven by the samples of a simulated hand that makes mistakes.

The session is constructed here, because only it has the time stamps of the events without a process around
it; test_command.py does the same through the command.
"""

import numpy as np
import pytest

import imucal
from imucal.capture.poses import angle_deg, attitude_with, pose_words, standard_poses, turn_words
from imucal.capture.session import Order, Session
from simulated_hand import COLUMNS, Hand

POSES = standard_poses()
# Time within which a mistake must be said, s of the stream.
WITHIN_S = 2.0
DEFAULT = Order()


def session_of(rows, order=DEFAULT, columns=COLUMNS, piece=7):
    """A session that has received these samples, and its events."""
    session, events = Session(columns, order), []
    for start in range(0, len(rows), piece):
        events += session.feed(rows[start : start + piece])
    return session, events


def began(poses=4):
    """A hand that has held the first poses."""
    hand = Hand().hold(3.6)
    for up in POSES[1:poses]:
        hand.turn_to(up).hold(3.6)
    return hand


def in_g(rows):
    return rows / np.array([1, *[9.80665] * 3, 1, 1, 1])


def clipped(rows):
    return np.column_stack([rows[:, :4], rows[:, 4:].clip(-1.2, 1.2)])


def clipped_at_rest(rows):
    return np.column_stack([rows[:, :1], rows[:, 1:4].clip(-9.7, None), rows[:, 4:]])


def coarse(rows):
    """A converter with steps of 0.3 m/s^2, larger than the noise."""
    return np.column_stack([rows[:, :1], np.round(rows[:, 1:4] / 0.3) * 0.3, rows[:, 4:]])


def degrees(rows):
    return np.column_stack([rows[:, :4], np.degrees(rows[:, 4:])])


def radians(rows):
    return np.column_stack([rows[:, :4], np.radians(rows[:, 4:])])


def dropped(rows):
    return np.delete(rows, slice(1900, 1960), axis=0)


def stuck(rows):
    rows = rows.copy()
    rows[:, 5] = rows[0, 5]
    return rows


NEXT, LATER = POSES[4], POSES[5]
# The motion from the mistake on, what is done to the samples, the code of the event, and how long after the
# mark it may come: the mistake of a pose that is left too early is over after 1.2 s.
MISTAKES = {
    "moves too early": (
        lambda h: h.turn_to(NEXT).hold(1.2).mark("mistake").turn_to(LATER).hold(2),
        None,
        "moved_too_early",
    ),
    "repeats a pose": (lambda h: h.turn_to(POSES[2]).mark("mistake").hold(3), None, "repeated"),
    "shakes": (lambda h: h.turn_to(NEXT).mark("mistake").shake(4), None, "shaking"),
    "stays still all the time": (lambda h: h.hold(1.0).mark("mistake").hold(6), None, "stays"),
    "turns too fast": (lambda h: h.mark("mistake").turn_to(NEXT, 0.3).hold(3), None, "too_fast"),
    "clips": (lambda h: h.mark("mistake").turn_to(NEXT, 1.2).hold(3), clipped, "gyro_saturation"),
    "clips at rest": (lambda h: h.turn_to(NEXT).mark("mistake").hold(4), clipped_at_rest, "accel_saturation"),
    "drops samples": (lambda h: h.mark("mistake").hold(4), dropped, "samples_missing"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_said_within_two_seconds(name):
    motion, edit, code = MISTAKES[name]
    hand = motion(began())
    rows = hand.rows() if edit is None else edit(hand.rows())
    _, events = session_of(rows)
    start_s = hand.marks["mistake"]
    said = [event for event in events if event.code == code and event.time_s >= start_s]
    assert said, [event.code for event in events]
    assert said[0].time_s <= start_s + WITHIN_S
    assert len(said[0].text) > 40


@pytest.mark.parametrize(
    ("rate_hz", "lost", "code"),
    [
        # At 50 Hz the limit is five sampling intervals, and at 200 Hz it is 0.05 s.
        (50, 3, "moved_too_early"),
        (50, 5, "interrupted"),
        (200, 8, "moved_too_early"),
        (200, 10, "interrupted"),
    ],
)
def test_a_pose_is_interrupted_by_a_long_gap_of_samples(rate_hz, lost, code):
    hand = Hand(rate_hz=rate_hz).hold(3.6).turn_to(POSES[1]).hold(2.4).turn_to(POSES[2]).hold(1.0)
    in_the_move = round((3.6 + 1.5 + 2.4 + 0.3) * rate_hz)
    rows = np.delete(hand.rows(), slice(in_the_move, in_the_move + lost), axis=0)
    said = [event.code for event in session_of(rows)[1]]
    assert [each for each in said if each in ("moved_too_early", "interrupted")] == [code]


@pytest.mark.parametrize(
    ("edit", "code", "by_s", "words"),
    [
        # The units of the accelerometer show at once, and those of the gyroscope in the first rotation.
        (in_g, "accel_units", 2.0, "accel_x_g"),
        (degrees, "gyro_units", 6.0, "_dps"),
        (radians, "gyro_units", 7.1, "_radps"),
        (stuck, "stuck_axis", 12.2, "gyro_y"),
    ],
)
def test_a_wrong_unit_is_said(edit, code, by_s, words):
    _, events = session_of(edit(began().rows()))
    said = [event for event in events if event.code == code]
    assert said and said[0].time_s <= by_s and words in said[0].text


@pytest.mark.parametrize("up", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0.6, 0, -0.8), (-0.48, 0.6, 0.64)])
def test_an_attitude_with_another_up_is_the_nearest(up):
    before = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    up = np.array(up, dtype=float)
    found = attitude_with(up, before)
    np.testing.assert_allclose(found @ found.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(found @ up, [0, 0, 1], atol=1e-12)
    assert np.linalg.det(found) == pytest.approx(1.0)
    # No rotation between the attitudes is smaller than the angle between the directions.
    turned = np.arccos(np.clip((np.trace(found @ before.T) - 1) / 2, -1, 1))
    assert np.degrees(turned) == pytest.approx(angle_deg(up, before[2]), abs=1e-6)


def test_a_clipped_axis_is_not_said_to_tremble():
    hand = began(6)
    said = {event.code for event in session_of(clipped_at_rest(hand.rows()))[1]}
    assert "accel_saturation" in said and "shaking" not in said
    # A converter whose step exceeds the noise repeats values without being clipped.
    assert "accel_saturation" not in {event.code for event in session_of(coarse(hand.rows()))[1]}


def test_a_good_recording_has_no_complaints_and_ends_by_itself():
    hand = began(18).turn_to(POSES[0]).hold(3)
    rows = hand.rows()
    session, events = session_of(rows)
    assert {event.kind for event in events} <= {"next", "hold", "taken", "finished"}
    assert session.done and len(session.poses) == 18
    # It ends while the last pose is held, before the hand goes on.
    assert len(session.samples) < len(rows) - 300
    assert [angle_deg(pose.up, up) < 3 for pose, up in zip(session.poses, POSES, strict=False)] == [True] * 18
    taken = [event.text for event in events if event.kind == "taken"]
    assert "ppm ->" in taken[-1] and "not determined yet" in taken[0]
    assert session.snapshot.state == "finished" and session.snapshot.missing is None


def test_what_is_said_does_not_depend_on_how_samples_arrive():
    rows = began(6).rows()
    by_one, by_many = session_of(rows, piece=1), session_of(rows, piece=len(rows))
    assert by_one[1] == by_many[1]
    assert [pose.start_s for pose in by_one[0].poses] == [pose.start_s for pose in by_many[0].poses]


def test_undo_drops_the_last_pose_and_all_after_the_one_before():
    rows = began(4).rows()
    session, _ = session_of(rows)
    before = session.poses[-2].end_s
    kept, events = session.undo()
    assert len(session.poses) == 3 and len(session.samples) == kept
    assert before <= session.samples.times_s(session.samples.rows)[-1] <= before + 0.1
    assert events[0].code == "undone" and "pose 4" in events[0].text
    # The pose can be held again; the gap is not said to be missing data.
    again = began(4).turn_to(NEXT).hold(4).rows()[len(rows) :]
    again[:, 0] += 4e6
    events = session.feed(again)
    assert "taken" in [event.code for event in events]
    assert "samples_missing" not in [event.code for event in events]
    for _ in range(5):
        kept, events = session.undo()
    assert (kept, events[0].code) == (0, "nothing_to_undo")


def test_a_recording_is_continued_from_its_samples():
    rows = began(18).rows()
    whole, _ = session_of(rows)
    half = len(rows) // 2
    session = Session(COLUMNS, Order())
    events = session.resume(rows[:half])
    assert events[0].code == "resumed" and len(session.poses) == session_of(rows[:half])[0].snapshot.poses
    session.feed(rows[half:])
    assert session.done
    assert [round(pose.start_s, 1) for pose in session.poses] == [round(p.start_s, 1) for p in whole.poses]


def test_targets_end_the_recording_early_or_late():
    rows = began(18).rows()
    loose, _ = session_of(rows, Order(targets={"accel_sensitivity": "500 ppm"}))
    assert loose.done and 9 <= len(loose.poses) < 18
    tight, events = session_of(rows, Order(poses=10, targets={"gyro_sensitivity": "100 ppm"}))
    assert not tight.done
    assert any(event.code == "not_enough" and "100 ppm" in event.text for event in events)
    with pytest.raises(imucal.InputError, match="accel_size"):
        Order(targets={"accel_size": "1"})
    with pytest.raises(imucal.InputError, match="hold time"):
        Order(hold_s=0.5)


@pytest.mark.parametrize("offset", [0, 32768])
def test_raw_counts(offset):
    """Signed and unsigned counts; the second have their zero in the middle of the range."""
    rows = began(18).rows()
    force, rate = rows[:, 1:4] / 9.80665 * 4096, np.degrees(rows[:, 4:]) * 65.5
    counts = np.round(np.column_stack([force, rate])) + offset
    columns = [name.replace("_mps2", "_lsb").replace("_radps", "_lsb") for name in COLUMNS]
    session, events = session_of(np.column_stack([rows[:, 0], counts]), columns=columns)
    assert session.done and len(session.poses) == 18
    assert {event.kind for event in events} <= {"next", "hold", "taken", "finished"}


def test_the_accelerometer_alone():
    rows = began(18).rows()[:, :4]
    session, events = session_of(rows, columns=COLUMNS[:4])
    assert session.done
    assert "gyro" not in " ".join(event.text for event in events)


@pytest.mark.parametrize("name", ["xsens", "mpu9150"])
def test_real_recordings_of_a_hand(data_file, name):
    """People who rotated a unit by hand, without a guide: their rests count, and nothing false is said."""
    if name == "xsens":
        files = [data_file(f"xsens_mti/xsens_{sensor}.mat") for sensor in ("acc", "gyro")]
        recording, kinds = imucal.read(*files, format="imu_tk").between(0, 120), ("lsb", "lsb")
    else:
        names = ",".join(COLUMNS[1:])
        recording = imucal.read(data_file("mpu9150/imu0.log"), columns=names, rate_hz=100)
        kinds = ("mps2", "radps")
    columns = ["time_s", *(f"accel_{a}_{kinds[0]}" for a in "xyz"), *(f"gyro_{a}_{kinds[1]}" for a in "xyz")]
    rows = np.column_stack([recording.time_s, recording.specific_force, recording.angular_rate])
    _, events = session_of(rows, Order(hold_s=2.0, poses=100), columns)
    assert not {event.code for event in events if event.kind == "warning"} - {"too_fast"}
    rests = imucal.inspect(recording).rests
    seen = [event for event in events if event.code in ("taken", "repeated")]
    assert len(seen) >= 0.6 * sum(rest.end_s - rest.start_s > 2.5 for rest in rests)


def test_words_of_poses():
    assert [pose_words(up) for up in POSES[:2]] == ["+z up", "+x up"]
    assert pose_words(np.array([0.7, 0.02, -0.7])) == "+x and -z up, on an edge"
    assert turn_words(POSES[0], POSES[1]) == "by 90 deg about the y axis"
    assert len(POSES) == 26
    attitude = np.eye(3)
    for up in POSES[1:]:
        attitude = attitude_with(up, attitude)
        np.testing.assert_allclose(attitude[2], up, atol=1e-12)
        np.testing.assert_allclose(attitude @ attitude.T, np.eye(3), atol=1e-12)
