//! Python bindings of the reader for text tables of numbers.

use imucal::number_columns::{Column, Form, NotPlain, NumberColumns as Library};
use numpy::{IntoPyArray, PyArrayMethods, PyUntypedArray};
use pyo3::prelude::*;

/// Reads the columns of a text table that contains only numbers. The text is passed in blocks of bytes.
#[pyclass]
pub(crate) struct NumberColumns {
    /// None after a block that is not part of a plain table, and after a call of `finish`.
    table: Option<Library>,
}

#[pymethods]
impl NumberColumns {
    /// `separator` and `decimal` are the bytes of the field separator and of the decimal point. `used` states for each
    /// field of a line whether it becomes a column of the result.
    #[new]
    fn new(separator: u8, decimal: u8, used: Vec<bool>) -> Self {
        let form = Form { separator, decimal, used };
        Self { table: Some(Library::new(form)) }
    }

    /// Adds a block of text. Returns false if the text is not a plain table. In a plain table, each field in use is a
    /// decimal number, and all lines have equal numbers of fields.
    fn add(&mut self, py: Python<'_>, block: &[u8]) -> bool {
        let Some(table) = &mut self.table else { return false };
        let is_plain = py.detach(|| table.add(block)) == Ok(());
        if !is_plain {
            self.table = None;
        }
        is_plain
    }

    /// The columns as arrays of int64 or float64; None if the text is not a plain table.
    fn finish<'py>(&mut self, py: Python<'py>) -> Option<Vec<Bound<'py, PyUntypedArray>>> {
        let columns = self.table.take().ok_or(NotPlain).and_then(Library::finish).ok()?;
        Some(columns.into_iter().map(|column| array(py, column)).collect())
    }
}

fn array(py: Python<'_>, column: Column) -> Bound<'_, PyUntypedArray> {
    match column {
        Column::Whole(values) => values.into_pyarray(py).as_untyped().clone(),
        Column::Real(values) => values.into_pyarray(py).as_untyped().clone(),
    }
}
