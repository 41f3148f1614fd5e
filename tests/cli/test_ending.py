"""Signals inside callbacks whose exceptions Python discards.

`as_interrupts` is called directly, because a signal to a command cannot be timed to be inside a callback.
"""

import signal
import sys
import weakref

import pytest

from children import wait_until
from imucal.cli.ending import as_interrupts

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="timers that raise a signal are POSIX")


class Dying:
    """An object to which a weak reference with a callback can point."""


@pytest.fixture
def discarded(monkeypatch):
    """The exceptions that Python discards and that reach its own hook; SIGINT has its usual handler."""
    seen = []
    monkeypatch.setattr(sys, "unraisablehook", lambda given: seen.append(given.exc_type))
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield seen
    signal.signal(signal.SIGINT, before)


def call_back(function):
    """Call a function as the callback of a weak reference."""
    dying = Dying()
    reference = weakref.ref(dying, lambda _: function())
    del dying
    assert reference() is None


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_inside_a_callback_ends_the_command(discarded, number):
    with as_interrupts() as ended, pytest.raises(KeyboardInterrupt):
        call_back(lambda: signal.raise_signal(number))
        wait_until(lambda: False)
    assert ended.what == ("interrupted" if number == signal.SIGINT else "ended by SIGTERM")
    assert ended.code == 128 + number
    assert discarded == []


def test_another_exception_inside_a_callback_is_left_to_python(discarded):
    with as_interrupts():
        call_back(lambda: int("not a number"))
        assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
    assert discarded == [ValueError]


def test_the_end_of_the_block_restores_everything(discarded):
    before = sys.unraisablehook, signal.getsignal(signal.SIGALRM), signal.getsignal(signal.SIGTERM)
    with as_interrupts():
        signal.setitimer(signal.ITIMER_REAL, 60.0)
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
    after = sys.unraisablehook, signal.getsignal(signal.SIGALRM), signal.getsignal(signal.SIGTERM)
    assert after == before
