"""The sensor model of one unit: its parameters, file, corrections, and comparison with another model."""
