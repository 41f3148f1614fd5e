//! The samples of a move, freed of the effects, and the effects' columns there.

use std::ops::Range;

use imucal_core::effects::{Need, Sensor};
use imucal_core::integrate::increment;
use imucal_core::sensor::Triad;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::model::{Model, surroundings};
use super::pass::Route;
use super::planes::Planes;
use super::terms::{Sample, Terms};
use crate::carry::times_hat;
use crate::derivative::Derivative;
use crate::recording::Samples;

/// The samples of a move after correction, with one more on either side.
pub(super) struct Corrected {
    pub(super) rate: Vec<Vector3<f64>>,
    /// Empty where neither blocks nor effects need it.
    pub(super) force: Vec<Vector3<f64>>,
    pub(super) seen_rate: Vec<Vector3<f64>>,
    pub(super) seen_force: Vec<Vector3<f64>>,
    /// Columns of the effects on either sensor.
    pub(super) on_rate: Planes,
    pub(super) on_force: Planes,
}

/// The place of a step among the samples that are corrected.
#[derive(Clone, Copy)]
pub(super) struct Step {
    /// The sample before it.
    pub(super) before: usize,
    /// Whether samples further off are there and as far from each other: else the rate goes straight.
    pub(super) smooth: bool,
}

impl Step {
    /// Mean over the step, `value(k)` being that of sample k.
    #[inline(always)]
    pub(super) fn mean(self, value: impl Fn(usize) -> Vector3<f64>) -> Vector3<f64> {
        let k = self.before;
        let inner = value(k) + value(k + 1);
        if self.smooth { (inner * 13.0 - (value(k - 1) + value(k + 2))) / 24.0 } else { inner / 2.0 }
    }

    /// Hands out what the columns d of each sample add to the turn, `A (h s(d) + h^2/12 ([w0]x d1 - [w1]x d0))`: matrices before d.
    #[inline(always)]
    pub(super) fn weigh(
        self,
        a: &Matrix3<f64>,
        h: f64,
        [w0, w1]: [&Vector3<f64>; 2],
        mut add: impl FnMut(usize, Matrix3<f64>),
    ) {
        let k = self.before;
        let (mean, coning) = (a * h, a * (h * h / 12.0));
        let inner = if self.smooth { mean * (13.0 / 24.0) } else { mean * 0.5 };
        add(k, inner - times_hat(&coning, w1));
        add(k + 1, inner + times_hat(&coning, w0));
        if self.smooth {
            let outer = mean * (-1.0 / 24.0);
            add(k - 1, outer);
            add(k + 2, outer);
        }
    }
}

/// Where steps differ by more than this share, straight lines are safer.
const UNEVEN: f64 = 0.01;
/// The angular acceleration is that of the corrected rate, which is only known afterwards. A pass shrinks the error by the
/// delay of the gyroscope over the time in which the rate changes, a fiftieth, and adds noise where the delay is long.
const SLOPE_PASSES: usize = 3;

impl Route<'_> {
    /// The samples that are corrected: those of the move, and one on either side where there is one.
    fn reach(&self) -> Range<usize> {
        self.span.first.saturating_sub(1)..(self.span.last + 2).min(self.recording.len())
    }

    /// The step after sample `i`.
    pub(super) fn step(&self, i: usize) -> Step {
        let reach = self.reach();
        let time = &self.recording.time_s;
        let before = i - reach.start;
        if i == 0 || i + 2 >= reach.end {
            return Step { before, smooth: false };
        }
        let h = time[i + 1] - time[i];
        let even = |step: f64| (step - h).abs() <= UNEVEN * h;
        Step { before, smooth: even(time[i] - time[i - 1]) && even(time[i + 2] - time[i + 1]) }
    }

    /// The samples of the reach, freed of the effects.
    pub(super) fn correct(&self, model: &Model, terms: &Terms<'_>) -> Corrected {
        let reach = self.reach();
        let corrected = |triad: &Triad<f64>, rows: Samples<'_>, samples: Range<usize>| -> Vec<Vector3<f64>> {
            rows.part(samples).iter().map(|row| triad.correct(Vector3::from(*row))).collect()
        };
        let seen_rate = corrected(&model.gyroscope, self.recording.angular_rate, reach.clone());
        let is_force_needed = self.with_blocks || terms.count > 0;
        let of_force = if is_force_needed { reach.clone() } else { 0..0 };
        let seen_force = corrected(&model.accelerometer, self.recording.specific_force, of_force);
        let planes = |sensor: Sensor| Planes::new(&terms.sensors, sensor, reach.len());
        let mut all = Corrected {
            rate: seen_rate.clone(),
            force: seen_force.clone(),
            seen_rate,
            seen_force,
            on_rate: planes(Sensor::Gyroscope),
            on_force: planes(Sensor::Accelerometer),
        };
        if terms.count == 0 {
            return all;
        }
        let active = terms.active(&model.values);
        let needs_slopes = terms.needs(Need::AngularAcceleration);
        let passes = if active.needs(Need::AngularAcceleration) { SLOPE_PASSES } else { 1 };
        let derivative =
            needs_slopes.then(|| Derivative::smooth(&self.recording.time_s[reach.clone()], &all.seen_rate));
        for pass in 1..=passes {
            let slopes = derivative.as_ref().map_or_else(Vec::new, |derivative| derivative.of(&all.rate));
            self.correct_once(&mut all, &slopes, model, [&active, terms], pass == passes);
        }
        all
    }

    fn correct_once(
        &self,
        all: &mut Corrected,
        slopes: &[Vector3<f64>],
        model: &Model,
        [active, terms]: [&Terms<'_>; 2],
        with_columns: bool,
    ) {
        let mut attitude = self.rotation_world_from_start;
        let mut columns = terms.room();
        let all_active = active.all.len() == terms.all.len();
        for (k, index) in self.reach().enumerate() {
            let mut around = surroundings(self.recording, index);
            around.angular_acceleration = slopes.get(k).copied();
            if let (Some(attitude), true) = (&mut attitude, index > self.span.first) {
                let h = self.recording.time_s[index] - self.recording.time_s[index - 1];
                // Without its own rate yet, the sample takes the seen one less what the effects were just before.
                let rate = all.seen_rate[k] - (all.seen_rate[k - 1] - all.rate[k - 1]);
                *attitude *= UnitQuaternion::from_scaled_axis(increment(&all.rate[k - 1], &rate, h));
            }
            around.rotation_world_from_body = attitude;
            let sample = Sample { recording: self.span.recording, index };
            let (seen_rate, seen_force) = (all.seen_rate[k], all.seen_force[k]);
            let state = active.settle(&model.values, seen_rate, seen_force, &around, sample, &mut columns);
            (all.rate[k], all.force[k]) = (state.angular_rate, state.specific_force);
            if with_columns {
                // Else the last pass has just made them.
                if !all_active {
                    terms.columns_at(&model.values, &state, sample, &mut columns);
                }
                all.on_rate.push(&columns);
                all.on_force.push(&columns);
            }
        }
    }
}
