"""Many units: their store, calibrations on many machines, and statistics over units."""
