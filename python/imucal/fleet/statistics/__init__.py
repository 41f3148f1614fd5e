"""Statistics over the units of a fleet."""
