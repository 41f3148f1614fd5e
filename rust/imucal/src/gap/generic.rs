//! Generic hypotheses: variations of a bias or a scale that no effect of the catalogue describes (docs/model.md (24)).
//!
//! A hypothesis consists of a block and a kernel. The block is the sensor parameter that varies. The kernel is the
//! covariance of the parameter's deviations at two times. Each eigenfunction of the kernel gives one Jacobian column of
//! the linear model for each axis, and the coefficients of the columns have independent normal priors. The evidence of
//! a hypothesis is therefore computed in the same way as the evidence of an effect.

use std::sync::Arc;

use imucal_core::effects::Sensor;
use nalgebra::Vector3;

use super::kernel::Kernel;
use super::shares::{Moment, Moments, Place, Shares};
use super::smooth::Smooth;
use crate::numerics::gaussian::gaussian_kernels;
use crate::numerics::workers::{in_order, processors};

/// The sensor parameter that varies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Block {
    /// The gyroscope's bias.
    GyroscopeBias,
    /// The accelerometer's bias.
    AccelerometerBias,
    /// The gyroscope's scale.
    GyroscopeScale,
    /// The accelerometer's scale.
    AccelerometerScale,
}

impl Block {
    pub(crate) fn sensor(self) -> Sensor {
        match self {
            Self::GyroscopeBias | Self::GyroscopeScale => Sensor::Gyroscope,
            Self::AccelerometerBias | Self::AccelerometerScale => Sensor::Accelerometer,
        }
    }

    /// Typical deviation of the parameter, SI units. The prior widths of hypotheses are multiples of this deviation.
    /// The values are 0.02 deg/s for gyroscope bias, 0.5 mg for accelerometer bias, 0.2 % for gyroscope scale, and
    /// 0.1 % for accelerometer scale.
    pub(super) fn typical(self) -> f64 {
        match self {
            Self::GyroscopeBias => 3.5e-4,
            Self::AccelerometerBias => 5e-3,
            Self::GyroscopeScale => 2e-3,
            Self::AccelerometerScale => 1e-3,
        }
    }

    /// Name of the block in JSON documents.
    pub fn name(self) -> &'static str {
        match self {
            Self::GyroscopeBias => "gyro_bias",
            Self::AccelerometerBias => "accel_bias",
            Self::GyroscopeScale => "gyro_scale",
            Self::AccelerometerScale => "accel_scale",
        }
    }
}

/// Pairs of sensor parameter (block) and kernel that are tested if accelerometer samples inside moves are not used.
const ALL: [(Block, Kernel); 22] = {
    use Block::{AccelerometerBias, AccelerometerScale, GyroscopeBias, GyroscopeScale};
    use Kernel::{Attitude, Force, GravityDirection, Heading, LastMotion, RandomWalk, Rate, Session, Temperature};
    [
        (GyroscopeBias, RandomWalk),
        (GyroscopeBias, GravityDirection),
        (GyroscopeBias, Attitude),
        (GyroscopeBias, Heading),
        (GyroscopeBias, Temperature),
        (GyroscopeBias, LastMotion),
        (AccelerometerBias, RandomWalk),
        (AccelerometerBias, GravityDirection),
        (AccelerometerBias, Attitude),
        (AccelerometerBias, Temperature),
        (AccelerometerBias, LastMotion),
        (GyroscopeScale, RandomWalk),
        (GyroscopeScale, GravityDirection),
        (GyroscopeScale, Temperature),
        (GyroscopeScale, Rate),
        (AccelerometerScale, RandomWalk),
        (AccelerometerScale, Temperature),
        (AccelerometerScale, Force),
        (GyroscopeBias, Session),
        (AccelerometerBias, Session),
        (GyroscopeScale, Session),
        (AccelerometerScale, Session),
    ]
};
/// Pairs of sensor parameter (block) and kernel that are tested if accelerometer samples inside moves are used. Inside
/// moves, the accelerometer bias may depend on the angular rate. The pair of accelerometer bias and rate is therefore
/// added to [`ALL`].
const INSIDE: [(Block, Kernel); ALL.len() + 1] = {
    let mut all = [(Block::AccelerometerBias, Kernel::Rate); ALL.len() + 1];
    let mut k = 0;
    while k < ALL.len() {
        all[k] = ALL[k];
        k += 1;
    }
    all
};

/// A generic hypothesis: the sensor parameter that varies, and the shape of its variation.
pub(crate) struct Hypothesis {
    pub(crate) block: Block,
    pub(crate) kernel: Kernel,
    shape: Shape,
    gravity_mps2: f64,
}

enum Shape {
    /// The deviation of the parameter is a linear combination of eigenfunctions of the kernel.
    Varies(Arc<Shares>),
    /// The deviation is a nonlinear function of the sensor's input (angular rate or specific force). The `f64` is the
    /// largest magnitude of the input. Each axis has columns of three kinds: the input on this axis multiplied by
    /// smooth functions of the same input, the products of the inputs on two axes and, for the gyroscope, the angular
    /// acceleration.
    Follows(Smooth<f64>, f64),
    /// The deviation is linear in the products of two components of the angular rate and in the components of the
    /// angular acceleration.
    Turns,
}

/// Correlation length of the smooth function of the input (angular rate or specific force) on one axis, as a share of
/// the largest input.
const CURVE_LENGTH: f64 = 0.5;
/// Number of nodes of the smooth function of the input on one axis. The nodes are equally spaced from minus to plus the
/// largest input.
const CURVE_POINTS: usize = 9;
/// Factor, in seconds, by which the Jacobian columns of the angular acceleration are multiplied. With this factor,
/// their coefficients have the same typical size as deviations of the scale.
const LAG_S: f64 = 0.1;

/// All hypotheses that are observable in the recordings and for which `asked` is true. `inside` is true if
/// accelerometer samples inside moves are used.
pub(crate) fn hypotheses(
    moments: &Moments,
    inside: bool,
    gravity_mps2: f64,
    asked: impl Fn(Block, Kernel) -> bool,
) -> Vec<Hypothesis> {
    let all: &[(Block, Kernel)] = if inside { &INSIDE } else { &ALL };
    let pairs: Vec<(Block, Kernel)> = all.iter().copied().filter(|(block, kernel)| asked(*block, *kernel)).collect();
    // `known` lists the kernels whose eigenfunctions are needed, each with a flag. If the flag is true, the
    // eigenfunctions are computed from values of the kernel in the middle of the moves, otherwise from values at the
    // rests. Hypotheses with a rate or force kernel need no such eigenfunctions.
    let varies = |(block, kernel): (Block, Kernel)| {
        (!matches!(kernel, Kernel::Rate | Kernel::Force)).then_some((kernel, block == Block::GyroscopeScale))
    };
    let mut known: Vec<(Kernel, bool)> = Vec::new();
    for key in pairs.iter().copied().filter_map(varies) {
        if !known.contains(&key) {
            known.push(key);
        }
    }
    let shares = in_order(processors(), known.len(), |k| Shares::new(known[k].0, known[k].1, moments).map(Arc::new));
    let made = pairs.iter().filter_map(|&(block, kernel)| {
        let shape = match varies((block, kernel)) {
            Some(key) => Shape::Varies(shares[known.iter().position(|own| *own == key)?].clone()?),
            None if (block, kernel) == (Block::AccelerometerBias, Kernel::Rate) => Shape::Turns,
            None => curve(kernel, moments, gravity_mps2)?,
        };
        Some(Hypothesis { block, kernel, shape, gravity_mps2 })
    });
    made.collect()
}

fn curve(kernel: Kernel, moments: &Moments, gravity_mps2: f64) -> Option<Shape> {
    let rates = moments.moves.iter().flatten().map(|moment| moment.rate.amax());
    let largest = if kernel == Kernel::Rate { rates.fold(0.0, f64::max) } else { gravity_mps2 };
    let grid = (0..CURVE_POINTS).map(|k| 2.0 * k as f64 / (CURVE_POINTS - 1) as f64 - 1.0).collect();
    Smooth::new(grid, near_on_curve, CURVE_POINTS).filter(|_| largest > 0.0).map(|s| Shape::Follows(s, largest))
}

fn near_on_curve(a: &f64, others: &[f64], to: &mut [f64]) {
    to.iter_mut().zip(others).for_each(|(to, b)| *to = ((a - b) / CURVE_LENGTH).powi(2));
    gaussian_kernels(to);
}

impl Hypothesis {
    /// Typical size of the coefficient of each Jacobian column, SI units.
    pub(crate) fn typical(&self) -> f64 {
        self.block.typical()
    }

    /// Number of Jacobian columns. The first third belongs to the x axis, the second to the y axis, and the last to the
    /// z axis.
    pub(crate) fn width(&self) -> usize {
        3 * match &self.shape {
            Shape::Varies(shares) => shares.width(),
            Shape::Follows(smooth, _) if self.kernel == Kernel::Rate => smooth.width() + 6,
            Shape::Follows(smooth, _) => smooth.width() + 3,
            Shape::Turns => 9,
        }
    }

    /// For each evaluation time (a rest, or a time inside a move) and each column: the error of the angular rate or
    /// specific force, SI units, if the coefficient of this column is 1 and all other coefficients are 0.
    pub(crate) fn columns(&self, moments: &Moments, place: Place) -> Vec<f64> {
        let force = |at: &Moment| at.up * self.gravity_mps2;
        let moments = moments.at(place);
        match &self.shape {
            Shape::Varies(shares) => {
                let input = |at: &Moment| match self.block {
                    Block::GyroscopeScale => at.rate,
                    Block::AccelerometerScale => force(at),
                    Block::GyroscopeBias | Block::AccelerometerBias => Vector3::repeat(1.0),
                };
                shares.times(place, moments.iter().map(input))
            }
            Shape::Follows(smooth, largest) => {
                let of_rate = self.kernel == Kernel::Rate;
                let inputs: Vec<Vector3<f64>> =
                    moments.iter().map(|at| if of_rate { at.rate } else { force(at) }).collect();
                let places: Vec<f64> = inputs.iter().flatten().map(|input| input / largest).collect();
                let curves = smooth.at(&places, near_on_curve);
                let mut all = Vec::with_capacity(moments.len() * self.width());
                for (m, (at, input)) in moments.iter().zip(&inputs).enumerate() {
                    let products = Vector3::from_fn(|k, _| input[k] * input[(k + 1) % 3] / largest);
                    let change = at.acceleration * LAG_S;
                    for axis in 0..3 {
                        all.extend(curves.col_as_slice(3 * m + axis).iter().map(|curve| input[axis] * curve));
                        all.extend(&products);
                        all.extend(change.iter().filter(|_| of_rate));
                    }
                }
                all
            }
            Shape::Turns => {
                let parts = |at: &Moment| {
                    let (w, change) = (at.rate, at.acceleration);
                    [w.x * w.x, w.x * w.y, w.x * w.z, w.y * w.y, w.y * w.z, w.z * w.z, change.x, change.y, change.z]
                };
                moments.iter().flat_map(|at| [parts(at); 3]).flatten().collect()
            }
        }
    }

    /// For each evaluation time (a rest, or a time inside a move) and each column: the deviation of the sensor
    /// parameter if the coefficient of this column is 1 and all other coefficients are 0.
    pub(crate) fn shares(&self, moments: &Moments, place: Place) -> Vec<f64> {
        match &self.shape {
            Shape::Varies(shares) => shares.times(place, std::iter::repeat(Vector3::repeat(1.0))),
            Shape::Follows(_, largest) => self.columns(moments, place).iter().map(|number| number / largest).collect(),
            Shape::Turns => self.columns(moments, place),
        }
    }

    /// Whether the hypothesis is observable only inside moves, and not at rests.
    pub(crate) fn is_of_moves(&self) -> bool {
        self.block == Block::GyroscopeScale || matches!(self.shape, Shape::Turns)
    }
}
