"""The journal of a run, to which all data are written as they arrive, with checksums that detect damage.

A journal is a sequence of blocks. Each block has a head (magic, kind, number, length, and the CRC-32 of head
and payload) and a payload, little-endian. The kinds of blocks are:

    H  header, JSON: schema, column names of a sample, and information about the run
    S  samples: rows of float64, the columns of the header followed by the host time of arrival, s
    P  motor positions: rows of float64, host time, s, and three angles, deg
    E  event, JSON
    D  progress, JSON: number of completed steps, and the position that the controller reports with all motors
       at zero, deg

Blocks are only appended, each with one write. If the process is killed, the file ends with complete blocks
and at most one partial block. Data written before the last `sync` survive a power failure.
"""

from __future__ import annotations

import json
import os
import struct
import zlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.document.appending import lock, write_all
from imucal.errors import FormatError, InputError

__all__ = ["Journal", "Logged", "read_journal"]

SCHEMA: Final = "imucal.journal/1"
MAGIC: Final = b"\x89imJ"
HEAD: Final = struct.Struct("<4sc3xIII")
HEADER, SAMPLES, POSITIONS, EVENT, PROGRESS = b"H", b"S", b"P", b"E", b"D"
POSITION_COLUMNS: Final = 4


class Journal:
    """A journal open for writing, for use in a `with` block. The file is locked while it is open.

    Raises InputError if the file cannot be written, or if it exists, because it may contain the only copy of
    the samples of an interrupted run.
    """

    def __init__(
        self, path: str | os.PathLike[str], columns: Sequence[str], about: Mapping[str, Any]
    ) -> None:
        self.path = Path(path)
        self.columns = tuple(columns)
        self.written = 0
        self._number = 0
        try:
            self._file = os.open(
                self.path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666
            )
        except FileExistsError:
            raise self._there_already() from None
        except OSError as error:
            raise self._unwritable(error) from error
        try:
            # Some network file systems do not support locks.
            with suppress(OSError):
                lock(self._file)
            header = {"schema": SCHEMA, "columns": list(self.columns), **about}
            self._append(HEADER, json.dumps(header).encode())
            self.sync()
        except BaseException:
            # The file is removed, because a file without a header contains nothing and would block the next
            # run.
            os.close(self._file)
            self.path.unlink(missing_ok=True)
            raise

    @classmethod
    def continued(cls, logged: Logged) -> Journal:
        """The journal of an interrupted run, open for writing after its last complete block.

        Raises InputError if another process is writing the journal, or if it cannot be written.
        """
        journal = cls.__new__(cls)
        journal.path, journal.columns = Path(logged.path), logged.columns
        journal.written, journal._number = len(logged.samples), logged.next_number
        if _is_locked(journal.path):
            raise journal._there_already()
        try:
            journal._file = os.open(journal.path, os.O_RDWR | getattr(os, "O_BINARY", 0))
            with suppress(OSError):
                lock(journal._file)
            os.ftruncate(journal._file, logged.end)
            os.lseek(journal._file, 0, os.SEEK_END)
        except OSError as error:
            raise journal._unwritable(error) from error
        return journal

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._file)

    def samples(self, rows: FloatArray, host_s: FloatArray | float) -> None:
        """Append samples, (N, columns), with their host times of arrival, (N,), or one time for all, s."""
        if len(rows) == 0:
            return
        stamped = np.column_stack([rows, np.broadcast_to(host_s, len(rows))])
        self._append(SAMPLES, stamped.astype("<f8").tobytes())
        self.written += len(rows)

    def positions(self, rows: Sequence[Sequence[float]]) -> None:
        """Append motor positions, (N, 4): host time, s, and three angles, deg."""
        if rows:
            self._append(POSITIONS, np.asarray(rows, dtype="<f8").tobytes())

    def progress(self, steps_done: int, zero_deg: Sequence[float]) -> None:
        """Append the number of completed steps and the zero of the motors, which `stand resume` needs."""
        progress = {"steps_done": steps_done, "zero_deg": list(zero_deg)}
        self._append(PROGRESS, json.dumps(progress).encode())

    def event(self, host_s: float, code: str, message: str) -> None:
        """Append an event; `code` is a stable identifier."""
        self._append(EVENT, json.dumps({"host_s": host_s, "code": code, "message": message}).encode())

    def sync(self) -> int:
        """Flush all data to the disk. Returns the number of samples on the disk."""
        try:
            os.fsync(self._file)
        except OSError as error:
            raise self._unwritable(error) from error
        return self.written

    def _append(self, kind: bytes, payload: bytes) -> None:
        block = _block(kind, self._number, payload)
        self._number += 1
        try:
            write_all(self._file, block)
        except OSError as error:
            raise self._unwritable(error) from error

    def _there_already(self) -> InputError:
        if _is_locked(self.path):
            return InputError(
                f"{self.path} exists, and another process is recording into it: wait until it ends, or give "
                "another file (-o)"
            )
        return InputError(
            f"{self.path} exists and belongs to an interrupted run: save its samples with "
            f"`imucal stand recover {self.path} -o FILE`, then remove it"
        )

    def _unwritable(self, error: OSError) -> InputError:
        return InputError(f"{self.path} cannot be written: {error.strerror}; earlier samples are kept")


@dataclass(frozen=True, eq=False)
class Logged:
    """The contents of a journal.

    header      fields of the header
    columns     column names of a sample
    samples     (N, columns), NaN for missing numbers
    host_s      (N,)    host time of arrival of each sample, s
    positions   (M, 4)  host time, s, and motor angles, deg
    events      events with host_s, code and message
    steps_done  number of completed steps of the program
    zero_deg    position that the controller reports with all motors at zero, deg; None if it is not known
    blocks_lost number of damaged or missing blocks, from the gaps in the block numbers
    tail_bytes  number of bytes after the last complete block, which belong to a partially written block
    """

    path: str
    header: Mapping[str, Any]
    columns: tuple[str, ...]
    samples: FloatArray
    host_s: FloatArray
    positions: FloatArray
    events: tuple[Mapping[str, Any], ...]
    blocks_lost: int
    tail_bytes: int
    steps_done: int = 0
    zero_deg: tuple[float, float, float] | None = None
    next_number: int = 0
    end: int = 0


def read_journal(path: str | os.PathLike[str]) -> Logged:
    """Read all complete blocks of a journal; damaged blocks are skipped and counted.

    Raises InputError if the file cannot be read, FormatError if it is not a journal or has no header.
    """
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise InputError(f"{os.fspath(path)} cannot be read: {error.strerror}") from error
    blocks, end = _blocks(content)
    if not blocks or blocks[0][0] != HEADER:
        raise FormatError(f"{os.fspath(path)} is no journal of a run: it does not start with a header")
    header = json.loads(blocks[0][2])
    if header.get("schema") != SCHEMA:
        raise FormatError(f"{os.fspath(path)} has the schema {header.get('schema')!r}, {SCHEMA!r} is needed")
    columns = tuple(header["columns"])

    def rows(kind: bytes, width: int) -> FloatArray:
        data = b"".join(payload for found, _, payload in blocks if found == kind)
        return np.frombuffer(data, dtype="<f8").astype(np.float64).reshape(-1, width)

    samples = rows(SAMPLES, len(columns) + 1)
    progress = [json.loads(payload) for kind, _, payload in blocks if kind == PROGRESS]
    zero = [float(angle) for angle in progress[-1]["zero_deg"]] if progress else []
    return Logged(
        path=os.fspath(path),
        header=header,
        columns=columns,
        samples=samples[:, :-1],
        host_s=samples[:, -1],
        positions=rows(POSITIONS, POSITION_COLUMNS),
        events=tuple(json.loads(payload) for kind, _, payload in blocks if kind == EVENT),
        blocks_lost=blocks[-1][1] + 1 - len(blocks),
        tail_bytes=len(content) - end,
        steps_done=int(progress[-1]["steps_done"]) if progress else 0,
        zero_deg=(zero[0], zero[1], zero[2]) if zero else None,
        next_number=blocks[-1][1] + 1,
        end=end,
    )


def _is_locked(path: Path) -> bool:
    """Whether another process is writing this journal."""
    try:
        file = os.open(path, os.O_RDONLY)
    except OSError:
        return False
    try:
        lock(file)
    except BlockingIOError:
        return True
    except OSError:
        return False
    finally:
        os.close(file)
    return False


def _block(kind: bytes, number: int, payload: bytes) -> bytes:
    head = HEAD.pack(MAGIC, kind, number, len(payload), 0)
    return HEAD.pack(MAGIC, kind, number, len(payload), zlib.crc32(payload, zlib.crc32(head))) + payload


def _blocks(content: bytes) -> tuple[list[tuple[bytes, int, bytes]], int]:
    """The complete blocks in ascending order of their numbers, and the byte offset after the last block."""
    found: list[tuple[bytes, int, bytes]] = []
    at = end = 0
    while (at := content.find(MAGIC, at)) >= 0 and at + HEAD.size <= len(content):
        _, kind, number, length, _ = HEAD.unpack_from(content, at)
        stop = at + HEAD.size + length
        payload = content[at + HEAD.size : stop]
        whole = stop <= len(content) and content[at:stop] == _block(kind, number, payload)
        if whole and (not found or number > found[-1][1]):
            found.append((kind, number, payload))
            at = end = stop
        else:
            # The bytes `MAGIC`, with which a block starts, may also occur by coincidence inside a payload, so
            # the search continues at the next byte.
            at += 1
    return found, end
