"""An effect of your own: the gyroscope's bias follows the supply voltage, recorded along.

Simulate it, estimate it together with the 21 parameters, judge on a run that the fit never saw,
and let it be found.
"""

import numpy as np

import imucal


def field(state: imucal.State) -> np.ndarray:
    """What one unit of each parameter adds to the true rate: (N, 3, 3), rad/s per V off 3.3 V."""
    return (state.auxiliary["supply_v"] - 3.3)[:, None, None] * np.eye(3)


supply = imucal.UserEffect(
    "gyro_bias_supply",
    "gyroscope",
    tuple(imucal.EffectParameter(axis, unit="rad/s/V", typical=1e-3) for axis in "xyz"),
    field,
)

# A battery that empties, and a load that comes and goes. Real recordings bring such a column along.
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
        f"{name}: {figures['gravity_direction_rms_deg']:.3f} deg rms per move of the control run, "
        f"chi2 per degree of freedom {figures['chi2_per_dof']:.2f}"
    )
for parameter, true in zip(result.parameters[21:], TRUE["gyro_bias_supply"], strict=True):
    print(f"{parameter.name}: {parameter.value:.5f} +- {parameter.std:.5f} {parameter.unit}, true {true}")

# Is it that effect? The search knows all of the catalogue, too.
gap = imucal.find_gap(run, control=control, user_effects=[supply])
print(gap.summary())

# The file has the numbers, not the function: give the definition again.
result.calibration.save("unit.json")
calibration = imucal.Calibration.load("unit.json", user_effects=[supply])
for name, used in (("before", plain.calibration), ("after", calibration)):
    rate = used.apply_recording(control).angular_rate
    still = np.array([rate[rest["first"] : rest["end"]].mean(axis=0) for rest in result.control.rests])
    print(f"{name}: rate at rest {np.degrees(np.sqrt((still**2).mean())):.4f} deg/s rms")
