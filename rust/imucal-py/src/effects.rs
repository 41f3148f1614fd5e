//! Effects with numbers on their way in.

use imucal::error::Error;
use imucal_core::effects::{self as library, EffectSet};
use numpy::PyReadonlyArray1;
use pyo3::prelude::*;

use crate::arrays::column;
use crate::error::ToPython;

fn find(name: &str) -> Result<&'static library::Effect<f64>, Error> {
    library::Effect::find(name).ok_or_else(|| {
        Error::Input(format!("the effect {name:?} is not in the catalogue: imucal.effects.catalogue() lists it"))
    })
}

/// An `imucal.EffectValues`, taken by attribute.
#[derive(FromPyObject)]
pub(crate) struct EffectArrays<'py> {
    name: String,
    values: PyReadonlyArray1<'py, f64>,
    shape: Option<f64>,
}

impl EffectArrays<'_> {
    /// The effects of a unit as the library takes them.
    pub(crate) fn set(py: Python<'_>, effects: &[Self]) -> PyResult<EffectSet<f64>> {
        let mut set = EffectSet::none();
        for effect in effects {
            let values = column(py, &effect.values, &format!("the values of {}", effect.name))?;
            let row = find(&effect.name).to_python(py)?;
            library::EffectValues::try_new(row, values, effect.shape)
                .and_then(|values| set.push(values))
                .map_err(|error| Error::Input(error.to_string()))
                .to_python(py)?;
        }
        Ok(set)
    }
}
