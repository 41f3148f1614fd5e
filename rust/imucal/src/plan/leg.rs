//! A run in pieces: what a rest shows, and what the way to the next one does.

use nalgebra::Matrix2;

use super::chain::{Carry, Chain};
use super::sensors::Sensors;
use crate::simulate::Moment;

/// Rest detection gives up this much of a rest at each end; a move is so much longer.
pub(super) const EDGE_S: f64 = 0.01;
/// Length of a block inside a move, and of a stretch of a rest in a hand, s: as the joint fit has them.
const BLOCK_S: f64 = 0.04;
const HELD_S: f64 = 0.2;
/// Steps in which a move is integrated: the midpoint rule is good to 1e-3 of the information.
const STEPS: usize = 32;

/// A rest: rows of force and rate for one second, in units of their standard deviations.
#[derive(Clone)]
pub(super) struct Still {
    force: [Vec<f64>; 3],
    rate: [Vec<f64>; 3],
    /// In a hand: what the gyroscope does in half a stretch of the rest.
    half_stretch: Option<Carry>,
}

/// The way from rest to rest.
#[derive(Clone)]
pub(super) struct Leg {
    stretches: Vec<Stretch>,
}

#[derive(Clone)]
struct Stretch {
    carry: Carry,
    /// Force after it, in units of its standard deviation.
    force: Option<[Vec<f64>; 3]>,
}

impl Still {
    /// `in_hand`: it trembles, and the gyroscope's mean says nothing.
    pub(super) fn new(sensors: &Sensors, moment: &Moment, time_s: f64, in_hand: bool) -> Self {
        let scaled = |rows: [Vec<f64>; 3], variance: f64| {
            rows.map(|row| row.into_iter().map(|value| value / variance.sqrt()).collect::<Vec<f64>>())
        };
        Self {
            force: scaled(sensors.force_rows(moment, time_s), sensors.force_variance),
            rate: scaled(sensors.rate_rows(moment, time_s), sensors.rate_variance),
            half_stretch: in_hand
                .then(|| carry_along(sensors, [(*moment, time_s, HELD_S / 2.0)], sensors.rate_variance)),
        }
    }

    /// What `duration_s` of it show.
    pub(super) fn see(&self, chain: &mut Chain, duration_s: f64) {
        let Some(half) = &self.half_stretch else {
            self.force.iter().chain(&self.rate).for_each(|row| chain.see(row, duration_s));
            return;
        };
        for _ in 0..(duration_s / HELD_S).round().max(1.0) as usize {
            chain.carry(half);
            self.force.iter().for_each(|row| chain.see(row, HELD_S));
            chain.carry(half);
        }
    }
}

impl Leg {
    /// From `start_s` for `duration_s`; `at` is the motion, still before and after. The rest that follows is not used for `settle_s`.
    pub(super) fn new(
        sensors: &Sensors,
        start_s: f64,
        duration_s: f64,
        settle_s: f64,
        at: impl Fn(f64) -> Moment,
    ) -> Self {
        let inside = sensors.look_inside();
        let count = if inside { ((duration_s / BLOCK_S).round() as usize).max(1) } else { 1 };
        let steps = STEPS.div_ceil(count);
        let block_s = duration_s / count as f64;
        let mut stretches = Vec::with_capacity(count + 1);
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
            let carry = carry_along(sensors, parts, sensors.moving_variance);
            // The force belongs to the middle of its block: as near as makes no difference to what a block adds.
            let force = inside.then(|| {
                let middle_s = first_s + block_s / 2.0;
                let sigma = (sensors.force_variance / block_s).sqrt();
                sensors
                    .force_rows(&at(middle_s), middle_s)
                    .map(|row| row.into_iter().map(|value| value / sigma).collect())
            });
            stretches.push(Stretch { carry, force });
        }
        Self { stretches }
    }

    /// Carries the direction of gravity along.
    pub(super) fn go(&self, chain: &mut Chain) {
        for Stretch { carry, force } in &self.stretches {
            chain.carry(carry);
            force.iter().flatten().for_each(|row| chain.see(row, 1.0));
        }
    }
}

/// The gyroscope over moments, each at a time and for a duration, s.
fn carry_along(sensors: &Sensors, parts: impl IntoIterator<Item = (Moment, f64, f64)>, variance: f64) -> Carry {
    let mut by = [vec![0.0; sensors.parameters()], vec![0.0; sensors.parameters()]];
    let mut covariance = Matrix2::zeros();
    for (moment, time_s, duration_s) in parts {
        let [x, y] = sensors.add_turn(&moment, time_s, duration_s, &mut by);
        covariance += Matrix2::new(x.dot(&x), x.dot(&y), x.dot(&y), y.dot(&y)) * (duration_s * variance);
    }
    Carry { by, covariance }
}
