"""Simulate your own program to see how accurate its calibration is, before you run it on a stand.

This program is shorter than the paper's: 24 positions, one motor at a time, with rests of 2 s.
"""

import imucal

steps = [imucal.Step((0.0, 0.0, 0.0), move_s=0.0, hold_s=2.0)]
for k in range(24):
    turn_deg = [0.0, 0.0, 0.0]
    turn_deg[k % 3] = 90.0 if k % 4 < 2 else -135.0
    steps.append(imucal.Step((turn_deg[0], turn_deg[1], turn_deg[2]), move_s=1.5, hold_s=2.0))
program = imucal.Program(tuple(steps))
program.write("program.json")  # also for `imucal simulate program.json`

simulation = imucal.simulate(program, unit="paper", rate_hz=100.0, seed=3)
result = imucal.calibrate(simulation.recording)
truth = {parameter.name: parameter.value for parameter in simulation.truth.calibration.parameters}

print(f"{simulation.recording.duration_s:.0f} s on the stand, {len(simulation.truth.rests)} rests")
for parameter in result.parameters:
    error = parameter.value - truth[parameter.name]
    print(f"{parameter.name:<22} 1 sigma {parameter.std:.1e} {parameter.unit:<6} error {error:+.1e}")
