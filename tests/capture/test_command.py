"""`imucal capture` on a pseudo-terminal, at whose other end a simulated hand makes mistakes, and is killed.

Times are those of the stream, which are printed with each message: the samples arrive faster than in reality.
"""

import contextlib
import functools
import json
import os
import re
import select
import signal
import subprocess
import sys
import threading

import numpy as np
import pytest

import imucal
from children import HANGS_S, heed_signals, wait_until
from imucal.capture.file import marker_of
from imucal.capture.poses import standard_poses
from simulated_hand import COLUMNS, TEMPLATE, Hand, lines

pty = pytest.importorskip("pty", reason="there are no pseudo-terminals")
tty = pytest.importorskip("tty")

POSES = standard_poses()
MESSAGE = re.compile(r"\[ *([\d.]+) s\] ([A-Z ]+): (.*)")
WITHIN_S = 2.0
# Rows that the unit sends before they are on disk: one second.
AHEAD = 100
# The command says so when it has opened the port, which discards what was sent before.
LISTENS = "no data yet"


class Port:
    """A serial port as a symbolic link to a pseudo-terminal; it can be unplugged and plugged in."""

    def __init__(self, path):
        self.path, self.master, self.slave = path, -1, -1
        self.plug_in()

    def plug_in(self):
        self.master, self.slave = pty.openpty()
        tty.setraw(self.slave)
        os.set_blocking(self.master, False)
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(self.slave))

    def unplug(self):
        self.path.unlink()
        os.close(self.slave)
        os.close(self.master)
        self.master = self.slave = -1

    def send(self, data, said):
        """Send bytes to the process; the rest is dropped once it has ended: nothing makes room for it."""
        view = memoryview(data)
        while view:
            if select.select([], [self.master], [], 0.01)[1]:
                view = view[os.write(self.master, view) :]
            elif not said.goes_on:
                return


class Recorded:
    """The rows of a recording on disk. A unit that waits for them is at most a second ahead of the disk."""

    def __init__(self, path, said):
        self._path, self._said = path, said
        self._lines = self._at = 0

    def wait_for(self, count):
        """Wait until so many rows are on disk, or the process has ended."""
        if self._lines <= count:
            wait_until(lambda: self.rows() >= count or not self._said.goes_on)

    def rows(self):
        """Number of rows on disk."""
        if self._path.exists():
            with self._path.open("rb") as file:
                file.seek(self._at)
                new = file.read()
            self._at += len(new)
            self._lines += new.count(b"\n")
        return self._lines - 1


@pytest.fixture
def port(tmp_path):
    made = Port(tmp_path / "port")
    yield made
    if made.master >= 0:
        made.unplug()


def started(port, output, *options):
    words = [sys.executable, "-m", "imucal", "capture", str(output), "--source", str(port.path)]
    return subprocess.Popen(
        [*words, "--columns", TEMPLATE, "--plain", *options],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        preexec_fn=heed_signals,
    )


class Said:
    """Collects the lines that a process prints."""

    def __init__(self, process):
        self.lines = []
        self._thread = threading.Thread(target=self._read, args=(process,), daemon=True)
        self._thread.start()

    def _read(self, process):
        for line in process.stdout:
            self.lines.append(line.rstrip("\n"))

    def wait(self):
        self._thread.join(HANGS_S)
        return "\n".join(self.lines)

    @property
    def goes_on(self):
        """Whether the process prints, or may do so."""
        return self._thread.is_alive()

    def has(self, words):
        """Whether these words were said; fails if the process has ended without them."""
        found = any(words in line for line in self.lines)
        assert found or self._thread.is_alive(), self.lines
        return found

    @property
    def messages(self):
        found = (MESSAGE.match(line) for line in self.lines)
        return [(float(match[1]), match[2], match[3]) for match in found if match]


def result_of(document):
    """A result without its date."""
    provenance = {name: value for name, value in document["provenance"].items() if name != "date"}
    return {**document, "provenance": provenance}


def calibrated(recording, *options):
    """The document and the calibration file of `imucal calibrate`."""
    saved, document = recording.with_suffix(".again"), recording.with_suffix(".doc")
    words = [sys.executable, "-m", "imucal", "calibrate", recording, "-o", saved, "--json", document]
    done = subprocess.run([*map(str, words), *options], capture_output=True, text=True, timeout=HANGS_S)
    assert done.returncode in (0, 2), done.stderr
    return json.loads(document.read_text()), calibration_of(saved)


def calibration_of(path):
    document = json.loads(path.read_text())
    document["provenance"].pop("date", None)
    return document


def turned(hand, numbers, hold_s=3.6):
    for number in numbers:
        hand.turn_to(POSES[number]).hold(hold_s)
    return hand


def test_ten_mistakes_are_said_and_the_result_is_that_of_calibrate(port, tmp_path):
    hand = turned(Hand().hold(3.6), (1, 2))
    hand.turn_to(POSES[3]).hold(1.2).mark("moves too early")
    hand.turn_to(POSES[1]).mark("repeats a pose").hold(2.5)
    turned(hand, [3]).turn_to(POSES[4]).mark("shakes").shake(3.0).hold(3.6).turn_to(POSES[5])
    hand.hold(4.0).mark("stays").hold(3.0).mark("too fast").turn_to(POSES[6], 0.8).hold(3.6)
    hand.mark("clips").turn_to(POSES[7], 0.3).hold(3.6).mark("drops").turn_to(POSES[8]).hold(3.6)
    turned(hand, [9]).mark("garbage").hold(0.1).turn_to(POSES[10]).hold(3.6)
    hand.mark("unplugs").hold(0.1)
    turned(hand, range(11, 22))
    rows = hand.rows()
    at = {name: round(mark_s * hand.rate_hz) for name, mark_s in hand.marks.items()}
    # A range of 400 deg/s.
    rows[:, 4:] = rows[:, 4:].clip(-7.0, 7.0)
    sent = lines(rows)
    output, document = tmp_path / "hand.csv", tmp_path / "hand.doc"
    process = started(port, output, "--poses", "17", "--json", str(document))
    said = Said(process)
    wait_until(functools.partial(said.has, LISTENS))
    recorded, arrived = Recorded(output, said), 0
    try:
        for number, line in enumerate(sent):
            if number == at["garbage"]:
                port.send(b"\xff\x00 garbage \x81\n3,4\n", said)
            if number == at["unplugs"]:
                wait_until(functools.partial(said.has, "pose 11 of"))
                port.unplug()
                wait_until(functools.partial(said.has, "connection to the unit is lost"))
                port.plug_in()
                wait_until(functools.partial(said.has, "is open again"))
            if at["drops"] <= number < at["drops"] + 60:
                continue
            recorded.wait_for(arrived - AHEAD)
            if not said.goes_on:
                break
            port.send(line, said)
            arrived += 1
    except OSError:
        # The command has ended, and has closed its side.
        assert process.wait(HANGS_S) == 0, said.wait()
    text = said.wait()
    assert process.wait(HANGS_S) == 0, text
    expected = {
        "moves too early": ("NOT TAKEN", "moved too early: held still for 1."),
        "repeats a pose": ("NOT TAKEN", "this is pose 2 again (+x up)"),
        "shakes": ("NOT TAKEN", "it shakes without rotating"),
        "stays": ("NOT TAKEN", "the unit is still in it"),
        "too fast": ("WARNING", "rotated too fast"),
        "clips": ("WARNING", "saturated at 7 rad/s"),
        "drops": ("WARNING", "60 samples are missing"),
        "garbage": ("WARNING", "lines do not have the expected columns"),
        "unplugs": ("WARNING", "the connection to the unit is lost"),
    }
    for name, (kind, words) in expected.items():
        found = [time_s for time_s, word, text in said.messages if word == kind and words in text]
        found = [time_s for time_s in found if time_s >= hand.marks[name] - 0.3]
        assert found and found[0] <= hand.marks[name] + WITHIN_S, (name, hand.marks[name], said.messages)
    captured = json.loads(document.read_text())
    assert captured["ending"] == "finished" and len(captured["poses"]) >= 17
    assert "--exclude-saturated" in text and not marker_of(output).exists()
    again, calibration = calibrated(output, "--exclude-saturated")
    assert result_of(captured["result"]) == result_of(again)
    assert calibration_of(output.with_suffix(".json")) == calibration


def test_wrong_units_are_said_and_an_interrupt_leaves_a_recording(port, tmp_path):
    rows = turned(Hand().hold(3.6), (1,)).rows()
    output = tmp_path / "hand.csv"
    words = [sys.executable, "-m", "imucal", "capture", str(output), "--source", str(port.path), "--plain"]
    in_g = TEMPLATE.replace("_mps2", "_g")
    process = subprocess.Popen(
        [*words, "--columns", in_g],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        preexec_fn=heed_signals,
    )
    said = Said(process)
    wait_until(functools.partial(said.has, LISTENS))
    for line in lines(rows):
        port.send(line, said)
    wait_until(functools.partial(said.has, "pose 2 of 18 is taken"))
    process.send_signal(signal.SIGINT)
    text = said.wait()
    assert process.wait(HANGS_S) == 130 and "the same command continues the recording" in text
    first_s = next(time_s for time_s, _, text in said.messages if "looks like m/s^2" in text)
    assert first_s <= WITHIN_S
    read = imucal.read(output)
    assert len(read) >= len(rows) - 30
    np.testing.assert_array_equal(read.specific_force[:, 0], np.round(rows[: len(read), 1], 6) * 9.80665)


@pytest.mark.parametrize(
    ("kills", "poses", "last_row"), [(4, 14, 6500), pytest.param(12, 18, 9000, marks=pytest.mark.slow)]
)
def test_a_killed_capture_loses_at_most_the_last_second_and_goes_on(kills, poses, last_row, port, tmp_path):
    # A pose that a kill interrupts does not count, and is held again in the second round.
    hand = turned(turned(Hand(seed=kills).hold(3.6), range(1, 20)), range(20))
    hand_rows = hand.rows()
    sent, output = lines(hand_rows), tmp_path / "hand.csv"
    random = np.random.default_rng(kills)
    moments = np.sort(random.choice(np.arange(300, last_row), kills, replace=False))
    first = kept = 0
    for moment in [*moments, len(sent)]:
        process = started(port, output, "--poses", str(poses), "--json", str(tmp_path / "doc"))
        said = Said(process)
        wait_until(functools.partial(said.has, LISTENS))
        assert not first or said.has("are in the file already")
        recorded = Recorded(output, said)
        for number in range(first, moment):
            # It would wait for ever if more than the last second were not on disk.
            recorded.wait_for(kept + number - first - AHEAD)
            if not said.goes_on:
                break
            with contextlib.suppress(OSError):
                port.send(sent[number], said)
        if moment < len(sent):
            process.kill()
            process.wait(HANGS_S)
            said.wait()
            rows = recorded.rows()
            assert moment - first - AHEAD - 2 <= rows - kept <= moment - first
            # Whatever is on disk can be read, and is what was sent.
            read = imucal.read(output)
            assert len(read) == rows
            was_sent = np.round(hand_rows[first : first + rows - kept, 1:4], 6)
            np.testing.assert_array_equal(read.specific_force[kept:], was_sent)
            first, kept = moment, rows
            # What the port still holds is lost with the process that would have read it.
            port.unplug()
            port.plug_in()
    text = said.wait()
    # Poses that were held over a gap can make the verdict poor.
    assert process.wait(HANGS_S) in (0, 2), text
    assert "FINISHED" in text and not marker_of(output).exists()
    assert result_of(json.loads((tmp_path / "doc").read_text())["result"]) == result_of(calibrated(output)[0])


def test_a_file_that_is_there_is_not_overwritten(port, tmp_path):
    output = tmp_path / "hand.csv"
    output.write_text(",".join(COLUMNS) + "\n")
    process = started(port, output)
    assert "exists: give another file" in Said(process).wait() and process.wait(HANGS_S) == 1
    assert output.read_text() == ",".join(COLUMNS) + "\n"


def test_a_pipe(tmp_path):
    """Standard input gives the samples; it ends, and the calibration is made from what there is."""
    sent = b"".join(lines(turned(Hand().hold(3.6), range(1, 14)).rows()))
    words = [sys.executable, "-m", "imucal", "capture", str(tmp_path / "hand.csv"), "--source", "-"]
    done = subprocess.run([*words, "--columns", TEMPLATE], input=sent, capture_output=True, timeout=HANGS_S)
    assert done.returncode == 0, done.stderr
    assert b"14 poses" in done.stdout and b"verdict: good" in done.stdout
    short = subprocess.run(
        [*words[:4], str(tmp_path / "short.csv"), "--source", "-", "--columns", TEMPLATE],
        input=sent[:50000],
        capture_output=True,
        timeout=HANGS_S,
    )
    assert short.returncode == 1 and b"the same command continues it" in short.stdout
