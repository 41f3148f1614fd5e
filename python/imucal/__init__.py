"""Calibrate MEMS accelerometers and gyroscopes with gravity as the only reference.

    rec = imucal.read("run.csv")
    result = imucal.calibrate(rec, control=imucal.read("control.csv"))
    result.calibration.save("unit-0042.json")
    rate, force = result.calibration.apply(rec.angular_rate, rec.specific_force)

Conventions: SI units; one sample per row; a sensor at rest reads +g on the axis that points up; measured = T
true + bias.
"""

import lazy_loader

import imucal.data_frame as _data_frame
import imucal.notebook as _notebook

# Each name is loaded when it is first used, so `import imucal` loads no library for arrays, files or
# commands. The names are listed once, in the stub, for this call and for type checkers.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

_notebook.register("imucal.report.notebook")
_data_frame.register("imucal.io.frames")
