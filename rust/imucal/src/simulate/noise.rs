//! Random errors of a triad: white noise, bias instability (flicker noise) and random walk. The errors of the axes are
//! independent.
//!
//! ```text
//!                      two-sided power density        Allan deviation                     a sample at rate r
//! white noise          N^2                            N / sqrt(tau)                       N sqrt(r) n_i
//! bias instability     B^2 / (2 pi |f|)               sqrt(2 ln(2) / pi) B = 0.664 B      B sum_k h_k n_(i-k)
//! random walk          K^2 / (2 pi f)^2               K sqrt(tau / 3)                     (K / sqrt(r)) sum_(k<i) n_k
//! ```
//!
//! f is the frequency and tau the averaging time. N, B and K are the fields `noise_density`, `bias_instability` and
//! `random_walk` of [`Sensor`]. The n_i are independent standard normal numbers, and the h_k are defined below
//! (`docs/model.md` (22)). Sources: N. Kasdin, Proc. IEEE 83, 802, 1995; densities as in IEEE Std 952.
//!
//! # Flicker noise
//!
//! h_n are the coefficients of z^-n in the power series of `(1 - z^-1)^(-1/2)`. This is the transfer function of an
//! integrator of order one half. The power gain of this filter is `1 / (2 sin(pi f / r))`, which approaches
//! `r / (2 pi f)` for frequencies f far below the rate r. Each h_n is an integral over the poles p of first-order
//! filters. A finite sum of such filters, with the poles p_k and the coefficients c_k, approximates this integral:
//!
//! ```text
//! h_n = (1 / pi) * integral from 0 to 1 of p^n / sqrt(p (1 - p)) dp
//!     = sum_k c_k p_k^n approximately,    p_k = exp(-d_k),    d_k = d_0 2.5^(-k)
//! c_k = (ln(2.5) / pi) d_k exp(-d_k / 2) / sqrt(1 - p_k)
//! ```
//!
//! The sum approximates the integral by the trapezoidal rule in the variable ln d, where p = exp(-d). d_0 is the
//! largest decay, 64 (`FASTEST`). The error of the sum is proportional to exp(-pi^2 / spacing), where `spacing` is the
//! spacing of ln d. With the spacing ln(2.5), the relative error of the power is 0.05 %. The time constant of the
//! slowest pole is longer than the record. This pole also represents all slower poles.

use std::f64::consts::{PI, TAU};

use nalgebra::{DMatrix, DVector, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::unit::Sensor;

/// Values of three axes and an unused fourth value, which gives the array the width of a vector register.
type Lanes = [f64; 4];

/// One random number generator per axis.
pub(super) type Generators = [ChaCha8Rng; 3];

/// State of the random errors of a triad.
pub(super) struct Noise {
    white: Option<White>,
    flicker: Option<Flicker>,
    walk: Option<Walk>,
}

impl Noise {
    /// Random errors for `steps` time steps at the rate `rate_hz`. `generators` are the random number generators of
    /// white noise, flicker noise and random walk, in this order.
    pub(super) fn new(sensor: &Sensor, rate_hz: f64, steps: usize, generators: [Generators; 3]) -> Self {
        let [white, flicker, walk] = generators;
        Self {
            white: (sensor.noise_density > 0.0).then(|| White {
                std: sensor.noise_density * rate_hz.sqrt(),
                in_motion: sensor.noise_in_motion,
                generators: white,
            }),
            flicker: (sensor.bias_instability > 0.0).then(|| Flicker::new(sensor.bias_instability, steps, flicker)),
            walk: (sensor.random_walk != Vector3::zeros()).then(|| Walk {
                step_std: sensor.random_walk / rate_hz.sqrt(),
                value: Vector3::zeros(),
                generators: walk,
            }),
        }
    }

    /// Adds the errors of the next step to `value`.
    #[inline]
    pub(super) fn add_to(&mut self, value: &mut Vector3<f64>, moving: bool) {
        if let Some(white) = &mut self.white {
            let std = if moving { white.std * white.in_motion } else { white.std };
            *value += normals(&mut white.generators) * std;
        }
        if let Some(flicker) = &mut self.flicker {
            *value += flicker.next();
        }
        if let Some(walk) = &mut self.walk {
            *value += walk.next();
        }
    }
}

struct White {
    std: f64,
    /// Factor that multiplies the standard deviation of the white noise while the unit moves.
    in_motion: f64,
    generators: Generators,
}

/// Random walk. The first value is zero, because the bias of the unit is defined as the bias at the start of the run.
struct Walk {
    step_std: Vector3<f64>,
    value: Vector3<f64>,
    generators: Generators,
}

impl Walk {
    #[inline]
    fn next(&mut self) -> Vector3<f64> {
        let now = self.value;
        self.value += normals(&mut self.generators).component_mul(&self.step_std);
        now
    }
}

/// One of the first-order filters whose sum is the flicker filter. p is its pole, and c its coefficient in the sum.
struct Pole {
    /// The decay d in p = exp(-d).
    decay: f64,
    p: f64,
    c: f64,
}

struct Flicker {
    input_std: f64,
    poles: Vec<Pole>,
    states: Vec<Lanes>,
    /// Sum of the coefficients c of the poles whose response decays within one step. These poles are treated as filters
    /// without memory, so the sum of their outputs is `through` times the input.
    through: f64,
    generators: Generators,
}

/// Ratio of the decays d of adjacent poles p = exp(-d). With this ratio, the relative error of the power of the flicker
/// noise is 0.05 %.
const RATIO: f64 = 2.5;
/// Largest decay d of a pole p = exp(-d). Poles with larger decays have coefficients c below 1e-12 and are omitted.
const FASTEST: f64 = 64.0;
/// Decay d above which a pole is treated as a filter without memory. The state of such a pole decays within one step by
/// the factor p, which is below 1e-6.
const MEMORYLESS: f64 = 14.0;

impl Flicker {
    /// Creates a filter that is in its steady state from the first step on, because a sensor has usually been switched
    /// on long before a record starts.
    fn new(instability: f64, steps: usize, mut generators: Generators) -> Self {
        // Decay of the pole whose corner frequency is a tenth of the lowest frequency in the record.
        let slowest = TAU / (10.0 * steps.max(1) as f64);
        let mut poles = Vec::new();
        let mut through = 0.0;
        let mut decay = FASTEST;
        loop {
            let c = RATIO.ln() / PI * decay * (-decay / 2.0).exp() / (-(-decay).exp_m1()).sqrt();
            if decay > MEMORYLESS {
                through += c;
            } else {
                poles.push(Pole { decay, p: (-decay).exp(), c });
            }
            if decay < slowest.min(MEMORYLESS) {
                break;
            }
            decay /= RATIO;
        }
        // Poles with smaller decays are omitted. The coefficient c of each of these poles would be the coefficient of
        // the previous pole divided by sqrt(RATIO). The omitted coefficients therefore form a geometric series. The sum
        // of this series is added to the last c.
        if let Some(last) = poles.last_mut() {
            last.c /= 1.0 - RATIO.sqrt().recip();
        }
        let states = steady_states(&poles, &mut generators);
        Self { input_std: instability, poles, states, through, generators }
    }

    #[inline]
    fn next(&mut self) -> Vector3<f64> {
        let n = normals(&mut self.generators);
        let input: Lanes = [n.x, n.y, n.z, 0.0];
        let mut sum = input.map(|value| value * self.through);
        for (pole, state) in self.poles.iter().zip(&mut self.states) {
            for lane in 0..4 {
                state[lane] = pole.p * state[lane] + input[lane];
                sum[lane] += pole.c * state[lane];
            }
        }
        Vector3::new(sum[0], sum[1], sum[2]) * self.input_std
    }
}

/// Draws random steady states of the filters of all poles, for each axis. If the input is white noise with a variance
/// of one, the steady states of the filters with the poles p_j and p_k have the covariance `1 / (1 - p_j p_k)`.
fn steady_states(poles: &[Pole], generators: &mut Generators) -> Vec<Lanes> {
    let n = poles.len();
    let covariance = DMatrix::from_fn(n, n, |j, k| -(-(poles[j].decay + poles[k].decay)).exp_m1().recip());
    let mut states = vec![[0.0; 4]; n];
    // The matrix is positive definite, because all poles differ.
    if let Some(factor) = covariance.cholesky() {
        for (axis, generator) in generators.iter_mut().enumerate() {
            let axis_states = factor.l() * DVector::from_fn(n, |_, _| generator.sample::<f64, _>(StandardNormal));
            states.iter_mut().zip(&axis_states).for_each(|(state, value)| state[axis] = *value);
        }
    }
    states
}

/// One standard normal number from each generator.
#[inline]
pub(super) fn normals(generators: &mut Generators) -> Vector3<f64> {
    let [x, y, z] = generators;
    Vector3::new(x.sample(StandardNormal), y.sample(StandardNormal), z.sample(StandardNormal))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::stream::{Stream, Triad};

    fn generators(kind: fn(Triad, u8) -> Stream, seed: u64) -> Generators {
        [0, 1, 2].map(|axis| kind(Triad::Gyroscope, axis).generator(seed))
    }

    fn noise(sensor: &Sensor, rate_hz: f64, steps: usize, seed: u64) -> Noise {
        let kinds: [fn(Triad, u8) -> Stream; 3] = [Stream::White, Stream::Flicker, Stream::Walk];
        Noise::new(sensor, rate_hz, steps, kinds.map(|kind| generators(kind, seed)))
    }

    /// Computes the Allan variance of means over m steps, averaged over the axes. The second result is the number of
    /// pairs of consecutive means per axis.
    fn allan_variance(values: &[Vector3<f64>], m: usize) -> (f64, f64) {
        let means: Vec<Vector3<f64>> =
            values.chunks_exact(m).map(|chunk| chunk.iter().sum::<Vector3<f64>>() / m as f64).collect();
        let pairs = means.len() as f64 - 1.0;
        (means.windows(2).map(|w| (w[1] - w[0]).norm_squared()).sum::<f64>() / (6.0 * pairs), pairs)
    }

    /// Tests that the Allan variance agrees with a function of tau within four standard deviations. For white noise,
    /// adjacent differences of means have a correlation of -1/2. The relative standard deviation of an Allan variance
    /// from K pairs of consecutive means is then sqrt(3 / K). For flicker noise and a random walk, the correlation is
    /// only about 1/4 in magnitude, so the standard deviation is smaller.
    fn check_allan(sensor: &Sensor, from: usize, expected: impl Fn(f64) -> f64) {
        let (rate_hz, n) = (50.0, 1_000_000);
        let mut noise = noise(sensor, rate_hz, n, 3);
        let values: Vec<Vector3<f64>> = (0..n)
            .map(|_| {
                let mut value = Vector3::zeros();
                noise.add_to(&mut value, false);
                value
            })
            .collect();
        let mut m = from;
        while m <= n / 20 {
            let (variance, pairs) = allan_variance(&values, m);
            let ratio = variance / expected(m as f64 / rate_hz);
            let band = 4.0 * (3.0 / (3.0 * pairs)).sqrt();
            assert!((ratio - 1.0).abs() < band + 2e-3, "{m} steps: {ratio}, band {band}");
            m *= 4;
        }
    }

    #[test]
    fn allan_deviation_of_white_noise_is_its_density_over_root_tau() {
        let sensor = Sensor { noise_density: 0.3, ..Sensor::ideal() };
        check_allan(&sensor, 1, |tau_s| 0.3 * 0.3 / tau_s);
    }

    #[test]
    fn allan_deviation_of_the_bias_instability_is_flat() {
        let sensor = Sensor { bias_instability: 0.2, ..Sensor::ideal() };
        // The comparison starts at means over 16 samples, because the Allan variance of means over fewer samples is
        // larger than the expected constant. The reason is that the power of the samples is proportional to
        // `1 / sin(pi f / r)` instead of `r / (pi f)`, where f is the frequency and r the sampling rate. Near the
        // Nyquist frequency, this power is larger than the power of 1/f noise. Above the Nyquist frequency, the
        // spectrum repeats.
        check_allan(&sensor, 16, |_| 2.0 * 2_f64.ln() / PI * 0.04);
    }

    #[test]
    fn allan_deviation_of_the_random_walk_grows_with_root_tau() {
        let sensor = Sensor { random_walk: Vector3::repeat(0.1), ..Sensor::ideal() };
        check_allan(&sensor, 16, |tau_s| 0.01 * tau_s / 3.0);
    }

    #[test]
    fn walks_of_the_axes_have_their_own_size_and_start_at_zero() {
        let sensor = Sensor { random_walk: Vector3::new(1.0, 0.0, 3.0), ..Sensor::ideal() };
        let (runs, steps) = (2000, 50);
        let mut squares = Vector3::zeros();
        for seed in 0..runs {
            let mut noise = noise(&sensor, 25.0, steps, seed);
            let mut value = Vector3::zeros();
            noise.add_to(&mut value, false);
            assert_eq!(value, Vector3::zeros());
            for _ in 0..steps {
                value = Vector3::zeros();
                noise.add_to(&mut value, false);
            }
            squares += value.component_mul(&value) / runs as f64;
        }
        // The expected variance of a random walk with coefficient K (`random_walk`) after the time t is K^2 t. Here t
        // is 50 steps at 25 Hz, which is 2 s. The relative standard deviation of a variance from `runs` values is
        // sqrt(2 / runs).
        let band = 4.0 * (2.0 / runs as f64).sqrt();
        assert!((squares.x / 2.0 - 1.0).abs() < band && (squares.z / 18.0 - 1.0).abs() < band, "{squares}");
        assert_eq!(squares.y, 0.0);
    }

    /// The power gain of the filter is tested without random numbers, for a record of one hour at 1 kHz. The tested
    /// frequencies range from one period per record to the Nyquist frequency.
    #[test]
    fn power_of_flicker_noise_is_that_of_half_an_integration() {
        let steps = 3_600_000;
        let flicker = Flicker::new(1.0, steps, generators(Stream::Flicker, 1));
        let power = |angle: f64| {
            let (mut re, mut im) = (flicker.through, 0.0);
            for Pole { decay, p, c } in &flicker.poles {
                // Adds the response c / (1 - p exp(-i angle)) of the pole. 1 - p cos(angle) is computed without
                // cancellation.
                let (a, b) = (-(-decay).exp_m1() + 2.0 * p * (angle / 2.0).sin().powi(2), p * angle.sin());
                re += c * a / (a * a + b * b);
                im -= c * b / (a * a + b * b);
            }
            re * re + im * im
        };
        let mut angle = TAU / steps as f64;
        let lowest = power(angle) * 2.0 * (angle / 2.0).sin();
        assert!((lowest - 1.0).abs() < 0.06, "{lowest} at one period per record");
        angle *= 10.0;
        while angle <= PI {
            let ratio = power(angle) * 2.0 * (angle / 2.0).sin();
            assert!(
                (ratio - 1.0).abs() < 5e-4 + 0.02 * (10.0 * TAU / steps as f64 / angle).powi(2),
                "{ratio} at {angle}"
            );
            angle *= 1.1;
        }
    }

    #[test]
    fn flicker_noise_is_in_its_steady_state_from_the_first_step() {
        let (runs, steps) = (4000, 200);
        let flicker = |seed| Flicker::new(1.0, steps, generators(Stream::Flicker, seed));
        let poles = flicker(0).poles;
        let through = flicker(0).through;
        // The flicker value is white noise times `through`, plus the sum of c_j times the state of filter j. Its
        // variance is through^2 + 2 through (sum of c_j) + (sum of c_j c_k / (1 - p_j p_k) over all j and k).
        let mut expected = through * through;
        for a in &poles {
            expected += 2.0 * through * a.c;
            expected += poles.iter().map(|b| a.c * b.c / (1.0 - a.p * b.p)).sum::<f64>();
        }
        let (mut first, mut last) = (0.0, 0.0);
        for seed in 0..runs {
            let mut flicker = flicker(seed);
            let values: Vec<Vector3<f64>> = (0..steps).map(|_| flicker.next()).collect();
            first += values[0].norm_squared() / (3 * runs) as f64;
            last += values[steps - 1].norm_squared() / (3 * runs) as f64;
        }
        let band = 4.0 * (2.0 / (3 * runs) as f64).sqrt();
        for found in [first, last] {
            assert!((found / expected - 1.0).abs() < band, "{found}, not {expected}");
        }
    }

    #[test]
    fn white_noise_grows_in_motion_by_its_factor() {
        let sensor = Sensor { noise_density: 0.1, noise_in_motion: 2.5, ..Sensor::ideal() };
        let (mut still, mut moving) = (noise(&sensor, 100.0, 10, 4), noise(&sensor, 100.0, 10, 4));
        for _ in 0..10 {
            let (mut a, mut b) = (Vector3::zeros(), Vector3::zeros());
            still.add_to(&mut a, false);
            moving.add_to(&mut b, true);
            assert!((a * 2.5 - b).norm() < 1e-15 && a != b);
        }
    }
}
