//! How every parameter turns the unit until each block inside a move, and what it changes of the force there.
//!
//! A block is one stretch of n samples or more; with G what its columns turn while it lasts, Gdot and G.. the differences between its
//! neighbours and the bend of three:
//!
//! ```text
//! turn(end)    = turn(begin) + G + G.. / 24
//! turn, mean   = turn(begin) + G / 2 - (1/8 - (1 - 1/n^2) / 24) Gdot + G.. / 48,   Gdot = (G_(k+1) - G_(k-1)) / 2
//! force, mean  = F + (1 - 1/n^2) F.. / 24,   F = R Phi
//! ```

use std::ops::Range;

use imucal_core::effects::{Need, Sensor};
use nalgebra::Vector3;
use pulp::{Arch, Simd, WithSimd};

use super::Route;
use super::changes::Changes;
use super::corrected::Corrected;
use super::planes::Planes;
use super::stretches::Stretches;
use crate::joint::layout::{ACCEL, BASE, GYRO_BIAS, GYRO_SENSITIVITY};
use crate::joint::model::{Model, force_by_parameters};
use crate::joint::terms::Terms;

/// The columns inside a move, block by block; their signs are those of what is taken off rate and force.
pub(super) struct Turns {
    stretches: Stretches,
    /// What each stretch turns, and what is added to the force in its middle, in the frame of the move's start.
    on_rate: Planes,
    on_force: Planes,
    /// Where the next block begins: its first stretch, and what is turned until there.
    next: usize,
    turned: Vec<f64>,
    /// Stretches of a block.
    of_block: usize,
    /// Those of the blocks that are done.
    changes: Changes,
}

impl Route<'_> {
    /// Columns of the base parameters in the middle of a stretch. The force there is what gravity, carried along, lets expect.
    fn base_columns(
        &self,
        model: &Model,
        freed: &Corrected,
        stretches: &Stretches,
        k: usize,
        columns: &mut [Vector3<f64>],
    ) {
        let [on_rate, on_force] = self.mean_added(model, freed, stretches.groups.samples(k));
        let rate = stretches.states[k].angular_rate + on_rate;
        let inverse = model.gyroscope.inverse();
        for i in 0..3 {
            columns[GYRO_BIAS.start + i] = inverse.column(i).into_owned();
            for j in 0..3 {
                columns[GYRO_SENSITIVITY.start + 3 * i + j] = inverse.column(i) * rate[j];
            }
        }
        let gravity = stretches.rotations[k].tr_mul(&self.gravity_at_start);
        let by_parameters = force_by_parameters(&model.accelerometer, &(gravity + on_force));
        ACCEL.for_each(|p| columns[p] = -by_parameters.column(p));
    }
}

impl Turns {
    /// Of the route, with stretches of so many samples and so many of these in a block.
    pub(super) fn new(
        route: &Route<'_>,
        model: &Model,
        terms: &Terms<'_>,
        freed: &Corrected,
        [size, of_block]: [usize; 2],
    ) -> Self {
        let wants_slopes = terms.needs(Need::AngularAcceleration);
        let stretches = route.stretches(model, Some(freed), size, wants_slopes);
        let planes = |base: Range<usize>, sensor: Sensor| {
            let parameters = base.chain(terms.parameters_of(sensor).map(|p| BASE + p)).collect();
            Planes::new(parameters, stretches.count())
        };
        let mut on_rate = planes(GYRO_BIAS.start..BASE, Sensor::Gyroscope);
        let mut on_force = planes(ACCEL, Sensor::Accelerometer);
        let weights = stretches.weights();
        let mut columns = vec![Vector3::zeros(); BASE];
        columns.extend(terms.room());
        for k in 0..stretches.count() {
            let (base, of_terms) = columns.split_at_mut(BASE);
            route.columns(terms, &model.values, &stretches, k, of_terms);
            route.base_columns(model, freed, &stretches, k, base);
            on_rate.push(&columns);
            on_rate.turn_last(&weights[k]);
            on_force.push(&columns);
            on_force.turn_last(&stretches.rotations[k]);
        }
        let next = stretches.groups.of(route.span.first + 1 - route.reach().start);
        let turned = on_rate.sum(next);
        let blocks = stretches.count() / of_block;
        let changes = Changes { turn: on_rate.like(blocks), force: on_force.like(blocks) };
        Self { stretches, on_rate, on_force, next, turned, of_block, changes }
    }

    /// Takes the means over the next block.
    pub(super) fn next_block(&mut self) {
        Arch::new().dispatch(NextBlock(self));
    }

    #[inline(always)] // With the widest registers.
    fn take_block(&mut self) {
        let Self { stretches, on_rate, on_force, next, turned, of_block, changes } = self;
        let (turn, force) = (changes.turn.next(), changes.force.next());
        let (share, spread) = (1.0 / *of_block as f64, stretches.spread / 24.0);
        for k in *next..*next + *of_block {
            // Beside what is as far on either side nothing bends.
            let [before, after] = if stretches.are_even[k] { [k - 1, k + 1] } else { [k, k] };
            let (of_slope, of_turned) = (share * (spread - 0.125) / 2.0, share / 48.0);
            let around = on_rate.of(before).iter().zip(on_rate.of(k)).zip(on_rate.of(after));
            for (((before, own), after), (mean, turned)) in around.zip(turn.iter_mut().zip(&mut *turned)) {
                let bend = before + after - 2.0 * own;
                *mean += share * (*turned + 0.5 * own) + of_slope * (after - before) + of_turned * bend;
                *turned += own + bend / 24.0;
            }
            let around = on_force.of(before).iter().zip(on_force.of(k)).zip(on_force.of(after));
            for (((before, own), after), mean) in around.zip(&mut *force) {
                *mean += share * (own + spread * (before + after - 2.0 * own));
            }
        }
        *next += *of_block;
    }

    /// d_turn_d_p at the end of the move for each of `total` parameters, and all blocks.
    pub(super) fn at_end(self, total: usize) -> (Vec<Vector3<f64>>, Changes) {
        let mut turn = vec![Vector3::zeros(); total];
        self.on_rate.put_negative(&self.on_rate.sum(self.stretches.count()), &mut turn);
        (turn, self.changes)
    }
}

struct NextBlock<'a>(&'a mut Turns);

impl WithSimd for NextBlock<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        self.0.take_block();
    }
}
