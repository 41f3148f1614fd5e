"""JSON documents, atomic writing, file hashes, and plain values."""
