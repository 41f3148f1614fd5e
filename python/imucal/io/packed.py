"""Decompression of gzip files, and access to the contents of zip archives."""

from __future__ import annotations

import io
import os
import zlib
from pathlib import Path
from typing import Final

from imucal.errors import FormatError

__all__ = ["GZIP", "OLD_SPREADSHEET", "ZIP", "Archive", "kind_of_zip", "unpacked", "unpacked_start"]

GZIP: Final = b"\x1f\x8b"
ZIP: Final = b"PK\x03\x04"
# First bytes of a compound file, the format of .xls and .doc.
OLD_SPREADSHEET: Final = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"
# Protection against decompression bombs. LARGEST_RATIO is the largest accepted ratio of decompressed to
# compressed size. If the decompressed size is at most ALWAYS_ALLOWED, bytes, any ratio is accepted.
LARGEST_RATIO, ALWAYS_ALLOWED = 40, 200_000_000
TEXT_ENDINGS: Final = (".csv", ".txt", ".tsv", ".dat", ".log", ".asc")


def unpacked(name: str, content: bytes) -> bytes:
    """The content of a file, decompressed if it is a gzip file."""
    if not content.startswith(GZIP):
        return content
    import gzip

    limit = max(LARGEST_RATIO * len(content), ALWAYS_ALLOWED)
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(content)) as file:
            text = file.read(limit + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise FormatError(f"{name} cannot be decompressed ({error}): copy or compress it again") from None
    if len(text) > limit:
        raise FormatError(
            f"{name} is more than {LARGEST_RATIO} times larger decompressed: decompress it first"
        )
    return text


def unpacked_start(name: str, start: bytes, count: int) -> bytes:
    """The start of a file, decompressed to at most `count` bytes if it is a gzip file."""
    if not start.startswith(GZIP):
        return start
    try:
        return zlib.decompressobj(16 + zlib.MAX_WBITS).decompress(start, count)
    except zlib.error as error:
        raise FormatError(f"{name} cannot be decompressed ({error}): copy or compress it again") from None


class Archive:
    """The text files in a zip archive."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        import zipfile

        self.name = Path(path).name
        try:
            with zipfile.ZipFile(path) as archive:
                self.members = [info.filename for info in archive.infolist() if not info.is_dir()]
        except (OSError, zipfile.BadZipFile, NotImplementedError, ValueError) as error:
            raise FormatError(
                f"{self.name} is a damaged zip archive ({error}): copy or export it again"
            ) from None
        self._path = path

    def texts(self) -> list[str]:
        """The names of the text files, without files that describe the archive."""
        return [
            name
            for name in self.members
            if name.lower().endswith(TEXT_ENDINGS) and "__MACOSX" not in name and "meta/" not in name.lower()
        ]

    def read(self, member: str, count: int = -1) -> bytes:
        """The content of a file in the archive, or its first `count` bytes."""
        import zipfile

        try:
            with zipfile.ZipFile(self._path) as archive, archive.open(member) as file:
                size = archive.getinfo(member)
                limit = max(LARGEST_RATIO * size.compress_size, ALWAYS_ALLOWED)
                content = file.read(limit + 1 if count < 0 else count)
        except (
            OSError,
            zipfile.BadZipFile,
            NotImplementedError,
            RuntimeError,
            zlib.error,
            EOFError,
        ) as error:
            raise FormatError(
                f"{self.name}: {member} cannot be read ({error}): unpack the archive, and give the file"
            ) from None
        if len(content) > limit:
            raise FormatError(f"{self.name}: {member} is too large decompressed: unpack the archive first")
        return content


def kind_of_zip(path: str | os.PathLike[str]) -> str:
    """The kind of a zip archive: "numpy", "spreadsheet", "texts" or "other"."""
    members = Archive(path).members
    if members and all(name.endswith(".npy") for name in members):
        return "numpy"
    if any(name.startswith(("xl/", "Index/")) for name in members) or "content.xml" in members:
        return "spreadsheet"
    if any(name.lower().endswith(TEXT_ENDINGS) for name in members):
        return "texts"
    return "other"
