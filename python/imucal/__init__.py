"""Calibrate MEMS accelerometers and gyroscopes with gravity as the only reference.

    rec = imucal.read("run.csv")
    result = imucal.calibrate(rec, control=imucal.read("control.csv"))
    result.calibration.save("unit-0042.json")
    rate, force = result.calibration.apply(rec.angular_rate, rec.specific_force)

Conventions: SI units; one sample per row; an accelerometer at rest reads +g on the axis that points up. The
sensor model is measured = T true + bias, where T is the product of scale factors and misalignment.
"""

import lazy_loader

import imucal.data_frame as _data_frame
import imucal.notebook as _notebook

# Each name is loaded when it is first used, so `import imucal` loads no library for arrays, files or
# commands. The stub `__init__.pyi` is the only list of the names, for this call and for type checkers.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

_notebook.register("imucal.report.notebook")
_data_frame.register("imucal.io.frames")
