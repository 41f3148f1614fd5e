"""What has to be reached, and whether it was."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Gate:
    """One aim: its words, what came out, and whether that is enough."""

    what: str
    aim: str
    found: str
    met: bool
