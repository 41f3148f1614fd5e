//! Python bindings.
#[pyo3::pymodule]
mod _core {}
