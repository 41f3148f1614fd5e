"""Time of the simulation relative to drawing its white noise: `make bench`, to docs/results/speed.md."""

import numpy as np

import imucal
from compare import REPORT, medians_ms
from sections import machine_name, write_section

SECTION = "Simulation"
ROUNDS = 5
LIMIT = 5.0
RATE_HZ = 1000.0
# Moves of the paper's random program for one hour; the paper has 45.
MOVES = 514
TEN = (
    "gyro_g_sensitivity",
    "gyro_scale_quadratic",
    "gyro_scale_asymmetry",
    "gyro_bias_temperature",
    "gyro_bias_drift",
    "gyro_angular_acceleration",
    "earth_rate",
    "accel_scale_quadratic",
    "accel_bias_warmup",
    "accel_lever_arm",
)


def sensor(density: float, instability: float = 0.0, walk: float = 0.0) -> imucal.Sensor:
    return imucal.Sensor(noise_density=density, bias_instability=instability, random_walk=np.full(3, walk))


def simulation_lines() -> list[str]:
    """Simulations of one hour at 1 kHz with an increasing number of errors."""
    program = imucal.Program.random(seed=1, moves=MOVES)
    effects = dict.fromkeys(TEN, "typical")
    white = imucal.Unit(sensor(1e-3), sensor(1e-4))
    all_noise = imucal.Unit(sensor(1e-3, 1e-4, 1e-5), sensor(1e-4, 1e-5, 1e-6))

    def run(unit: imucal.Unit, effects: dict[str, str]) -> imucal.Simulation:
        return imucal.simulate(
            program, unit=unit, effects=effects, temperature="cycle:10:50:1200", rate_hz=RATE_HZ, seed=1
        )

    samples = len(run(white, {}).recording.time_s)
    generator = np.random.default_rng(1)
    functions = {
        "NumPy: `standard_normal`, six numbers per sample": lambda: generator.standard_normal((samples, 6)),
        "imucal: white noise": lambda: run(white, {}),
        "imucal: white noise, ten effects": lambda: run(white, effects),
        "imucal: white and flicker noise, random walk, ten effects": lambda: run(all_noise, effects),
    }
    ms = medians_ms(functions, ROUNDS)
    numpy_ms = next(iter(ms.values()))
    rows = [f"| {name} | {value:.0f} | {value / numpy_ms:.1f} |" for name, value in ms.items()]
    worst = max(ms.values()) / numpy_ms
    met = "met" if worst <= LIMIT else "missed"
    return [
        f"The paper's random program for an hour at 1 kHz ({samples} samples) on a perfect stand, with a",
        "changing temperature. The time is that from the setup to recording and truth in memory.",
        "",
        "| | ms | times NumPy |",
        "|---|---:|---:|",
        *rows,
        "",
        f"The aim, at most {LIMIT:.0f} times the time of NumPy with ten effects, is {met}. imucal uses all",
        "processors, NumPy one. The result does not depend on the number of processors.",
    ]


def main() -> None:
    taken_on = f"{machine_name()}, NumPy {np.__version__}. Medians of {ROUNDS} interleaved rounds."
    write_section(REPORT, "Speed", SECTION, "\n".join([taken_on, "", *simulation_lines()]))


if __name__ == "__main__":
    main()
