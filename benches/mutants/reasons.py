"""Why an error that no test finds is harmless, by the name of the error."""

__all__ = ["REASONS"]

REASONS: dict[str, str] = {}
