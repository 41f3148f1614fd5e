"""Acceptance limits of units, and their judgement."""
