"""The grbl driver against a simulated controller, with everything that goes wrong on a bench.

Faults are tested in virtual time, so that no result depends on the load of the computer; the same driver at
pseudo-terminals of the operating system is tested in real time, with deadlines that no load reaches. The
driver is constructed here, and not by the command, because the command has no option for the clock.
"""

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import imucal
from imucal import Program, Step

if sys.platform == "win32":
    pytest.skip("pseudo-terminals are POSIX", allow_module_level=True)

from children import heed_signals, wait_until
from grbl_controller import Controller
from imucal.stand.grbl import GrblDriver
from imucal.stand.grbl_session import Timeouts
from imucal.stand.link import link_to
from imucal.stand.packet import Field, PacketDecoder, PacketFormat
from imucal.stand.recorder import record
from imucal.stand.stream import StreamSource
from serial_lines import MemoryLine, PseudoTerminal
from stand_devices import ControllerDevice, RealTime, UnitDevice
from virtual_clock import VirtualClock

TURNS = ((0, 0, 0), (40, 0, 0), (0, 60, -30), (-20, 0, 90), (35, -20, 10))
PROGRAM = Program(tuple(Step(turn, 1.0 if any(turn) else 0.0, 1.0) for turn in TURNS))
POSES = np.cumsum(TURNS, axis=0)
# Longer than any delay on a busy computer, s.
ENDLESS = Timeouts(answer_s=60.0, stall_s=60.0, reconnect_s=600.0)
UNIT_BAUD, UNIT_HZ = 921600, 500.0
NAMES = (*(f"accel_{axis}_lsb" for axis in "xyz"), *(f"gyro_{axis}_lsb" for axis in "xyz"))
PACKET = PacketFormat(
    b"\xaa\x55",
    "little",
    (Field("sequence", "uint16"), Field("time_us", "uint32"), *(Field(name, "int16") for name in NAMES)),
    "crc16-ccitt",
)


def packet(number):
    """The packet of a sample; its six values identify its number."""
    values = [(number * factor + 7) % 60000 - 30000 for factor in (1, 3, 7, 11, 13, 17)]
    return PACKET.pack(number % 65536, number * 2000 % 2**32, *values)


def damaged(number, whole, draw):
    """Damage 5 % of the packets: bits flipped, bytes lost, noise before the packet, truncated, or missing."""
    if number < 20 or draw.random() > 0.05:
        return whole
    # More than one byte is cut off, because the first byte of the next packet may equal a missing last one.
    kind, at = draw.randrange(5), draw.randrange(1, len(whole) - 4)
    return (
        whole[:at] + bytes([whole[at] ^ draw.randrange(1, 256)]) + whole[at + 1 :],
        whole[:at] + whole[at + draw.randrange(1, 4) :],
        bytes(draw.randrange(256) for _ in range(at)) + whole[:-3],
        whole[:at],
        b"",
    )[kind]


@pytest.fixture
def bench(tmp_path):
    """Run the program with this controller and this unit in virtual time; the result of the run."""

    def run(
        controller=None, program=PROGRAM, unit_damage=None, timeouts=None, latency_s=0.0, watch=None, **device
    ):
        clock = VirtualClock()
        line, unit_line = MemoryLine(115200, latency_s), MemoryLine(UNIT_BAUD)
        stand = ControllerDevice(line, controller or Controller(), **device)
        unit = UnitDevice(unit_line, packet, damage=unit_damage, rate_hz=UNIT_HZ)
        clock.devices += [stand, unit]
        driver = GrblDriver(program, "memory", timeouts=timeouts, clock=clock, open_port=line.open_port)
        source = StreamSource(unit_line, PacketDecoder(PACKET), clock=clock)
        output = tmp_path / "run.csv"
        try:
            done = record(driver, source, output, steps=len(program.steps), watch=watch, clock=clock)
        except Interruption:
            # The controller receives the last bytes.
            clock.sleep(1.0)
            return None, stand, unit, None, None
        return done, stand, unit, *read_back(output)

    return run


@pytest.fixture
def terminals(tmp_path):
    """Run the program at pseudo-terminals, in real time; the result of the run."""

    def run(**device):
        line, unit_line = PseudoTerminal(tmp_path / "controller", 0.01), PseudoTerminal(tmp_path / "unit")
        stand = ControllerDevice(line, Controller(), scale=12.0, **device)
        unit = UnitDevice(unit_line, packet, rate_hz=UNIT_HZ)
        with RealTime(stand, unit):
            driver = GrblDriver(PROGRAM, str(line.path), timeouts=ENDLESS)
            source = StreamSource(link_to(str(unit_line.path), UNIT_BAUD), PacketDecoder(PACKET))
            output = tmp_path / "run.csv"
            done = record(driver, source, output, steps=len(PROGRAM.steps), silent_s=600.0)
        return done, stand, unit, *read_back(output)

    return run


class Interruption(Exception):
    """What a test raises in the middle of a run."""


def read_back(output):
    """The recording, and the numbers of its samples."""
    read = imucal.read(output)
    numbers = np.round(read.time_s * UNIT_HZ).astype(int)
    # Time begins at the first sample that arrived; its values give its number.
    first = int(read.specific_force[0, 0] + 30000 - 7)
    return read, numbers + first


def assert_every_intact_sample_once(unit, read, numbers):
    """Every sample that was sent undamaged is recorded once, and no other sample."""
    assert len(set(numbers)) == len(numbers)
    intact = [number for number in unit.intact if numbers[0] <= number <= numbers[-1]]
    assert numbers.tolist() == intact
    values = np.array([(numbers * f + 7) % 60000 - 30000 for f in (1, 3, 7, 11, 13, 17)]).T
    assert np.array_equal(np.hstack([read.specific_force, read.angular_rate]), values)


def assert_poses_were_held(stand):
    """Each pose of the program was held for its time, in the program's order."""
    held = [pose for pose, hold_s in stand.controller.dwelt if hold_s >= 1.0]
    found = 0
    for pose in held:
        if found < len(POSES) and np.allclose(pose, POSES[found], atol=0.01):
            found += 1
    assert found == len(POSES)


def moving(controller):
    """Whether it moves to the third pose."""
    return len(controller.dwelt) == 2 and controller.speed > 20.0


def holding(controller):
    """Whether it holds the third pose."""
    return len(controller.dwelt) == 3 and controller.dwell is not None


def codes(done):
    return [event["code"] for event in done.events]


def test_a_run_without_trouble(bench):
    done, stand, unit, read, numbers = bench(latency_s=0.01)
    assert (done.state, codes(done)) == ("completed", [])
    assert stand.controller.overflowed == 0
    # The poses, and the return to zero.
    dwelt = np.array([pose for pose, _ in stand.controller.dwelt])
    assert dwelt == pytest.approx(np.array([*POSES, (0, 0, 0)]), abs=1e-3)
    assert_every_intact_sample_once(unit, read, numbers)
    # The recorded angles of the controller range from the first pose to the last and back to zero.
    angles = np.degrees(read.stand_rad)
    assert np.allclose(angles[0], POSES[0], atol=0.01)
    assert np.abs(angles[-1]).max() < 1.0
    for pose in POSES:
        assert (np.abs(angles - pose).max(axis=1) < 0.1).any()
    assert np.ptp(angles, axis=0) == pytest.approx(np.ptp(POSES, axis=0), abs=2.0)


def test_the_start_is_where_the_stand_is(bench):
    controller = Controller()
    controller.position = controller.planned = [100.0, -50.0, 7.0]
    done, stand, _, read, _ = bench(controller)
    assert done.state == "completed"
    assert np.allclose(stand.controller.dwelt[0][0], (100.0, -50.0, 7.0))
    assert np.allclose(stand.controller.dwelt[-2][0], POSES[-1] + (100.0, -50.0, 7.0), atol=1e-3)
    assert np.allclose(stand.controller.dwelt[-1][0], (100.0, -50.0, 7.0), atol=1e-3)
    assert np.allclose(np.degrees(read.stand_rad[0]), 0.0, atol=0.01)


def test_feeds_are_those_that_the_motors_can(bench):
    """A slow controller is not mistaken for a stalled one, and lines never overflow its buffer."""
    slow = Controller(max_rate_dpm=(900.0,) * 3, acceleration=(200.0,) * 3)
    done, stand, unit, read, numbers = bench(slow, latency_s=0.05)
    assert (done.state, codes(done)) == ("completed", [])
    assert_poses_were_held(stand)
    assert_every_intact_sample_once(unit, read, numbers)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_lost_bytes_either_way(bench, seed):
    done, stand, unit, read, numbers = bench(loss=0.01, seed=seed, latency_s=0.005)
    assert stand.lost > 3
    assert done.state == "completed", (done.message, done.events)
    assert_poses_were_held(stand)
    assert_every_intact_sample_once(unit, read, numbers)


def test_damaged_packets_are_counted_and_never_recorded(bench):
    done, _, unit, read, numbers = bench(unit_damage=damaged)
    assert_every_intact_sample_once(unit, read, numbers)
    heard = range(numbers[0], numbers[-1] + 1)
    missing = len(heard) - len(numbers)
    assert missing > 100
    assert done.counts["packets_missing"] == missing
    assert done.counts["packets_damaged"] > 0
    assert done.counts["samples"] == len(read)


class Mishearing(Controller):
    """Executes one line other than the one that was sent, or loses one answer."""

    def __init__(self, heard=None, keeps_ok=True):
        super().__init__()
        self.heard, self.keeps_ok = heard, keeps_ok

    def _execute(self, line):
        if self.heard is not None and "Y60" in line:
            line, self.heard = self.heard(line), None
        super()._execute(line)

    def take(self):
        said = super().take()
        if not self.keeps_ok and self.clock_s > 4.0 and b"ok\r\n" in said:
            said, self.keeps_ok = said.replace(b"ok\r\n", b"o\r\n", 1), True
        return said


@pytest.mark.parametrize(
    ("controller", "code"),
    [
        (lambda: Mishearing(lambda line: line.replace("Y60", "Y6")), "wrong_pose"),
        (lambda: Mishearing(lambda line: line.replace("Y60", "60")), "wrong_pose"),
        (lambda: Mishearing(lambda line: line.replace("Y", "Q")), "error"),
        (lambda: Mishearing(lambda line: line + "G4P1"), "error"),
        (lambda: Mishearing(keeps_ok=False), "stalled"),
    ],
    ids=["digit", "letter", "unknown", "merged", "answer"],
)
def test_what_one_lost_byte_does_is_seen_and_made_good(bench, controller, code):
    done, stand, unit, read, numbers = bench(controller())
    assert done.state == "completed", (done.message, done.events)
    assert codes(done) == [code, "resumed"]
    # A wrong target may be far away; the motors are stopped before they reach it.
    assert stand.controller.reached_deg < 200.0
    assert_poses_were_held(stand)
    assert_every_intact_sample_once(unit, read, numbers)


def reset(port):
    port.controller.reset()


def power_cycle(port):
    port.controller.power_cycle()


def power_cycle_with_a_report(port):
    # The welcome message and a report relative to the new zero arrive together.
    port.controller.power_cycle()
    port.controller.out += port.controller.report()


@pytest.mark.parametrize("event", [reset, power_cycle, power_cycle_with_a_report])
@pytest.mark.parametrize("when", [moving, holding], ids=["moving", "holding"])
def test_a_reset_in_the_middle(bench, event, when):
    done, stand, unit, read, numbers = bench(script=[(when, event)])
    assert done.state == "completed", (done.message, done.events)
    assert "resumed" in codes(done)
    assert_every_intact_sample_once(unit, read, numbers)
    # At rest in a pose the zero position is lost only if the controller loses its supply.
    if when is holding:
        assert ("position_lost" in codes(done)) == (event is not reset)
    if "position_lost" not in codes(done):
        assert_poses_were_held(stand)
    # Recorded angles are continuous whatever the controller's zero is: the last pose is that of the program.
    angles = np.degrees(read.stand_rad)
    assert (np.abs(angles - POSES[-1]).max(axis=1) < 0.1).any()
    assert np.abs(angles[-1]).max() < 1.0


@pytest.mark.parametrize(("code", "ends"), [(1, "alarm"), (2, "alarm"), (3, "completed")])
def test_alarms(bench, code, ends):
    done, stand, unit, read, numbers = bench(script=[(moving, lambda port: port.controller.alarm(code))])
    assert done.state == ends
    assert f"alarm {code}" in str([done.message, *done.events])
    assert_every_intact_sample_once(unit, read, numbers)
    if ends == "completed":
        assert_poses_were_held(stand)
    else:
        assert not done.good
        assert 0 < done.step < len(POSES) - 1
        assert "run the program again" in done.message


def test_locked_when_it_is_switched_on(bench):
    done, stand, *_ = bench(Controller(locked=True))
    assert done.state == "completed"
    assert_poses_were_held(stand)


def test_a_damaged_welcome(bench, monkeypatch):
    import grbl_controller

    monkeypatch.setattr(grbl_controller, "WELCOME", b"\r\nG\xffbl 1.\x001h ['$' fo")
    done, stand, *_ = bench()
    assert done.state == "completed"
    assert_poses_were_held(stand)


def unplug(stand):
    stand.line.unplug()


def plug(stand):
    stand.line.plug()


def unplugged_for(duration_s):
    """Unplug the cable in a move, and plug it again when the controller's time is `duration_s` later."""
    gone_s = []

    def note_and_unplug(stand):
        gone_s.append(stand.controller.clock_s)
        unplug(stand)

    return [(moving, note_and_unplug), (lambda c: c.clock_s > gone_s[0] + duration_s, plug)]


def test_a_cable_that_is_unplugged_and_plugged_again(bench):
    done, stand, unit, read, numbers = bench(script=unplugged_for(6.0))
    assert done.state == "completed", (done.message, done.events)
    assert codes(done)[0] == "controller_lost"
    assert "resumed" in codes(done)
    assert_poses_were_held(stand)
    assert_every_intact_sample_once(unit, read, numbers)


def test_a_cable_that_stays_unplugged(bench):
    done, _, unit, read, numbers = bench(script=[(moving, unplug)])
    assert (done.state, done.good) == ("controller_lost", False)
    assert "check cable and supply" in done.message
    assert done.output is not None
    assert_every_intact_sample_once(unit, read, numbers)


def test_a_controller_that_falls_silent(bench):
    silent = [(moving, lambda stand: setattr(stand, "loss", 1.0))]
    done, _, unit, read, numbers = bench(script=silent)
    assert done.state == "controller_lost"
    assert_every_intact_sample_once(unit, read, numbers)


@pytest.mark.slow
def test_a_run_at_pseudo_terminals(terminals):
    done, stand, unit, read, numbers = terminals()
    assert (done.state, codes(done)) == ("completed", [])
    assert stand.controller.overflowed == 0
    assert_poses_were_held(stand)
    assert_every_intact_sample_once(unit, read, numbers)


@pytest.mark.slow
def test_a_pseudo_terminal_that_goes_and_comes_back(terminals):
    done, stand, unit, read, numbers = terminals(script=unplugged_for(6.0))
    assert done.state == "completed", (done.message, done.events)
    assert codes(done)[0] == "controller_lost"
    assert "resumed" in codes(done)
    assert_poses_were_held(stand)
    assert_every_intact_sample_once(unit, read, numbers)


def test_no_port(tmp_path):
    with pytest.raises(imucal.ImucalError, match="cannot be opened"):
        GrblDriver(PROGRAM, str(tmp_path / "nothing")).start()


def test_a_port_without_a_controller():
    clock, line = VirtualClock(), MemoryLine(115200)
    clock.devices.append(ControllerDevice(line, Controller(), loss=1.0))
    with pytest.raises(imucal.ImucalError, match="baud rate"):
        GrblDriver(PROGRAM, "memory", clock=clock, open_port=line.open_port).start()


def test_the_motors_are_stopped_when_a_run_is_interrupted(bench, tmp_path):
    def watch(moment):
        if moment.status.step >= 2:
            raise Interruption

    _, stand, *_ = bench(watch=watch)
    assert stand.controller.idle
    assert len(stand.controller.dwelt) < len(POSES)
    assert (tmp_path / "run.csv.journal").exists()


def line(number):
    """A sample of the unit, as text."""
    return f"{number * 500},1,2,3,4,5,{number % 100}\n".encode()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)]
)
def test_the_motors_are_stopped_when_the_command_is_ended(name, code, tmp_path):
    # The holds are longer than any delay on a busy computer, so that the program cannot end first.
    long_holds = Program(tuple(Step(turn, 4.0 if any(turn) else 0.0, 600.0) for turn in TURNS[1:]))
    long_holds.write(tmp_path / "program.json")
    output = tmp_path / "run.csv"
    words = ["stand", "run", tmp_path / "program.json", "--driver", "grbl", "-o", output]
    words += ["--columns", ",".join(["time_us", *NAMES])]
    stand = ControllerDevice(PseudoTerminal(tmp_path / "controller"), Controller())
    unit = UnitDevice(PseudoTerminal(tmp_path / "unit"), line, rate_hz=1000.0)
    with (
        RealTime(stand, unit),
        subprocess.Popen(
            [
                Path(sys.executable).with_name("imucal"),
                *(*words, "--port", stand.line.path, "--source", unit.line.path),
                *("--json", tmp_path / "run.json"),
            ],
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=heed_signals,
        ) as child,
    ):
        wait_until(lambda: stand.controller.block is not None or child.poll() is not None)
        assert child.poll() is None, child.stderr.read()
        child.send_signal(name)
        if name == signal.SIGHUP:
            # A shell repeats the terminal's SIGHUP.
            time.sleep(0.01)
            child.send_signal(name)
        _, shown = child.communicate()
        assert child.returncode == code, shown
        # The reset arrives a moment later.
        wait_until(lambda: stand.controller.idle)
        assert len(stand.controller.dwelt) <= 1
    journal = f"{output}.journal"
    assert f"imucal stand recover {journal} -o {output}" in shown
    assert Path(journal).exists()
    assert '"no_result"' in (tmp_path / "run.json").read_text()
