"""The grbl driver against a simulated controller, with everything that goes wrong on a bench.

Faults are tested in virtual time, so that no result depends on the load of the computer; the same driver at
pseudo-terminals of the operating system is tested in real time, with deadlines that no load reaches. The
driver is constructed here, and not by the command, because the command has no option for the clock.
"""

import math
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
from imucal.stand.gcode import Axes
from imucal.stand.grbl import GrblDriver
from imucal.stand.grbl_session import Timeouts
from imucal.stand.grbl_start import Consent
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
# Longer than any delay on a busy computer, s. The driver is silent for a quarter of `answer_s` at its start.
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
        controller=None,
        program=PROGRAM,
        unit_damage=None,
        latency_s=0.0,
        watch=None,
        consent=None,
        axes=None,
        **device,
    ):
        clock = VirtualClock(0.004)
        line, unit_line = MemoryLine(115200, latency_s), MemoryLine(UNIT_BAUD)
        stand = ControllerDevice(line, controller or Controller(), **device)
        unit = UnitDevice(unit_line, packet, damage=unit_damage, rate_hz=UNIT_HZ)
        clock.devices += [stand, unit]
        driver = GrblDriver(
            program, "memory", axes=axes, consent=consent, clock=clock, open_port=line.open_port
        )
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
    found, since_s, poses = 0, None, POSES.tolist()
    for at_s, position in stand.truth:
        if found < len(POSES) and math.dist(position, poses[found]) < 0.03:
            since_s = at_s if since_s is None else since_s
            if at_s - since_s >= 0.95 / stand.scale:
                found, since_s = found + 1, None
        else:
            since_s = None
    assert found == len(POSES)


def codes(done):
    return [event["code"] for event in done.events]


def codes_but_delays(done):
    """The codes of the events without the one that reports the delay of a busy computer."""
    return [code for code in codes(done) if code != "angles_uncertain"]


def test_a_run_without_trouble(bench):
    done, stand, unit, read, numbers = bench(latency_s=0.01)
    assert (done.state, codes(done)) == ("completed", [])
    assert stand.controller.overflowed == 0
    assert_poses_were_held(stand)
    assert np.allclose(stand.controller.position, 0.0, atol=0.01)
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
    done, stand, _, read, _ = bench(controller, consent=Consent(start_here=True))
    assert done.state == "completed"
    assert np.allclose(stand.truth[-1][1], (100.0, -50.0, 7.0), atol=0.01)
    assert np.allclose(np.degrees(read.stand_rad[0]), 0.0, atol=0.01)
    low, high = (f([position for _, position in stand.truth], axis=0) for f in (np.min, np.max))
    assert np.allclose(low - (100, -50, 7), POSES.min(axis=0), atol=0.02)
    assert np.allclose(high - (100, -50, 7), POSES.max(axis=0), atol=0.02)


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
    """Executes one line other than the one that was sent."""

    def __init__(self, heard):
        super().__init__()
        self.heard = heard

    def _execute(self, line):
        if self.heard is not None and line.endswith("G1") and self.position[0] > 1.0:
            line, self.heard = self.heard(line), None
        super()._execute(line)


@pytest.mark.parametrize(
    ("heard", "code"),
    [
        (lambda line: line.replace("X.0Y.0", "X.0"), "wrong_pose"),
        (lambda line: line.replace("Y.0", "Y.8"), None),
        (lambda line: line.replace("Y", "Q"), "line_repeated"),
        (lambda line: line.replace("X", ""), "line_repeated"),
        (lambda line: line + "G4P1", None),
        (lambda line: "", None),
    ],
    ids=["axis", "bit", "unknown", "letter", "merged", "nothing"],
)
def test_a_damaged_move_is_seen_and_made_good(bench, heard, code):
    done, stand, unit, read, numbers = bench(Mishearing(heard))
    assert done.state == "completed", (done.message, done.events)
    assert code is None or code in codes(done)
    # Whatever was misheard, the motors stay in the range of the program.
    positions = np.array([position for _, position in stand.truth])
    assert (positions >= POSES.min(axis=0) - 1.0).all() and (positions <= POSES.max(axis=0) + 1.0).all()
    assert_poses_were_held(stand)
    assert_every_intact_sample_once(unit, read, numbers)


@pytest.mark.parametrize(
    ("consent", "refused"),
    [(Consent(), "--unlock"), (Consent(unlock=True), None), (Consent(home=True), None)],
    ids=["refused", "unlocked", "homed"],
)
def test_a_locked_controller_needs_the_users_word(bench, consent, refused):
    controller = Controller(locked=True, settings={"22": 1})
    if refused:
        with pytest.raises(imucal.ImucalError, match=refused):
            bench(controller, consent=consent)
        assert controller.state == "Alarm"
        return
    done, stand, *_ = bench(controller, consent=consent)
    assert done.state == "completed"
    assert_poses_were_held(stand)


@pytest.mark.parametrize(
    ("settings", "said"),
    [({"10": 0}, r"\$10=1"), ({"20": 1, "130": 30.0}, "soft limits are on"), ({"20": 1, "130": 500.0}, None)],
)
def test_settings_are_refused_by_name(bench, settings, said):
    if said is None:
        assert bench(Controller(settings=settings))[0].state == "completed"
        return
    with pytest.raises(imucal.ImucalError, match=said):
        bench(Controller(settings=settings))


@pytest.mark.parametrize(
    ("state", "said"),
    [("Door", "safety door"), ("Hold", "feed hold"), ("Sleep", "sleeps"), ("Check", "check")],
)
def test_a_start_in_another_state_is_refused_by_name(bench, state, said):
    controller = Controller()
    controller.state, controller.door_open = state, True
    with pytest.raises(imucal.ImucalError, match=said):
        bench(controller)


def test_a_tool_offset_that_the_controller_has_kept_is_cleared(bench):
    """grblHAL keeps it over a reset, and targets are set by it."""
    controller = Controller(hal=True)
    controller.receive(b"G43.1X10Y-20Z30\n")
    controller.advance(0.1)
    done, stand, *_ = bench(controller)
    assert controller.offset != [0.0, 0.0, 0.0] and b"G49" in stand.sent
    assert (done.state, done.events) == ("completed", ())


def test_axes_that_the_controller_lacks_are_refused(bench):
    with pytest.raises(imucal.ImucalError, match="the controller has 3 axes"):
        bench(axes=Axes("ABC"))


@pytest.mark.slow
def test_a_run_at_pseudo_terminals(terminals):
    done, stand, unit, read, numbers = terminals()
    assert (done.state, codes_but_delays(done)) == ("completed", [])
    assert stand.controller.overflowed == 0
    assert_poses_were_held(stand)
    assert_every_intact_sample_once(unit, read, numbers)


@pytest.mark.slow
def test_a_pseudo_terminal_that_goes_and_comes_back(terminals):
    moves, gone_s = lambda device: device.rests == 2 and device.speed_dps > 0.0, []

    def unplug(device):
        gone_s.append(device.now_s)
        device.line.unplug()

    script = [(moves, unplug), (lambda d: d.now_s > gone_s[0] + 0.5, lambda d: d.line.plug())]
    done, stand, unit, read, numbers = terminals(script=script)
    assert done.state == "completed", (done.message, done.events)
    assert codes_but_delays(done)[0] == "controller_lost"
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
    assert stand.rests < len(POSES)
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
        assert stand.rests <= 2
    journal = f"{output}.journal"
    assert f"imucal stand recover {journal} -o {output}" in shown
    assert Path(journal).exists()
    assert '"no_result"' in (tmp_path / "run.json").read_text()
