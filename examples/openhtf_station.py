"""A station of OpenHTF that calibrates one unit: each parameter with a limit is one of its measurements.

The recordings are simulated here; on a line the phase records them.
"""

from pathlib import Path

import openhtf as htf
from openhtf.util import units

import imucal

LIMITS = imucal.Limits(
    (
        imucal.ParameterLimit("gyro_bias_*", "rad/s", -0.05, 0.05),
        imucal.ParameterLimit("accel_bias_*", "m/s^2", -0.6, 0.6),
    )
)
NAMES = [f"{sensor}_bias_{axis}" for sensor in ("accel", "gyro") for axis in "xyz"]
UNITS = {"rad/s": units.RADIAN_PER_SECOND, "m/s^2": units.METRE_PER_SECOND_SQUARED}


@htf.measures(
    *(
        htf.Measurement(name).in_range(limit.low, limit.high).with_units(UNITS[limit.unit])
        for limit in LIMITS.parameters
        for name in filter(limit.covers, NAMES)
    ),
    htf.Measurement("verdict").with_validator(lambda verdict: verdict != "poor"),
)
def calibrate_unit(test):
    """Calibrates the unit and measures its biases."""
    serial = test.test_record.dut_id
    run, control = (imucal.read(f"{name}-{serial}.csv") for name in ("run", "control"))
    result = imucal.calibrate(run, control=control, serial_number=serial).judged_by(LIMITS)
    result.calibration.save(f"{serial}.json")
    test.attach_from_file(f"{serial}.json")
    test.measurements.verdict = result.verdict
    for parameter in result.parameters:
        if parameter.name in NAMES:
            test.measurements[parameter.name] = parameter.value


def simulate_recordings(serial):
    """Two recordings of one unit, run-SERIAL.csv and control-SERIAL.csv."""
    program = imucal.Program.random(seed=1)
    for seed, name in enumerate(("run", "control")):
        simulation = imucal.simulate(program, unit="random:bmi088:7", seed=seed, rate_hz=100.0)
        imucal.write(simulation.recording, f"{name}-{serial}.csv")


def print_record(record):
    """What OpenHTF writes to its files, in short."""
    print(record.dut_id, record.outcome.name)
    for name, measurement in record.phases[-1].measurements.items():
        print(f"{name} {measurement.outcome.name} {measurement.measured_value.value}")


if __name__ == "__main__":
    simulate_recordings("0007")
    test = htf.Test(calibrate_unit)
    test.add_output_callbacks(print_record)
    test.execute(test_start=lambda: "0007")
    print(sorted(path.name for path in Path().glob("0007*")))
