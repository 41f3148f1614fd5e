"""Noise figures and Allan deviations of a unit at rest."""
