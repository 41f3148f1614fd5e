"""A run on a simulated stand: each sample that arrives is written once, however the run ends.

Where the end of a run depends on time, the run is made in virtual time through `record`, because the
command has no option for the clock.
"""

import dataclasses
import errno
import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import imucal
import virtual_clock
from children import heed_signals, wait_until, with_path
from imucal import Program, Step
from imucal.cli import main
from imucal.stand.faults import SimulatedUnit
from imucal.stand.journal import Journal, read_journal
from imucal.stand.progress import parse_target
from imucal.stand.recorder import journal_of, record
from imucal.stand.recovery import recover
from imucal.stand.simulated import SimulatedStand
from virtual_clock import VirtualClock

SHORT = Program((Step((0, 0, 0), 0, 2), Step((90, 0, 0), 1, 2), Step((0, 90, 0), 1, 2)))


def simulated(program=SHORT, speed=1000.0, seed=1, **unit):
    return SimulatedStand(program, SimulatedUnit(**unit), seed=seed, speed=speed)


def test_a_run_writes_every_sample_of_the_unit_once(tmp_path):
    stand = simulated()
    done = record(stand, stand, tmp_path / "run.csv", steps=len(SHORT.steps))
    expected = imucal.simulate(SHORT, seed=1).recording
    written = imucal.read(tmp_path / "run.csv")
    assert (done.state, done.step, done.good) == ("completed", 2, True)
    assert done.samples == len(expected)
    for name in ("time_s", "specific_force", "angular_rate"):
        assert np.array_equal(getattr(written, name), getattr(expected, name))
    # Degrees and back: the last bit may differ.
    assert np.allclose(written.stand_rad, expected.stand_rad, rtol=1e-15, atol=0)
    header = (tmp_path / "run.csv").read_text().splitlines()[0]
    assert header.endswith("stand_1_deg,stand_2_deg,stand_3_deg")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run.csv"]


def test_the_speed_changes_nothing_but_the_time_taken(tmp_path):
    for speed in (200.0, 5000.0):
        stand = simulated(speed=speed)
        record(stand, stand, tmp_path / f"{speed}.parquet", steps=3)
    assert (tmp_path / "200.0.parquet").read_bytes() == (tmp_path / "5000.0.parquet").read_bytes()


@pytest.mark.slow
def test_a_target_ends_the_run_early(tmp_path):
    program = Program.random(seed=1)
    clock = VirtualClock()
    stand = SimulatedStand(program, SimulatedUnit(), seed=1, speed=300.0, clock=clock)
    targets = [parse_target("gyro_bias_*=2e-4"), parse_target("gyro_sensitivity_*=1e-3")]
    output, steps = tmp_path / "run.csv", len(program.steps)
    done = record(stand, stand, output, steps=steps, targets=targets, clock=clock)
    assert done.state == "target_reached"
    assert done.step < steps - 1
    # The calibration of the recording reaches the predicted standard deviations.
    result = imucal.calibrate(imucal.read(output))
    bias = [p.std for p in result.parameters if p.name.startswith("gyro_bias")]
    assert max(bias) < 2e-4 * 1.2


@pytest.mark.slow
def test_a_target_that_is_missed_is_said(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run = ["stand", "run", "random", "--driver", "simulated", "--speed", "2000", "-o", "run.csv"]
    assert main([*run, "--target-sigma", "gyro_bias_*=1e-12"]) == 2
    shown = capsys.readouterr().out
    assert "target_missed: the program ended before" in shown
    assert "run: completed at step" in shown
    assert Path("run.csv").exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--port", "/dev/ttyACM0"), "the driver simulated has no option --port: give --driver grbl"),
        (
            ("--source", "/dev/ttyUSB0"),
            "the driver simulated has no option --source: give --driver grbl or dynamixel or",
        ),
        (("--packet", "no-such.json"), "the driver simulated has no option --packet"),
        (("--sample-rate", "100"), "the driver simulated has no option --sample-rate"),
        (
            ("--driver", "manual", "--speed", "1000"),
            "the driver manual has no option --speed: give --driver sim",
        ),
        (
            ("--driver", "manual", "--port", "x"),
            "the driver manual has no option --port: give --driver grbl or dynamixel, or",
        ),
    ],
)
def test_options_of_another_driver_are_refused(options, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for command in (["run", "random", "-o", "run.csv"], ["calibrate", "-o", "units"]):
        assert main(["stand", *command, *options]) == 1
        assert said in capsys.readouterr().err
        assert not (tmp_path / "run.csv").exists()


def test_targets_that_mean_nothing_are_refused():
    for text in ("gyro_bias_x", "gyro_bias_x=fast", "gyro_bias_x=-1", "gyro_bias_w=1e-4", "=1"):
        with pytest.raises(imucal.InputError, match="the target"):
            parse_target(text)


def test_a_unit_that_falls_silent_ends_the_run_and_keeps_what_it_sent(tmp_path):
    clock = VirtualClock()
    stand = SimulatedStand(SHORT, SimulatedUnit(), seed=1, clock=clock)

    class Mute:
        columns = stand.columns
        start, events, counts, close = stand.start, stand.events, stand.counts, stand.close

        def arrivals(self):
            return stand.arrivals()[: self.taken]

        def read(self, wait_s):
            rows = stand.read(wait_s)
            rows = rows if rows.size and rows[-1, 0] < 3.0 else rows[:0]
            self.taken = len(rows)
            return rows

    class Patient:
        """A driver whose program does not end."""

        start, observe, positions, events, close = (lambda *_: (),) * 5
        progress = staticmethod(lambda: None)
        poll = staticmethod(lambda: imucal.stand.driver.Status("moving", 1))

    done = record(Patient(), Mute(), tmp_path / "run.csv", steps=3, silent_s=0.3, clock=clock)
    assert (done.state, done.good) == ("unit_silent", False)
    assert "cable" in done.message
    assert clock.now_s() == pytest.approx(3.0 + 0.3 + 0.2, abs=0.1)
    assert done.samples == len(imucal.read(tmp_path / "run.csv")) == 600


@pytest.mark.slow
def test_a_journal_that_is_there_is_never_overwritten(tmp_path, command):
    left = journal_of(tmp_path / "run.csv")
    with Journal(left, ("time_s", "a"), {}) as journal:
        journal.samples(np.ones((3, 2)), 0.0)
    before = left.read_bytes()
    done = command("stand", "run", "random", "--driver", "simulated", "-o", tmp_path / "run.csv")
    assert done.returncode == 1
    assert "imucal stand recover" in done.stderr
    assert left.read_bytes() == before
    assert command("stand", "run", "random", "-o", tmp_path / "run.txt").returncode == 1


@pytest.mark.skipif(sys.platform == "win32", reason="there is no fcntl")
def test_a_journal_that_is_being_written_is_not_called_interrupted(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run = ["stand", "run", "random", "-o", "run.csv"]
    with Journal("run.csv.journal", ("time_s", "a"), {}) as journal:
        journal.samples(np.ones((3, 2)), 0.0)
        assert main(run) == 1
        shown = capsys.readouterr().err
        assert "another process is recording into it" in shown
        assert "remove" not in shown
        # A second attempt does not release the lock.
        assert main(run) == 1
        assert "another process is recording into it" in capsys.readouterr().err
    assert main(run) == 1
    assert "belongs to an interrupted run" in capsys.readouterr().err


def test_a_full_disk_says_how_the_recording_is_had(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    SHORT.write("short.json")
    run = ["stand", "run", "short.json", "--speed", "1000", "-o", "run.csv"]
    wanted = "imucal stand recover run.csv.journal -o run.csv"
    with monkeypatch.context() as full:
        full.setattr("imucal.document.temporary.TemporaryFile.replace", full_disk)
        assert main(run) == 1
    shown = capsys.readouterr().err
    assert "No space left on device" in shown
    assert "all 1600 samples are safe in run.csv.journal" in shown
    assert shown.count(wanted) == 1
    assert main(wanted.split()[1:]) == 0
    assert len(imucal.read("run.csv")) == 1600
    assert capsys.readouterr().err == ""


def test_a_disk_that_fills_in_the_run_says_how_the_recording_is_had(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    SHORT.write("short.json")
    write, room = os.write, 60_000

    def until_full(file, data):
        nonlocal room
        room -= len(data)
        return write(file, data) if room > 0 else full_disk()

    with monkeypatch.context() as full:
        full.setattr("os.write", until_full)
        assert main(["stand", "run", "short.json", "--speed", "20", "-o", "run.csv"]) == 1
    shown = capsys.readouterr().err
    wanted = "imucal stand recover run.csv.journal -o run.csv"
    assert "run.csv.journal cannot be written: No space left on device" in shown
    assert shown.count(wanted) == 1
    assert main(wanted.split()[1:]) == 0
    assert f" {len(imucal.read('run.csv'))} samples are safe" in shown


def full_disk(*_, **__):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_bug_says_how_the_recording_is_had(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)

    def broken(*_):
        raise ZeroDivisionError

    monkeypatch.setattr("imucal.stand.recorder.read_journal", broken)
    SHORT.write("short.json")
    assert main(["stand", "run", "short.json", "--speed", "1000", "-o", "run.csv"]) == 1
    assert "imucal stand recover run.csv.journal -o run.csv" in capsys.readouterr().err


def test_a_recording_that_is_there_is_replaced_by_force_alone(tmp_path, capsys):
    SHORT.write(tmp_path / "short.json")
    output = tmp_path / "run.csv"
    output.write_text("of an hour ago")
    given = ["stand", "run", str(tmp_path / "short.json"), "--speed", "1000", "-o", str(output)]
    assert main(given) == 1
    assert "--force" in capsys.readouterr().err
    assert output.read_text() == "of an hour ago"
    assert main([*given, "--force"]) == 0
    assert len(imucal.read(output)) == 1600


# --- the journal ---


@pytest.fixture
def written(tmp_path):
    """A journal of 20 blocks of samples, and where the file ended after each."""
    path, ends, rows = tmp_path / "run.csv.journal", [], []
    draw = np.random.default_rng(3)
    with Journal(path, ("time_s", "value"), {"seed": 3}) as journal:
        for number in range(20):
            block = np.column_stack([np.arange(5) + 5 * number, draw.normal(size=5)])
            journal.samples(block, host_s=float(number))
            journal.positions([(float(number), 1.0, 2.0, 3.0)])
            journal.event(float(number), "step", f"block {number}")
            rows.append(block)
            ends.append(path.stat().st_size)
    return path, ends, np.concatenate(rows)


def test_a_journal_that_cannot_begin_leaves_nothing(tmp_path, monkeypatch):
    path = tmp_path / "run.csv.journal"

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    before = set(Path("/proc/self/fd").iterdir())
    with monkeypatch.context() as disk:
        disk.setattr(os, "write", full)
        with pytest.raises(imucal.InputError, match="No space left"):
            Journal(path, ("time_s", "value"), {})
    assert not path.exists()
    assert set(Path("/proc/self/fd").iterdir()) == before
    with Journal(path, ("time_s", "value"), {}):
        pass


def test_a_power_cut_at_any_byte_costs_the_unfinished_block_alone(written, tmp_path):
    path, ends, rows = written
    content, first = path.read_bytes(), len(path.read_bytes()) - 600
    for length in range(first, len(content) + 1):
        cut = tmp_path / "cut.journal"
        cut.write_bytes(content[:length])
        whole = sum(end <= length for end in ends)
        found = read_journal(cut).samples
        # The samples of a block come before its position and its event.
        assert len(found) in (5 * whole, 5 * whole + 5)
        assert np.array_equal(found, rows[: len(found)])


def test_damage_anywhere_costs_the_blocks_it_hits_and_is_counted(written, tmp_path):
    path, _, rows = written
    content = bytearray(path.read_bytes())
    start = len(content) // 2
    content[start : start + 40] = bytes(40)
    damaged = tmp_path / "damaged.journal"
    damaged.write_bytes(content)
    logged = read_journal(damaged)
    assert 1 <= logged.blocks_lost <= 3
    kept = {tuple(row) for row in logged.samples}
    assert kept <= {tuple(row) for row in rows}
    assert len(rows) - 5 <= len(logged.samples) == len(kept)


def test_a_block_that_stands_twice_is_read_once(written, tmp_path):
    path, ends, rows = written
    content = path.read_bytes()
    twice = tmp_path / "twice.journal"
    twice.write_bytes(content[: ends[9]] + content[ends[4] : ends[9]] + content[ends[9] :])
    assert np.array_equal(read_journal(twice).samples, rows)


@pytest.mark.parametrize("content", [b"", b"time_s,accel\n1,2\n", bytes(5000), b"\x89imJ" * 400])
def test_what_is_no_journal_is_refused(content, tmp_path):
    path = tmp_path / "other.journal"
    path.write_bytes(content)
    with pytest.raises(imucal.FormatError, match="no journal of a run"):
        recover(path, tmp_path / "run.csv")
    assert not (tmp_path / "run.csv").exists()


def test_positions_are_joined_to_the_samples_at_their_instants(tmp_path):
    """Samples arrive up to 30 ms late; their time stamps are regular, so the joined angles are accurate."""
    draw, rate_hz = random.Random(5), 100.0
    path = tmp_path / "run.csv.journal"
    columns = ("time_us", *(f"accel_{a}_mps2" for a in "xyz"), *(f"gyro_{a}_radps" for a in "xyz"))
    with Journal(path, columns, {}) as journal:
        for block in range(100):
            time_s = (np.arange(10) + 10 * block) / rate_hz
            rows = np.column_stack([5e6 + time_s * 1e6, np.ones((10, 6))])
            journal.samples(rows, 1000.0 + time_s[-1] + draw.uniform(0.001, 0.03))
            journal.positions([(1000.0 + time_s[0], 10.0 * time_s[0], 0.0, -20.0 * time_s[0])])
    recover(path, tmp_path / "run.csv")
    read = imucal.read(tmp_path / "run.csv")
    expected = np.degrees(read.stand_rad[:980, 0])
    # At 10 deg/s an unobservable delay of 5 ms is 0.05 deg.
    assert np.abs(expected - 10.0 * read.time_s[:980]).max() < 0.2
    assert np.allclose(read.stand_rad[:980, 2], -2 * read.stand_rad[:980, 0])
    # After the last position of a moving stand its angles are not known.
    assert np.isnan(read.stand_rad[-5:]).all()


# --- killed at any moment ---

# Forks a child for every line it reads. The child runs the stand, prints the number of acknowledged samples,
# and waits to be killed before the run ends. Its stand runs in virtual time, so that the number of
# acknowledgements does not depend on the load of the computer.
KILLED = """
import os, signal, sys
import numpy, pyarrow.csv
from imucal import Program, Step
from imucal.stand.faults import SimulatedUnit
from imucal.stand.simulated import SimulatedStand
import imucal.stand.recorder as recorder
from virtual_clock import VirtualClock

# More frequent acknowledgements than in production, so that an error in them is likely to show.
recorder.SYNC_S = 0.005
# The predicted standard deviations are not needed, and would take most of the time.
recorder.Progress.update = lambda *_, **__: None
program = Program(tuple(Step((40.0, 20.0, 10.0), 0.5, 1.0) for _ in range(50)))
clock = VirtualClock()
stand = SimulatedStand(program, SimulatedUnit(), seed=1, speed=100.0, clock=clock)
for line in sys.stdin:
    # The number of acknowledgements after which the child waits to be killed, and the file.
    limit, name = line.split(maxsplit=1)
    child = os.fork()
    if child == 0:
        told, left = 0, int(limit)
        def tell(moment):
            global told, left
            if moment.acknowledged > told:
                told, left = moment.acknowledged, left - 1
                # One write, so that a kill cannot split the line.
                os.write(1, f"{told}\\n".encode())
            if left == 0:
                signal.pause()
        recorder.record(stand, stand, name.strip(), steps=len(program.steps), watch=tell, clock=clock)
        os._exit(1)
    print("child", child, flush=True)
    os.waitpid(child, 0)
    print("gone", flush=True)
"""


def test_a_unit_with_encoders_of_its_own_needs_no_positions(tmp_path):
    columns = ["time_s"] + [f"accel_{a}_mps2" for a in "xyz"] + [f"gyro_{a}_radps" for a in "xyz"]
    columns += [f"stand_{motor}_rad" for motor in "123"]
    samples = np.zeros((50, len(columns)))
    samples[:, 0], samples[:, 3], samples[:, -1] = np.arange(50) / 100, 9.8, 0.5
    with Journal(tmp_path / "a.journal", columns, {}) as journal:
        journal.samples(samples, 1.0)
        journal.positions([(1.0, 0.0, 0.0, 0.0), (2.0, 1.0, 0.0, 0.0)])
    recover(tmp_path / "a.journal", tmp_path / "a.csv")
    assert np.array_equal(imucal.read(tmp_path / "a.csv").stand_rad[:, 2], samples[:, -1])


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals are POSIX")
def test_killed_at_fifty_moments_every_acknowledged_sample_is_recovered(tmp_path):
    program = Program(tuple(Step((40.0, 20.0, 10.0), 0.5, 1.0) for _ in range(50)))
    expected = imucal.simulate(program, seed=1).recording
    draw, kept = random.Random(11), []
    parent = subprocess.Popen(
        [sys.executable, "-W", "ignore", "-c", KILLED],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=with_path(Path(virtual_clock.__file__).parent),
    )
    for moment in range(50):
        output, limit = tmp_path / f"{moment}.csv", draw.randrange(1, 60)
        parent.stdin.write(f"{limit} {output}\n")
        parent.stdin.flush()
        said, acknowledged = parent.stdout.readline().split(), 0
        # Killed a random time after a random number of acknowledgements.
        while said[0] != "child":
            acknowledged = int(said[0])
            said = parent.stdout.readline().split()
        for _ in range(draw.randrange(0, limit)):
            acknowledged = int(parent.stdout.readline())
        time.sleep(draw.uniform(0.0, 0.02))
        os.kill(int(said[1]), signal.SIGKILL)
        while (line := parent.stdout.readline()) != "gone\n":
            acknowledged = int(line)
        journal = journal_of(output)
        if not acknowledged and len(read_journal_or_none(journal)) == 0:
            kept.append(0)
            continue
        logged = recover(journal, output)
        read = imucal.read(output)
        assert len(read) == len(logged.samples) >= acknowledged
        # The samples of the unit from the first one, each once, bit for bit.
        assert np.array_equal(read.time_s, expected.time_s[: len(read)])
        assert np.array_equal(read.angular_rate, expected.angular_rate[: len(read)])
        kept.append(acknowledged)
    parent.stdin.close()
    parent.wait()
    assert sum(count > 0 for count in kept) > 30
    assert len(set(kept)) > 20


def read_journal_or_none(path):
    try:
        return read_journal(path).samples
    except (imucal.FormatError, imucal.InputError):
        return ()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals are POSIX")
def test_interrupted_the_command_says_where_the_samples_are(tmp_path):
    output = tmp_path / "run.csv"
    command = [Path(sys.executable).with_name("imucal"), "stand", "run", "random"]
    child = subprocess.Popen(
        [*command, "--driver", "simulated", "--speed", "5", "-o", str(output)],
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=heed_signals,
    )
    journal = journal_of(output)
    wait_until(lambda: len(read_journal_or_none(journal)) > 100 or child.poll() is not None)
    assert child.poll() is None, child.stderr.read()
    child.send_signal(signal.SIGINT)
    _, shown = child.communicate()
    assert child.returncode == 130
    assert "Traceback" not in shown
    assert f"imucal stand recover {journal} -o {output}" in shown
    assert not output.exists()
    assert len(recover(journal, output).samples) == len(imucal.read(output)) > 100


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals are POSIX")
def test_a_terminal_that_is_closed_ends_a_run_as_an_interrupt_does(tmp_path):
    import pty

    output = tmp_path / "run.csv"
    command = [Path(sys.executable).with_name("imucal"), "stand", "run", "random", "--speed", "5"]
    child, master = pty.fork()
    if child == 0:
        heed_signals()
        os.execv(command[0], [*map(str, command), "-o", str(output)])
    journal = journal_of(output)
    while len(read_journal_or_none(journal)) <= 100:
        os.read(master, 65536)
    os.close(master)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 128 + signal.SIGHUP
    assert len(recover(journal, output).samples) > 100


# --- the command ---


def test_run_of_a_program_file_by_the_command(tmp_path, command):
    SHORT.write(tmp_path / "program.json")
    done = command(
        *("stand", "run", tmp_path / "program.json", "--driver", "simulated", "--speed", "1000"),
        *("-o", tmp_path / "run.csv", "--json", tmp_path / "run.json", "--unit", "bmi088"),
    )
    assert done.returncode == 0, done.stderr
    # In a pipe there is no live view.
    assert done.stderr == ""
    document = json.loads((tmp_path / "run.json").read_text())
    assert document["state"] == "completed"
    assert document["samples"] == len(imucal.read(tmp_path / "run.csv"))
    assert document["prospect"]["rests"] == 3


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals are POSIX")
def test_a_terminal_shows_what_there_is(tmp_path):
    import pty

    Program.random(seed=1, moves=12).write(tmp_path / "program.json")
    master, slave = pty.openpty()
    command = [Path(sys.executable).with_name("imucal"), "stand", "run", tmp_path / "program.json"]
    child = subprocess.Popen(
        [*command, "--speed", "60", "-o", tmp_path / "run.csv"],
        stderr=slave,
        stdout=subprocess.DEVNULL,
        env={**os.environ, "TERM": "xterm-256color", "COLUMNS": "160", "LINES": "40"},
    )
    os.close(slave)
    shown = b""
    while True:
        try:
            piece = os.read(master, 65536)
        except OSError:
            break
        if not piece:
            break
        shown += piece
    os.close(master)
    assert child.wait() == 0
    text = shown.decode()
    for expected in (
        "of 13",
        "per second",
        "on disk",
        "of all directions",
        "gyroscope bias, predicted sigma",
    ):
        assert expected in text


@pytest.mark.parametrize("options", [("--speed", "0"), ("--fault", "fire"), ("--driver", "steam")])
def test_options_that_mean_nothing(options, tmp_path, command):
    done = command("stand", "run", "random", *options, "-o", tmp_path / "run.csv")
    assert done.returncode == 1
    assert "give" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_program_carries_its_stand(tmp_path):
    cheap = dataclasses.replace(SHORT, stand=imucal.Stand.cheap(4))
    stand = simulated(cheap)
    record(stand, stand, tmp_path / "run.csv", steps=3)
    expected = imucal.simulate(cheap, seed=1).recording
    assert np.array_equal(imucal.read(tmp_path / "run.csv").specific_force, expected.specific_force)
