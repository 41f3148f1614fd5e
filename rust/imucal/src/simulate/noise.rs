//! Random errors of a triad, each axis on its own: white noise, bias instability (flicker noise) and rate random walk.
//!
//! ```text
//!                      two-sided power density        Allan deviation                     a sample at rate r
//! white noise          N^2                            N / sqrt(tau)                       N sqrt(r) n_i
//! bias instability     B^2 / (2 pi |f|)               sqrt(2 ln 2 / pi) B = 0.664 B       B sum_k h_k n_(i-k)
//! random walk          K^2 / (2 pi f)^2               K sqrt(tau / 3)                     K / sqrt(r) sum of n_k, k <= i
//! ```
//!
//! n are independent normal numbers. (N. Kasdin, Proc. IEEE 83, 802, 1995; densities as in IEEE Std 952.)
//!
//! # Flicker noise
//!
//! h are the coefficients of `(1 - z^-1)^(-1/2)`, half of an integration, whose power `1 / (2 sin(pi f / r))` is `r / (2 pi f)`
//! where f is small beside the rate. They are moments, so that the filter is a sum of first-order ones with poles p:
//!
//! ```text
//! h_n = 1/pi  integral from 0 to 1 of  p^n / sqrt(p (1 - p)) dp
//!     = sum_k c_k p_k^n,    p_k = exp(-d_k),  d_k = d_0 3^-k,  c_k = ln 3 / pi  d_k exp(-d_k / 2) / sqrt(1 - p_k)
//! ```
//!
//! The sum is the trapezoidal rule in ln d. With poles a factor of 3 apart its error shrinks as exp(-pi^2 / ln 3): the power
//! is right to 0.05 %. The slowest pole stands for all slower ones, too; it is slow beside the whole record.

use std::f64::consts::{PI, TAU};

use nalgebra::{DMatrix, DVector, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::unit::Sensor;

/// Three axes, and a place that fills the processor's vectors.
type Lanes = [f64; 4];

/// One random number generator per axis.
pub(super) type Generators = [ChaCha8Rng; 3];

/// The random errors of a triad, step by step.
pub(super) struct Noise {
    white: Option<White>,
    flicker: Option<Flicker>,
    walk: Option<Walk>,
}

impl Noise {
    /// For `steps` steps of `rate_hz`. `generators` are for white noise, flicker noise and random walk.
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

    /// Adds the errors of the next step.
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
    /// Factor while the unit moves.
    in_motion: f64,
    generators: Generators,
}

/// The first value is zero: the bias of the unit is that at the start.
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

/// One first-order filter of the sum.
struct Pole {
    /// d in p = exp(-d).
    decay: f64,
    p: f64,
    c: f64,
}

struct Flicker {
    input_std: f64,
    poles: Vec<Pole>,
    states: Vec<Lanes>,
    /// The sum of the c whose poles are so fast that nothing is left of them in the next step.
    through: f64,
    generators: Generators,
}

const RATIO: f64 = 3.0;
/// Faster than this, c is below 1e-12.
const FASTEST: f64 = 64.0;
/// Faster than this, p is below 1e-6.
const MEMORYLESS: f64 = 14.0;

impl Flicker {
    /// In its steady state from the first step on: a sensor is switched on long before its record, or wanders as if.
    fn new(instability: f64, steps: usize, mut generators: Generators) -> Self {
        // A tenth of the lowest frequency that the record can show.
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
        // Slower ones would follow with c shrinking by the root of the ratio: a geometric series.
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

/// States with the covariance `1 / (1 - p_j p_k)` that the filters reach after a long time.
fn steady_states(poles: &[Pole], generators: &mut Generators) -> Vec<Lanes> {
    let n = poles.len();
    let covariance = DMatrix::from_fn(n, n, |j, k| -(-(poles[j].decay + poles[k].decay)).exp_m1().recip());
    let mut states = vec![[0.0; 4]; n];
    // It is positive definite by construction: its poles differ.
    if let Some(factor) = covariance.cholesky() {
        for (axis, generator) in generators.iter_mut().enumerate() {
            let axis_states = factor.l() * DVector::from_fn(n, |_, _| generator.sample::<f64, _>(StandardNormal));
            states.iter_mut().zip(&axis_states).for_each(|(state, value)| state[axis] = *value);
        }
    }
    states
}

/// One standard normal number of each generator.
#[inline]
pub(super) fn normals(generators: &mut Generators) -> Vector3<f64> {
    let [x, y, z] = generators;
    Vector3::new(x.sample(StandardNormal), y.sample(StandardNormal), z.sample(StandardNormal))
}
