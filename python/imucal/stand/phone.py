"""Phones as units: the HTTP push of Sensor Logger, and the remote access of phyphox.

Both links return messages in the form of Sensor Logger's push, one JSON object per line:

    {"payload": [{"name": "totalacceleration", "time": 1698501144401773000, "values": {"x": ..., "y": ...,
    "z": ...}},
                 {"name": "gyroscope", "time": ..., "values": {...}}]}

with times in ns, and values in m/s^2 and rad/s. Messages of phyphox are converted to this form.

Sources: https://github.com/tszheichoi/awesome-sensor-logger (PUSHING.md, UNITS.md) and
https://phyphox.org/wiki/index.php/Remote-interface_communication.
"""

from __future__ import annotations

import http.client
import http.server
import json
import queue
import threading
import urllib.parse
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any, Final

from imucal.errors import InputError
from imucal.stand.link import WAIT_S, Link, LinkLostError, host_and_port, own_address

__all__ = ["phone_link"]

# Longest accepted message of a phone, bytes. A batch of 10 s of all sensors has about 1 MB.
LONGEST_MESSAGE: Final = 16 << 20
# Timeout of a request to the phone, s.
REQUEST_S: Final = 3.0
# Interval between two requests, s.
EVERY_S: Final = 0.1
# Ports of the remote access of phyphox on Android, and on iOS.
PHYPHOX_PORTS: Final = (8080, 80)
# Inputs of a phyphox experiment, and the names of their samples in a message.
PHYPHOX_INPUTS: Final = {"accelerometer": "totalacceleration", "gyroscope": "gyroscope"}
NO_SENSORS: Final = (
    "the phyphox experiment does not record both sensors: add a simple experiment with accelerometer and "
    "gyroscope (the + button), open it, and switch on remote access"
)


def phone_link(address: str) -> Link:
    """The link for http://[HOST]:PORT (Sensor Logger) or phyphox://HOST[:PORT]."""
    if address.startswith("http://"):
        return _SensorLogger(*host_and_port(address, "http://:PORT, the port to which Sensor Logger pushes"))
    given = urllib.parse.urlsplit(address)
    try:
        port = given.port
    except ValueError:
        port = -1
    if not given.hostname or port == -1:
        raise InputError(f"the address {address!r} is not phyphox://HOST or phyphox://HOST:PORT")
    return _Phyphox(given.hostname, port)


class _SensorLogger:
    """A web server to which Sensor Logger pushes its messages."""

    comes_back = True

    def __init__(self, host: str, port: int) -> None:
        self.name = f"http://{host}:{port}"
        self.hint = (
            "in Sensor Logger, switch on Total Acceleration, Gyroscope and HTTP Push to "
            f"http://{own_address()}:{port} "
            "with the shortest batch period, and start recording"
        )
        self._address = (host, port)
        self._server: http.server.ThreadingHTTPServer | None = None
        self._messages: queue.SimpleQueue[bytes] = queue.SimpleQueue()

    def open(self) -> None:
        messages = self._messages

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                length = self.headers.get("Content-Length", "")
                if not length.isdigit() or int(length) > LONGEST_MESSAGE:
                    self.send_error(413 if length.isdigit() else 411)
                    return
                # Line ends are replaced, so that a message is one line. This is valid, because strings of
                # JSON contain no line ends.
                messages.put(self.rfile.read(int(length)).replace(b"\n", b" ") + b"\n")
                self.send_response(200)
                self.send_header("Content-Length", "0")
                self.end_headers()

            def log_message(self, *_: object) -> None:
                """Requests are not printed, because they would disturb the live view of the run."""

        try:
            self._server = http.server.ThreadingHTTPServer(self._address, Handler)
        except OSError as error:
            raise LinkLostError(f"{self.name} cannot be opened: {error}") from None
        self._server.daemon_threads = True
        threading.Thread(
            target=self._server.serve_forever, kwargs={"poll_interval": WAIT_S}, daemon=True
        ).start()

    def read(self) -> bytes:
        try:
            return self._messages.get(timeout=WAIT_S)
        except queue.Empty:
            return b""

    def close(self) -> None:
        if self._server is not None:
            self._server.shutdown()
            self._server.server_close()
            self._server = None


class _Phyphox:
    """The remote access of phyphox, from which new samples are requested repeatedly."""

    comes_back = True

    def __init__(self, host: str, port: int | None) -> None:
        self._host, self._ports = host, PHYPHOX_PORTS if port is None else (port,)
        self.name = f"phyphox://{host}"
        self.hint = f"in phyphox, start the experiment, and keep remote access to http://{host} switched on"
        self._connection: http.client.HTTPConnection | None = None
        # For each input of the experiment, the names of the buffers of t, x, y and z.
        self._buffers: dict[str, tuple[str, ...]] = {}
        self._last = dict.fromkeys(PHYPHOX_INPUTS, 0.0)
        self._session = ""
        self._pause = threading.Event()

    def open(self) -> None:
        error: Exception | None = None
        for port in self._ports:
            self._connection = http.client.HTTPConnection(self._host, port, timeout=REQUEST_S)
            try:
                self._buffers = _buffers(self._get("/config"))
                self._get("/control?cmd=start")
                return
            except LinkLostError as failed:
                error = failed
                self.close()
        raise LinkLostError(str(error))

    def read(self) -> bytes:
        self._pause.wait(EVERY_S)
        given = self._get("/get?" + "&".join(self._requests()))
        session = str(_of(given, "status", {}).get("session", ""))
        if session != self._session:
            # The user has cleared the measurement, so its time starts at zero again.
            if self._session:
                self._last = dict.fromkeys(PHYPHOX_INPUTS, 0.0)
                self._session = session
                return b""
            self._session = session
        payload = []
        for source, names in self._buffers.items():
            columns = [_of(_of(given, "buffer", {}), name, {}).get("buffer", []) for name in names]
            for t, *xyz in zip(*columns, strict=False):
                if t is None or None in xyz or t <= self._last[source]:
                    continue
                self._last[source] = t
                values = dict(zip("xyz", xyz, strict=True))
                payload.append({"name": PHYPHOX_INPUTS[source], "time": round(t * 1e9), "values": values})
        return json.dumps({"payload": payload}).encode() + b"\n" if payload else b""

    def close(self) -> None:
        if self._connection is not None:
            with suppress(OSError):
                self._connection.close()
            self._connection = None

    def _requests(self) -> list[str]:
        """Parameters of a request: for each buffer, its name and the time after which values are wanted."""
        return [
            urllib.parse.quote(name) + f"={self._last[source]!r}%7C" + urllib.parse.quote(names[0])
            for source, names in self._buffers.items()
            for name in names
        ]

    def _get(self, path: str) -> Any:
        assert self._connection is not None
        try:
            self._connection.request("GET", path)
            given = json.loads(self._connection.getresponse().read())
        except (OSError, http.client.HTTPException, ValueError) as error:
            raise LinkLostError(f"{self.name} does not answer: {error or type(error).__name__}") from None
        return given


def _buffers(config: Any) -> dict[str, tuple[str, ...]]:
    """For each sensor: names of phyphox's data buffers of t, x, y and z, from the configuration."""
    found: dict[str, tuple[str, ...]] = {}
    for item in _of(config, "inputs", []):
        outputs: dict[str, str] = {}
        for output in _of(item, "outputs", []):
            outputs.update(output if isinstance(output, Mapping) else {})
        if item.get("source") in PHYPHOX_INPUTS and all(axis in outputs for axis in "txyz"):
            found[item["source"]] = tuple(outputs[axis] for axis in "txyz")
    if len(found) < len(PHYPHOX_INPUTS):
        raise LinkLostError(NO_SENSORS)
    return found


def _of(given: Any, name: str, default: Any) -> Any:
    """A field of a JSON object if it has the type of the default; otherwise the default."""
    value = given.get(name) if isinstance(given, Mapping) else None
    kind = Sequence if isinstance(default, list) else Mapping
    return value if isinstance(value, kind) and not isinstance(value, str) else default
