"""The commands that the head of the Makefile lists."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_each_command_of_the_help_is_one_rule():
    text = (ROOT / "Makefile").read_text()
    listed = re.findall(r"^#   make ([\w-]+)", text, re.MULTILINE)
    rules = re.findall(r"^([\w-]+):(?!=)", text, re.MULTILINE)
    assert len(listed) > 25
    assert not set(listed) - set(rules)
    assert len(set(rules)) == len(rules), sorted(rules)
