"""The command `imucal compose`, which combines two calibrations of a unit into one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from imucal.cli.options import JsonPath
from imucal.cli.output import Output, require_apart
from imucal.cli.parameters import argument, option

__all__ = ["compose"]


def compose(
    first: Annotated[Path, argument(metavar="FIRST", help="Calibration file of the raw samples.")],
    second: Annotated[
        Path,
        argument(
            metavar="SECOND", help="Calibration file from recordings corrected by the first calibration."
        ),
    ],
    output: Annotated[Path, option("--output", "-o", metavar="PATH", help="Calibration file to write.")],
    json: JsonPath = None,
) -> None:
    """Combine two calibrations of a unit into one. The second is estimated from data corrected by the first.

    The result corrects raw samples as both calibrations do one after the other. Its uncertainty is the
    uncertainty of the second calibration. Effects that only the first calibration has keep their uncertainty.

    Example: imucal compose unit-0042.json second.json -o both.json
    """
    import imucal
    from imucal.document.source import open_file

    require_apart([first, second], {"--output": output, "--json": json})
    calibrations = [imucal.Calibration.load(path) for path in (first, second)]
    files = tuple(open_file(path).source for path in (first, second))
    both = imucal.compose(*calibrations, files=files)
    both.save(output)
    unknown = [parameter.name for parameter in both.parameters if parameter.std is None]
    out = Output(json)
    out.document(
        {
            "output": str(output),
            "composed_of": [{"path": source.path, "sha256": source.sha256} for source in files],
            "frame": both.frame,
            "effects": [effect.name for effect in both.effects],
            "parameters": both.to_dict()["parameters"],
            "without_std": unknown,
        }
    )
    out.line(f"{output}: {first} and then {second}, {both!r}")
    if len(unknown) == len(both.parameters):
        out.line(f"no standard deviations, because {second} has none")
    elif unknown:
        out.line(f"no standard deviation of {', '.join(unknown)}, because {first} has none")
