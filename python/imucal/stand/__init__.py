"""A stand: what drives a real one, what records, and what judges the run."""
