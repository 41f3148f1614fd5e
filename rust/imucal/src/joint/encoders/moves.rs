//! Computes the whitened residuals inside a move on a stand with encoders. They compare the attitude integrated from
//! the gyroscope with the attitude computed from the encoders. If the fit uses the force in motion, they also include
//! the residuals of the force (model.md (20), (21)).
//!
//! ```text
//! stand   log(C_0^T C(t) R(t)^T),   C = R_wb(q)      = random walk + encoder noise
//! force   residual of the module `inside`            = random walk + direction error at the start + force noise
//! ```
//!
//! q are the encoder readings after removal of the encoder effects. C(t) is the attitude R_wb(q) of the stand (world
//! from body), and C_0 is its value at the start of the move. R(t) is the rotation from the body frame at time t to the
//! body frame at the start of the move, integrated from the gyroscope rates. The residual relative to the stand is a
//! random walk (integrated gyroscope noise) measured with encoder noise. The force residuals contain the same random
//! walk, so one filter whitens both. The gravity direction at the end of the move is not used here, because the
//! residuals of the rests relative to the stand contain it.

use imucal_core::so3;
use nalgebra::{Rotation3, UnitQuaternion, Vector3};

use super::{Angles, StandModel};
use crate::joint::inside::InsideNoise;
use crate::joint::inside::filter::{Filter, WalkFilter};
use crate::joint::move_ends::AtMove;
use crate::joint::pass::Pass;
use crate::joint::terms::Terms;
use crate::rests::moves::across;

/// Whether a whitened residual inside a move belongs to the force or to the attitude relative to the stand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum About {
    Force,
    Stand,
}

/// One move, with the encoder angles from which its residuals relative to the stand are computed.
pub(crate) struct EncoderMove<'a> {
    /// Corrected encoder angles of the samples of the move.
    pub(crate) angles: &'a Angles,
    /// Corrected encoder angles at the rest before the move.
    pub(crate) rest: &'a Angles,
    pub(crate) stand: &'a StandModel,
}

/// Number of attitude residuals of a move relative to the stand: three per block.
pub(crate) fn count(pass: &Pass) -> usize {
    3 * pass.blocks.len()
}

impl EncoderMove<'_> {
    /// Passes every whitened residual to `push`, as a slice that contains its derivatives with respect to all
    /// parameters and then the residual. `reading` is the variance of one encoder reading, rad^2.
    pub(crate) fn innovations(
        &self,
        at_move: &AtMove,
        terms: &Terms<'_>,
        (noise, reading): (&InsideNoise, f64),
        gravity_mps2: f64,
        mut push: impl FnMut(About, &[f64]),
    ) {
        let (AtMove { pass, before: start, .. }, n) = (at_move, terms.total());
        let first = self.stand.attitude(&self.rest.angle_rad[0]).inverse();
        let rest_jacobian = self.rest.attitude_jacobian(0..1, terms, self.stand);
        // Mean attitude residual of each block, rad, and its derivatives, in the body frame at the start of the move.
        let turns: Vec<(Vector3<f64>, Vec<Vector3<f64>>)> = (pass.blocks.iter().enumerate())
            .map(|(k, block)| {
                let residual = |i: usize| {
                    let here = first * self.stand.attitude(&self.angles.angle_rad[i]);
                    let gyroscope = Rotation3::from_matrix_unchecked(pass.attitudes[i]);
                    so3::log(&(here * UnitQuaternion::from_rotation_matrix(&gyroscope).inverse()))
                };
                let samples = block.samples.clone();
                let mean = samples.clone().map(residual).sum::<Vector3<f64>>() / samples.len() as f64;
                let jacobian = self
                    .angles
                    .attitude_jacobian(samples, terms, self.stand)
                    .iter()
                    .zip(&rest_jacobian)
                    .zip(&pass.changes.turns(k, n))
                    .map(|((here, rest), turn)| first * (here - rest) - turn)
                    .collect();
                (mean, jacobian)
            })
            .collect();
        let [side, other] = across(&start.up);
        // The random-walk state x is the negative attitude error of the gyroscope. It changes the force residual, in
        // units of gravity, by u cross x, where u is the direction up at the start of the move. The component of this
        // change along `other` is x . side, the component along `-side` is x . other, and the component along u is
        // zero.
        let mut z = vec![0.0; n + 1];
        let mut by_lane = vec![0.0; pass.changes.lanes()];
        for (d, along, observation) in [(start.up, start.up, 0.0), (side, other, 1.0), (other, -side, 1.0)] {
            // The second state is the error of the gravity direction at the start of the move. Only the force residuals
            // depend on it.
            let mut filter = Filter::new(n + 1, WalkFilter::new([0.0, noise.start]));
            let mut last_s = 0.0;
            let at_start: Vec<f64> =
                start.jacobian.iter().chain([&start.up]).map(|column| -along.dot(column)).collect();
            let along = along / gravity_mps2;
            for (k, (block, (mean, jacobian))) in pass.blocks.iter().zip(&turns).enumerate() {
                filter.walk.predict(noise.walk * (block.time_s - last_s));
                last_s = block.time_s;
                for (value, column) in z.iter_mut().zip(jacobian.iter().chain([mean])) {
                    *value = d.dot(column);
                }
                // The mean of a random walk over n = `count` steps has a smaller variance than the value of the random
                // walk at the centre. The difference is n q (1 - 1/n^2) / 6, where q is the variance per step. n q is
                // the variance over the block, `noise.walk * block.duration_s`.
                let count = block.samples.len() as f64;
                let smoothed = noise.walk * block.duration_s * (1.0 - 1.0 / (count * count)) / 6.0;
                filter.innovate(&mut z, [1.0, 0.0], reading / count - smoothed);
                push(About::Stand, &z);
                if terms.kinds.in_motion {
                    by_lane.fill(0.0);
                    pass.changes.add_along(k, &block.force, &along, &mut by_lane);
                    z.copy_from_slice(&at_start);
                    z[n] += along.dot(&block.force);
                    pass.changes.parameters().for_each(|(lane, p)| z[p] += by_lane[lane]);
                    filter.innovate(
                        &mut z,
                        [observation, observation],
                        noise.force / block.duration_s / gravity_mps2.powi(2),
                    );
                    push(About::Force, &z);
                }
            }
        }
    }
}
