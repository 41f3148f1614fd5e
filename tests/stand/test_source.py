"""What a unit sends: packets and lines, over a serial port, TCP and a pipe; and a person who turns it.

Decoders, links and the manual driver are constructed here, because the command needs hardware for them.
"""

import json
import socket
import struct
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

import imucal
from children import HANGS_S
from imucal import Program, Step
from imucal.stand.lines import LineDecoder
from imucal.stand.link import link_to
from imucal.stand.manual import ManualDriver, pose_text
from imucal.stand.packet import CHECKSUMS, Field, PacketDecoder, PacketFormat
from imucal.stand.recorder import record
from imucal.stand.stream import StreamSource
from serial_lines import Fed

AXES = [
    f"{sensor}_{axis}_{unit}" for sensor, unit in (("accel", "mps2"), ("gyro", "radps")) for axis in "xyz"
]


def test_checksums_have_their_published_check_values():
    """Of "123456789", as the catalogues of CRCs give them."""
    published = {"crc32": 0xCBF43926, "crc16-ccitt": 0x29B1, "crc16-xmodem": 0x31C3, "crc16-modbus": 0x4B37}
    published |= {"crc8": 0xF4, "sum8": 0xDD, "xor8": 0x31}
    assert {name: of(b"123456789") for name, (_, of) in CHECKSUMS.items()} == published


def described(**changes):
    return {
        "schema": "imucal.packet/1",
        "sync": "aa55",
        "byte_order": "big",
        "fields": [
            {"name": "time_us", "type": "uint32"},
            *({"name": name, "type": "float32"} for name in AXES),
            {"name": "-", "type": "uint8"},
            {"name": "temp_degc", "type": "int16", "scale": 0.01, "offset": 20.0},
        ],
        "checksum": {"kind": "crc16-modbus", "over": "fields"},
        **changes,
    }


def test_a_packet_by_hand(tmp_path):
    """Bytes written by hand from the description, and not by the class that reads them."""
    (tmp_path / "packet.json").write_text(json.dumps(described()))
    decoder = PacketDecoder(PacketFormat.read(tmp_path / "packet.json"))
    body = struct.pack(">I6fBh", 123456, 0.5, -1.0, 9.75, 0.25, 0.0, -0.125, 77, -550)
    crc = 0xFFFF
    for byte in body:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    packet = b"\xaa\x55" + body + crc.to_bytes(2, "big")
    rows = [row for byte in packet * 3 for row in decoder.feed(bytes([byte]))]
    assert decoder.columns == ("time_us", *AXES, "temp_degc")
    assert rows == [pytest.approx((123456.0, 0.5, -1.0, 9.75, 0.25, 0.0, -0.125, 14.5))] * 3
    assert decoder.counts() == {"packets_damaged": 0, "bytes_skipped": 0}


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"schema": "imucal.packet/9"}, "imucal.packet/1"),
        ({"sync": "a5z"}, "sync"),
        ({"sync": ""}, "sync"),
        ({"byte_order": "middle"}, "byte_order"),
        ({"checksum": {"kind": "md5"}}, "checksum.kind"),
        ({"fields": [{"name": "time_us", "type": "int24"}]}, r"fields\[0\].type"),
        ({"fields": {}}, "fields"),
    ],
)
def test_a_description_that_is_wrong_names_its_field(changes, named, tmp_path):
    (tmp_path / "packet.json").write_text(json.dumps(described(**changes)))
    with pytest.raises(imucal.FormatError, match=named):
        PacketFormat.read(tmp_path / "packet.json")


def test_the_rest_of_a_packet_that_passes_for_one_by_chance():
    """Cut after ten bytes, with the beginning of the next one it has the right CRC: one in 65536 has."""
    names = [f"{sensor}_{axis}_lsb" for sensor in ("accel", "gyro") for axis in "xyz"]
    fields = (Field("sequence", "uint16"), Field("time_us", "uint32"), *(Field(n, "int16") for n in names))
    form = PacketFormat(b"\xaa\x55", "little", fields, "crc16-ccitt")
    rest = bytes.fromhex("aa55730e9c381c004a99")
    following = bytes.fromhex("aa55740e903a1c004b9933b603f0d329bb462b968d6c")
    false = (rest + following)[: len(following)]
    assert form.sum_of(false[:-2]) == false[-2:]
    for size in (1, 7, 100):
        decoder, stream = PacketDecoder(form), form.pack(*range(8)) + rest + following + form.pack(*range(8))
        pieces = [stream[start : start + size] for start in range(0, len(stream), size)]
        rows = [row for piece in pieces for row in decoder.feed(piece)]
        assert [row[0] for row in rows] == [0.0, 3700.0, 0.0]
        assert decoder.damaged >= 1


def test_lines_by_template_and_checksum():
    decoder = LineDecoder("time_ms,-,accel_x_g*")
    good = b"$12,7,0.5*"
    checksum = 0
    for byte in b"12,7,0.5":
        checksum ^= byte
    good += b"%02x\r\n" % checksum
    assert decoder.feed(b"rest of a line 9\r\n" + good) == [(12.0, 0.5)]
    assert decoder.feed(good.replace(b"0.5", b"0.6") + good[:5]) == []
    assert decoder.feed(good[5:] + b"1,2\r\n" + b"1,2,x*00\r\n") == [(12.0, 0.5)]
    assert decoder.counts() == {"lines_damaged": 3}
    assert LineDecoder("a, b").feed(b"1\t2\n3 ;4\n5\n") == [(1.0, 2.0), (3.0, 4.0)]
    # With another number of values than is named no line is whole, and that is said.
    other = LineDecoder("a,b")
    assert other.feed(b"1,2,3\n" * 5) == []
    assert other.counts() == {"lines_damaged": 4}
    # A line without end does not fill the memory.
    endless = LineDecoder("a")
    for _ in range(100):
        endless.feed(b"1" * 1000)
    assert endless.counts()["lines_damaged"] > 10


def heard(source):
    source.start()
    rows = []
    while not any(event.code == "unit_link_lost" for event in source.events()):
        rows.append(source.read(0.05))
    return np.concatenate([*rows, source.read(0.0)])


def test_counters_that_turn_over_go_on():
    form = PacketFormat(
        b"\x01",
        "little",
        (Field("sequence", "uint8"), Field("time_us", "uint16"), Field("a", "int8")),
        "sum8",
    )
    numbers = [number for number in range(1000) if number not in (300, 301, 777)]
    pieces = [form.pack(n % 256, 100 * n % 65536, n % 100) for n in numbers]
    pieces.insert(500, pieces[499])
    source = StreamSource(Fed(*pieces), PacketDecoder(form))
    rows = heard(source)
    assert source.columns == ("time_us", "a")
    assert rows[:, 0].tolist() == [100.0 * n for n in numbers]
    assert source.counts()["packets_missing"] == 3
    assert source.counts()["packets_repeated"] == 1


@pytest.mark.parametrize("number", ["nan", "inf", "-inf"])
@pytest.mark.parametrize("counter", ["time_us", "sequence"])
def test_a_counter_that_is_no_number_costs_its_sample_alone(counter, number):
    rates = {} if counter == "time_us" else {"rate_hz": 100.0}
    lines = [number, "1", number, "2", "nan", "3", "4"]
    fed = [f"{counted},{n}\n".encode() for n, counted in enumerate(lines)]
    source = StreamSource(Fed(*fed), LineDecoder(f"{counter},a"), **rates)
    rows = heard(source)
    assert rows[:, 1].tolist() == [1.0, 3.0, 5.0]
    assert rows[:, 0].tolist() == ([1.0, 2.0, 3.0] if counter == "time_us" else [0.01, 0.02, 0.03])
    assert source.counts()["counters_not_finite"] == 3
    assert source.counts()["unit_restarts"] == 0


def test_a_unit_that_starts_anew_does_not_go_back_in_time():
    form = PacketFormat(b"\x01", "little", (Field("time_us", "uint32"), Field("a", "int8")), "sum8")
    source = StreamSource(Fed(*(form.pack(t, 0) for t in (900, 1000, 1100, 20, 120))), PacketDecoder(form))
    rows = heard(source)
    assert (np.diff(rows[:, 0]) >= 0).all()
    assert rows[4, 0] - rows[3, 0] == 100.0
    assert source.counts()["unit_restarts"] == 1


def test_time_of_a_unit_that_sends_none():
    form = PacketFormat(b"\x01", "little", (Field("sequence", "uint8"), Field("a", "int8")), "sum8")
    source = StreamSource(Fed(*(form.pack(n, 0) for n in (5, 6, 9))), PacketDecoder(form), rate_hz=100.0)
    assert source.columns == ("time_s", "a")
    assert heard(source)[:, 0].tolist() == [0.05, 0.06, 0.09]
    counted = StreamSource(Fed(b"1\n2\n3\n"), LineDecoder("a"), rate_hz=10.0)
    assert heard(counted)[:, 0].tolist() == [0.0, 0.1, 0.2]
    for decoder, rate_hz in (
        (LineDecoder("a"), None),
        (LineDecoder("time_s,a"), 10.0),
        (LineDecoder("a"), -1),
    ):
        with pytest.raises(imucal.InputError, match="rate"):
            StreamSource(Fed(), decoder, rate_hz=rate_hz)


def lines_of(recording):
    rows = zip(recording.time_s, recording.specific_force, recording.angular_rate, strict=True)
    return [f"{t:.6f},{','.join(map(repr, [*f.tolist(), *w.tolist()]))}\n".encode() for t, f, w in rows]


class Idle:
    """A driver for a unit that is only listened to, until it has sent `count` samples."""

    def __init__(self, count):
        self.count = count

    def observe(self, samples):
        self.count -= len(samples)

    def progress(self):
        return None

    def poll(self):
        from imucal.stand.driver import Status

        return Status("finished" if self.count <= 0 else "moving", 0)

    def start(self):
        pass

    positions = events = close = lambda self: ()


def test_over_tcp_and_again_after_the_connection_broke(tmp_path):
    recording = imucal.simulate(imucal.Static(10.0), seed=1, rate_hz=50.0).recording
    lines = lines_of(recording)
    server = socket.create_server(("127.0.0.1", 0))

    def serve():
        for part in (lines[:200], lines[200:]):
            connection, _ = server.accept()
            connection.sendall(b"".join(part))
            connection.close()

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    link = link_to(f"tcp://127.0.0.1:{server.getsockname()[1]}", 0)
    source = StreamSource(link, LineDecoder(",".join(["time_s", *AXES])))
    done = record(Idle(len(lines)), source, tmp_path / "run.csv", steps=1, silent_s=HANGS_S)
    thread.join()
    server.close()
    assert done.state == "completed"
    assert [event["code"] for event in done.events][:2] == ["unit_link_lost", "unit_link_back"]
    assert np.array_equal(imucal.read(tmp_path / "run.csv").specific_force, recording.specific_force)
    for address in ("tcp://", "tcp://host", "tcp://:12x"):
        with pytest.raises(imucal.InputError, match="tcp"):
            link_to(address, 0)


# --- by hand ---


def test_a_person_is_told_and_believed(tmp_path):
    """What a hand does that trembles, and is late: every pose is seen once, and none that is not held."""
    turns = ((0, 0, 0), (90, 0, 0), (0, 90, 0), (0, 0, 90), (90, 0, 0), (-60, 30, 0))
    asked = Program(tuple(Step(turn, 1.0, 2.0) for turn in turns))
    by_hand = []
    for turn in turns:
        # On the way it is held for too short a time, and in the end 7 deg beside the pose.
        half = tuple(angle / 2 for angle in turn)
        by_hand += [Step(half, 1.5, 0.6), Step(half, 1.5, 4.0)]
    by_hand[-1] = Step((-30, 22, 0), 1.5, 4.0)
    trembling = imucal.Stand(tremor_deg=0.2, tremor_seed=4)
    run = imucal.simulate(Program(tuple(by_hand), trembling), seed=3, unit="random:bmi088:5", rate_hz=100.0)
    recording = run.recording
    rows = np.column_stack([recording.time_s, recording.specific_force, recording.angular_rate])
    driver = ManualDriver(asked, ("time_s", *AXES))
    begun, said = {}, []
    for start in range(0, len(rows), 7):
        driver.observe(rows[start : start + 7])
        status = driver.poll()
        if status.step not in begun:
            begun[status.step] = rows[start, 0]
            said.append(status.message)
        if status.state == "finished":
            break
    assert status.state == "finished"
    # Each is done when it has been held for its 2 s, and not in the short stop on the way.
    held_from_s = np.cumsum([step.move_s + step.hold_s for step in by_hand])[1::2] - 4.0
    took_s = np.array([begun[k + 1] - held_from_s[k] for k in range(1, 5)])
    assert ((took_s > 1.9) & (took_s < 3.0)).all(), took_s
    assert any("+y up" in text or "-y up" in text for text in said), said


def test_poses_in_words():
    assert pose_text(np.array([0.0, 0.0, -1.0])) == "-z up"
    assert pose_text(np.array([0.6, 0.0, -0.8])) == "up between -z and +x (0.60, 0.00, -0.80)"
    with pytest.raises(imucal.InputError, match="accel_x"):
        ManualDriver(Program.random(seed=1, moves=2), ("time_s", "a"))


@pytest.mark.slow
def test_by_hand_with_the_command_and_a_pipe(tmp_path):
    """The unit's lines come on standard input; without a terminal each pose is a line on standard error."""
    program = Program((Step((0, 0, 0), 0.0, 1.0), Step((90, 0, 0), 1.0, 1.0)))
    program.write(tmp_path / "program.json")
    by_hand = Program((Step((0, 0, 0), 0.0, 2.0), Step((90, 0, 0), 1.0, 2.5)))
    lines = lines_of(imucal.simulate(by_hand, seed=1, rate_hz=100.0).recording)
    columns = ",".join(["time_s", *AXES])
    child = subprocess.Popen(
        [
            *(Path(sys.executable).with_name("imucal"), "stand", "run", tmp_path / "program.json"),
            *("--driver", "manual", "--source", "-", "--columns", columns, "-o", tmp_path / "run.csv"),
        ],
        stdin=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    said = [child.stderr.readline()]
    # The first pose is held for 2 s; then the next one is asked for.
    for part in (lines[:200], lines[200:]):
        child.stdin.write(b"".join(part).decode())
        child.stdin.flush()
        said.append(child.stderr.readline())
    assert child.wait() == 0, said
    child.stdin.close()
    assert said[0].startswith("1 of 2: +z up")
    assert said[1].startswith("2 of 2: ")
    assert said[2] == ""
    read = imucal.read(tmp_path / "run.csv")
    assert np.array_equal(read.time_s, np.arange(len(read)) / 100)


SIX = "time_s,accel_x_g,accel_y_g,accel_z_g,gyro_x_dps,gyro_y_dps,gyro_z_dps"


@pytest.mark.parametrize(
    ("options", "asks_for"),
    [
        (("--driver", "grbl"), "--port"),
        (("--driver", "grbl", "--port", "nowhere"), "--source"),
        (("--driver", "manual"), "--source"),
        (("--driver", "manual", "--source", "-"), "--columns"),
        (("--driver", "manual", "--source", "-", "--columns", "a", "--packet", "b"), "either"),
        (("--driver", "manual", "--source", "nowhere", "--columns", "time_s,a"), "accel_x"),
        (("--driver", "grbl", "--port", "nowhere", "--source", "no", "--columns", "time_s,a"), "accel_x"),
        (("--driver", "grbl", "--port", "nowhere", "--source", "no", "--columns", SIX), "cannot be"),
    ],
)
def test_equipment_that_is_incomplete(options, asks_for, tmp_path, monkeypatch, capsys):
    from imucal.cli import main

    monkeypatch.chdir(tmp_path)
    assert main(["stand", "run", "random", *options, "-o", "run.csv"]) == 1
    assert asks_for in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_without_pyserial_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "serial", None)
    with pytest.raises(imucal.ImucalError, match=r"imucal-rs\[stand\]"):
        link_to("/dev/ttyUSB0", 921600)
