//! Whitening for biases that vary between rests.

use faer::Mat;
use imucal_core::effects::Sensor;

use super::Joint;
use crate::error::Error;
use crate::joint::lanes::Lanes;
use crate::joint::linear::Linear;
use crate::joint::wander::{MOST_ROWS, UnitWander};

/// Second whitening of norms, moves and mean rates. It accounts for the covariance of biases that vary between rests,
/// model.md (28).
pub(crate) struct Wandering {
    /// Lower Cholesky factor of `I + D C D^T`. D contains the whitened derivatives with respect to the bias of each
    /// rest.
    factor: Mat<f64>,
}

impl Wandering {
    pub(crate) fn new(joint: &Joint<'_>, linear: &Linear, unit: &UnitWander) -> Result<Self, Error> {
        let rows = linear.lines.len() + 3 * linear.rates.len();
        if rows > MOST_ROWS {
            return Err(Error::Input(format!(
                "{} rests are too many to take the bias instability and the random walk into account: leave the unit's \
                 profile out, or calibrate with a part of the recordings",
                linear.rates.len()
            )));
        }
        let mut covariance = Mat::<f64>::identity(rows, rows);
        let [by_gyroscope, by_accelerometer] = joint.by_biases_of_rests(linear);
        let prepared = joint.prepared;
        for (index, recording) in prepared.recordings.iter().enumerate() {
            let (places, spans) = prepared.rests_of(index);
            for (sensor, wander, by_bias) in [
                (Sensor::Gyroscope, &unit.gyroscope, &by_gyroscope),
                (Sensor::Accelerometer, &unit.accelerometer, &by_accelerometer),
            ] {
                let raw = joint.raw_scale(sensor, &linear.model.parameters());
                for axis in 0..3 {
                    let own = wander.of_rests(axis, &spans, recording.span_s());
                    let by = Mat::from_fn(rows, places.len(), |row, k| raw * by_bias[(row, 3 * places[k] + axis)]);
                    covariance += &by * own * by.transpose();
                }
            }
        }
        let factor = covariance.llt(faer::Side::Lower).map_err(|_| {
            Error::Fit("the wandering of the biases outgrows all else: check bias_instability and random_walk".into())
        })?;
        Ok(Self { factor: factor.L().to_owned() })
    }

    /// Whitens the rows of norms, moves and mean rates of a matrix.
    pub(crate) fn apply(&self, matrix: &mut Mat<f64>) {
        let head = matrix.as_ref().subrows(0, self.factor.nrows()).to_owned();
        let white = self.solved(&head);
        matrix.as_mut().subrows_mut(0, self.factor.nrows()).copy_from(&white);
    }

    /// Whitens the rows of norms, moves and mean rates, stored row by row.
    pub(crate) fn apply_to_rows(&self, rows: &mut Lanes) {
        let (count, width) = (self.factor.nrows(), rows.width());
        let head = Mat::from_fn(count, width, |row, place| rows.row(row)[place]);
        let white = self.solved(&head);
        for row in 0..count {
            rows.row_mut(row).iter_mut().enumerate().for_each(|(place, to)| *to = white[(row, place)]);
        }
    }

    /// Whitens a column whose nonzero values begin at row `first`. Returns the values from that row on.
    pub(crate) fn unit(&self, first: usize, column: &[f64]) -> Vec<f64> {
        let whole = Mat::from_fn(self.factor.nrows(), 1, |row, _| {
            row.checked_sub(first).and_then(|k| column.get(k)).copied().unwrap_or(0.0)
        });
        let white = self.solved(&whole);
        (first..white.nrows()).map(|row| white[(row, 0)]).collect()
    }

    fn solved(&self, right: &Mat<f64>) -> Mat<f64> {
        let mut white = right.clone();
        self.factor.as_ref().solve_lower_triangular_in_place(&mut white);
        white
    }
}
