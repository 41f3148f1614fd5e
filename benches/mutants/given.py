"""Errors that stand in every copy besides the sample: earlier tests passed with each of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from mutants.sites import Edit, Site

__all__ = ["FIRST", "IN_PYTHON", "IN_RUST", "given_sites"]

# Numbers of these errors, above all of a sample.
FIRST = 3000
# File, text that occurs once in it, and the error in its place.
IN_RUST = (
    # Each standard deviation is larger by 5 %.
    (
        "rust/imucal/src/calibrate/outcome.rs",
        "of_unit(&joint.covariance)",
        "faer::Scale(1.05 * 1.05) * of_unit(&joint.covariance)",
    ),
    # The covariance of two stages does not contain the error of the gyroscope bias.
    ("rust/imucal/src/two_stage/uncertainty.rs", "3 * k..6 * k", "3 * k..3 * k"),
    # The evidence of each candidate is larger by three nats.
    (
        "rust/imucal/src/gap/score.rs",
        "beside.evidence(width, settled)?.0.log - before.log",
        "beside.evidence(width, settled)?.0.log - before.log + 3.0",
    ),
    # A test of many candidates is not corrected for their number.
    ("rust/imucal/src/gap/detect.rs", "FALSE_ALARM / tests.max(1) as f64", "FALSE_ALARM"),
    # Each turn of a plan takes 5 % longer.
    ("rust/imucal/src/plan/limits.rs", "(time_s / TICK_S - 1e-6)", "(1.05 * time_s / TICK_S - 1e-6)"),
)
IN_PYTHON = (
    # A gap in a stream has five steps, or in a guided recording six.
    ("imucal/io/streams.py", "2.5", "5.0"),
    ("imucal/capture/session.py", "5.0", "6.0"),
    # The exit code of a search does not depend on what remains, such as a random walk.
    ("imucal/cli/commands/gap.py", "is_unexplained or remains", "is_unexplained"),
)


def given_sites(errors: tuple[tuple[str, str, str], ...], sources: Mapping[str, bytes]) -> dict[int, Site]:
    """The errors of a list by number, in their sources by name."""
    return dict(enumerate(_sites(errors, sources), FIRST))


def _sites(errors: tuple[tuple[str, str, str], ...], sources: Mapping[str, bytes]) -> Iterator[Site]:
    for path, before, after in errors:
        text = sources[path].decode()
        if text.count(before) != 1:
            raise SystemExit(f"{path}: {before!r} occurs {text.count(before)} times")
        first = text.index(before)
        line = text.count("\n", 0, first)
        start = len(text[:first].encode())
        edit = Edit(start, start + len(before.encode()), (), (after,))
        whole = text.splitlines()[line]
        # In Python, a line without an indent is evaluated when the module is imported.
        yield Site(path, line + 1, whole.strip(), before, after, edit, not whole[0].isspace())
