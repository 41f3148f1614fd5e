"""What has to be reached, and whether it was."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Gate:
    """One aim: its words, what came out, whether that is enough, and of how many cases."""

    what: str
    aim: str
    found: str
    met: bool
    of: int = 0
