//! The samples of a move, freed of the effects, and the effects' columns there.

use std::borrow::Cow;
use std::ops::Range;

use imucal_core::effects::{Need, Sensor, State};
use imucal_core::integrate::increment;
use imucal_core::sensor::Triad;
use imucal_core::so3;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::model::{Model, mean_surroundings, surroundings};
use super::pass::Route;
use super::planes::Planes;
use super::terms::{Sample, Terms};
use crate::carry::{Between, times_hat};
use crate::recording::Samples;

/// The samples of a move after correction, with one more on either side.
pub(super) struct Corrected {
    pub(super) rate: Vec<Vector3<f64>>,
    /// Empty where neither blocks nor effects need it.
    pub(super) force: Vec<Vector3<f64>>,
    pub(super) seen_rate: Vec<Vector3<f64>>,
    pub(super) seen_force: Vec<Vector3<f64>>,
}

/// Neighbouring samples whose columns are asked for once, at their mean state.
#[derive(Clone, Copy)]
pub(super) struct Groups {
    /// Samples of each.
    pub(super) size: usize,
    /// So many of the first one are not there.
    lacking: usize,
}

/// So many in a block.
const GROUPS: usize = 4;

impl Groups {
    /// One begins with this sample.
    fn new(size: usize, sample: usize) -> Self {
        Self { size, lacking: (size - sample % size) % size }
    }

    /// That of sample `k`.
    #[inline(always)]
    pub(super) fn of(self, k: usize) -> usize {
        (k + self.lacking) / self.size
    }

    /// Its samples.
    fn samples(self, group: usize) -> Range<usize> {
        (group * self.size).saturating_sub(self.lacking)..(group + 1) * self.size - self.lacking
    }
}

/// A correction on its way: what is corrected so far, and the columns of the effects at the last of it.
pub(super) struct Correction<'a> {
    route: &'a Route<'a>,
    model: &'a Model,
    /// The effects whose columns are asked for.
    terms: Cow<'a, Terms<'a>>,
    /// Those that change anything.
    active: Terms<'a>,
    slopes: Vec<Vector3<f64>>,
    attitude: Option<UnitQuaternion<f64>>,
    columns: Vec<Vector3<f64>>,
    /// How many samples are corrected.
    done: usize,
    pub(super) all: Corrected,
    pub(super) groups: Groups,
    /// Columns of the effects on either sensor, by group.
    pub(super) on_rate: Planes,
    pub(super) on_force: Planes,
}

/// The place of a step among the samples that are corrected.
#[derive(Clone, Copy)]
pub(super) struct Step {
    /// The sample before it.
    pub(super) before: usize,
    is_straight: bool,
    /// Of the four samples around it in the mean over it.
    shares: [f64; 4],
}

impl Step {
    /// Mean over the step, `value(k)` being that of sample k.
    #[inline(always)]
    pub(super) fn mean(&self, value: impl Fn(usize) -> Vector3<f64>) -> Vector3<f64> {
        let (k, [before, start, end, after]) = (self.before, self.shares);
        let inner = value(k) * start + value(k + 1) * end;
        if self.is_straight { inner } else { inner + value(k - 1) * before + value(k + 2) * after }
    }

    /// Hands out what the columns d of each sample add to the turn, `A (h s(d) + h^2/12 ([w0]x d1 - [w1]x d0))`: matrices before d.
    #[inline(always)]
    pub(super) fn weigh(
        &self,
        a: &Matrix3<f64>,
        h: f64,
        [w0, w1]: [&Vector3<f64>; 2],
        mut add: impl FnMut(usize, Matrix3<f64>),
    ) {
        let (k, [before, start, end, after]) = (self.before, self.shares);
        let (mean, coning) = (a * h, a * (h * h / 12.0));
        add(k, mean * start - times_hat(&coning, w1));
        add(k + 1, mean * end + times_hat(&coning, w0));
        if !self.is_straight {
            add(k - 1, mean * before);
            add(k + 2, mean * after);
        }
    }
}

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
        let (between, shares) = Between::of(self.recording.time_s, i);
        Step { before: i - self.reach().start, is_straight: between == Between::Straight, shares }
    }

    /// The samples of the reach, to be freed of the effects.
    pub(super) fn correct<'t>(&'t self, model: &'t Model, terms: &'t Terms<'t>) -> Correction<'t> {
        let reach = self.reach();
        let corrected = |triad: &Triad<f64>, rows: Samples<'_>, samples: Range<usize>| -> Vec<Vector3<f64>> {
            rows.part(samples).iter().map(|row| triad.correct(Vector3::from(*row))).collect()
        };
        let seen_rate = corrected(&model.gyroscope, self.recording.angular_rate, reach.clone());
        let is_force_needed = self.has_blocks || terms.count > 0;
        let of_force = if is_force_needed { reach.clone() } else { 0..0 };
        let seen_force = corrected(&model.accelerometer, self.recording.specific_force, of_force);
        let active = terms.active(&model.values);
        // What turns the unit is all that the end of a move tells of.
        let terms = if self.has_blocks { Cow::Borrowed(terms) } else { Cow::Owned(terms.of(Sensor::Gyroscope)) };
        let passes = if active.needs(Need::AngularAcceleration) { SLOPE_PASSES } else { 1 };
        let needs_slopes = passes > 1 || terms.needs(Need::AngularAcceleration);
        let raw = || self.recording.angular_rate.part(reach.clone()).iter().map(|row| Vector3::from(*row)).collect();
        let derivative = needs_slopes.then(|| self.width.derivative(&self.recording.time_s[reach.clone()], raw));
        let planes = |sensor: Sensor| Planes::new(&terms.sensors, sensor);
        let mut correction = Correction {
            route: self,
            model,
            active,
            slopes: Vec::new(),
            attitude: None,
            columns: terms.room(),
            done: 0,
            all: Corrected { rate: seen_rate.clone(), force: seen_force.clone(), seen_rate, seen_force },
            groups: Groups::new((self.of_block() / GROUPS).max(1), self.span.first + 1 - reach.start),
            on_rate: planes(Sensor::Gyroscope),
            on_force: planes(Sensor::Accelerometer),
            terms,
        };
        for pass in 1..=passes {
            correction.slopes = derivative.as_ref().map_or_else(Vec::new, |d| d.of(&correction.all.rate));
            correction.done = 0;
            correction.attitude = self.rotation_world_from_start;
            if pass < passes {
                correction.advance(reach.len(), false);
            }
        }
        correction
    }
}

impl Correction<'_> {
    /// Corrects all samples before this one, and those that share their columns, and has these.
    pub(super) fn until(&mut self, end: usize) {
        let end = end.min(self.all.rate.len());
        self.advance(self.groups.samples(self.groups.of(end - 1)).end.min(self.all.rate.len()), true);
    }

    fn advance(&mut self, end: usize, with_columns: bool) {
        if self.terms.all.is_empty() && self.active.all.is_empty() {
            return;
        }
        let Self { route, model, terms, active, all, groups, columns, .. } = self;
        let first = route.reach().start;
        let all_active = terms.all.iter().all(|term| active.all.iter().any(|own| own.first == term.first));
        for k in self.done..end {
            let index = first + k;
            let mut around = surroundings(route.recording, index);
            around.angular_acceleration = self.slopes.get(k).copied();
            if let (Some(attitude), true) = (&mut self.attitude, index > route.span.first) {
                let h = route.recording.time_s[index] - route.recording.time_s[index - 1];
                // Without its own rate yet, the sample takes the seen one less what the effects were just before.
                let rate = all.seen_rate[k] - (all.seen_rate[k - 1] - all.rate[k - 1]);
                *attitude *= so3::exp(&increment(&all.rate[k - 1], &rate, h));
            }
            around.rotation_world_from_body = self.attitude;
            let sample = Sample { recording: route.span.recording, index };
            let (seen_rate, seen_force) = (all.seen_rate[k], all.seen_force[k]);
            let state = active.settle(&model.values, seen_rate, seen_force, &around, sample, columns);
            (all.rate[k], all.force[k]) = (state.angular_rate, state.specific_force);
            let own = groups.samples(groups.of(k));
            if !with_columns || k + 1 < own.end.min(all.rate.len()) {
                continue;
            }
            let own = own.start..k + 1;
            if own.len() > 1 {
                let state = mean_state(route, all, &self.slopes, own.clone(), self.attitude);
                terms.columns_at(&model.values, &state, sample, columns);
                terms.user_means(sample.recording, &(first + own.start..first + own.end), columns);
            } else if !all_active {
                // Else the last pass has just made them.
                terms.columns_at(&model.values, &state, sample, columns);
            }
            self.on_rate.push(columns);
            if route.has_blocks {
                self.on_force.push(columns);
            }
        }
        self.done = end;
    }
}

/// The mean over neighbouring samples; `attitude` is that of the last.
fn mean_state(
    route: &Route<'_>,
    all: &Corrected,
    slopes: &[Vector3<f64>],
    samples: Range<usize>,
    attitude: Option<UnitQuaternion<f64>>,
) -> State<f64> {
    let mean = |values: &[Vector3<f64>]| values[samples.clone()].iter().sum::<Vector3<f64>>() / samples.len() as f64;
    let (time, first) = (route.recording.time_s, route.reach().start);
    let angular_rate = mean(&all.rate);
    let mut surroundings = mean_surroundings(route.recording, first + samples.start..first + samples.end);
    surroundings.angular_acceleration = (!slopes.is_empty()).then(|| mean(slopes));
    surroundings.rotation_world_from_body = attitude.map(|last| {
        let half_s = (time[first + samples.end - 1] - time[first + samples.start]) / 2.0;
        last * so3::exp(&(angular_rate * -half_s))
    });
    State { angular_rate, specific_force: mean(&all.force), surroundings }
}
