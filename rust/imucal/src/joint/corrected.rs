//! The samples of a move, freed of the effects, and the effects' columns there.

use std::borrow::Cow;
use std::ops::Range;

use imucal_core::effects::{Need, Sensor, State};
use imucal_core::integrate::increment;
use imucal_core::sensor::Triad;
use imucal_core::so3;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::groups::Groups;
use super::model::{Model, surroundings};
use super::pass::Route;
use super::planes::Planes;
use super::terms::{Sample, Terms};
use crate::carry::{Between, Sums, carry_smoothly, times_hat};
use crate::recording::Samples;

/// The samples of a move after correction, with one more on either side.
pub(super) struct Corrected {
    pub(super) rate: Vec<Vector3<f64>>,
    pub(super) force: Vec<Vector3<f64>>,
    pub(super) seen_rate: Vec<Vector3<f64>>,
    pub(super) seen_force: Vec<Vector3<f64>>,
}

/// The samples of a move, corrected, and the columns of the effects as far as they are asked for.
pub(super) struct Correction<'a> {
    route: &'a Route<'a>,
    model: &'a Model,
    /// The effects whose columns are asked for.
    terms: Cow<'a, Terms<'a>>,
    pub(super) all: Corrected,
    /// Whether no effect changes anything: the samples are what is seen of them.
    is_plain: bool,
    pub(super) groups: Groups,
    /// Of each group, with what the effects ask for.
    means: Vec<State<f64>>,
    /// `v_start = rotation v_here` in the middle of each group; empty inside a move whose effects ask for no attitude.
    rotations: Vec<UnitQuaternion<f64>>,
    /// Room for the columns of a group, and how many groups have theirs.
    columns: Vec<Vector3<f64>>,
    done: usize,
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
    pub(super) fn reach(&self) -> Range<usize> {
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
        let corrected = |triad: &Triad<f64>, rows: Samples<'_>| -> Vec<Vector3<f64>> {
            rows.part(reach.clone()).iter().map(|row| triad.correct(Vector3::from(*row))).collect()
        };
        let seen_rate = corrected(&model.gyroscope, self.recording.angular_rate);
        let seen_force = corrected(&model.accelerometer, self.recording.specific_force);
        let active = terms.active(&model.values);
        // What turns the unit is all that the end of a move tells of.
        let terms = if self.has_blocks { Cow::Borrowed(terms) } else { Cow::Owned(terms.of(Sensor::Gyroscope)) };
        let passes = if active.needs(Need::AngularAcceleration) { SLOPE_PASSES } else { 1 };
        let needs_slopes = passes > 1 || terms.needs(Need::AngularAcceleration);
        let raw = || self.recording.angular_rate.part(reach.clone()).iter().map(|row| Vector3::from(*row)).collect();
        let derivative = needs_slopes.then(|| self.width.derivative(&self.recording.time_s[reach.clone()], raw));
        let mut all = Corrected { rate: seen_rate.clone(), force: seen_force.clone(), seen_rate, seen_force };
        let mut slopes = Vec::new();
        for _ in 0..passes {
            slopes = derivative.as_ref().map_or_else(Vec::new, |d| d.of(&all.rate));
            self.free(&mut all, &slopes, model, &active);
        }
        let groups = Groups::new(self.of_block(), self.span.first + 1 - reach.start, reach.len());
        let mut means = self.means(groups, &all, &slopes);
        let mut rotations = Vec::new();
        if self.rotation_world_from_start.is_some() || !self.has_blocks {
            rotations = self.rotations(groups, &means);
        }
        if let Some(start) = self.rotation_world_from_start {
            for (mean, rotation) in means.iter_mut().zip(&rotations) {
                mean.surroundings.rotation_world_from_body = Some(start * rotation);
            }
        }
        let planes = |sensor: Sensor| Planes::new(&terms.sensors, sensor);
        Correction {
            route: self,
            model,
            all,
            is_plain: active.all.is_empty(),
            groups,
            means,
            rotations,
            columns: terms.room(),
            done: 0,
            on_rate: planes(Sensor::Gyroscope),
            on_force: planes(Sensor::Accelerometer),
            terms,
        }
    }

    /// Frees all samples of the effects that change anything.
    fn free(&self, all: &mut Corrected, slopes: &[Vector3<f64>], model: &Model, active: &Terms<'_>) {
        if active.all.is_empty() {
            return;
        }
        let reach = self.reach();
        let mut attitude = self.rotation_world_from_start;
        let mut columns = active.room();
        for (k, index) in reach.enumerate() {
            let mut around = surroundings(self.recording, index);
            around.angular_acceleration = slopes.get(k).copied();
            if let (Some(attitude), true) = (&mut attitude, index > self.span.first) {
                let h = self.recording.time_s[index] - self.recording.time_s[index - 1];
                // Without its own rate yet, the sample takes the seen one less what the effects were just before.
                let rate = all.seen_rate[k] - (all.seen_rate[k - 1] - all.rate[k - 1]);
                *attitude *= so3::exp(&increment(&all.rate[k - 1], &rate, h));
            }
            around.rotation_world_from_body = attitude;
            let sample = Sample { recording: self.span.recording, index };
            let (seen_rate, seen_force) = (all.seen_rate[k], all.seen_force[k]);
            let state = active.settle(&model.values, seen_rate, seen_force, &around, sample, &mut columns);
            (all.rate[k], all.force[k]) = (state.angular_rate, state.specific_force);
        }
    }
}

impl Correction<'_> {
    /// Has the columns of all groups before this one.
    pub(super) fn until(&mut self, end: usize) {
        let Self { route, model, terms, groups, means, columns, .. } = self;
        if terms.all.is_empty() {
            return;
        }
        let (first, recording) = (route.reach().start, route.span.recording);
        for group in self.done..end {
            let own = groups.samples(group);
            let range = first + own.start..first + own.end;
            terms.columns_at(&model.values, &means[group], Sample { recording, index: range.start }, columns);
            if range.len() > 1 {
                terms.user_means(recording, &range, columns);
            }
            self.on_rate.push(columns);
            if route.has_blocks {
                self.on_force.push(columns);
            }
        }
        self.done = self.done.max(end);
    }

    /// The rotation from the start of the move to its end, and the sums of the base parameters, as the kernel takes them.
    pub(super) fn carried(&self) -> (Matrix3<f64>, Sums) {
        let Self { route, model, all, groups, .. } = self;
        let (recording, span) = (route.recording, route.span);
        if self.is_plain {
            return route.carried(&model.gyroscope);
        }
        let reach = route.reach();
        let rates: Vec<[f64; 3]> = all.rate.iter().map(|rate| (*rate).into()).collect();
        let (first, last) = (span.first - reach.start, span.last - reach.start);
        let time_s = &recording.time_s[reach];
        let (rotation, mut sums) = carry_smoothly(time_s, Samples::from(&rates), first, last, &Triad::identity());
        // The entries multiply the rates that are seen.
        for (group, weight) in self.weights().iter().enumerate() {
            let samples = groups.samples(group);
            let beyond = samples.clone().map(|k| all.seen_rate[k] - all.rate[k]).sum::<Vector3<f64>>();
            sums.add_beyond(weight, &(beyond / samples.len() as f64));
        }
        (rotation, sums)
    }

    /// The rotation in the middle of each group times its share of a trapezoid from the start of the move to its end.
    pub(super) fn weights(&self) -> Vec<Matrix3<f64>> {
        let Self { route, groups, rotations, .. } = self;
        let (time_s, first) = (route.recording.time_s, route.reach().start);
        let mut shares_s = vec![0.0; groups.count()];
        for i in route.span.first..route.span.last {
            let half_s = (time_s[i + 1] - time_s[i]) / 2.0;
            shares_s[groups.of(i - first)] += half_s;
            shares_s[groups.of(i + 1 - first)] += half_s;
        }
        rotations
            .iter()
            .zip(shares_s)
            .map(|(rotation, share_s)| *rotation.to_rotation_matrix().matrix() * share_s)
            .collect()
    }
}
