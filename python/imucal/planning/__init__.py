"""Motions that determine the parameters, before they are run."""
