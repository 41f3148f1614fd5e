"""Traps that calibrate a changed simulated recording."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import imucal
from changes import Change, changed, stand_run, truth_of
from imucal import Recording
from trap import Options, Question, Right, Trap


def same(recording: Recording) -> Recording:
    """The recording without a change."""
    return changed(recording)


def calibrating(
    kind: str,
    name: str,
    change: Change,
    *right: Right,
    run: Callable[[], Any] = stand_run,
    control: Change | None = None,
    truth: Mapping[str, float] | None = None,
    changing: tuple[str, ...] = (),
    ending: str = "parquet",
    **options: Any,
) -> Trap:
    """A trap that calibrates a changed simulated recording.

    change    returns a recording or several
    control   makes the control recording of the unchanged one; without it there is none
    truth     true parameters by name; those of the simulated unit if None
    changing  beginnings of the names of parameters that change during the run, and have no one truth
    options   of `imucal.calibrate`, passed to the command, too
    """

    def make(folder: Path) -> Question:
        simulated = run()
        given = change(simulated.recording)
        given = given if isinstance(given, list) else [given]
        paths = [folder / f"run-{number}.{ending}" for number in range(len(given))]
        for recording, path in zip(given, paths, strict=True):
            imucal.write(recording, path)
        asked = Options(options)
        words = ["calibrate", *map(str, paths), *asked.words()]
        if control is not None:
            imucal.write(control(simulated.recording), folder / f"control.{ending}")
            words += ["--control", str(folder / f"control.{ending}")]

        def call() -> Any:
            recordings = [imucal.read(path) for path in paths]
            judge = None if control is None else imucal.read(folder / f"control.{ending}")
            return imucal.calibrate(recordings, control=judge, **options)

        known = truth_of(simulated) if truth is None else truth
        constant = {n: value for n, value in known.items() if not n.startswith(changing)}
        return Question(words, call, constant)

    return Trap(kind, name, make, right)
