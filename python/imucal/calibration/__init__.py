"""The sensor model of one unit: its numbers, its file, its corrections, and the difference of two."""
