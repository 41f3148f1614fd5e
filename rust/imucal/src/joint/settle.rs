//! The true state behind what the sensors see, where effects depend on that state.

use std::ops::Range;

use imucal_core::effects::{Sensor, State, Surroundings};
use nalgebra::Vector3;

use super::terms::{Kind, Sample, Terms};

/// Passes of the fixed point; one shrinks the error by the slope of the effects, a per cent or less.
const MOST_PASSES: usize = 24;
/// By which one pass may shrink it less than the one before.
const SLACK: f64 = 10.0;

impl Terms<'_> {
    /// The true state behind what the sensors see.
    pub(crate) fn settle(
        &self,
        values: &[f64],
        seen_rate: Vector3<f64>,
        seen_force: Vector3<f64>,
        surroundings: &Surroundings<f64>,
        sample: Sample,
        columns: &mut [Vector3<f64>],
    ) -> State<f64> {
        let mut state = State { angular_rate: seen_rate, specific_force: seen_force, surroundings: *surroundings };
        if self.all.is_empty() {
            return state;
        }
        let (reads_rate, reads_force) = (self.reads(Sensor::Gyroscope), self.reads(Sensor::Accelerometer));
        let mut last_change = None;
        for _ in 0..MOST_PASSES {
            self.columns_at(values, &state, sample, columns);
            let (on_rate, on_force) = self.sums(values, columns);
            let (rate, force) = (seen_rate - on_rate, seen_force - on_force);
            let by_rate = if reads_rate { (rate - state.angular_rate).amax() } else { 0.0 };
            let by_force = if reads_force { (force - state.specific_force).amax() } else { 0.0 };
            (state.angular_rate, state.specific_force) = (rate, force);
            let change = by_rate + by_force;
            // The next change is smaller by as much as this one was, or nearly.
            let next = last_change.map_or(change, |last: f64| change * (SLACK * change / last).min(1.0));
            if next <= 1e-15 * (1.0 + seen_force.amax()) {
                break;
            }
            last_change = Some(change);
        }
        state
    }

    /// Mean columns over a rest, where the rate is zero and the force does not change, and that force.
    ///
    /// `moments` are the surroundings through the rest, one at least where there are terms; what does not change with them is asked at the
    /// first. A user's field is the mean over the samples `range`.
    pub(crate) fn at_rest(
        &self,
        values: &[f64],
        seen_force: Vector3<f64>,
        moments: &[Surroundings<f64>],
        recording: usize,
        range: Range<usize>,
        columns: &mut [Vector3<f64>],
    ) -> (Vector3<f64>, Vector3<f64>) {
        let mut force = seen_force;
        let mut one = self.room();
        let step = (range.len() / moments.len().max(1)).max(1);
        let share = 1.0 / moments.len().max(1) as f64;
        let mut on_rate = Vector3::zeros();
        for _ in 0..MOST_PASSES {
            columns.fill(Vector3::zeros());
            for (k, surroundings) in moments.iter().enumerate() {
                let state =
                    State { angular_rate: Vector3::zeros(), specific_force: force, surroundings: *surroundings };
                let index = (range.start + k * step + step / 2).min(range.end - 1);
                for term in self.all.iter().filter(|term| k == 0 || term.changes_at_rest()) {
                    term.columns_at(values, &state, Sample { recording, index }, &mut one);
                    let (own, share) =
                        (term.first..term.first + term.count(), if term.changes_at_rest() { share } else { 1.0 });
                    for (sum, column) in columns[own.clone()].iter_mut().zip(&one[own]) {
                        *sum += column * share;
                    }
                }
            }
            self.user_means(recording, &range, columns);
            let on_force;
            (on_rate, on_force) = self.sums(values, columns);
            let change = (seen_force - on_force - force).amax();
            force = seen_force - on_force;
            if change <= 1e-15 * (1.0 + seen_force.amax()) {
                break;
            }
        }
        (on_rate, force)
    }

    /// A user's field may change from sample to sample: its mean is over all of them.
    pub(super) fn user_means(&self, recording: usize, range: &Range<usize>, columns: &mut [Vector3<f64>]) {
        for term in &self.all {
            if let Kind::User(field) = term.kind {
                let p = term.linear;
                let rows = &field.columns[recording][3 * p * range.start..3 * p * range.end];
                let own = &mut columns[term.first..term.first + p];
                own.fill(Vector3::zeros());
                for row in rows.chunks_exact(3 * p) {
                    for (k, column) in own.iter_mut().enumerate() {
                        *column += Vector3::new(row[k], row[p + k], row[2 * p + k]);
                    }
                }
                for column in own {
                    *column /= range.len() as f64;
                }
            }
        }
    }

    pub(super) fn has_user_fields(&self) -> bool {
        self.all.iter().any(|term| matches!(term.kind, Kind::User(_)))
    }

    /// What a user's fields are in the middle of a stretch, of which the columns are means: this share of how they bend between the
    /// stretches before and after is taken off.
    pub(super) fn user_middles(
        &self,
        recording: usize,
        [before, after]: [&Range<usize>; 2],
        share: f64,
        columns: &mut [Vector3<f64>],
    ) {
        let (mut earlier, mut later) = (columns.to_vec(), columns.to_vec());
        self.user_means(recording, before, &mut earlier);
        self.user_means(recording, after, &mut later);
        for term in self.all.iter().filter(|term| matches!(term.kind, Kind::User(_))) {
            for p in term.first..term.first + term.linear {
                columns[p] -= (earlier[p] + later[p] - columns[p] * 2.0) * share;
            }
        }
    }
}
