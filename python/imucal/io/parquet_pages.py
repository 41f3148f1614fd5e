"""Verification of the sizes in a Parquet file before Arrow allocates memory for them.

Each column chunk is a sequence of pages. A page starts with a header in the compact protocol of Thrift, whose
fields 2 and 3 are the uncompressed and the compressed size of the page (parquet.thrift, PageHeader). Arrow
allocates memory of these sizes without comparing them with the size of the file.

The positions of the column chunks are read from the end of the file (FileMetaData). They are not read through
pyarrow's `RowGroupMetaData.column`, because this method crashes the process for some damaged files.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Any, BinaryIO, Final, NamedTuple

__all__ = ["Chunk", "column_chunks", "require_plausible_pages", "require_plausible_rows"]

# In memory, the values of a file may take at most MEMORY_BYTES plus MEMORY_PER_BYTE times the size of the
# file, bytes. Constant columns can be compressed by any factor. MEMORY_BYTES is enough for hours of such
# columns.
MEMORY_BYTES: Final = 100_000_000
MEMORY_PER_BYTE: Final = 1000
# Largest accepted page, bytes. Programs write pages of about 1 MB.
LARGEST_PAGE: Final = 64_000_000
# Longest page header that is parsed, bytes. Headers can be long, because their statistics contain values of
# the column.
LONGEST_HEADER: Final = 1 << 16
# Number of bytes after the metadata at the end of a file: the length of the metadata and the letters PAR1.
TAIL: Final = 8
# Largest accepted nesting depth of structures in a header.
DEEPEST: Final = 8
# Size of a value in memory, bytes.
VALUE_BYTES: Final = 8
# Type codes of the compact protocol.
TRUE, FALSE, BYTE, I16, I32, I64, DOUBLE, BINARY, LIST, SET, MAP, STRUCT = range(1, 13)


def require_plausible_rows(metadata: Any, size: int) -> None:
    """Raises ValueError if the number of rows in pyarrow's metadata does not fit a file of `size` bytes."""
    rows = sum(metadata.row_group(group).num_rows for group in range(metadata.num_row_groups))
    if rows != metadata.num_rows or rows < 0:
        raise ValueError(f"it claims {metadata.num_rows} rows, but its row groups have {rows}")
    if rows * VALUE_BYTES > MEMORY_BYTES + MEMORY_PER_BYTE * size:
        raise ValueError(f"it claims {rows} rows in {size} bytes")


def require_plausible_pages(file: BinaryIO, metadata: Any, size: int, names: Collection[str]) -> None:
    """Raises ValueError if a page of the named columns states an impossible size.

    file      the file, whose position changes
    metadata  pyarrow's metadata of the file
    size      size of the file, bytes
    """
    # Columns are identified by their index in the schema, because Arrow ignores the names in the row groups.
    paths = [metadata.schema.column(index).path for index in range(metadata.num_columns)]
    # A nested column has several chunks, whose paths start with its name.
    used = [
        index
        for index, path in enumerate(paths)
        if any(path == name or path.startswith(f"{name}.") for name in names)
    ]
    groups = column_chunks(file, size)
    if len(groups) != metadata.num_row_groups or any(len(chunks) != len(paths) for chunks in groups):
        raise ValueError("its row groups are damaged")
    for chunks in groups:
        for index in used:
            _require_chunk(file, paths[index], chunks[index], size)


class Chunk(NamedTuple):
    """A column chunk: number of values, compressed size, and positions of the first pages, bytes."""

    values: int
    compressed: int
    data_page: int
    dictionary_page: int


def column_chunks(file: BinaryIO, size: int) -> list[list[Chunk]]:
    """The column chunks of each row group, as the metadata at the end of the file lists them."""
    file.seek(max(size - TAIL, 0))
    length = int.from_bytes(file.read(4), "little")
    if length > size - TAIL:
        raise ValueError("its metadata are cut")
    file.seek(size - TAIL - length)
    reader = _Reader(file.read(length))
    return [
        [
            _chunk(reader)
            # The arguments are field numbers of parquet.thrift: 4 is row_groups, 1 is columns, 3 is
            # meta_data.
            for _ in reader.structures(1)
            for _ in reader.structures(3)
        ]
        for _ in reader.structures(4)
    ]


def _chunk(reader: _Reader) -> Chunk:
    found = {}
    for field, kind in reader.fields():
        if field in (5, 7, 9, 11) and kind == I64:
            found[field] = reader.signed()
        else:
            reader.skip(kind)
    return Chunk(*(found.get(field, 0) for field in (5, 7, 9, 11)))


def _require_chunk(file: BinaryIO, name: str, chunk: Chunk, size: int) -> None:
    first = chunk.data_page
    if 0 < chunk.dictionary_page < first:
        first = chunk.dictionary_page
    end = first + chunk.compressed
    # A column without values has no data page, and the offset of the data page is then 0.
    lowest = 1 if chunk.values else 0
    if not lowest <= first <= end <= size:
        raise ValueError(
            f"the column {name} is said to occupy bytes {first} to {end}, but the file has {size} bytes"
        )
    position = first
    # Only pages up to the last value are checked, because Arrow stops reading there, which can be before the
    # end of the chunk.
    values = 0
    while position < end and values < chunk.values:
        file.seek(position)
        header = _header(_Reader(file.read(min(LONGEST_HEADER, end - position))))
        if not 0 <= header.compressed <= end - position - header.length:
            raise ValueError(f"a page of the column {name} claims {header.compressed} bytes")
        if not 0 <= header.uncompressed <= LARGEST_PAGE:
            raise ValueError(f"a page of the column {name} claims {header.uncompressed} uncompressed bytes")
        values += header.values
        position += header.length + header.compressed


class _Header(NamedTuple):
    """A page header: its length, the sizes of its page, bytes, and the number of values in the page."""

    length: int
    uncompressed: int
    compressed: int
    values: int


def _header(reader: _Reader) -> _Header:
    uncompressed = compressed = -1
    values = 0
    for field, kind in reader.fields():
        if field == 2 and kind == I32:
            uncompressed = reader.signed()
        elif field == 3 and kind == I32:
            compressed = reader.signed()
        elif field in (5, 8) and kind == STRUCT:
            # The header of a data page (version 1 or 2). Its field 1 is the number of values.
            for inner, inner_kind in reader.fields():
                if inner == 1 and inner_kind == I32:
                    values = max(reader.signed(), 0)
                else:
                    reader.skip(inner_kind, 1)
        else:
            reader.skip(kind)
    return _Header(reader.position, uncompressed, compressed, values)


class _Reader:
    """Reads structures in the compact protocol of Thrift. `position` is the number of bytes read."""

    def __init__(self, content: bytes) -> None:
        self._content, self.position = content, 0

    def structures(self, number: int) -> Iterator[None]:
        """Yields at the start of each structure that the field `number` contains.

        The field is a structure itself, or a list of structures. Other fields are skipped.
        """
        for field, kind in self.fields():
            if field == number and kind == STRUCT:
                yield None
            elif field == number and kind == LIST:
                count, kind = self._list()
                for _ in range(count):
                    if kind != STRUCT:
                        raise ValueError("its metadata are damaged")
                    yield None
            else:
                self.skip(kind)

    def fields(self) -> Iterator[tuple[int, int]]:
        """Number and type of each field of a structure.

        The caller must read or skip the value of a field before it asks for the next field.
        """
        field = 0
        while (head := self._byte()) != 0:
            field = field + (head >> 4) if head >> 4 else self.signed()
            yield field, head & 15

    def skip(self, kind: int, depth: int = 0) -> None:
        """Skips the value of a field."""
        if depth > DEEPEST:
            raise ValueError("a structure is nested too deeply")
        if kind in (TRUE, FALSE):
            return
        if kind == BYTE:
            self._byte()
        elif kind in (I16, I32, I64):
            self._unsigned()
        elif kind == DOUBLE:
            self._advance(8)
        elif kind == BINARY:
            self._advance(self._unsigned())
        elif kind in (LIST, SET):
            count, kind = self._list()
            for _ in range(count):
                self._skip_item(kind, depth)
        elif kind == MAP:
            count = self._unsigned()
            kinds = self._byte() if count else 0
            for _ in range(count):
                self._skip_item(kinds >> 4, depth)
                self._skip_item(kinds & 15, depth)
        elif kind == STRUCT:
            for _, inner in self.fields():
                self.skip(inner, depth + 1)
        else:
            raise ValueError(f"a structure has a field of the unknown type {kind}")

    def _list(self) -> tuple[int, int]:
        """Number and type of the items of a list."""
        head = self._byte()
        return head >> 4 if head >> 4 < 15 else self._unsigned(), head & 15

    def _skip_item(self, kind: int, depth: int) -> None:
        # A boolean in a list takes one byte. A boolean field takes no byte, because the type of the field
        # contains its value.
        self.skip(BYTE if kind in (TRUE, FALSE) else kind, depth + 1)

    def signed(self) -> int:
        number = self._unsigned()
        return (number >> 1) ^ -(number & 1)

    def _unsigned(self) -> int:
        number = 0
        for shift in range(0, 70, 7):
            byte = self._byte()
            number |= (byte & 0x7F) << shift
            if not byte & 0x80:
                return number
        raise ValueError("a number in a structure is too long")

    def _byte(self) -> int:
        self._advance(1)
        return self._content[self.position - 1]

    def _advance(self, count: int) -> None:
        self.position += count
        if self.position > len(self._content):
            raise ValueError("a structure is cut")
