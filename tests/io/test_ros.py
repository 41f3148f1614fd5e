"""sensor_msgs/Imu from ROS bags and MCAP files, each written by its own library."""

from types import SimpleNamespace

import numpy as np
import pytest

import imucal
from ros_files import ROS1, ROS2, ROS_WRITERS, StoragePlugin, bag1, bag2, mcap1, mcap2, messages


def assert_is(recording, known):
    np.testing.assert_array_equal(recording.time_s, (known.time_ns - known.time_ns[0]) / 1e9)
    np.testing.assert_array_equal(recording.specific_force, known.accel)
    np.testing.assert_array_equal(recording.angular_rate, known.gyro)
    assert (recording.accel_unit, recording.gyro_unit, recording.findings) == ("m/s^2", "rad/s", ())


@pytest.mark.parametrize("name", ROS_WRITERS)
def test_imu_messages_are_the_recording(tmp_path, known, name):
    write, store = ROS_WRITERS[name]
    write(tmp_path / name, {"/imu/data": messages(known, store)})
    recording = imucal.read(tmp_path / name)
    assert_is(recording, known)
    assert recording.name == name
    received = imucal.read(tmp_path / name, receive_time=True)
    # All were received 3 ms late, so the time since the first is the same.
    np.testing.assert_array_equal(received.time_s, recording.time_s)


def test_one_file_of_a_ros_2_bag_is_read(tmp_path, known):
    bag2(tmp_path / "bag", {"/imu/data": messages(known, ROS2)})
    bag2(tmp_path / "mcap", {"/imu/data": messages(known, ROS2)}, storage=StoragePlugin.MCAP)
    assert_is(imucal.read(tmp_path / "bag" / "bag.db3"), known)
    assert_is(imucal.read(tmp_path / "mcap" / "mcap.mcap"), known)
    recording = imucal.read(tmp_path / "bag")
    assert [source.path.rsplit("/", 1)[1] for source in recording.sources] == ["bag.db3", "metadata.yaml"]


def test_names_that_mislead(tmp_path, known):
    bag2(tmp_path / "ros2.bag", {"/imu": messages(known, ROS2)})
    assert_is(imucal.read(tmp_path / "ros2.bag"), known)
    bag1(tmp_path / "drive.bag", {"/imu": messages(known, ROS1)})
    assert_is(imucal.read((tmp_path / "drive.bag").rename(tmp_path / "drive.bag.kept")), known)


@pytest.mark.parametrize("name", ROS_WRITERS)
def test_two_topics_are_listed_and_chosen(tmp_path, known, name):
    write, store = ROS_WRITERS[name]
    other = SimpleNamespace(**{**vars(known), "accel": -known.accel})
    write(tmp_path / name, {"/imu/data": messages(known, store), "/imu/raw": messages(other, store)})
    with pytest.raises(
        imucal.InputError,
        match=rf"{name}: 2 topics .*/imu/data \(400 messages\), /imu/raw \(400 messages\): choose one",
    ):
        imucal.read(tmp_path / name)
    assert_is(imucal.read(tmp_path / name, topic="/imu/data"), known)
    assert_is(imucal.read(tmp_path / name, topic="/imu/raw"), other)
    with pytest.raises(imucal.InputError, match=r"no topic '/imu'; topics of .*: /imu/data"):
        imucal.read(tmp_path / name, topic="/imu")


def test_a_topic_for_each_sensor(tmp_path, known):
    gyro = {"absent": ("accel",)}
    nothing = SimpleNamespace(**{**vars(known), "accel": 0 * known.accel})
    topics = {"/accel": messages(known, ROS1), "/gyro": messages(nothing, ROS1, **gyro)}
    bag1(tmp_path / "drive.bag", topics)
    assert_is(imucal.read(tmp_path / "drive.bag", topic="/accel,/gyro"), known)
    with pytest.raises(
        imucal.FormatError, match=r"linear_acceleration of /gyro is marked as not measured.*--topic"
    ):
        imucal.read(tmp_path / "drive.bag", topic="/gyro")
    with pytest.raises(imucal.InputError, match="3 topics given"):
        imucal.read(tmp_path / "drive.bag", topic="/accel,/gyro,/accel")


def test_topics_of_other_messages_are_named(tmp_path, known):
    bag1(tmp_path / "text.bag", {"/chatter": "std_msgs/msg/String"})
    with pytest.raises(
        imucal.FormatError,
        match=r"no topic has the type sensor_msgs/msg/Imu; found: /chatter \(std_msgs/msg/String\)",
    ):
        imucal.read(tmp_path / "text.bag")
    bag1(tmp_path / "both.bag", {"/chatter": "std_msgs/msg/String", "/imu": messages(known, ROS1)})
    assert_is(imucal.read(tmp_path / "both.bag"), known)
    with pytest.raises(imucal.InputError, match=r"/chatter has the type std_msgs/msg/String, .*: /imu"):
        imucal.read(tmp_path / "both.bag", topic="/chatter")


def test_header_stamps_that_are_not_set(tmp_path, known):
    bag1(tmp_path / "drive.bag", {"/imu": messages(known, ROS1, stamped=False)})
    with pytest.raises(
        imucal.FormatError, match=r"header.stamp of /imu is 0 in all messages.*--receive-time"
    ):
        imucal.read(tmp_path / "drive.bag")
    assert_is(imucal.read(tmp_path / "drive.bag", receive_time=True), known)


def test_no_messages_and_another_serialisation(tmp_path, known):
    bag1(tmp_path / "drive.bag", {"/imu": ()})
    with pytest.raises(imucal.FormatError, match="/imu contains no samples"):
        imucal.read(tmp_path / "drive.bag")
    mcap1(tmp_path / "drive.mcap", {"/imu": messages(known, ROS1)}, encoding="json")
    with pytest.raises(imucal.FormatError, match="'json', but ros1 or cdr is needed"):
        imucal.read(tmp_path / "drive.mcap")


@pytest.mark.parametrize(
    "name", ["drive.bag", "drive.mcap", "bag_sqlite3/bag_sqlite3.db3", "bag_mcap/bag_mcap.mcap"]
)
@pytest.mark.parametrize("kept", [0, 10, 0.5, 0.95])
def test_truncated_files_are_named(tmp_path, known, name, kept):
    write, store = ROS_WRITERS[name.split("/")[0]]
    write(tmp_path / name.split("/")[0], {"/imu": messages(known, store)})
    path = tmp_path / name
    content = path.read_bytes()
    path.write_bytes(content[: kept if isinstance(kept, int) else int(kept * len(content))])
    with pytest.raises(imucal.FormatError, match=path.name) as caught:
        imucal.read(path)
    assert "\n" not in str(caught.value)
    assert "empty (0 bytes)" in str(caught.value) if kept == 0 else "may repair it" in str(caught.value)


def test_folder_of_a_bag_that_is_not_whole(tmp_path, known):
    bag2(tmp_path / "bag", {"/imu": messages(known, ROS2)})
    (tmp_path / "bag" / "bag.db3").unlink()
    with pytest.raises(imucal.FormatError, match=r"bag cannot be read as a ROS bag.*reindex"):
        imucal.read(tmp_path / "bag")
    (tmp_path / "bag" / "metadata.yaml").rename(tmp_path / "bag" / "old.yaml")
    with pytest.raises(imucal.InputError, match=r"is a folder: give the file in it"):
        imucal.read(tmp_path / "bag")


@pytest.mark.slow
def test_examples_run_as_printed(tmp_path, known, example_of):
    bag1(tmp_path / "drive.bag", {"/imu/data": messages(known, ROS1), "/imu/raw": messages(known, ROS1)})
    mcap2(tmp_path / "drive.mcap", {"/imu/data": messages(known, ROS2), "/imu/raw": messages(known, ROS2)})
    for format in ("rosbag", "mcap"):
        assert_is(example_of(format), known)
