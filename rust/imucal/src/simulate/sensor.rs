//! Simulation of one triad (the three axes of a sensor): from the input of the triad to its samples.
//!
//! ```text
//! seen     = sensitivity * (true + effects) + bias
//! measured = convert(sample(low_pass(seen + noise)))         model.md (22)
//! ```
//!
//! `seen` is the input of the triad, before noise is added. White noise of density N is simulated at a given rate by
//! random numbers with the standard deviation N sqrt(rate). A mean over the time T then has the standard deviation N /
//! sqrt(T) at any rate. Densities are two-sided, as for the Allan deviation and the angle random walk. With one-sided
//! densities, the standard deviation would be N sqrt(rate / 2).

use nalgebra::Vector3;

use super::noise::Noise;
use super::sampling::Filter;
use super::stream::{Stream, Triad};
use super::unit::Sensor;

/// Input of a triad at one internal step: `sensitivity * (true + effects) + bias`. A sample may need several internal
/// steps, because filtering and averaging are simulated at a rate above the sampling rate.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Seen {
    pub(super) value: [f64; 3],
    /// Whether this step is outside the rests of the motion. During moves, the white noise is multiplied by
    /// `noise_in_motion`.
    pub(super) moving: bool,
}

/// Simulation of one triad, sample by sample. The struct keeps the state of the filter and of the noise from one sample
/// to the next.
pub(super) struct Sampler<'a> {
    sensor: &'a Sensor,
    noise: Noise,
    analogue: Option<Analogue>,
}

/// Low-pass filter and averaging of a triad, simulated at the internal rate, which is a multiple of the sampling rate.
struct Analogue {
    rate_hz: f64,
    /// Last input and state of the filter, which are needed for the next sample; `None` before the first sample.
    memory: Option<Memory>,
}

struct Memory {
    seen: Vector3<f64>,
    filter: Option<Filter>,
}

impl<'a> Sampler<'a> {
    /// Creates the simulation of a triad, for `samples` samples at the sampling rate `rate_hz`. Each sampling interval
    /// is divided into `steps` internal steps.
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

    /// Simulates the next sample. `seen` contains the input at the internal steps of this sample. The last step is at
    /// the instant of the sample.
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
            // The mean over one internal time step is the average of the values at its two ends. The mean over all
            // steps of a sample is therefore the trapezoidal rule over the sampling interval.
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
    /// Creates the state before the first sample. The input before the first sample is assumed to be constant and equal
    /// to the first input. This constant is passed through the filter with noise, because the first samples would
    /// otherwise have less noise than later samples.
    fn settled(sensor: &Sensor, noise: &mut Noise, rate_hz: f64, first: &Vector3<f64>) -> Self {
        let filter = sensor.low_pass.map(|low_pass| {
            let mut filter = Filter::new(&low_pass, rate_hz, first);
            // After three periods of the bandwidth frequency, the influence of the initial state of the filter has
            // decayed by the factor exp(-13).
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

#[cfg(test)]
mod tests {
    use std::f64::consts::{PI, SQRT_2};

    use super::*;
    use crate::simulate::sampling::LowPass;

    const RATE_HZ: f64 = 100.0;

    /// Simulates `n` samples of a sensor at zero input. Returns the mean square of the samples, and the mean product of
    /// consecutive samples. Both are means over all axes.
    fn noise_power(sensor: &Sensor, n: usize) -> (f64, f64) {
        let steps = sensor.steps(RATE_HZ);
        let mut sampler = Sampler::new(sensor, Triad::Accelerometer, RATE_HZ, n, steps, 8);
        let nothing = vec![Seen::default(); steps];
        let values: Vec<Vector3<f64>> = (0..n).map(|_| sampler.measure(&nothing).into()).collect();
        let power = values.iter().map(Vector3::norm_squared).sum::<f64>() / (3 * n) as f64;
        (power, values.windows(2).map(|w| w[0].dot(&w[1])).sum::<f64>() / (3 * n) as f64)
    }

    /// Computes the power of white noise of density N after the filter, in closed form. The internal rate is r. The
    /// bilinear filter has the power gain |H|^2 = 1 / (1 + u^4) at the frequency f. Here u = tan(pi f / r) / k and k =
    /// tan(pi bandwidth / r). The power is therefore (2 k N^2 r / pi) times
    ///
    /// ```text
    /// integral from 0 to infinity of du / ((1 + u^4) (1 + k^2 u^2))
    ///     = ((1 - k^2) pi / (2 sqrt(2)) + k^3 pi / 2) / (1 + k^4)
    /// ```
    fn filtered_power(density: f64, bandwidth_hz: f64, rate_hz: f64) -> f64 {
        let k = (PI * bandwidth_hz / rate_hz).tan();
        let integral = ((1.0 - k * k) * PI / (2.0 * SQRT_2) + k.powi(3) * PI / 2.0) / (1.0 + k.powi(4));
        density * density * rate_hz * 2.0 * k / PI * integral
    }

    #[test]
    fn the_filter_leaves_the_noise_of_its_bandwidth() {
        let n = 200_000;
        for bandwidth_hz in [5.0, 20.0, 50.0, 150.0] {
            let low_pass = LowPass { bandwidth_hz };
            let sensor = Sensor { noise_density: 0.1, low_pass: Some(low_pass), ..Sensor::ideal() };
            let expected = filtered_power(0.1, bandwidth_hz, RATE_HZ * low_pass.steps(RATE_HZ) as f64);
            // The noise bandwidth of the analogue filter is pi / (2 sqrt(2)) times its bandwidth. The bilinear
            // transform changes the noise bandwidth slightly. `analogue` is the noise power N^2 = 0.01 times the noise
            // bandwidth. The factor 2.0 before `PI` includes negative frequencies.
            let analogue = 0.01 * 2.0 * PI / (2.0 * SQRT_2) * bandwidth_hz;
            assert!((expected / analogue - 1.0).abs() < 0.04, "{bandwidth_hz} Hz");
            // Samples are correlated over about one period of the bandwidth frequency.
            let independent = (3 * n) as f64 * (bandwidth_hz / RATE_HZ).min(1.0);
            let (found, _) = noise_power(&sensor, n);
            let band = 4.0 * (2.0 / independent).sqrt();
            assert!((found / expected - 1.0).abs() < band, "{bandwidth_hz} Hz: {found}, not {expected}, band {band}");
        }
    }

    #[test]
    fn means_have_the_white_noise_of_points() {
        let n = 200_000;
        let sensor = Sensor { noise_density: 0.1, averaging: true, ..Sensor::ideal() };
        let (found, neighbours) = noise_power(&sensor, n);
        let band = 4.0 * (2.0 / (3 * n) as f64).sqrt();
        assert!((found / (0.01 * RATE_HZ) - 1.0).abs() < band, "{found}");
        assert!((neighbours / (0.01 * RATE_HZ)).abs() < band, "{neighbours}");
    }

    /// If the input is a parabola, each sample must equal the mean of the parabola over the interval before the sample,
    /// plus the error of the trapezoidal rule. This error is h^2 / 6 for steps of length h.
    #[test]
    fn means_are_integrals_over_the_interval_before_the_sample() {
        let sensor = Sensor { averaging: true, ..Sensor::ideal() };
        let steps = sensor.steps(RATE_HZ);
        let mut sampler = Sampler::new(&sensor, Triad::Gyroscope, RATE_HZ, 50, steps, 0);
        let (t, h) = (1.0 / RATE_HZ, 1.0 / (RATE_HZ * steps as f64));
        for i in 0..50 {
            let end = i as f64 * t;
            let value = |j: usize| (end - (steps - 1 - j) as f64 * h).powi(2);
            let seen: Vec<Seen> = (0..steps).map(|j| Seen { value: [value(j); 3], moving: true }).collect();
            let measured = sampler.measure(&seen)[0];
            let integral = (end.powi(3) - (end - t).powi(3)) / (3.0 * t);
            // The first sample is not compared, because the input before the first step is unknown.
            if i > 0 {
                assert!((measured - integral - h * h / 6.0).abs() < 1e-13, "sample {i}: {measured}, not {integral}");
            }
        }
    }

    #[test]
    fn a_filtered_constant_is_the_constant() {
        let low_pass = Some(LowPass { bandwidth_hz: 10.0 });
        for averaging in [false, true] {
            let sensor = Sensor { low_pass, averaging, ..Sensor::ideal() };
            let steps = sensor.steps(RATE_HZ);
            let mut sampler = Sampler::new(&sensor, Triad::Gyroscope, RATE_HZ, 10, steps, 0);
            let seen = vec![Seen { value: [1.0, -2.0, 3.0], moving: false }; steps];
            for _ in 0..10 {
                let measured = Vector3::from(sampler.measure(&seen));
                assert!((measured - Vector3::new(1.0, -2.0, 3.0)).norm() < 1e-12);
            }
        }
    }

    #[test]
    fn a_point_sensor_takes_the_last_step_of_a_faster_companion() {
        let sensor = Sensor { noise_density: 0.1, ..Sensor::ideal() };
        let mut alone = Sampler::new(&sensor, Triad::Gyroscope, RATE_HZ, 10, 1, 0);
        let mut beside = Sampler::new(&sensor, Triad::Gyroscope, RATE_HZ, 10, 8, 0);
        let last = Seen { value: [1.0; 3], moving: false };
        let mut steps = [Seen { value: [9.0; 3], moving: true }; 8];
        steps[7] = last;
        for _ in 0..10 {
            assert_eq!(alone.measure(&[last]), beside.measure(&steps));
        }
    }
}
