"""The full screen of a capture, driven without a terminal; and the drawing of a pose."""

import asyncio
import queue
import time

import numpy as np
import pytest

from children import HANGS_S
from imucal.capture.drawing import draw
from imucal.capture.file import CaptureFile, marker_of
from imucal.capture.loop import Capture
from imucal.capture.poses import attitude_with, standard_poses
from imucal.capture.session import Order, Session
from imucal.stand.lines import LineDecoder
from imucal.stand.stream import StreamSource
from simulated_hand import TEMPLATE, Hand, lines

screen = pytest.importorskip("imucal.capture.screen", reason="textual is not installed")


class Fed:
    """A link to which a test gives bytes."""

    name, comes_back, hint = "fed", True, "plug it in"

    def __init__(self):
        self.bytes = queue.SimpleQueue()

    def open(self):
        pass

    def read(self):
        try:
            return self.bytes.get(timeout=0.02)
        except queue.Empty:
            return b""

    def close(self):
        pass


def text_of(app, name):
    return str(app.query_one(name, screen.Static).visual)


def test_the_screen_shows_the_pose_the_hold_the_refusal_and_what_is_added(tmp_path):
    link = Fed()
    source = StreamSource(link, LineDecoder(TEMPLATE))
    hand = Hand().hold(4.0).turn_to(standard_poses()[1]).hold(1.2).turn_to(standard_poses()[2]).hold(1.6)
    sent = b"".join(lines(hand.rows()))
    path = tmp_path / "hand.csv"

    async def played():
        with CaptureFile(path, source.columns, {}) as file:
            app = screen.CaptureScreen(Capture(source, file, Session(source.columns, Order()), print))
            bells = []
            app.bell = lambda: bells.append(1)
            async with app.run_test(size=(120, 40)) as pilot:

                async def until(condition):
                    end_s = time.monotonic() + HANGS_S
                    while not condition():
                        assert time.monotonic() < end_s
                        await pilot.pause(0.05)

                def has_said():
                    messages = "\n".join(line.text for line in app.query_one("#messages").lines)
                    words = ("TAKEN", "moved too early", "NEXT")
                    return all(word in messages for word in words) and "next: +x up" in text_of(app, "#pose")

                link.bytes.put(sent)
                await until(has_said)
                assert bells
                pose, numbers = text_of(app, "#pose"), text_of(app, "#numbers")
                # The drawing has the height of its half of the screen, and no message is cut.
                assert app.query_one("#pose").size.height > 20
                panel = app.query_one("#messages")
                assert max(len(line.text.rstrip()) for line in panel.lines) <= panel.scrollable_size.width
                assert {key.description for key in app.query("FooterKey")} == {
                    "drop the last pose",
                    "end and calibrate",
                    "interrupt, to continue later",
                }
                # Letters of six lines.
                assert text_of(app, "#large").count("\n") >= 5
                await pilot.press("u")
                await until(lambda: not app._capture.session.poses)
                await pilot.press("ctrl+c")
                await until(lambda: app.ending)
            return app, pose, numbers

    app, pose, _numbers = asyncio.run(played())
    assert app.ending == "stopped" and app.error is None
    assert "+x up" in pose and any(0x2800 < ord(letter) < 0x2900 for letter in pose)
    assert not path.exists() or path.read_bytes().endswith(b"\n")
    assert not marker_of(path).exists() or path.exists()


def test_the_drawing_of_a_pose():
    drawings = []
    attitude = np.eye(3)
    for up in standard_poses()[:6]:
        attitude = attitude_with(up, attitude)
        text = draw(attitude, 40, 16).plain
        lines_drawn = text.split("\n")
        assert len(lines_drawn) == 16 and {len(line) for line in lines_drawn} == {40}
        # An axis that points up has its letter above the middle, one that points down below it.
        axis = int(np.argmax(np.abs(up)))
        row = next(i for i, line in enumerate(lines_drawn) if "xyz"[axis] in line)
        assert (row < 8) == (up[axis] > 0)
        drawings.append(text)
    assert len(set(drawings)) == 6
