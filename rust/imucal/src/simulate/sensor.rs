//! A triad at work: from what it sees to what it says.
//!
//! ```text
//! seen     = sensitivity * (true + effects) + bias
//! measured = convert(sample(low_pass(seen + noise)))
//! ```
//!
//! White noise of density N has the standard deviation N sqrt(rate) at the rate at which it is drawn (a mean over T has
//! N / sqrt(T) at every rate): the Allan deviation's and the angle random walk's convention, not the one-sided bandwidth's
//! N sqrt(rate / 2).

use nalgebra::Vector3;

use super::noise::Noise;
use super::sampling::Filter;
use super::stream::{Stream, Triad};
use super::unit::Sensor;

/// What a triad sees in one internal step.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Seen {
    pub(super) value: [f64; 3],
    /// Whether the unit moves.
    pub(super) moving: bool,
}

/// One triad, sample by sample; what it remembers from sample to sample is here.
pub(super) struct Sampler<'a> {
    sensor: &'a Sensor,
    noise: Noise,
    analogue: Option<Analogue>,
}

/// Filter and integral at the internal rate.
struct Analogue {
    rate_hz: f64,
    /// Set by the first value.
    memory: Option<Memory>,
}

struct Memory {
    seen: Vector3<f64>,
    filter: Option<Filter>,
}

impl<'a> Sampler<'a> {
    /// For `samples` of `rate_hz`, each of `steps` internal steps.
    pub(super) fn new(sensor: &'a Sensor, triad: Triad, rate_hz: f64, samples: usize, steps: usize, seed: u64) -> Self {
        let steps = if sensor.is_point_sampled() { 1 } else { steps };
        let rate_hz = rate_hz * steps as f64;
        let generators = [Stream::White, Stream::Flicker, Stream::Walk]
            .map(|kind| [0, 1, 2].map(|axis| kind(triad, axis).generator(seed)));
        Self {
            sensor,
            noise: Noise::new(sensor, rate_hz, samples * steps, generators),
            analogue: (!sensor.is_point_sampled()).then_some(Analogue { rate_hz, memory: None }),
        }
    }

    /// The next sample; `seen` are its internal steps, of which the last is at the sample's own instant.
    #[inline]
    pub(super) fn measure(&mut self, seen: &[Seen]) -> [f64; 3] {
        let measured = match (&mut self.analogue, seen) {
            (Some(analogue), _) => analogue.measure(self.sensor, &mut self.noise, seen),
            (None, [.., last]) => {
                let mut value = Vector3::from(last.value);
                self.noise.add_to(&mut value, last.moving);
                value
            }
            (None, []) => Vector3::zeros(),
        };
        match self.sensor.converter {
            Some(converter) => measured.map(|value| converter.convert(value)).into(),
            None => measured.into(),
        }
    }
}

impl Analogue {
    fn measure(&mut self, sensor: &Sensor, noise: &mut Noise, steps: &[Seen]) -> Vector3<f64> {
        let rate_hz = self.rate_hz;
        let first = Vector3::from(steps.first().map_or([0.0; 3], |step| step.value));
        let memory = self.memory.get_or_insert_with(|| Memory::settled(sensor, noise, rate_hz, &first));
        let (mut last, mut sum) = (Vector3::zeros(), Vector3::zeros());
        for step in steps {
            let now = Vector3::from(step.value);
            // The mean over the step, so that the mean of all steps is the trapezoidal rule over the interval.
            let mut value = if sensor.averaging { (memory.seen + now) * 0.5 } else { now };
            memory.seen = now;
            noise.add_to(&mut value, step.moving);
            last = match &mut memory.filter {
                Some(filter) => filter.next(&value),
                None => value,
            };
            sum += last;
        }
        if sensor.averaging { sum / steps.len() as f64 } else { last }
    }
}

impl Memory {
    /// As if the unit had stood at the first value for long: a filter that starts without noise would be too quiet at first.
    fn settled(sensor: &Sensor, noise: &mut Noise, rate_hz: f64, first: &Vector3<f64>) -> Self {
        let filter = sensor.low_pass.map(|low_pass| {
            let mut filter = Filter::new(&low_pass, rate_hz, first);
            // Three periods of the bandwidth leave exp(-13) of the start.
            for _ in 0..(3.0 * rate_hz / low_pass.bandwidth_hz).min(1e6) as usize {
                let mut value = *first;
                noise.add_to(&mut value, false);
                filter.next(&value);
            }
            filter
        });
        Self { seen: *first, filter }
    }
}
