"""JSON documents, whole files, and plain values."""
