"""Damage to files: bits, numbers, parts, lines and JSON values, from seeded random numbers."""

import json
import random
import struct
from copy import deepcopy

# Numbers at the ends of the ranges of lengths, offsets and values.
INTEGERS = [
    0,
    1,
    2,
    127,
    128,
    255,
    256,
    32767,
    65535,
    2**31 - 1,
    2**31,
    2**32 - 1,
    2**53,
    2**63 - 1,
    2**64 - 1,
]
NUMBERS = [
    "nan",
    "inf",
    "-inf",
    "1e308",
    "-1.7e153",
    "1e-320",
    "0",
    "-0",
    "",
    "x",
    "1,5",
    "99999999999999999999",
]
VALUES = [None, True, 0, -1, 1e308, 1.7e153, 2**70, "", "x\u2028", [], {}, [[]], [0] * 50, "9" * 300]
MOST_CHANGES = 4


def mutated(content, seed, *, is_text=False, is_json=False):
    """The bytes of a file with one to four changes."""
    chance = random.Random(seed)
    if is_json and chance.random() < 0.8:
        document = json.loads(content)
        for _ in range(chance.randint(1, MOST_CHANGES)):
            document = _change_value(document, chance)
        return json.dumps(document).encode()
    changes = BYTES + LINES if is_text else BYTES
    for _ in range(chance.randint(1, MOST_CHANGES)):
        if content:
            content = chance.choice(changes)(content, chance)
    return content


def _flip_bits(content, chance):
    changed = bytearray(content)
    for _ in range(chance.choice([1, 1, 2, 8])):
        changed[chance.randrange(len(changed))] ^= 1 << chance.randrange(8)
    return bytes(changed)


def _set_integer(content, chance):
    size, order = chance.choice([1, 2, 4, 8]), chance.choice("<>")
    number = chance.choice([*INTEGERS, chance.getrandbits(64), len(content)]) % 2 ** (8 * size)
    at = chance.randrange(len(content))
    raw = struct.pack(order + {1: "B", 2: "H", 4: "I", 8: "Q"}[size], number)
    return content[:at] + raw + content[at + size :]


def _remove_part(content, chance):
    start, end = _part(content, chance)
    return content[:start] + content[end:]


def _repeat_part(content, chance):
    start, end = _part(content, chance)
    return content[:end] + content[start:end] * chance.choice([1, 1, 3]) + content[end:]


def _move_part(content, chance):
    start, end = _part(content, chance)
    rest = content[:start] + content[end:]
    at = chance.randint(0, len(rest))
    return rest[:at] + content[start:end] + rest[at:]


def _fill_part(content, chance):
    start, end = _part(content, chance)
    return (
        content[:start]
        + bytes([chance.choice([0, 255, chance.randrange(256)])]) * (end - start)
        + content[end:]
    )


def _insert(content, chance):
    at = chance.randint(0, len(content))
    return content[:at] + chance.randbytes(chance.choice([1, 4, 64])) + content[at:]


def _cut(content, chance):
    return content[: chance.randrange(len(content))]


def _change_cell(content, chance):
    lines = content.split(b"\n")
    at = chance.randrange(len(lines))
    cells = lines[at].split(b",")
    cells[chance.randrange(len(cells))] = chance.choice(NUMBERS).encode()
    return b"\n".join([*lines[:at], b",".join(cells), *lines[at + 1 :]])


def _change_line(content, chance):
    lines = content.split(b"\n")
    at = chance.randrange(len(lines))
    replaced = chance.choice(
        [[], [lines[at]] * 2, [lines[at] + b","], [b"# note"], [b""], [b'"' + lines[at]]]
    )
    return b"\n".join([*lines[:at], *replaced, *lines[at + 1 :]])


def _change_ends(content, chance):
    return content.replace(b"\n", chance.choice([b"\r\n", b"\r", b"\n\n"]), chance.choice([1, -1]))


def _change_separator(content, chance):
    return content.replace(b",", chance.choice([b";", b"\t", b" ", b",,"]), chance.choice([1, 7, -1]))


BYTES = [
    _flip_bits,
    _set_integer,
    _set_integer,
    _remove_part,
    _repeat_part,
    _move_part,
    _fill_part,
    _insert,
    _cut,
]
LINES = [
    _change_cell,
    _change_cell,
    _change_cell,
    _change_line,
    _change_line,
    _change_ends,
    _change_separator,
]


def _part(content, chance):
    start = chance.randrange(len(content))
    return start, min(len(content), start + chance.choice([1, 2, 8, 64, 512, len(content) // 2 + 1]))


def _change_value(document, chance):
    places = list(_places(document))
    if not places:
        return deepcopy(chance.choice(VALUES))
    container, key = chance.choice(places)
    action = chance.randrange(10)
    value = container[key]
    if action < 2:
        del container[key]
    elif action < 5 and isinstance(value, int | float) and not isinstance(value, bool):
        container[key] = chance.choice([-value, value * 10, value * 1e-9, value + 1, value * 1e300, 0])
    elif action == 5 and isinstance(container, list):
        container.insert(key, value)
    elif action == 6:
        other, place = chance.choice(places)
        if place in other if isinstance(other, dict) else place < len(other):
            # A copy, so that the document stays a tree.
            container[key] = json.loads(json.dumps(other[place]))
    else:
        # A copy, because a later change must not change the list of values.
        container[key] = deepcopy(chance.choice(VALUES))
    return document


def _places(value):
    """Each container with each of its keys or indices."""
    if isinstance(value, dict | list):
        for key in list(value) if isinstance(value, dict) else range(len(value)):
            yield value, key
            yield from _places(value[key])
