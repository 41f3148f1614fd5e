"""The places of column chunks in a Parquet file, compared with those that pyarrow reads."""

import io
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import imucal
from imucal.io.parquet_pages import Chunk, column_chunks


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"compression": "zstd", "row_group_size": 1000},
        {"use_dictionary": False, "version": "1.0"},
        {"data_page_version": "2.0", "write_page_index": True, "row_group_size": 777},
    ],
)
def test_the_chunks_are_those_of_pyarrow(options):
    table = pa.table(
        {
            "time_s": np.arange(5000) * 0.01,
            "label": [str(i % 7) for i in range(5000)],
            "nested": [[1, 2]] * 5000,
            "flag": [True, False] * 2500,
        }
    )
    stream = io.BytesIO()
    pq.write_table(table, stream, **options)
    metadata = pq.read_metadata(stream)
    found = column_chunks(stream, len(stream.getvalue()))
    assert len(found) == metadata.num_row_groups
    for group, chunks in enumerate(found):
        assert len(chunks) == metadata.num_columns
        for index, chunk in enumerate(chunks):
            theirs = metadata.row_group(group).column(index)
            assert chunk == Chunk(
                theirs.num_values,
                theirs.total_compressed_size,
                theirs.data_page_offset,
                theirs.dictionary_page_offset or 0,
            )


def test_metadata_that_would_end_the_process_are_an_error():
    """pyarrow's `RowGroupMetaData.column` ends the process for a histogram of a wrong length in this file."""
    path = Path(__file__).parents[1] / "fuzz" / "corpus" / "parquet_histogram_abort.parquet"
    with pytest.raises(imucal.FormatError, match="damaged or truncated Parquet file"):
        imucal.read(path)
