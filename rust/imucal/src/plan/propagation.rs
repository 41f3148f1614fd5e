//! Computes the information that the rests and moves of a run give. A rest gives information about the gravity
//! direction and the parameters, and a move propagates the gravity direction to the next rest.

use nalgebra::Matrix2;

use super::information_filter::{InformationFilter, Propagation};
use super::sensors::Sensors;
use crate::simulate::Moment;

/// Time that rest detection removes from each end of a rest, s. The move next to this end becomes longer by this time.
pub(super) const EDGE_S: f64 = 0.01;
/// Length of a block over which forces during a move are averaged, s. It equals the block length in the joint fit,
/// which estimates the parameters from a recorded run.
const BLOCK_S: f64 = 0.04;
/// Length of the intervals into which a hand-held rest is divided, s. Within an interval, the gravity direction is
/// treated as constant.
const HELD_S: f64 = 0.2;
/// Minimum number of integration steps in a move. With this number of steps, the midpoint rule causes a relative error
/// of 1e-3 in the information.
const STEPS: usize = 32;

/// Information from a rest: derivatives of the mean force and of the mean rate with respect to the gravity direction
/// and the parameters. Each derivative is divided by the standard deviation of the mean reading over one second.
#[derive(Clone)]
pub(super) struct RestInformation {
    force: [Vec<f64>; 3],
    rate: [Vec<f64>; 3],
    /// For the mean force and for the mean rate: (variance of the rounding error) / (variance of the white noise of a
    /// mean over one second).
    rounding: [f64; 2],
    /// Propagation of the gravity direction over half of [`HELD_S`]; `None` for a rest on a stand. The mean force
    /// over an interval of a hand-held rest measures the gravity direction at the middle of the interval. The filter
    /// therefore propagates the direction to the middle, adds the force, and propagates the direction to the end.
    half_interval: Option<Propagation>,
}

/// Information from a move: the propagation of the direction of gravity from a rest to the next rest, and the forces
/// during the move if they are used.
#[derive(Clone)]
pub(super) struct MoveInformation {
    sections: Vec<Section>,
}

#[derive(Clone)]
struct Section {
    propagation: Propagation,
    /// The mean force over this section of the move, as a measurement: its derivatives with respect to the states of
    /// the filter, divided by its standard deviation. The filter adds this measurement after the propagation over this
    /// section. `None` if forces during moves are not used.
    force: Option<[Vec<f64>; 3]>,
}

impl RestInformation {
    /// Information from a rest at `time_s`. If `in_hand` is set, the unit trembles. The mean rate of the rest then
    /// contains no information about the gyroscope bias.
    pub(super) fn new(sensors: &Sensors, moment: &Moment, time_s: f64, in_hand: bool) -> Self {
        let scaled = |rows: [Vec<f64>; 3], variance: f64| {
            rows.map(|row| row.into_iter().map(|value| value / variance.sqrt()).collect::<Vec<f64>>())
        };
        Self {
            force: scaled(sensors.force_rows(moment, time_s), sensors.force_variance),
            rate: scaled(sensors.rate_rows(moment, time_s), sensors.rate_variance),
            rounding: [sensors.force_rounding / sensors.force_variance, sensors.rate_rounding / sensors.rate_variance],
            half_interval: in_hand
                .then(|| propagation_over(sensors, [(*moment, time_s, HELD_S / 2.0)], sensors.rate_variance)),
        }
    }

    /// Adds the information of a rest to the filter. The rest takes `duration_s`. `rests` is the number of rests of the
    /// whole run. The gyroscope has the same reading at all rests, so the rounding error of the rate is equal at all
    /// rests and does not average out over the rests. To account for this, the rounding variance of each rest is
    /// multiplied by `rests`.
    pub(super) fn add_to(&self, filter: &mut InformationFilter, duration_s: f64, rests: usize) {
        let Some(half) = &self.half_interval else {
            let [force, rate] = self.rounding;
            let weight = |rounding: f64| duration_s / (1.0 + rounding * duration_s);
            self.force.iter().for_each(|row| filter.add_row(row, weight(force)));
            self.rate.iter().for_each(|row| filter.add_row(row, weight(rate * rests as f64)));
            return;
        };
        for _ in 0..(duration_s / HELD_S).round().max(1.0) as usize {
            filter.propagate(half);
            self.force.iter().for_each(|row| filter.add_row(row, HELD_S));
            filter.propagate(half);
        }
    }
}

impl MoveInformation {
    /// Computes the propagation of the gravity direction over a move that starts at `start_s` and takes `duration_s`.
    /// `at` returns the motion as a function of time. The unit is at rest before and after the move. The propagation
    /// continues through the first `settle_s` of the next rest, because samples in this time are not used as samples at
    /// rest.
    pub(super) fn new(
        sensors: &Sensors,
        start_s: f64,
        duration_s: f64,
        settle_s: f64,
        at: impl Fn(f64) -> Moment,
    ) -> Self {
        let inside = sensors.uses_forces_in_moves();
        let count = if inside { ((duration_s / BLOCK_S).round() as usize).max(1) } else { 1 };
        let steps = STEPS.div_ceil(count);
        let block_s = duration_s / count as f64;
        let mut sections = Vec::with_capacity(count + 1);
        for block in 0..count {
            let first_s = start_s + block_s * block as f64;
            let step_s = block_s / steps as f64;
            let mut parts: Vec<(Moment, f64, f64)> = (0..steps)
                .map(|step| first_s + (step as f64 + 0.5) * step_s)
                .map(|time_s| (at(time_s), time_s, step_s))
                .collect();
            if block == 0 {
                parts.push((at(start_s), start_s, EDGE_S));
            }
            if block + 1 == count {
                let end_s = start_s + duration_s;
                parts.push((at(end_s), end_s, EDGE_S + settle_s));
            }
            let propagation = propagation_over(sensors, parts, sensors.moving_variance);
            // The force is evaluated at the middle of its block. The difference between this force and the mean force
            // over the block hardly changes the information.
            let force = inside.then(|| {
                let middle_s = first_s + block_s / 2.0;
                let sigma = (sensors.force_variance / block_s).sqrt();
                sensors
                    .force_rows(&at(middle_s), middle_s)
                    .map(|row| row.into_iter().map(|value| value / sigma).collect())
            });
            sections.push(Section { propagation, force });
        }
        Self { sections }
    }

    /// Propagates the gravity direction of the filter through the move, and adds the forces during the move if they are
    /// used.
    pub(super) fn propagate(&self, filter: &mut InformationFilter) {
        for Section { propagation, force } in &self.sections {
            filter.propagate(propagation);
            force.iter().flatten().for_each(|row| filter.add_row(row, 1.0));
        }
    }
}

/// Computes the propagation of the gravity direction with the gyroscope over consecutive intervals. `parts` contains,
/// for each interval, the motion at its middle, the time of its middle, s, and its duration, s. `variance` is the
/// variance of the mean gyroscope reading over one second, (rad/s)^2.
fn propagation_over(
    sensors: &Sensors,
    parts: impl IntoIterator<Item = (Moment, f64, f64)>,
    variance: f64,
) -> Propagation {
    let mut by = [vec![0.0; sensors.parameters()], vec![0.0; sensors.parameters()]];
    let mut covariance = Matrix2::zeros();
    for (moment, time_s, duration_s) in parts {
        let [x, y] = sensors.add_propagation(&moment, time_s, duration_s, &mut by);
        covariance += Matrix2::new(x.dot(&x), x.dot(&y), x.dot(&y), y.dot(&y)) * (duration_s * variance);
    }
    Propagation { jacobian: by, covariance }
}
