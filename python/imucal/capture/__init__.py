"""Guided recording by hand: `imucal capture`."""
