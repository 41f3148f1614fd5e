"""The whole SciPy program as a process: read both files, calibrate, print; `start.py` times it.

python benches/scipy_process.py scipy_calibration.py xsens_acc.mat xsens_gyro.mat
"""

import importlib.util
import sys

import numpy as np

spec = importlib.util.spec_from_file_location("scipy_calibration", sys.argv[1])
program = importlib.util.module_from_spec(spec)
spec.loader.exec_module(program)
print(program.calibrate(np.loadtxt(sys.argv[2]), np.loadtxt(sys.argv[3]), use_means=True))
