//! Biases that wander from rest to rest (model.md (28)).
//!
//! ```text
//! C_kl = cov(mean of b over rest k, mean of b over rest l),   b measured from its mean over the recording
//! covariance of b(t), b(s), up to a constant:   -B^2/pi ln |t - s|  -  K^2/2 |t - s|
//! ```
//!
//! with the bias instability B and the random walk K of each axis. Minutes of rests show a large B alone; else they are given.
//! What is estimated then is the mean bias over the recording, and a move has the bias of the rests around it.

use std::f64::consts::PI;

use faer::Mat;
use imucal_core::effects::Sensor;

use super::linear::Linear;
use super::prepared::Prepared;
use super::problem::Joint;
use crate::error::Error;
use crate::recording::Recording;

/// More residuals have a covariance that takes too long to factor.
const MOST_ROWS: usize = 6000;

/// How the biases of a unit are taken to wander.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Wander {
    /// They do not: what rests scatter they scatter one by one.
    Constant,
    /// As far as the rates at the rests show it, and it is likelier than a scatter one by one.
    Seen,
    Known(UnitWander),
}

/// How the biases of one sensor wander, x, y and z, SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BiasWander {
    /// Bias instability B: the floor of the Allan deviation is `sqrt(2 ln 2 / pi) B`.
    pub bias_instability: [f64; 3],
    /// Random walk K, per sqrt(s): the Allan deviation is `K sqrt(tau / 3)`.
    pub random_walk: [f64; 3],
}

/// How the biases of a unit wander.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnitWander {
    /// m/s^2.
    pub accelerometer: BiasWander,
    /// rad/s.
    pub gyroscope: BiasWander,
}

impl UnitWander {
    /// A gyroscope with these bias instabilities, and nothing else.
    pub(crate) fn of_gyroscope(bias_instability: [f64; 3]) -> Self {
        let none = BiasWander { bias_instability: [0.0; 3], random_walk: [0.0; 3] };
        Self { accelerometer: none, gyroscope: BiasWander { bias_instability, ..none } }
    }

    /// # Errors
    /// [`Error::Input`] for a number that is negative or not finite.
    pub fn check(&self) -> Result<(), Error> {
        for (name, wander) in [("accelerometer", &self.accelerometer), ("gyroscope", &self.gyroscope)] {
            for value in wander.bias_instability.iter().chain(&wander.random_walk) {
                if !(value.is_finite() && *value >= 0.0) {
                    return Err(Error::Input(format!(
                        "bias_instability or random_walk of the {name} is {value}: give numbers from zero on, SI units"
                    )));
                }
            }
        }
        Ok(())
    }
}

impl BiasWander {
    /// Second integral of the covariance of an axis, by the lag.
    fn integrated(&self, axis: usize, lag_s: f64) -> f64 {
        let lag_s = lag_s.abs();
        if lag_s == 0.0 {
            return 0.0;
        }
        let flicker = lag_s * lag_s / 2.0 * (lag_s.ln() - 1.5);
        let (b, k) = (self.bias_instability[axis], self.random_walk[axis]);
        -b * b / PI * flicker - k * k / 12.0 * lag_s.powi(3)
    }

    /// Covariance of the means over two stretches of time, up to a constant.
    fn covariance(&self, axis: usize, [a, b]: [f64; 2], [c, d]: [f64; 2]) -> f64 {
        let g = |lag_s: f64| self.integrated(axis, lag_s);
        (g(d - a) - g(c - a) - g(d - b) + g(c - b)) / ((b - a) * (d - c))
    }

    /// Covariance of the means over the rests of one recording, each less the mean over `whole`.
    fn of_rests(&self, axis: usize, rests: &[[f64; 2]], whole: [f64; 2]) -> Mat<f64> {
        let with_whole: Vec<f64> = rests.iter().map(|rest| self.covariance(axis, *rest, whole)).collect();
        let all = self.covariance(axis, whole, whole);
        let mut own = Mat::zeros(rests.len(), rests.len());
        for (i, j) in (0..rests.len()).flat_map(|i| (0..=i).map(move |j| (i, j))) {
            own[(i, j)] = self.covariance(axis, rests[i], rests[j]) - with_whole[i] - with_whole[j] + all;
            own[(j, i)] = own[(i, j)];
        }
        own
    }
}

/// Covariance of the mean biases at the rests that take part, in their order, for a bias instability of one; `None` where there
/// are too many.
pub(crate) fn flicker_of_rests(prepared: &Prepared<'_>) -> Option<Mat<f64>> {
    let places: Vec<usize> = (0..prepared.rests.len()).filter(|&k| prepared.used[k]).collect();
    if rows(places.len(), prepared.moves.len()) > MOST_ROWS {
        return None;
    }
    let unit = BiasWander { bias_instability: [1.0; 3], random_walk: [0.0; 3] };
    let mut covariance = Mat::zeros(places.len(), places.len());
    for (index, recording) in prepared.recordings.iter().enumerate() {
        let (at, spans): (Vec<usize>, Vec<[f64; 2]>) = (places.iter().enumerate())
            .filter(|(_, k)| prepared.rests[**k].recording == index)
            .map(|(at, k)| (at, [prepared.rests[*k].rest.start_s, prepared.rests[*k].rest.end_s]))
            .unzip();
        let own = unit.of_rests(0, &spans, span(recording));
        for (i, j) in (0..at.len()).flat_map(|i| (0..at.len()).map(move |j| (i, j))) {
            covariance[(at[i], at[j])] = own[(i, j)];
        }
    }
    Some(covariance)
}

/// A norm and three rates for each rest, and two lines for each move.
fn rows(rests: usize, moves: usize) -> usize {
    4 * rests + 2 * moves
}

/// Whitens the residuals of rests and moves once more, for what the wandering biases add to white noise.
pub(crate) struct Wandering {
    /// Lower factor of `I + D C D^T`, D the whitened derivatives by the bias of each rest.
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
            let (places, spans): (Vec<usize>, Vec<[f64; 2]>) = (0..prepared.rests.len())
                .filter(|&k| prepared.used[k] && prepared.rests[k].recording == index)
                .map(|k| (k, [prepared.rests[k].rest.start_s, prepared.rests[k].rest.end_s]))
                .unzip();
            for (sensor, wander, by_bias) in [
                (Sensor::Gyroscope, &unit.gyroscope, &by_gyroscope),
                (Sensor::Accelerometer, &unit.accelerometer, &by_accelerometer),
            ] {
                let raw = joint.raw_scale(sensor, &linear.model.parameters());
                for axis in 0..3 {
                    let own = wander.of_rests(axis, &spans, span(recording));
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

    /// Whitens the first rows of a matrix.
    pub(crate) fn apply(&self, matrix: &mut Mat<f64>) {
        let head = matrix.as_ref().subrows(0, self.factor.nrows()).to_owned();
        let white = self.solved(&head);
        matrix.as_mut().subrows_mut(0, self.factor.nrows()).copy_from(&white);
    }

    /// What is left of a column that begins at row `first`, from there on.
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

fn span(recording: &Recording<'_>) -> [f64; 2] {
    [recording.time_s[0], recording.time_s[recording.len() - 1]]
}

#[cfg(test)]
mod tests {
    use super::*;

    const UNIT: BiasWander = BiasWander { bias_instability: [2e-5, 0.0, 3e-5], random_walk: [0.0, 4e-6, 1e-6] };

    /// The Allan variance is half the mean square of the difference of neighbouring means.
    #[test]
    fn neighbouring_means_have_the_allan_variance_of_the_definitions() {
        for (axis, tau_s) in [(0, 0.5), (1, 3.0), (2, 100.0)] {
            let spans = [[7.0, 7.0 + tau_s], [7.0 + tau_s, 7.0 + 2.0 * tau_s]];
            let c = |i: usize, j: usize| UNIT.covariance(axis, spans[i], spans[j]);
            let (b, k) = (UNIT.bias_instability[axis], UNIT.random_walk[axis]);
            let expected = 2.0 * 2f64.ln() / PI * b * b + k * k * tau_s / 3.0;
            let allan = (c(0, 0) + c(1, 1) - 2.0 * c(0, 1)) / 2.0;
            assert!((allan / expected - 1.0).abs() < 1e-9, "{axis}: {allan:e} {expected:e}");
        }
    }

    #[test]
    fn means_of_all_parts_add_up_to_the_mean_of_the_recording() {
        let spans: Vec<[f64; 2]> = (0..10).map(|k| [f64::from(k) * 3.0, f64::from(k + 1) * 3.0]).collect();
        for axis in 0..3 {
            let covariance = UNIT.of_rests(axis, &spans, [0.0, 30.0]);
            let size = covariance[(0, 0)];
            for i in 0..10 {
                let sum: f64 = (0..10).map(|j| covariance[(i, j)]).sum();
                assert!(sum.abs() < 1e-9 * size, "{axis} {i}: {sum:e} of {size:e}");
            }
        }
    }
}
