//! Computes the true rate and force, on which many effects depend. The computation is a fixed-point iteration that
//! starts from the readings corrected for sensitivity and bias (model.md (16)).

use std::ops::Range;

use imucal_core::effects::{MAX_PARAMETERS, Sensor, State, Surroundings};
use nalgebra::{UnitQuaternion, Vector3};

use super::choices::UserField;
use super::histories::Sample;
use super::model::Part;
use super::terms::{Kind, Term, Terms};

/// Maximum number of fixed-point iterations. Each iteration multiplies the error of rate and force by about 0.01 for
/// effects of typical size.
const MAX_ITERATIONS: usize = 24;
/// Safety factor of the convergence test. The iteration stops when the predicted change of the next iteration, times
/// this factor, is as small as rounding errors.
const SLACK: f64 = 10.0;

/// Solver for the true rate and force of single samples, by fixed-point iteration.
pub(super) struct Settling<'a> {
    terms: &'a Terms<'a>,
    values: &'a [f64],
    reads_rate: bool,
    reads_force: bool,
    columns: Vec<Vector3<f64>>,
}

impl<'a> Settling<'a> {
    pub(super) fn new(terms: &'a Terms<'a>, values: &'a [f64]) -> Self {
        let (reads_rate, reads_force) = (terms.reads(Sensor::Gyroscope), terms.reads(Sensor::Accelerometer));
        Self { terms, values, reads_rate, reads_force, columns: terms.room() }
    }

    /// Computes the true state of one sample by fixed-point iteration. `seen_rate` (rad/s) and `seen_force` (m/s^2) are
    /// the readings, corrected for the sensitivity and the bias only.
    #[inline]
    pub(super) fn settle(
        &mut self,
        seen_rate: Vector3<f64>,
        seen_force: Vector3<f64>,
        surroundings: &Surroundings<f64>,
        sample: Sample,
    ) -> State<f64> {
        let Self { terms, values, reads_rate, reads_force, columns } = self;
        let mut state = State { angular_rate: seen_rate, specific_force: seen_force, surroundings: *surroundings };
        let mut last_change = None;
        for _ in 0..MAX_ITERATIONS {
            terms.columns_at(values, &state, sample, columns);
            let (on_rate, on_force) = terms.sums(values, columns);
            let (rate, force) = (seen_rate - on_rate, seen_force - on_force);
            let by_rate = if *reads_rate { (rate - state.angular_rate).amax() } else { 0.0 };
            let by_force = if *reads_force { (force - state.specific_force).amax() } else { 0.0 };
            (state.angular_rate, state.specific_force) = (rate, force);
            let change = by_rate + by_force;
            // Convergence is linear, so the next change is predicted from the ratio of the last two changes.
            let next = last_change.map_or(change, |last: f64| change * (SLACK * change / last).min(1.0));
            if next <= 1e-15 * (1.0 + seen_force.amax()) {
                break;
            }
            last_change = Some(change);
        }
        state
    }
}

/// A rest, with the temperature and time on which effects depend.
pub(super) struct Still {
    pub(super) recording: usize,
    pub(super) samples: Range<usize>,
    /// Parts of the rest, each with its mean temperature and time. There is at least one part.
    pub(super) parts: Vec<Part>,
}

impl Terms<'_> {
    /// Computes the true force at a rest, m/s^2, from the force `seen` without correction for the effects. `columns`
    /// contains the derivatives of the force with respect to the parameters of the effects. On entry, `columns` must
    /// already contain the derivatives for effects that do not depend on the force. The derivatives for all other
    /// effects are computed here.
    pub(super) fn force_at_rest(
        &self,
        values: &[f64],
        seen: Vector3<f64>,
        still: &Still,
        columns: &mut [Vector3<f64>],
    ) -> Vector3<f64> {
        let mut force = seen;
        for _ in 0..MAX_ITERATIONS {
            self.mean_columns(values, (&force, None), still, |term| term.reads(Sensor::Accelerometer), columns);
            let before = force;
            force = seen - self.sum_of(Sensor::Accelerometer, values, columns);
            if (force - before).amax() <= 1e-15 * (1.0 + seen.amax()) {
                break;
            }
        }
        force
    }

    /// Computes `columns`, the derivatives of the sensor readings with respect to the parameters of the effects that
    /// `is_asked` selects. They are evaluated at the given force and attitude and are averaged over a rest. If the
    /// derivatives of an effect are constant during a rest, they are evaluated only for the first part of the rest. The
    /// derivatives of a user-defined effect are averaged over the samples of the rest.
    pub(super) fn mean_columns(
        &self,
        values: &[f64],
        (force, attitude): (&Vector3<f64>, Option<UnitQuaternion<f64>>),
        still: &Still,
        is_asked: impl Fn(&Term<'_>) -> bool,
        columns: &mut [Vector3<f64>],
    ) {
        let Still { recording, samples, parts } = still;
        let asked = || self.all.iter().filter(|term| is_asked(term));
        let changes = |term: &Term<'_>| term.changes_at_rest(parts[0].surroundings.temperature_difference_k.is_some());
        let parts = if asked().any(changes) { parts } else { &parts[..1] };
        let state = |part: &Part| State {
            angular_rate: Vector3::zeros(),
            specific_force: *force,
            surroundings: Surroundings { rotation_world_from_body: attitude, ..part.surroundings },
        };
        let states: Vec<(State<f64>, Sample)> = parts
            .iter()
            .map(|part| {
                let Range { start: index, end } = part.samples;
                (state(part), Sample { recording: *recording, index, count: end - index })
            })
            .collect();
        let mut each = vec![[Vector3::zeros(); MAX_PARAMETERS]; states.len()];
        for term in asked() {
            let own = &mut columns[term.first..term.first + term.count()];
            if let Kind::User(field) = term.kind {
                user_mean(field, *recording, samples, own);
                continue;
            }
            let count = if changes(term) { states.len() } else { 1 };
            // All columns are stored before any of them is added, because reading a value immediately after it was
            // written would be slow.
            for ((state, sample), one) in states[..count].iter().zip(&mut each) {
                term.columns_at(values, state, *sample, one);
            }
            let weights = || states[..count].iter().map(|(_, sample)| sample.count as f64);
            let total: f64 = weights().sum();
            let mean = |k: usize| {
                each.iter().zip(weights()).map(|(one, weight)| one[k] * weight).sum::<Vector3<f64>>() / total
            };
            own.iter_mut().enumerate().for_each(|(k, own)| *own = mean(k));
        }
    }

    /// For each user-defined effect, computes the means of its columns (derivatives of the reading) over a range of
    /// samples.
    pub(super) fn user_means(&self, recording: usize, range: &Range<usize>, columns: &mut [Vector3<f64>]) {
        for term in &self.all {
            if let Kind::User(field) = term.kind {
                user_mean(field, recording, range, &mut columns[term.first..term.first + term.linear]);
            }
        }
    }

    pub(super) fn has_user_fields(&self) -> bool {
        self.all.iter().any(|term| matches!(term.kind, Kind::User(_)))
    }

    /// Converts the columns (derivatives of the reading) of user-defined effects from means over a segment of a move to
    /// values at the midpoint of the segment. The conversion subtracts `share` times the second difference of the means
    /// over three consecutive segments.
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

/// Computes the means of the columns (derivatives of the reading) of a user-defined effect over a range of samples. The
/// columns may vary from sample to sample.
fn user_mean(field: &UserField<'_>, recording: usize, range: &Range<usize>, columns: &mut [Vector3<f64>]) {
    let p = columns.len();
    columns.fill(Vector3::zeros());
    for row in field.columns[recording][3 * p * range.start..3 * p * range.end].chunks_exact(3 * p) {
        for (k, column) in columns.iter_mut().enumerate() {
            *column += Vector3::new(row[k], row[p + k], row[2 * p + k]);
        }
    }
    columns.iter_mut().for_each(|column| *column /= range.len() as f64);
}
