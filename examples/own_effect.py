"""A user-defined effect: the bias of the gyroscope depends on the recorded supply voltage.

The program simulates the effect, estimates it together with the 21 parameters, judges the result on a control
recording, and searches for the effect.
"""

import numpy as np

import imucal


def field(state: imucal.State) -> np.ndarray:
    """Change of the true rate per unit of each parameter, (N, 3, 3): the voltage minus 3.3 V on each axis."""
    return (state.auxiliary["supply_v"] - 3.3)[:, None, None] * np.eye(3)


supply = imucal.UserEffect(
    "gyro_bias_supply",
    "gyroscope",
    tuple(imucal.EffectParameter(axis, unit="rad/s/V", typical=1e-3) for axis in "xyz"),
    field,
)

# A discharging battery with a load that is switched on and off. A real recording has such a column.
TRUE = {"gyro_bias_supply": [0.02, -0.01, 0.015]}
run, control = (
    imucal.simulate(
        "random",
        seed=seed,
        effects=TRUE,
        user_effects=[supply],
        auxiliary={"supply_v": lambda time_s: 3.5 - 1e-3 * time_s - 0.1 * (np.sin(time_s / 30.0) > 0.5)},
    ).recording
    for seed in (1, 2)
)

plain = imucal.calibrate(run, control=control)
result = imucal.calibrate(run, control=control, effects=[supply])
for name, judged in (("before", plain), ("after", result)):
    figures = judged.control_set
    print(
        f"{name}: {figures.gravity_direction_rms_deg:.3f} deg rms per move of the control run, "
        f"chi2 per degree of freedom {figures.chi2_per_dof:.2f}"
    )
for parameter, true in zip(result.parameters[21:], TRUE["gyro_bias_supply"], strict=True):
    print(f"{parameter.name}: {parameter.value:.5f} +- {parameter.std:.5f} {parameter.unit}, true {true}")

# The search compares the effect with the whole catalogue.
gap = imucal.find_gap(run, control=control, user_effects=[supply])
print(gap.summary())

# The file contains the values but not the function, so the definition is given again.
result.calibration.save("unit.json")
calibration = imucal.Calibration.load("unit.json", user_effects=[supply])
for name, used in (("before", plain.calibration), ("after", calibration)):
    rate = used.apply_recording(control).angular_rate
    still = np.array([rate[rest.first : rest.end].mean(axis=0) for rest in result.control.rests])
    print(f"{name}: rate at rest {np.degrees(np.sqrt((still**2).mean())):.4f} deg/s rms")
