//! Evaluates user-defined effects with Python functions, which the library calls during a fit.

use std::sync::Arc;

use imucal::calibrate::{BriefCorrection, CorrectedSamples, Outcome, SampledField, UserEffects};
use imucal::error::Error;
use imucal::verdict::RecordingSet;
use numpy::PyReadonlyArray2;
use pyo3::prelude::*;

use crate::arrays::{UserFieldArrays, rows};
use crate::results::Estimate;

/// A Python object that evaluates user-defined effects. It has the attribute `names` and the methods `fields(names,
/// estimate)`, `corrected(estimate, of_control)` and `brief_means(before, after, of_control)`. The trait
/// [`UserEffects`] describes these methods.
pub(crate) struct PythonEffects {
    names: Vec<String>,
    source: Py<PyAny>,
}

impl<'py> FromPyObject<'_, 'py> for PythonEffects {
    type Error = PyErr;

    fn extract(source: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        Ok(Self { names: source.getattr("names")?.extract()?, source: source.to_owned().unbind() })
    }
}

impl PythonEffects {
    /// Calls a method of the object, and converts an exception to the corresponding error of the library.
    fn call<T>(&self, work: impl FnOnce(Python<'_>, &Bound<'_, PyAny>) -> PyResult<T>) -> Result<T, Error> {
        Python::attach(|py| work(py, self.source.bind(py)).map_err(|error| library_error(py, error)))
    }
}

impl UserEffects for PythonEffects {
    fn names(&self) -> &[String] {
        &self.names
    }

    fn fields(&self, names: &[String], outcome: &Outcome) -> Result<Vec<SampledField>, Error> {
        self.call(|py, source| {
            let found = source.call_method1("fields", (names, Estimate::new(py, outcome)?))?;
            sampled(py, &found.extract::<Vec<UserFieldArrays<'_>>>()?)
        })
    }

    fn corrected(&self, outcome: &Outcome, set: RecordingSet) -> Result<Vec<CorrectedSamples>, Error> {
        self.call(|py, source| {
            let of_control = set == RecordingSet::Control;
            let found = source.call_method1("corrected", (Estimate::new(py, outcome)?, of_control))?;
            samples(py, &found.extract::<Vec<RateAndForce<'_>>>()?)
        })
    }

    fn brief_means(&self, before: &Outcome, after: &Outcome, set: RecordingSet) -> Result<BriefCorrection, Error> {
        type Found<'py> = (Vec<RateAndForce<'py>>, Vec<RateAndForce<'py>>, Vec<UserFieldArrays<'py>>);
        self.call(|py, source| {
            let estimates = (Estimate::new(py, before)?, Estimate::new(py, after)?, set == RecordingSet::Control);
            let found = source.call_method1("brief_means", estimates)?;
            let (before, after, fields) = found.extract::<Found<'_>>()?;
            Ok(BriefCorrection {
                before: samples(py, &before)?,
                after: samples(py, &after)?,
                fields: sampled(py, &fields)?,
            })
        })
    }
}

/// Corrected angular rate and specific force of one recording, (N, 3) each.
type RateAndForce<'py> = (PyReadonlyArray2<'py, f64>, PyReadonlyArray2<'py, f64>);

fn samples(py: Python<'_>, arrays: &[RateAndForce<'_>]) -> PyResult<Vec<CorrectedSamples>> {
    let of_recording = |(rate, force): &RateAndForce<'_>| {
        Ok((rows(py, rate, "angular_rate")?.to_vec(), rows(py, force, "specific_force")?.to_vec()))
    };
    arrays.iter().map(of_recording).collect()
}

fn sampled(py: Python<'_>, fields: &[UserFieldArrays<'_>]) -> PyResult<Vec<SampledField>> {
    let of_field = |field: &UserFieldArrays<'_>| {
        let view = field.view(py)?;
        let columns = view.columns.iter().map(|columns| columns.to_vec()).collect();
        Ok(SampledField { name: view.name.to_owned(), sensor: view.sensor, typical: view.typical, columns })
    };
    fields.iter().map(of_field).collect()
}

/// Converts an exception of a Python function to an error of the library. FitError, NotEnoughMotionError and an
/// InputError without findings are converted to the corresponding error of the library. Any other exception reaches the
/// user unchanged.
pub(crate) fn library_error(py: Python<'_>, error: PyErr) -> Error {
    let message = error.value(py).to_string();
    let is = |name: &str| {
        let class = py.import("imucal.errors").and_then(|errors| errors.getattr(name));
        class.is_ok_and(|class| error.get_type(py).is(&class))
    };
    let has_findings = || {
        let findings = error.value(py).getattr("findings").and_then(|findings| findings.len());
        findings.is_ok_and(|count| count > 0)
    };
    if is("FitError") {
        Error::Fit(message)
    } else if is("NotEnoughMotionError") {
        Error::NotEnoughMotion(message)
    } else if is("InputError") && !has_findings() {
        Error::Input(message)
    } else {
        Error::Caller(Arc::new(error))
    }
}
