"""Processes that a test starts, and sends signals to."""

import signal


def heed_signals():
    """What a child calls before its command.

    A test run in the background of a script ignores SIGINT, one under nohup SIGHUP, and a child would, too.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
