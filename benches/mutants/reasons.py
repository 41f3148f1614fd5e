"""Why an error that no test finds is harmless, by file, line and change (`Site.name`)."""

__all__ = ["REASONS"]

REASONS: dict[tuple[str, str, str], str] = {
    (
        "imucal/io/label_blocks.py",
        "names = Counter(tuple(block) for block in blocks).most_common(1)[0][0]",
        "1 -> 2",
    ): "the first of the two most frequent is the most frequent",
    (
        "imucal/cli/commands/fleet_run.py",
        "rate = self._told / max(time.monotonic() - self._start_s, 1e-3)",
        "0.001 -> 0.0010500000000000002",
    ): "prevents a division by zero in the first millisecond",
}
