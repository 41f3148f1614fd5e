//! Runs calculations so that a signal can cancel them, for example the signal of Ctrl-C.

use std::sync::{Arc, Mutex, PoisonError};

use imucal::cancellation::Cancellation;
use imucal::error::Error;
use pyo3::prelude::*;

use crate::error::ToPython;

/// Runs `work` while the Python interpreter lock (GIL) is released. If a Python signal handler raises an exception
/// during `work`, the calculation is cancelled, and the exception is returned. Python runs signal handlers only on its
/// main thread, so a call from another thread cannot be cancelled.
pub(crate) fn interruptible<T: Send>(py: Python<'_>, work: impl FnOnce() -> Result<T, Error> + Send) -> PyResult<T> {
    let raised: Arc<Mutex<Option<PyErr>>> = Arc::default();
    let kept = raised.clone();
    let cancellation = Cancellation::with_poll(move || {
        let Err(error) = Python::attach(|py| py.check_signals()) else { return false };
        *kept.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
        true
    });
    let found = py.detach(|| cancellation.run(work));
    match raised.lock().unwrap_or_else(PoisonError::into_inner).take() {
        Some(error) => Err(error),
        None => found.to_python(py),
    }
}
