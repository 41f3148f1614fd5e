//! Quantisation step (LSB) of the readings of one axis: the distance between two adjacent levels of the converter, in
//! the unit of the readings. It is determined from the readings of this axis only.
//!
//! Values may be counts, counts times a scale, or such products rounded to float32 or to the decimals of a text file.
//! If a recording was corrected for misalignment, each axis is a linear combination of the counts of three axes. The
//! readings of such an axis are not quantised, or their quantisation step is far below the noise.

use crate::recording::Samples;

/// Maximum number of samples that are examined.
const MOST_SAMPLES: usize = 200_000;
/// Relative accuracy of float32. Differences below this fraction of the largest value are due to the number format.
const FLOAT32: f64 = 3e-7;
/// Largest distance between neighbouring levels, in steps, that is compared with the multiples of the quantisation
/// step.
const FAR: f64 = 20.5;
/// Maximum deviation of a distance between two levels from a multiple of the step, in steps. In a text file with few
/// decimals, the distances are uneven.
const UNEVEN: f64 = 0.25;
/// Readings are quantised only if at least this share of the distances between neighbouring levels are multiples of the
/// step. Only distances shorter than [`FAR`] steps are counted.
const REGULAR: f64 = 0.9;
/// Readings are quantised only if at least this share of the distances between neighbouring levels is shorter than
/// [`FAR`] steps. Continuous values do not reach this share, because most of their distances are much larger than the
/// smallest distance.
const NEAR: f64 = 0.5;

/// Quantisation step (LSB) of the readings of an axis; `None` if the readings are not quantised.
pub(crate) fn step_of(rows: Samples<'_>, axis: usize) -> Option<f64> {
    let every = rows.len().div_ceil(MOST_SAMPLES).max(1);
    let mut levels: Vec<f64> = rows.axis(axis).step_by(every).filter(|value| value.is_finite()).collect();
    levels.sort_unstable_by(f64::total_cmp);
    let largest = levels.first()?.abs().max(levels.last()?.abs());
    let gaps: Vec<f64> =
        levels.windows(2).map(|pair| pair[1] - pair[0]).filter(|gap| *gap > FLOAT32 * largest).collect();
    let smallest = gaps.iter().copied().reduce(f64::min)?;
    let single: Vec<f64> = gaps.iter().copied().filter(|gap| *gap < 1.5 * smallest).collect();
    let step = single.iter().sum::<f64>() / single.len() as f64;
    let near: Vec<f64> = gaps.iter().map(|gap| gap / step).filter(|ratio| *ratio < FAR).collect();
    let regular = near.iter().filter(|ratio| (*ratio - ratio.round()).abs() < UNEVEN).count() as f64;
    let is_lattice = regular >= REGULAR * near.len() as f64 && near.len() as f64 >= NEAR * gaps.len() as f64;
    is_lattice.then_some(step)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Simulates the counts of a converter: a slow oscillation of 40 counts plus a disturbance of 0.3 counts, rounded.
    fn counts() -> Vec<f64> {
        let value = |k: i32| 40.0 * (f64::from(k) * 0.01).sin() + 0.3 * (f64::from(k) * 12.9898).sin();
        (0..3000).map(|k| value(k).round()).collect()
    }

    fn found(values: impl Iterator<Item = f64>) -> Option<f64> {
        let rows: Vec<[f64; 3]> = values.map(|value| [value, 0.0, 0.0]).collect();
        step_of(Samples::from(&rows), 0)
    }

    #[test]
    fn counts_in_any_unit_and_number_format_have_their_step() {
        let lsb = 0.07_f64.to_radians();
        let near = |step: Option<f64>, expected: f64| (step.unwrap() / expected - 1.0).abs() < 1e-3;
        assert_eq!(found(counts().into_iter()), Some(1.0));
        assert_eq!(found(counts().into_iter().map(|k| 16.0 * k)), Some(16.0));
        assert!(near(found(counts().into_iter().map(|k| k * lsb + 0.3)), lsb));
        assert!(near(found(counts().into_iter().map(|k| f64::from((k * lsb) as f32))), lsb));
        let decimals = |k: f64, digits: f64| (k * lsb * digits).round() / digits;
        assert!(near(found(counts().into_iter().map(|k| decimals(k, 1e6))), lsb));
        assert!((found(counts().into_iter().map(|k| decimals(k, 1e4))).unwrap() / lsb - 1.0).abs() < 0.02);
    }

    #[test]
    fn continuous_values_have_no_step_and_a_mix_of_axes_none_that_matters() {
        assert_eq!(found((0..3000).map(|k| (f64::from(k) * 0.37).sin() * 3.0)), None);
        let mix = counts().into_iter().zip(counts().into_iter().skip(77)).map(|(x, y)| x + 0.0123 * y);
        assert!(found(mix).is_none_or(|step| step < 0.02), "the noise of a count is 0.3");
        assert_eq!(found([0.0; 100].into_iter()), None);
    }
}
