"""Reader of labelled lines such as `ax:0.01 ay:0.02` (Arduino plotter), and of VectorNav sentences."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import reduce
from operator import xor
from typing import Any, Final

from imucal.document.source import File, open_file
from imucal.errors import FormatError, InputError
from imucal.finding import Finding
from imucal.io.headed import recording_of_text
from imucal.io.label_blocks import are_blocks, rows_of_blocks
from imucal.io.layout import HEAD
from imucal.io.mapping import column_list, mapping_of
from imucal.io.remarks import lines_left_out, remark
from imucal.io.table import Table
from imucal.io.text import content_of, open_text
from imucal.io.vocabulary import recording_from_table
from imucal.recording.recording import Recording

__all__ = ["are_labels", "are_sentences", "read_labels", "read_vectornav"]

# Matches a label, its number, and an optional unit: `ax:0.01`, `ax = 0.01 g`, `"ax": 0.01`.
PAIR: Final = re.compile(
    r"[\"']?([A-Za-z_][\w ]{0,40}?(?:\[\w+\])?)[\"']?\s*[:=]\s*"
    r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)(?![\w:.])"
    r"(?:\s?([cm]?m/s\^?2|[cm]?m/s²|[cm]?m/s/s|Gal|mg|µg|ug|g|m?rad/s|mdps|(?:deg|°)/(?:s|min|h)|dps|dph|rpm|"
    r"gon/s|°C|degC|us|ms|s)(?=[\s,;|}]|$))?"
)
# Fields of the known sentences, from the VN-100 user manual (registers 27 and 54). The fields that are not
# read, `-`, are attitude, magnetic field and pressure.
_ACCEL: Final = [f"accel_{axis}_mps2" for axis in "xyz"]
_GYRO: Final = [f"gyro_{axis}_radps" for axis in "xyz"]
SENTENCES: Final = {
    "VNYMR": ["-"] * 6 + _ACCEL + _GYRO,
    "VNIMU": ["-"] * 3 + _ACCEL + _GYRO + ["temp_degc", "-"],
    "VNQMR": ["-"] * 7 + _ACCEL + _GYRO,
    "VNMAR": ["-"] * 3 + _ACCEL + _GYRO,
}
SENTENCE: Final = re.compile(
    rb"^(.*?)\$([A-Z][A-Z0-9]{1,9}),([^*\r\n$]*)\*?([0-9A-Fa-fXx]*)[ \t\r]*$", re.MULTILINE
)
# Largest share of sentences with a wrong checksum; a larger share is an error.
MOST_WRONG: Final = 0.1


def are_labels(start: bytes) -> bool:
    """Whether most lines of a text consist of three or more labels with numbers."""
    if are_blocks(start):
        return True
    lines = [line for line in start.decode(errors="replace").splitlines()[1:41] if line.strip()]
    labelled = [
        line for line in lines if len(PAIR.findall(line)) >= 3 and not PAIR.sub("", line).strip(" \t,;|{}&")
    ]
    return len(lines) > 2 and 2 * len(labelled) > len(lines)


def are_sentences(start: bytes) -> bool:
    """Whether a text contains VectorNav sentences with samples, or mostly sentences with checksums."""
    if re.search(rb"^\$VN(YMR|IMU|QMR|MAR),", start, re.MULTILINE) is not None:
        return True
    lines = [line for line in start.split(b"\n")[1:41] if line.strip()]
    return len(lines) > 2 and 2 * sum(b"*" in line and line[:1] == b"$" for line in lines) > len(lines)


def read_labels(
    path: str | os.PathLike[str], *, columns: str | Sequence[str] | None = None, rate_hz: float | None = None
) -> Recording:
    """Read lines of `label:value` pairs, or lines with the axes of one sensor. Labels are column names.

    Other arguments as for `read_csv`.
    """
    file = open_file(path)
    content = content_of(file)
    lines = content.decode(errors="replace").splitlines()
    if are_blocks(content[:HEAD]):
        rows, left = rows_of_blocks(lines)
        return _of_rows(file, rows, left, columns, rate_hz)
    found = [PAIR.findall(line) for line in lines]
    labels = Counter(_labels(pairs) for pairs in found if len(pairs) >= 3)
    if not labels:
        raise FormatError(
            f"{file.name}: no line consists of label:value pairs: check that it is the right file"
        )
    names = labels.most_common(1)[0][0]
    rows, left = [",".join(names)], 0
    for line, pairs in zip(lines, found, strict=True):
        if _labels(pairs) == names:
            rows.append(",".join(number for _, number, _ in pairs))
        elif line.strip():
            left += 1
    if left > len(rows):
        raise FormatError(
            f"{file.name}: {left} of {len(lines)} lines have other labels: export one kind of line"
        )
    return _of_rows(file, rows, left, columns, rate_hz)


def _of_rows(
    file: File, rows: Sequence[str], left: int, columns: str | Sequence[str] | None, rate_hz: float | None
) -> Recording:
    """The recording in a header line and rows, with a warning about the `left` skipped lines."""
    text = open_text(replace(file, content="\n".join([*rows, ""]).encode()))
    recording = recording_of_text(text, columns, rate_hz)
    warning = lines_left_out(file.name, [f"{left} lines without these labels"], left)
    return _with(recording, [warning] if left else [])


def _labels(pairs: Sequence[tuple[str, str, str]]) -> tuple[str, ...]:
    """The names of the columns, each with its unit if it has one."""
    return tuple(f"{label.strip()} ({unit})" if unit else label.strip() for label, _, unit in pairs)


def read_vectornav(
    path: str | os.PathLike[str], *, columns: str | Sequence[str] | None = None, rate_hz: float | None = None
) -> Recording:
    """Read the sentences $VNYMR, $VNIMU, $VNQMR and $VNMAR of VectorNav, which contain no time.

    columns  the name of the sentence, then a name for every field of this sentence. They replace the names in
             the manual. With this option, other sentences in the form of NMEA 0183 can also be read
    """
    file = open_file(path)
    content = content_of(file)
    found = SENTENCE.findall(content)
    given_names = None if columns is None else _given(file.name, columns)
    kind = _kind(file.name, found, given_names)
    sentences = [(kind + b"," + body, given) for _, of, body, given in found if of == kind]
    good = [(body, given) for body, given in sentences if _is_valid(body, given)]
    findings = []
    placeholders = len({given for _, given in sentences}) == 1 and len({body for body, _ in sentences}) > 1
    if placeholders and 2 * len(good) < len(sentences):
        findings.append(
            remark(
                file.name,
                "checksums_missing",
                f"all sentences have the check sum {sentences[0][1].decode() or '(none)'}, which is a "
                "placeholder, so garbled sentences cannot be found",
                "record with check sums",
            )
        )
        good = sentences
    wrong = len(sentences) - len(good)
    if wrong > max(MOST_WRONG * len(sentences), 1) or not good:
        raise FormatError(
            f"{file.name}: {wrong} of {len(sentences)} sentences have a wrong check sum: they are "
            "altered, or bytes were lost: record again at a higher baud rate or a lower output rate"
        )
    names = SENTENCES[kind.decode()] if given_names is None else given_names
    rows = [body.partition(b",")[2].split(b",") for body, _ in good]
    full = [row for row in rows if len(row) == len(names)]
    if not full:
        raise FormatError(
            f"{file.name}: the sentences have {len(rows[0])} fields, {len(names)} are named: name every field"
        )
    other = (
        len([line for line in content.split(b"\n") if line.strip()]) - len(sentences) + len(rows) - len(full)
    )
    if wrong:
        findings.append(lines_left_out(file.name, [f"{wrong} sentences with a wrong check sum"], wrong))
    if other:
        findings.append(lines_left_out(file.name, [f"{other} other lines"], other))
    table = _table(file.name, names, full)
    return _with(recording_from_table(table, [file.source], rate_hz), findings)


def _kind(file: str, found: Sequence[tuple[bytes, bytes, bytes, bytes]], names: list[str] | None) -> bytes:
    """The most frequent sentence type with as many fields as `names`, or the most frequent known type."""
    kinds = Counter(
        kind
        for _, kind, body, _ in found
        if (kind.decode() in SENTENCES if names is None else body.count(b",") + 1 == len(names))
    )
    if kinds:
        return kinds.most_common(1)[0][0]
    shown = Counter((kind.decode(), body.count(b",") + 1) for _, kind, body, _ in found).most_common(5)
    listed = ", ".join(f"${kind} with {count} fields" for (kind, count), _ in shown) or "none"
    known = ", ".join(f"${kind}" for kind in SENTENCES)
    raise FormatError(
        f"{file}: sentences found: {listed}. Known are {known}; for others name every field, '-' for the "
        "name of the sentence (--columns -,time_s,accel_x_g,...)"
    )


def _given(file: str, columns: str | Sequence[str]) -> list[str]:
    if mapping_of(columns) is not None:
        raise InputError(f"{file} has no column names: give a name for every field, '-' to ignore it")
    return column_list(columns)[1:]


def _is_valid(body: bytes, given: bytes) -> bool:
    """Whether `given` is the checksum of the sentence `body`: 8-bit exclusive or, or CRC-16-CCITT."""
    if len(given) == 2 and given.upper() != b"XX":
        return _is_hex(given) and reduce(xor, body, 0) == int(given, 16)
    if len(given) == 4 and _is_hex(given):
        import binascii

        return binascii.crc_hqx(body, 0) == int(given, 16)
    return False


def _is_hex(text: bytes) -> bool:
    return all(byte in b"0123456789abcdefABCDEF" for byte in text)


def _table(file: str, names: list[str], rows: Sequence[Sequence[bytes]]) -> Table:
    import pyarrow as pa

    used = [index for index, name in enumerate(names) if name != "-"]
    columns: list[Any] = []
    for index in used:
        try:
            columns.append(pa.chunked_array([pa.array([float(row[index]) for row in rows])]))
        except ValueError:
            raise FormatError(
                f"{file}: field {index + 1} of a sentence is not a number: record again"
            ) from None
    return Table(file, [names[index] for index in used], columns, lambda row: f"sentence {row + 1}")


def _with(recording: Recording, findings: Sequence[Finding]) -> Recording:
    return replace(recording, findings=(*recording.findings, *findings))
