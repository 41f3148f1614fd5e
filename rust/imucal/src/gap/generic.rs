//! What is not in the catalogue: a bias that varies from rest to rest in some pattern (model.md (24)).
//!
//! A hypothesis is a block, the bias of one sensor at each rest, and a kernel, the covariance of two rests. In its
//! eigenvectors it is a set of independent columns with a normal prior, and is judged like an effect.

use faer::Mat;
use imucal_core::effects::Sensor;
use nalgebra::Vector3;

/// Which bias varies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Block {
    /// The gyroscope's.
    GyroscopeBias,
    /// The accelerometer's.
    AccelerometerBias,
}

impl Block {
    pub(crate) fn sensor(self) -> Sensor {
        match self {
            Self::GyroscopeBias => Sensor::Gyroscope,
            Self::AccelerometerBias => Sensor::Accelerometer,
        }
    }

    /// Typical bias from rest to rest: 0.02 deg/s and half a mg.
    pub(crate) fn typical_si(self) -> f64 {
        match self {
            Self::GyroscopeBias => 3.5e-4,
            Self::AccelerometerBias => 5e-3,
        }
    }

    /// The name in results.
    pub fn name(self) -> &'static str {
        match self {
            Self::GyroscopeBias => "gyro_bias",
            Self::AccelerometerBias => "accel_bias",
        }
    }
}

/// How the biases of two rests belong together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kernel {
    /// They do not.
    White,
    /// A random walk in time.
    RandomWalk,
    /// The same for the same direction of gravity in the body.
    GravityDirection,
    /// The same for the same attitude, heading included.
    Attitude,
    /// The same for the same temperature.
    Temperature,
    /// The same after the same turn.
    LastMotion,
}

impl Kernel {
    /// The name in results.
    pub fn name(self) -> &'static str {
        match self {
            Self::White => "white",
            Self::RandomWalk => "random_walk",
            Self::GravityDirection => "gravity_direction",
            Self::Attitude => "attitude",
            Self::Temperature => "temperature",
            Self::LastMotion => "last_motion",
        }
    }

    pub(crate) const ALL: [Self; 6] =
        [Self::White, Self::RandomWalk, Self::GravityDirection, Self::Attitude, Self::Temperature, Self::LastMotion];
}

/// What the kernels know of a rest.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Epoch {
    pub(crate) recording: usize,
    pub(crate) time_s: f64,
    /// Direction of gravity in the body.
    pub(crate) up: Vector3<f64>,
    /// A horizontal direction of the world in the body, carried along by the gyroscope.
    pub(crate) ahead: Vector3<f64>,
    pub(crate) temperature_degc: Option<f64>,
    /// Rotation vector of the move that led here, rad.
    pub(crate) turn: Vector3<f64>,
}

/// Two attitudes this far apart hardly belong together: length of the kernels, as a distance of unit vectors.
const LENGTH: f64 = 0.6;
/// Eigenvalues below this share of the largest one are left out.
const SMALLEST: f64 = 1e-3;

/// The kernel's factor, epochs x r: its columns are eigenvectors times the roots of the eigenvalues, with a mean square of one over
/// the epochs. `None` where the recordings lack what it depends on.
pub(crate) fn factor(kernel: Kernel, epochs: &[Epoch]) -> Option<Mat<f64>> {
    let n = epochs.len();
    if n < 3 || (kernel == Kernel::Temperature && epochs.iter().any(|e| e.temperature_degc.is_none())) {
        return None;
    }
    let temperatures: Vec<f64> = epochs.iter().filter_map(|e| e.temperature_degc).collect();
    let spread = |values: &[f64]| {
        values.iter().copied().fold(f64::NEG_INFINITY, f64::max) - values.iter().copied().fold(f64::INFINITY, f64::min)
    };
    let near = |square: f64| (-0.5 * square / (LENGTH * LENGTH)).exp();
    let covariance = |a: &Epoch, b: &Epoch| match kernel {
        Kernel::White => f64::from(u8::from(std::ptr::eq(a, b))),
        Kernel::RandomWalk if a.recording != b.recording => 0.0,
        Kernel::RandomWalk => {
            let start = epochs.iter().find(|e| e.recording == a.recording).map_or(0.0, |e| e.time_s);
            (a.time_s - start).min(b.time_s - start)
        }
        Kernel::GravityDirection => near((a.up - b.up).norm_squared()),
        Kernel::Attitude => near((a.up - b.up).norm_squared() + (a.ahead - b.ahead).norm_squared()),
        Kernel::Temperature => {
            let scale = spread(&temperatures) / 4.0;
            let difference = a.temperature_degc.zip(b.temperature_degc).map_or(0.0, |(a, b)| a - b);
            if scale > 0.0 { (-0.5 * (difference / scale).powi(2)).exp() } else { 1.0 }
        }
        Kernel::LastMotion => (0..3).map(|axis| a.turn[axis].signum() * b.turn[axis].signum()).sum(),
    };
    let mut matrix = Mat::from_fn(n, n, |i, j| covariance(&epochs[i], &epochs[j]));
    // What all epochs share is a constant bias, which the base has: only what differs counts.
    let means: Vec<f64> = (0..n).map(|i| (0..n).map(|j| matrix[(i, j)]).sum::<f64>() / n as f64).collect();
    let mean = means.iter().sum::<f64>() / n as f64;
    matrix = Mat::from_fn(n, n, |i, j| matrix[(i, j)] - means[i] - means[j] + mean);
    let trace: f64 = (0..n).map(|i| matrix[(i, i)]).sum();
    if trace <= 1e-12 {
        return None;
    }
    let eigen = matrix.self_adjoint_eigen(faer::Side::Lower).ok()?;
    let largest = eigen.S()[n - 1];
    let kept: Vec<usize> = (0..n).rev().filter(|&k| eigen.S()[k] > SMALLEST * largest).collect();
    Some(Mat::from_fn(n, kept.len(), |i, c| eigen.U()[(i, kept[c])] * (eigen.S()[kept[c]] * n as f64 / trace).sqrt()))
}
