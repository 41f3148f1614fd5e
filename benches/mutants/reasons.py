"""Why an error that no test finds is harmless, by file, line and change (`Site.name`)."""

__all__ = ["REASONS"]

REASONS: dict[tuple[str, str, str], str] = {}
