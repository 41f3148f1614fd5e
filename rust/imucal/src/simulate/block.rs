//! Simulation of a run in blocks of consecutive samples, so that the data of a block fit into the processor's cache.
//! For each block, the true state is computed first, and then the measurements.
//!
//! The true state is a function of time only. A block is therefore divided into pieces, whose true states are computed
//! in parallel on several threads. The measurements also depend on the past states of the noise and of the filter. All
//! measurements of one triad (the three axes of a sensor) in a block are therefore computed one after the other on a
//! single thread. The result has the same bytes for any number of threads.

use imucal_core::so3;
use imucal_core::temperature_memory::{TemperatureHistory, TemperatureMemory};
use nalgebra::Vector3;

use super::faults::Clock;
use super::noise::{Generators, normals};
use super::sensor::{Sampler, Seen};
use super::stand::Stand;
use super::stream::Stream;
use super::truth::Truth;
use super::{Added, Setup, Simulation};
use crate::numerics::workers::share_out;
use crate::recording::REFERENCE_TEMPERATURE_DEGC;

/// Number of internal time steps in a block. The sampling interval is divided into one or more internal time steps, so
/// that filters and averaging can be simulated. The buffers of a block of this size fit into the processor's cache.
const BLOCK_STEPS: usize = 32_768;
/// Number of internal time steps in a piece of a block. The true states of a piece are computed by one thread. A block
/// has about 32 pieces, which are distributed among the threads.
const PIECE_STEPS: usize = 1024;

/// Inputs of a run, which all threads read.
pub(super) struct Plan<'a> {
    pub(super) setup: &'a Setup<'a>,
    pub(super) truth: Truth<'a>,
    /// The stand whose encoders are read; `None` if the unit is not on a stand.
    pub(super) stand: Option<&'a Stand>,
    /// Number of internal time steps per sample.
    pub(super) steps: usize,
    pub(super) threads: usize,
}

/// Computes the true values and the measurements of a run whose time stamps are already set.
pub(super) fn fill(plan: &Plan, run: &mut Simulation, triads: [&mut Sampler; 2], clock: &mut Clock) {
    let samples = run.time_s.len();
    let block_samples = (BLOCK_STEPS / plan.steps).max(1);
    let mut buffers = Buffers::new(plan, block_samples);
    let [accelerometer, gyroscope] = triads;
    for first in (0..samples).step_by(block_samples) {
        let end = samples.min(first + block_samples);
        buffers.draw(&run.time_s[first..end], clock);
        buffers.remember(&plan.truth);
        share_out(plan.threads, pieces(plan, run, &mut buffers, first, end), |piece| piece.fill(plan));

        let steps = plan.steps * (end - first);
        let jobs = vec![
            (&mut *accelerometer, &buffers.seen_force[..steps], &mut run.specific_force[first..end]),
            (&mut *gyroscope, &buffers.seen_rate[..steps], &mut run.angular_rate[first..end]),
        ];
        share_out(plan.threads, jobs, |(sampler, seen, measured)| {
            for (seen, measured) in seen.chunks_exact(plan.steps).zip(measured) {
                *measured = sampler.measure(seen);
            }
        });
    }
}

/// Intermediate data of a block that the finished run does not contain.
struct Buffers {
    true_time_s: Vec<f64>,
    encoder_noise: Vec<Vector3<f64>>,
    encoders: Option<Generators>,
    /// Filters that compute the temperature history, and the time of their last input, s. The time is `None` before the
    /// first input. `memory` is `None` if no effect depends on the temperature history.
    memory: Option<(TemperatureMemory<f64>, Option<f64>)>,
    /// Temperature history (lag, rate and direction of the temperature) at the sample before the block and at each
    /// sample of the block; empty if no effect depends on the temperature history.
    history: Vec<TemperatureHistory<f64>>,
    seen_force: Vec<Seen>,
    seen_rate: Vec<Seen>,
}

impl Buffers {
    fn new(plan: &Plan, samples: usize) -> Self {
        let noisy = plan.stand.is_some_and(|stand| stand.encoder_noise_rad > 0.0);
        Self {
            true_time_s: Vec::with_capacity(samples),
            encoder_noise: vec![Vector3::zeros(); samples],
            encoders: noisy.then(|| [0, 1, 2].map(|motor| Stream::Encoder(motor).generator(plan.setup.seed))),
            memory: plan.truth.needs_history().then(|| (TemperatureMemory::new(&plan.setup.unit.effects), None)),
            history: Vec::new(),
            seen_force: vec![Seen::default(); samples * plan.steps],
            seen_rate: vec![Seen::default(); samples * plan.steps],
        }
    }

    /// Computes the true instants of the samples of the block, including clock jitter, and draws the encoder noise. The
    /// random numbers are drawn in the order of the samples, so they do not depend on the number of threads.
    fn draw(&mut self, stamps_s: &[f64], clock: &mut Clock) {
        self.true_time_s.clear();
        self.true_time_s.extend(stamps_s.iter().map(|stamp_s| clock.next(*stamp_s)));
        if let Some(generators) = &mut self.encoders {
            self.encoder_noise.iter_mut().take(stamps_s.len()).for_each(|noise| *noise = normals(generators));
        }
    }

    /// Computes the temperature history at each sample of the block. The history depends on all earlier samples, so the
    /// samples are processed in order.
    fn remember(&mut self, truth: &Truth) {
        let Some((memory, last_s)) = &mut self.memory else { return };
        self.history.clear();
        self.history.push(memory.history());
        self.history.extend(self.true_time_s.iter().map(|time_s| {
            let step_s = last_s.replace(*time_s).map_or(0.0, |last_s| (time_s - last_s).max(0.0));
            memory.update(step_s, truth.temperature_degc(*time_s) - REFERENCE_TEMPERATURE_DEGC)
        }));
    }
}

/// The rows of a run's arrays that belong to consecutive samples of a block. One thread computes these rows.
struct Piece<'r> {
    first: usize,
    true_time_s: &'r [f64],
    encoder_noise: &'r [Vector3<f64>],
    /// Temperature history at the sample before the piece and at each sample of the piece; empty if no effect depends
    /// on the temperature history.
    history: &'r [TemperatureHistory<f64>],
    seen_force: &'r mut [Seen],
    seen_rate: &'r mut [Seen],
    specific_force: &'r mut [[f64; 3]],
    angular_rate: &'r mut [[f64; 3]],
    angular_acceleration: &'r mut [[f64; 3]],
    rotation: &'r mut [[f64; 4]],
    temperature_degc: &'r mut [f64],
    /// Motor angles from the encoders; empty without a stand.
    stand_rad: &'r mut [[f64; 3]],
}

/// Divides the samples from `first` to `end` (excluded) into pieces, each of which one thread computes.
fn pieces<'r>(
    plan: &Plan,
    run: &'r mut Simulation,
    buffers: &'r mut Buffers,
    first: usize,
    end: usize,
) -> Vec<Piece<'r>> {
    let samples = (PIECE_STEPS / plan.steps).max(1);
    let steps = samples * plan.steps;
    let stand_rad = run.stand_rad.as_mut().map_or(&mut [][..], |rows| &mut rows[first..end]);
    let mut encoder_noise = buffers.encoder_noise.chunks(samples);
    let mut seen_force = buffers.seen_force.chunks_mut(steps);
    let mut seen_rate = buffers.seen_rate.chunks_mut(steps);
    let mut specific_force = run.true_specific_force[first..end].chunks_mut(samples);
    let mut angular_rate = run.true_angular_rate[first..end].chunks_mut(samples);
    let mut angular_acceleration = run.true_angular_acceleration[first..end].chunks_mut(samples);
    let mut rotation = run.rotation_world_from_body[first..end].chunks_mut(samples);
    let mut temperature_degc = run.temperature_degc[first..end].chunks_mut(samples);
    let mut stand_rad = stand_rad.chunks_mut(samples);
    let times = buffers.true_time_s.chunks(samples).enumerate();
    // `stand_rad` is empty without a stand, and `history` is empty if no effect depends on the temperature history. All
    // other arrays have rows for every sample, so only these two arrays use the empty default.
    times
        .map(|(k, true_time_s)| Piece {
            first: first + k * samples,
            true_time_s,
            encoder_noise: encoder_noise.next().unwrap_or_default(),
            history: buffers.history.get(k * samples..=k * samples + true_time_s.len()).unwrap_or_default(),
            seen_force: seen_force.next().unwrap_or_default(),
            seen_rate: seen_rate.next().unwrap_or_default(),
            specific_force: specific_force.next().unwrap_or_default(),
            angular_rate: angular_rate.next().unwrap_or_default(),
            angular_acceleration: angular_acceleration.next().unwrap_or_default(),
            rotation: rotation.next().unwrap_or_default(),
            temperature_degc: temperature_degc.next().unwrap_or_default(),
            stand_rad: stand_rad.next().unwrap_or_default(),
        })
        .collect()
}

impl Piece<'_> {
    fn fill(self, plan: &Plan) {
        let steps = plan.steps;
        let step_s = 1.0 / (plan.setup.rate_hz * (1.0 + plan.setup.faults.clock_rate_error) * steps as f64);
        let mut cursor = plan.truth.cursor();
        let mut seen = self.seen_force.iter_mut().zip(self.seen_rate.iter_mut());
        for (i, time_s) in self.true_time_s.iter().enumerate() {
            // The last internal step is at the instant of the sample, so the cursor contains the true state at this
            // instant after the loop.
            for step in 1..=steps {
                let share = step as f64 / steps as f64;
                cursor.seek(time_s - (steps - step) as f64 * step_s, history(self.history, i, share));
                let (rate, force) = cursor.seen(added(plan.setup.added.as_ref(), self.first + i, share));
                if let Some((seen_force, seen_rate)) = seen.next() {
                    *seen_force = Seen { value: force.into(), moving: cursor.moving };
                    *seen_rate = Seen { value: rate.into(), moving: cursor.moving };
                }
            }
            let state = &cursor.state;
            let surroundings = &state.surroundings;
            self.specific_force[i] = state.specific_force.into();
            self.angular_rate[i] = state.angular_rate.into();
            self.angular_acceleration[i] = surroundings.angular_acceleration.map_or([0.0; 3], Into::into);
            self.rotation[i] = surroundings.rotation_world_from_body.map_or([1.0, 0.0, 0.0, 0.0], |r| so3::to_wxyz(&r));
            self.temperature_degc[i] = cursor.temperature_degc;
            if let (Some(row), Some(stand), Some(motors)) = (self.stand_rad.get_mut(i), plan.stand, &surroundings.stand)
            {
                *row = stand.read_encoders(motors, &plan.setup.unit.effects, self.encoder_noise[i]).into();
            }
        }
    }
}

/// Computes the temperature history between two samples of a piece by linear interpolation. `share` is 0 at the sample
/// before `sample`, and 1 at `sample`. The first of the `rows` ([`Piece::history`]) belongs to the sample before the
/// piece. Therefore, the row with the index `sample` belongs to the sample before `sample`.
#[inline]
fn history(rows: &[TemperatureHistory<f64>], sample: usize, share: f64) -> Option<TemperatureHistory<f64>> {
    Some(rows.get(sample)?.between(rows.get(sample + 1)?, share))
}

/// Returns the rate and force that the setup adds to the true rate and force of the motion. The added rate and force
/// are interpolated linearly between samples: `share` is 0 at the sample before `sample`, and 1 at `sample`.
#[inline]
fn added(added: Option<&Added>, sample: usize, share: f64) -> (Vector3<f64>, Vector3<f64>) {
    let at = |rows: Option<&[[f64; 3]]>| match rows {
        Some(rows) => {
            let (before, now) = (Vector3::from(rows[sample.saturating_sub(1)]), Vector3::from(rows[sample]));
            now + (before - now) * (1.0 - share)
        }
        None => Vector3::zeros(),
    };
    added.map_or((Vector3::zeros(), Vector3::zeros()), |added| (at(added.rate), at(added.force)))
}
