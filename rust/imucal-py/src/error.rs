//! Converts the library's errors to the classes of `imucal.errors`, which are defined in Python.

use imucal::error::Error;
use imucal::finding::{Finding, Severity};
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use pyo3::types::PyTuple;

/// Converts an error of the library to a Python exception.
pub(crate) trait ToPython<T> {
    fn to_python(self, py: Python<'_>) -> PyResult<T>;
}

impl<T> ToPython<T> for Result<T, Error> {
    fn to_python(self, py: Python<'_>) -> PyResult<T> {
        self.map_err(|error| python_error(py, &error).unwrap_or_else(|failure| failure))
    }
}

fn python_error(py: Python<'_>, error: &Error) -> PyResult<PyErr> {
    let class = match error {
        // The library called a Python function, which raised an exception (`cause`).
        Error::Caller(cause) => {
            return Ok(match cause.downcast_ref::<PyErr>() {
                Some(exception) => exception.clone_ref(py),
                None => PyRuntimeError::new_err(cause.to_string()),
            });
        }
        Error::Input(_) | Error::Data(_) => "InputError",
        Error::NotEnoughMotion(_) => "NotEnoughMotionError",
        Error::Fit(_) => "FitError",
        // Only a signal cancels a calculation, and `interruptible` then raises the exception of the signal handler
        // instead of this class.
        Error::Cancelled => "ImucalError",
    };
    let class = py.import("imucal.errors")?.getattr(class)?;
    let message = error.to_string();
    let instance = match error {
        Error::Data(findings) => {
            let findings = findings.iter().map(|f| finding(py, f)).collect::<PyResult<Vec<_>>>()?;
            class.call1((message, findings))?
        }
        _ => class.call1((message,))?,
    };
    Ok(PyErr::from_value(instance))
}

/// Converts a finding to an `imucal.finding.Finding`.
pub(crate) fn finding(py: Python<'_>, finding: &Finding) -> PyResult<Py<PyAny>> {
    let module = py.import("imucal.finding")?;
    let place = match &finding.place {
        Some(place) => module
            .getattr("Place")?
            .call1((place.first_sample, place.last_sample, place.start_s, place.end_s))?
            .unbind(),
        None => py.None(),
    };
    let severity = match finding.severity {
        Severity::Warning => "warning",
        Severity::Error => "error",
    };
    let arguments = (
        finding.code,
        severity,
        &finding.recording,
        PyTuple::new(py, &finding.columns)?,
        place,
        finding.count,
        finding.value,
        finding.unit,
        &finding.message,
        &finding.way_out,
    );
    Ok(module.getattr("Finding")?.call1(arguments)?.unbind())
}
