"""The SciPy program as a whole process, for `start.py`: reads both files, calibrates, and prints.

python benches/scipy_process.py scipy_calibration.py xsens_acc.mat xsens_gyro.mat
"""

import importlib.util
import sys

import numpy as np


def main(program: str, accel: str, gyro: str) -> None:
    # The folder of the program is not part of this repository, so no bytecode is stored there.
    sys.dont_write_bytecode = True
    spec = importlib.util.spec_from_file_location("scipy_calibration", program)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    print(module.calibrate(np.loadtxt(accel), np.loadtxt(gyro), use_means=True))


if __name__ == "__main__":
    main(*sys.argv[1:])
