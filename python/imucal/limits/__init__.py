"""Acceptance limits, and the judgement of units against these limits."""
