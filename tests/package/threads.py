"""Calibrates recordings in eight threads at once; the results must be those of one thread, bit for bit.

    python tests/package/threads.py [RECORDINGS]

Plain Python, because it is run by free-threaded versions, which few packages support. With PYTHON_GIL=0
checks that the extension has not switched the lock on.
"""

import os
import sys
from concurrent.futures import ThreadPoolExecutor

import imucal

THREADS = 8


def parameters(seed: int) -> str:
    """The calibration of a simulated run, as text with all digits."""
    run = imucal.simulate(imucal.Program.random(seed=seed, moves=12), unit="paper", rate_hz=50, seed=seed)
    calibration = imucal.calibrate(run.recording).calibration
    triads = calibration.accelerometer, calibration.gyroscope
    return repr([(triad.sensitivity.tolist(), triad.bias.tolist()) for triad in triads if triad is not None])


def main() -> int:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    one_by_one = [parameters(seed) for seed in range(count)]
    with ThreadPoolExecutor(THREADS) as pool:
        at_once = list(pool.map(parameters, range(count)))
    locked = getattr(sys, "_is_gil_enabled", lambda: True)()
    print(f"{count} recordings in {THREADS} threads, global lock {'on' if locked else 'off'}")
    if os.environ.get("PYTHON_GIL") == "0" and locked:
        print("an extension has switched the global lock on")
        return 1
    if at_once != one_by_one:
        print("results differ from those of one thread")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
