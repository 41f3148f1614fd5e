//! Divides a move into short segments. The derivatives of the sensor readings with respect to the parameters of the
//! effects are evaluated once per segment, at its midpoint.
//!
//! ```text
//! midpoint value from means m over n samples     m_k - (1 - 1/n^2) (m_(k-1) - 2 m_k + m_(k+1)) / 24
//! derivative of the rate                         (8 (w_(k+1) - w_(k-1)) - (w_(k+2) - w_(k-2))) / (12 step)
//! ```
//!
//! m_k is the mean of a signal over the n samples of segment k. w_k is the rate at the midpoint of segment k, and
//! `step` is the time between two midpoints, s.

use std::ops::Range;

use imucal_core::effects::{State, Surroundings};
use imucal_core::sensor::Triad;
use imucal_core::so3;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::Route;
use super::corrected::{Corrected, Step};
use super::planes::Groups;
use crate::joint::histories::Sample;
use crate::joint::model::{Model, mean_surroundings};
use crate::joint::terms::Terms;
use crate::preintegration::{are_equal_steps, attitudes};
use crate::recording::Samples;
use crate::rests::moves::Move;

/// Segments of a move.
pub(super) struct Stretches {
    /// Division of the corrected samples into segments. Samples are counted from the first corrected sample.
    pub(super) groups: Groups,
    /// Corrected rate and force, temperature, time and attitude at the midpoint of each segment.
    pub(super) states: Vec<State<f64>>,
    /// Rotation from the body frame at each midpoint to the start of the move: `v_start = rotation v_here`.
    pub(super) rotations: Vec<Matrix3<f64>>,
    /// Duration of each segment's part inside the move, s.
    pub(super) durations_s: Vec<f64>,
    /// For each segment: whether the midpoints of the previous and the next segment are at equal distances in time from
    /// its midpoint.
    pub(super) are_even: Vec<bool>,
    /// Factor `1 - 1/n^2` of the second difference in the conversion from means to midpoint values (see the start of
    /// this file), for segments of n samples.
    pub(super) spread: f64,
}

impl Stretches {
    pub(super) fn count(&self) -> usize {
        self.states.len()
    }

    /// For each segment, the rotation at its midpoint times its duration, s.
    pub(super) fn weights(&self) -> Vec<Matrix3<f64>> {
        self.rotations.iter().zip(&self.durations_s).map(|(rotation, duration_s)| rotation * *duration_s).collect()
    }
}

impl Route<'_> {
    /// Divides the samples into segments of `size` samples. One of the segments begins at the second sample of the
    /// move. `freed` are the corrected samples. If `freed` is `None`, the raw samples are averaged, which is sufficient
    /// if all effects are zero. If `wants_slopes` is true and `freed` contains no angular acceleration, the angular
    /// acceleration is computed here.
    pub(super) fn stretches(
        &self,
        model: &Model,
        freed: Option<&Corrected>,
        size: usize,
        wants_slopes: bool,
    ) -> Stretches {
        let (span, reach) = (self.span, self.reach());
        let groups = Groups::new(size, span.first + 1 - reach.start, reach.len());
        let none = State {
            angular_rate: Vector3::zeros(),
            specific_force: Vector3::zeros(),
            surroundings: Surroundings::unknown(),
        };
        // A state is large, so it is modified in place instead of copied.
        let mut states = vec![none; groups.count()];
        states.iter_mut().enumerate().for_each(|(k, state)| self.set_means(groups, k, (model, freed), state));
        let time_s: Vec<f64> = states.iter().map(|state| state.surroundings.time_s.unwrap_or_default()).collect();
        let spread = 1.0 - 1.0 / (size * size) as f64;
        let are_even: Vec<bool> = (0..states.len()).map(|k| is_even(&time_s, k)).collect();
        in_the_middle(&mut states, &are_even, spread / 24.0);
        if wants_slopes && states.iter().all(|state| state.surroundings.angular_acceleration.is_none()) {
            find_slopes(&mut states, &time_s, &are_even);
        }
        let rotations = self.rotations(groups.of(span.first - reach.start), &states, &time_s);
        if let Some(start) = self.rotation_world_from_start {
            for (state, rotation) in states.iter_mut().zip(&rotations) {
                state.surroundings.rotation_world_from_body = Some(start * rotation);
            }
        }
        let rotations = rotations.iter().map(|rotation| *rotation.to_rotation_matrix().matrix()).collect();
        Stretches { groups, states, rotations, durations_s: self.durations_s(groups), are_even, spread }
    }

    /// Sets `state` to the mean state over segment `k`. The attitude is not set.
    #[inline]
    fn set_means(
        &self,
        groups: Groups,
        k: usize,
        (model, freed): (&Model, Option<&Corrected>),
        state: &mut State<f64>,
    ) {
        let (own, range) = (groups.samples(k), self.samples(groups, k));
        let of_freed = |values: &[Vector3<f64>]| values[own.clone()].iter().sum::<Vector3<f64>>() / own.len() as f64;
        let of_raw = |triad: &Triad<f64>, rows: Samples<'_>| {
            let rows = rows.part(range.clone());
            triad.correct(rows.iter().map(|row| Vector3::from(*row)).sum::<Vector3<f64>>() / rows.len() as f64)
        };
        (state.angular_rate, state.specific_force) = match freed {
            Some(all) => (of_freed(&all.rate), of_freed(&all.force)),
            None => (
                of_raw(&model.gyroscope, self.recording.angular_rate),
                of_raw(&model.accelerometer, self.recording.specific_force),
            ),
        };
        let around = mean_surroundings(self.recording, range);
        state.surroundings.temperature_difference_k = around.temperature_difference_k;
        state.surroundings.time_s = around.time_s;
        state.surroundings.angular_acceleration =
            freed.filter(|all| !all.slopes.is_empty()).map(|all| of_freed(&all.slopes));
    }

    /// Integrates the rates at the midpoints of the segments to the rotation from the body frame at each midpoint to
    /// the start of the move. Segments before the start of the move have the rotation of the first segment of the move.
    fn rotations(&self, start: usize, states: &[State<f64>], time_s: &[f64]) -> Vec<UnitQuaternion<f64>> {
        let rates: Vec<Vector3<f64>> = states.iter().map(|state| state.angular_rate).collect();
        let since_start_s = time_s[start] - (self.recording.time_s[self.span.first] - self.recording.time_s[0]);
        let begin = so3::exp(&(rates[start] * since_start_s));
        let turned = |k: usize| Step::after(time_s, k).turn(|k| rates[k], time_s[k + 1] - time_s[k]);
        let turns: Vec<Vector3<f64>> = (start..rates.len() - 1).map(turned).collect();
        let mut rotations = vec![begin; start];
        rotations.extend(attitudes(begin, &turns));
        rotations
    }

    /// Computes the duration of each segment inside the move, s. It is the sum of the weights that the trapezoidal rule
    /// gives to the samples of the segment.
    fn durations_s(&self, groups: Groups) -> Vec<f64> {
        let Move { first, last, .. } = *self.span;
        let time_s = |i: usize| self.recording.time_s[i.clamp(first, last)];
        let own_s = |k: usize| {
            let Range { start, end } = self.samples(groups, k);
            // The segment extends from the midpoint between its first sample and the previous sample to the midpoint
            // between its last sample and the next sample.
            f64::midpoint(time_s(end - 1), time_s(end)) - f64::midpoint(time_s(start.saturating_sub(1)), time_s(start))
        };
        (0..groups.count()).map(own_s).collect()
    }

    /// Computes the derivatives of the sensor readings with respect to the parameters of the effects (`columns`) at the
    /// midpoint of segment `k`. The derivatives of user-defined effects are averaged over the segment, and the mean is
    /// converted to the value at the midpoint.
    pub(super) fn columns(
        &self,
        terms: &Terms<'_>,
        values: &[f64],
        stretches: &Stretches,
        k: usize,
        columns: &mut [Vector3<f64>],
    ) {
        let (recording, samples) = (self.span.recording, |k: usize| self.samples(stretches.groups, k));
        let Range { start: index, end } = samples(k);
        let sample = Sample { recording, index, count: end - index };
        terms.columns_at(values, &stretches.states[k], sample, columns);
        if terms.has_user_fields() {
            terms.user_means(recording, &samples(k), columns);
            if stretches.are_even[k] {
                terms.user_middles(recording, [&samples(k - 1), &samples(k + 1)], stretches.spread / 24.0, columns);
            }
        }
    }

    /// Range of the samples of a segment (`group`) in the recording.
    fn samples(&self, groups: Groups, group: usize) -> Range<usize> {
        let (first, own) = (self.reach().start, groups.samples(group));
        first + own.start..first + own.end
    }
}

/// Whether the times before and after `time_s[k]` are equally far from it.
fn is_even(time_s: &[f64], k: usize) -> bool {
    match k.checked_sub(1).and_then(|before| time_s[before..].first_chunk()) {
        Some([t0, t1, t2]) => are_equal_steps(t1 - t0, t2 - t1),
        None => false,
    }
}

/// Converts means over segments to values at the midpoints of the segments. The conversion subtracts `share` times the
/// second difference of the means. Segments with unequal spacing keep their mean.
fn in_the_middle(states: &mut [State<f64>], are_even: &[bool], share: f64) {
    let means = |state: &State<f64>| {
        let slope = state.surroundings.angular_acceleration.unwrap_or_default();
        [state.angular_rate, state.specific_force, slope]
    };
    let Some(mut before) = states.first().map(means) else { return };
    // The first and the last segment have a neighbour on one side only and keep their mean.
    for k in 1..states.len() - 1 {
        let (own, after) = (means(&states[k]), means(&states[k + 1]));
        if are_even[k] {
            let bend = |value: usize| before[value] + after[value] - own[value] * 2.0;
            let state = &mut states[k];
            state.angular_rate -= bend(0) * share;
            state.specific_force -= bend(1) * share;
            if let Some(slope) = &mut state.surroundings.angular_acceleration {
                *slope -= bend(2) * share;
            }
        }
        before = own;
    }
}

/// Computes the angular acceleration from the rates. Equally spaced segments use the five-point formula, and all other
/// segments a difference quotient.
fn find_slopes(states: &mut [State<f64>], time_s: &[f64], are_even: &[bool]) {
    let rates: Vec<Vector3<f64>> = states.iter().map(|state| state.angular_rate).collect();
    for (k, state) in states.iter_mut().enumerate() {
        let (from, to) = (k.saturating_sub(1), (k + 1).min(rates.len() - 1));
        let (change, across_s) = (rates[to] - rates[from], time_s[to] - time_s[from]);
        state.surroundings.angular_acceleration = Some(if are_even[from..=to].iter().all(|even| *even) {
            (change * 8.0 - (rates[k + 2] - rates[k - 2])) / (6.0 * across_s)
        } else if across_s > 0.0 {
            change / across_s
        } else {
            Vector3::zeros()
        });
    }
}
