//! Attitudes along a move, for residuals inside it.

use imucal_core::integrate::Integrator;
use nalgebra::{UnitQuaternion, Vector3};

use crate::error::Error;

/// Rotations from the body at the samples `at`, and half-way between each two of them, to the body at the first of
/// `at`.
///
/// # Errors
/// [`Error::Input`] for indices that do not rise or lie beyond the samples, and for columns of different lengths.
pub fn attitudes(time_s: &[f64], angular_rate: &[[f64; 3]], at: &[usize]) -> Result<Vec<UnitQuaternion<f64>>, Error> {
    let samples = time_s.len();
    if angular_rate.len() != samples || at.windows(2).any(|pair| pair[0] >= pair[1]) || at.last() >= Some(&samples) {
        let message =
            format!("{samples} times and {} rates at {at:?}: indices must rise within them", angular_rate.len());
        return Err(Error::Input(message));
    }
    let mut whole = UnitQuaternion::identity();
    let mut found = Vec::with_capacity(2 * at.len());
    found.extend(at.first().map(|_| whole));
    for pair in at.windows(2) {
        let mut integrator = Integrator::new();
        let mut last = time_s[pair[0]];
        for (&time, rate) in time_s[pair[0]..=pair[1]].iter().zip(&angular_rate[pair[0]..=pair[1]]) {
            integrator.push(time - last, Vector3::from(*rate));
            last = time;
        }
        let turn = integrator.rotation();
        found.push(whole * UnitQuaternion::from_scaled_axis(turn.scaled_axis() * 0.5));
        whole *= turn;
        found.push(whole);
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_way_of_an_even_turn_is_half_of_it() {
        let time: Vec<f64> = (0..11).map(|k| f64::from(k) * 0.1).collect();
        let found = attitudes(&time, &[[0.0, 0.0, 1.0]; 11], &[0, 4, 10]).unwrap();
        let angles: Vec<f64> = found.iter().map(|rotation| rotation.scaled_axis().z).collect();
        for (angle, expected) in angles.iter().zip([0.0, 0.2, 0.4, 0.7, 1.0]) {
            assert!((angle - expected).abs() < 1e-12, "{angles:?}");
        }
        assert!(attitudes(&time, &[[0.0; 3]; 11], &[0, 11]).is_err());
    }
}
