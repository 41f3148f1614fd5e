//! Corrects the samples of standard input with an exported module: rows of raw rate, raw force and temperature
//! difference, little-endian doubles. Gives rows of rate and force, first those of `f64`, then those of `f32`.

use imucal_core::{calibration::Calibration, effects::Surroundings};
use nalgebra::{RealField, Vector3, convert, try_convert};
use std::io::{Read, Result, Write, stdin, stdout};

mod unit {
    include!(env!("IMUCAL_EXPORT"));
}

fn correct<F: RealField + Copy>(calibration: &Calibration<F>, row: &[f64]) -> [f64; 6] {
    let vector = |numbers: &[f64]| Vector3::new(numbers[0], numbers[1], numbers[2]).map(convert::<f64, F>);
    let surroundings = Surroundings { temperature_difference_k: Some(convert(row[6])), ..Surroundings::unknown() };
    let (raw_rate, raw_force) = (vector(&row[..3]), vector(&row[3..6]));
    #[cfg(not(feature = "formulas"))]
    let (rate, force) = calibration.correct_at(raw_rate, raw_force, &surroundings);
    // The column supply_v of the test repeats the temperature, degC.
    #[cfg(feature = "formulas")]
    let (rate, force) = calibration.correct_with(raw_rate, raw_force, &surroundings, |state| {
        unit::formulas(state, convert::<f64, F>(row[6] + 25.0))
    });
    [rate.x, rate.y, rate.z, force.x, force.y, force.z].map(|value| try_convert(value).expect("a float is a double"))
}

fn main() -> Result<()> {
    let mut bytes = Vec::new();
    stdin().read_to_end(&mut bytes)?;
    let numbers: Vec<f64> = bytes.as_chunks().0.iter().map(|chunk| f64::from_le_bytes(*chunk)).collect();
    let double = unit::calibration::<f64>().expect("the export is a calibration");
    let single = unit::calibration::<f32>().expect("the export is a calibration");
    let rows = numbers.chunks_exact(7);
    let corrected = rows.clone().map(|row| correct(&double, row)).chain(rows.map(|row| correct(&single, row)));
    let bytes: Vec<u8> = corrected.flatten().flat_map(f64::to_le_bytes).collect();
    stdout().write_all(&bytes)
}
