"""Phones as units: messages of Sensor Logger over HTTP and UDP, and the remote access of phyphox.

The servers and clients of these tests are written from the descriptions of the apps. Links and decoders are
constructed here, because the command needs a person for them.
"""

import http.client
import http.server
import json
import socket
import sys
import threading
import time
import types
import urllib.parse

import numpy as np
import pytest

import imucal
from imucal.stand.phone_messages import COLUMNS, PhoneDecoder
from imucal.stand.unit_source import unit_source

START_NS = 1_698_501_144_401_773_000


def samples(name, hz, seconds, late_ns=0):
    """Samples of one sensor, in which x is the time since the start, s."""
    times = [START_NS + late_ns + round(i * 1e9 / hz) for i in range(int(seconds * hz))]
    return [
        {"name": name, "time": t, "values": {"x": (t - START_NS) / 1e9, "y": 1.0, "z": -2.0}} for t in times
    ]


def messages(payload, size=37):
    """Messages of Sensor Logger with the samples in order of time."""
    payload = sorted(payload, key=lambda item: item["time"])
    for number, start in enumerate(range(0, len(payload), size)):
        message = {"messageId": number, "sessionId": "s", "deviceId": "d"}
        yield json.dumps({**message, "payload": payload[start : start + size]}).encode()


@pytest.mark.parametrize(
    ("accel_hz", "gyro_hz", "late_ns"),
    [(100, 100, 0), (100, 100, 3_000_000), (200, 100, 0), (100, 400, 0)],
)
def test_both_sensors_are_brought_to_one_clock(accel_hz, gyro_hz, late_ns):
    decoder, rows = PhoneDecoder(), []
    other = {"name": "barometer", "time": START_NS, "values": {"pressure": 1000}}
    sensors = [*samples("totalacceleration", accel_hz, 4), *samples("gyroscope", gyro_hz, 4, late_ns)]
    for body in messages([*sensors, other]):
        rows += decoder.feed(body + b"\n")
    rows = np.array(rows)
    time_s = (rows[:, 0] - START_NS / 1e3) / 1e6
    assert decoder.columns == COLUMNS and (np.diff(time_s) > 0).all()
    np.testing.assert_allclose(np.diff(time_s), 1 / min(accel_hz, gyro_hz), atol=2e-6)
    # x of both sensors is the time, so it shows a shift of either.
    np.testing.assert_allclose(rows[:, 1], time_s, atol=2e-6)
    np.testing.assert_allclose(rows[:, 4], time_s, atol=2e-6)
    assert len(rows) > 3.8 * min(accel_hz, gyro_hz)
    assert decoder.counts() == {"messages_damaged": 0}


def test_messages_that_do_not_serve_are_explained():
    decoder = PhoneDecoder()
    decoder.feed(b"not json\n{}\n")
    assert decoder.counts() == {"messages_damaged": 2} and "Sensor Logger" in decoder.remark
    for body in messages([*samples("accelerometer", 50, 2), *samples("gyroscope", 50, 2)]):
        assert decoder.feed(body + b"\n") == []
    assert "without gravity" in decoder.remark
    alone = PhoneDecoder()
    for body in messages(samples("totalacceleration", 50, 2)):
        alone.feed(body + b"\n")
    assert "no gyroscope" in alone.remark


def collected(source, count, act):
    """The first `count` samples of a source, which `act` makes arrive."""
    source.start()
    try:
        act()
        rows, end_s = np.zeros((0, len(source.columns))), time.monotonic() + 60
        while len(rows) < count and time.monotonic() < end_s:
            rows = np.concatenate([rows, source.read(0.05)])
    finally:
        source.close()
    assert len(rows) >= count
    return rows


def free_port(kind=socket.SOCK_STREAM):
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def test_sensor_logger_pushes_by_http():
    port = free_port()
    source = unit_source(f"http://127.0.0.1:{port}", baud=0)
    assert f":{port}" in source.hint

    def push():
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
        for body in messages([*samples("totalacceleration", 100, 3), *samples("gyroscope", 100, 3)]):
            indented = json.dumps(json.loads(body), indent=1)
            connection.request("POST", "/data", indented, {"Content-Type": "application/json"})
            answer = connection.getresponse()
            assert (answer.status, answer.read()) == (200, b"")
        connection.close()

    rows = collected(source, 250, push)
    assert source.columns == COLUMNS and rows[0, 2] == 1.0


def test_datagrams_of_messages_and_of_lines():
    port = free_port(socket.SOCK_DGRAM)

    def send(bodies):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            for body in bodies:
                out.sendto(body, ("127.0.0.1", port))
                time.sleep(0.002)

    both = list(messages([*samples("totalacceleration", 100, 2), *samples("gyroscope", 100, 2)], size=5))
    assert len(collected(unit_source(f"udp://127.0.0.1:{port}", baud=0), 150, lambda: send(both)))
    columns = "time_ms,accel_x_g,accel_y_g,accel_z_g,gyro_x_dps,gyro_y_dps,gyro_z_dps"
    plain = [f"{10 * i},0,0,1,0.1,0.2,0.3".encode() for i in range(50)]
    rows = collected(unit_source(f"udp://:{port}", baud=0, columns=columns), 40, lambda: send(plain))
    assert rows[2].tolist() == [20.0, 0.0, 0.0, 1.0, 0.1, 0.2, 0.3]


class Phyphox(http.server.BaseHTTPRequestHandler):
    """The remote access of phyphox: buffers that grow, of which values after a threshold are asked for."""

    started = False
    session = "aaa"
    asked = 0
    buffers = types.MappingProxyType({})

    def do_GET(self):
        kind = type(self)
        parts = urllib.parse.urlsplit(self.path)
        if parts.path == "/config":
            inputs = [
                {"source": source, "outputs": [{a: f"{n}{a.upper()}"} for a in "xyz"] + [{"t": f"{n}_time"}]}
                for source, n in (("accelerometer", "acc"), ("gyroscope", "gyr"))
            ]
            return self.answer({"title": "simple", "inputs": inputs})
        if parts.path == "/control":
            kind.started = parts.query == "cmd=start"
            return self.answer({"result": True})
        kind.asked += 1
        given = {}
        for name, wanted in urllib.parse.parse_qsl(parts.query):
            after, reference = wanted.split("|")
            known = kind.buffers[reference][: 20 * kind.asked]
            values = [v for t, v in zip(known, kind.buffers[name], strict=False) if t > float(after)]
            given[name] = {"size": 0, "updateMode": "partial", "buffer": values}
        status = {"session": kind.session, "measuring": kind.started, "timedRun": False, "countDown": 0}
        return self.answer({"buffer": given, "status": status})

    def answer(self, document):
        body = json.dumps(document).encode()
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_):
        pass


@pytest.fixture
def phyphox():
    times = (np.arange(400) / 100 + 0.01).tolist()
    Phyphox.buffers = {f"{n}{axis}": times for n in ("acc", "gyr") for axis in ("_time", "X", "Y", "Z")}
    Phyphox.started, Phyphox.asked = False, 0
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Phyphox)
    threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True).start()
    yield f"phyphox://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()


def test_phyphox_is_asked_for_what_is_new(phyphox):
    rows = collected(unit_source(phyphox, baud=0), 150, lambda: None)
    assert Phyphox.started
    np.testing.assert_allclose(np.diff(rows[:, 0]), 1e4, atol=1)
    np.testing.assert_allclose(rows[:, 1], rows[:, 0] / 1e6, atol=1e-6)


def test_an_experiment_without_a_gyroscope_is_refused(phyphox, monkeypatch):
    monkeypatch.setattr(Phyphox, "answer", lambda self, _: Phyphox.plain(self), raising=False)
    body = json.dumps({"inputs": [{"source": "accelerometer", "outputs": [{"x": "accX"}]}]}).encode()

    def plain(self):
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    monkeypatch.setattr(Phyphox, "plain", plain, raising=False)
    with pytest.raises(imucal.ImucalError, match="simple experiment"):
        unit_source(phyphox, baud=0).start()


def test_a_topic_of_ros(monkeypatch):
    """An imitation of rclpy that calls back with messages as its documentation describes them."""
    vector = types.SimpleNamespace
    received = []

    class Node:
        def create_subscription(self, kind, topic, callback, qos):
            received.append((kind, topic, callback))

        def destroy_node(self):
            received.append("destroyed")

    rclpy = types.ModuleType("rclpy")
    rclpy.ok, rclpy.init, rclpy.create_node = (lambda: False), (lambda: None), (lambda _: Node())
    rclpy.spin = lambda _: None
    qos = types.ModuleType("rclpy.qos")
    qos.qos_profile_sensor_data = object()
    package, module = types.ModuleType("sensor_msgs"), types.ModuleType("sensor_msgs.msg")
    module.Imu = object
    for made in (rclpy, qos, package, module):
        monkeypatch.setitem(sys.modules, made.__name__, made)

    def publish():
        for i in range(30):
            stamp = vector(sec=5, nanosec=i * 10_000_000)
            received[0][2](
                vector(
                    header=vector(stamp=stamp),
                    linear_acceleration=vector(x=0.5, y=0.0, z=9.75),
                    angular_velocity=vector(x=0.0, y=0.25, z=0.0),
                )
            )

    rows = collected(unit_source("ros2:///imu/data_raw", baud=0), 25, publish)
    assert received[0][1] == "/imu/data_raw" and received[-1] == "destroyed"
    # The first line may be partial for other links, and is left out.
    assert rows[0].tolist()[1:] == [0.5, 0.0, 9.75, 0.0, 0.25, 0.0]
    assert np.diff(rows[:, 0]).tolist() == [1e7] * (len(rows) - 1)


def test_addresses_that_are_wrong():
    for address in ("udp://nowhere", "http://:port", "phyphox://", "phyphox://host:port"):
        with pytest.raises(imucal.InputError, match="is not"):
            unit_source(address, baud=0)
    with pytest.raises(imucal.InputError, match="leave --columns"):
        unit_source("http://:8000", baud=0, columns="time_s,accel_x_g")
    with pytest.raises(imucal.InputError, match="ROS 2 is not installed"):
        unit_source("ros2:///imu", baud=0)
