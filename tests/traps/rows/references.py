"""Traps of the references: local gravity and the clock of the time stamps."""

import functools

import imucal
from imucal import Program
from recordings import calibrating, same
from trap import good, refused


@functools.cache
def at(gravity_mps2=None, clock_rate_error=0.0):
    """A run at a place with this gravity, with a clock that is wrong by this share."""
    program = Program.random(seed=1, moves=30, hold_s=2.0)
    return imucal.simulate(
        program, rate_hz=100, seed=1, gravity_mps2=gravity_mps2, clock_rate_error=clock_rate_error
    )


GRAVITY = tuple(
    calibrating(
        "local gravity is not that assumed",
        f"{gravity_mps2} m/s^2, {name}",
        same,
        good(),
        run=functools.partial(at, gravity_mps2),
        **options,
    )
    for gravity_mps2, name, options in (
        (9.78, "its uncertainty is given", {"gravity_sigma_mps2": 0.02}),
        (9.832, "its uncertainty is given", {"gravity_sigma_mps2": 0.02}),
        (9.7806, "the latitude is given", {"latitude_deg": 0.0}),
        (9.8322, "the latitude is given", {"latitude_deg": -90.0, "height_m": 0.0}),
    )
)

CLOCK = tuple(
    calibrating(
        "the clock is wrong",
        f"by {100 * error:+g} %, its uncertainty is given",
        same,
        good(),
        run=functools.partial(at, None, error),
        clock_ppm=ppm,
    )
    for error, ppm in ((0.02, 2e4), (-0.015, 1e4), (1e-4, 100.0))
)

CONTRADICTIONS = tuple(
    calibrating("references that cannot be", name, same, refused(says), **options)
    for name, says, options in (
        ("gravity and latitude", "give gravity if known", {"gravity_mps2": 9.81, "latitude_deg": 50.0}),
        ("height without latitude", "without latitude", {"height_m": 300.0}),
        ("a latitude of 91 deg", "latitude_deg is 91", {"latitude_deg": 91.0}),
        ("an uncertain gravity of 5 m/s^2", "gravity_sigma_mps2", {"gravity_sigma_mps2": 5.0}),
        ("a clock of 50 %", "clock_ppm", {"clock_ppm": 5e5}),
    )
)

TRAPS = (*GRAVITY, *CLOCK, *CONTRADICTIONS)
