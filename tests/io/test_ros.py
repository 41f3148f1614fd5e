"""sensor_msgs/Imu from ROS bags and MCAP files, each written by its own library."""

from types import SimpleNamespace

import numpy as np
import pytest
from mcap.writer import Writer as McapWriter
from mcap_ros2.writer import Writer as McapRos2Writer
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin, Writer as Ros2Writer
from rosbags.typesys import Stores, get_typestore

import imucal

IMU = "sensor_msgs/msg/Imu"
ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_JAZZY)
RECEIVED_LATER_NS = 3_000_000


def messages(known, store, *, absent=(), stamped=True):
    """Stamp and Imu message of each sample; `absent` sensors are marked as not measured."""
    make = store.types
    for i, (stamp_ns, force, rate) in enumerate(
        zip(known.time_ns.tolist(), known.accel, known.gyro, strict=True)
    ):
        second, nanosecond = divmod(stamp_ns if stamped else 0, 1_000_000_000)
        header = {"seq": i} if store is ROS1 else {}
        covariance = {sensor: np.full(9, -1.0 if sensor in absent else 0.0) for sensor in ("accel", "gyro")}
        yield (
            stamp_ns,
            make[IMU](
                make["std_msgs/msg/Header"](
                    stamp=make["builtin_interfaces/msg/Time"](second, nanosecond), frame_id="imu", **header
                ),
                make["geometry_msgs/msg/Quaternion"](0, 0, 0, 1),
                np.full(9, -1.0),
                make["geometry_msgs/msg/Vector3"](*rate),
                covariance["gyro"],
                make["geometry_msgs/msg/Vector3"](*force),
                covariance["accel"],
            ),
        )


def bag1(path, topics):
    with Ros1Writer(path) as bag:
        for topic, recorded in topics.items():
            if isinstance(recorded, str):
                connection = bag.add_connection(topic, recorded, typestore=ROS1)
                text = ROS1.types[recorded]("x")
                bag.write(connection, 1, ROS1.serialize_ros1(text, recorded))
                continue
            connection = bag.add_connection(topic, IMU, typestore=ROS1)
            for stamp_ns, message in recorded:
                bag.write(connection, stamp_ns + RECEIVED_LATER_NS, ROS1.serialize_ros1(message, IMU))


def bag2(path, topics, *, storage=StoragePlugin.SQLITE3):
    with Ros2Writer(path, version=9, storage_plugin=storage) as bag:
        for topic, recorded in topics.items():
            connection = bag.add_connection(topic, IMU, typestore=ROS2)
            for stamp_ns, message in recorded:
                bag.write(connection, stamp_ns + RECEIVED_LATER_NS, ROS2.serialize_cdr(message, IMU))


def plain(message):
    """A message of rosbags as the nested attributes that mcap-ros2-support takes."""
    if not hasattr(message, "__dataclass_fields__"):
        return message.tolist() if isinstance(message, np.ndarray) else message
    return SimpleNamespace(**{name: plain(getattr(message, name)) for name in message.__dataclass_fields__})


def mcap2(path, topics):
    definition = ROS2.generate_msgdef(IMU, ros_version=2)[0]
    with path.open("wb") as file:
        writer = McapRos2Writer(file)
        schema = writer.register_msgdef(IMU, definition)
        for topic, recorded in topics.items():
            for stamp_ns, message in recorded:
                writer.write_message(topic, schema, plain(message), log_time=stamp_ns + RECEIVED_LATER_NS)
        writer.finish()


def mcap1(path, topics, *, encoding="ros1"):
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="ros1")
        definition = ROS1.generate_msgdef(IMU, ros_version=1)[0]
        schema = writer.register_schema("sensor_msgs/Imu", "ros1msg", definition.encode())
        for topic, recorded in topics.items():
            channel = writer.register_channel(topic, encoding, schema)
            for stamp_ns, message in recorded:
                raw = bytes(ROS1.serialize_ros1(message, IMU))
                writer.add_message(channel, stamp_ns + RECEIVED_LATER_NS, raw, stamp_ns)
        writer.finish()


def assert_is(recording, known):
    np.testing.assert_array_equal(recording.time_s, (known.time_ns - known.time_ns[0]) / 1e9)
    np.testing.assert_array_equal(recording.specific_force, known.accel)
    np.testing.assert_array_equal(recording.angular_rate, known.gyro)
    assert (recording.accel_unit, recording.gyro_unit, recording.findings) == ("m/s^2", "rad/s", ())


WRITERS = {
    "drive.bag": (bag1, ROS1),
    "bag_sqlite3": (bag2, ROS2),
    "bag_mcap": (lambda path, topics: bag2(path, topics, storage=StoragePlugin.MCAP), ROS2),
    "drive.mcap": (mcap2, ROS2),
    "ros1.mcap": (mcap1, ROS1),
}


@pytest.mark.parametrize("name", WRITERS)
def test_imu_messages_are_the_recording(tmp_path, known, name):
    write, store = WRITERS[name]
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


@pytest.mark.parametrize("name", WRITERS)
def test_two_topics_are_listed_and_chosen(tmp_path, known, name):
    write, store = WRITERS[name]
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
    write, store = WRITERS[name.split("/")[0]]
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
    (tmp_path / "bag" / "metadata.yaml").unlink()
    with pytest.raises(imucal.InputError, match=r"is a folder: give the file in it"):
        imucal.read(tmp_path / "bag")


@pytest.mark.slow
def test_examples_run_as_printed(tmp_path, known, example_of):
    bag1(tmp_path / "drive.bag", {"/imu/data": messages(known, ROS1), "/imu/raw": messages(known, ROS1)})
    mcap2(tmp_path / "drive.mcap", {"/imu/data": messages(known, ROS2), "/imu/raw": messages(known, ROS2)})
    for format in ("rosbag", "mcap"):
        assert_is(example_of(format), known)
