//! Evaluates the eigenfunctions of covariance kernels at rests and inside moves. A generic hypothesis assumes that a
//! bias or scale varies, and a kernel is the covariance of this variation (docs/model.md (24)).

use faer::Mat;
use nalgebra::Vector3;

use super::kernel::Kernel;
use super::smooth::Smooth;
use crate::numerics::gaussian::gaussian_kernels;

/// Values at one time of the quantities on which kernels depend, such as temperature.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Moment {
    pub(crate) recording: usize,
    /// Time since the first sample of the recording, s.
    pub(crate) time_s: f64,
    /// Direction up in the body frame.
    pub(crate) up: Vector3<f64>,
    /// Body-frame components of a fixed horizontal direction of the world frame. They are propagated by integrating the
    /// angular rate.
    pub(crate) ahead: Vector3<f64>,
    pub(crate) temperature_degc: Option<f64>,
    /// Sense of rotation about each axis, 1 or -1. At rest, it is the sense of the last rotation; 0 before the first
    /// rotation.
    pub(crate) signs: Vector3<f64>,
    /// Angular rate, rad/s.
    pub(crate) rate: Vector3<f64>,
    /// Angular acceleration, rad/s^2.
    pub(crate) acceleration: Vector3<f64>,
}

/// Quantities on which kernels depend, at the rests that the fit uses and at several times inside each move.
pub(crate) struct Moments {
    /// Indices of the rests that the fit uses.
    pub(crate) used: Vec<usize>,
    pub(crate) rests: Vec<Moment>,
    pub(crate) moves: Vec<Vec<Moment>>,
}

/// Selects the times at which quantities are evaluated: the rests, or the evaluation times inside one move.
#[derive(Clone, Copy)]
pub(crate) enum Place {
    Rests,
    Move(usize),
}

impl Moments {
    pub(super) fn at(&self, place: Place) -> &[Moment] {
        match place {
            Place::Rests => &self.rests,
            Place::Move(k) => &self.moves[k],
        }
    }
}

/// Values of the eigenfunctions of a kernel, one row for each function. Hypotheses about different sensor parameters
/// use the same values.
pub(super) struct Shares {
    /// One column for each rest that the fit uses.
    rests: Mat<f64>,
    /// For each move, one column for each evaluation time inside the move.
    moves: Vec<Mat<f64>>,
}

/// Correlation length of the kernels that depend on directions or attitudes. It is dimensionless, because the distance
/// between two directions is the length of the difference between their unit vectors.
const LENGTH: f64 = 0.6;
/// Maximum number of eigenfunctions per axis for a random walk. With this number, the eigenfunctions resolve periods
/// down to a tenth of the recording's duration.
const MOST_WAVES: usize = 20;
/// Maximum number of eigenfunctions per axis for all other kernels.
const MOST: usize = 12;

impl Shares {
    /// Computes the eigenfunctions of a kernel from its values in the middle of the moves if `in_moves` is true,
    /// otherwise from its values at the rests. `None` if the kernel is constant over these times, or if there are too
    /// few times or temperatures.
    pub(super) fn new(kernel: Kernel, in_moves: bool, moments: &Moments) -> Option<Self> {
        let points: Vec<Moment> = if in_moves {
            moments.moves.iter().filter_map(|way| way.get(way.len() / 2)).copied().collect()
        } else {
            moments.rests.clone()
        };
        let temperatures: Vec<f64> = points.iter().filter_map(|m| m.temperature_degc).collect();
        if points.len() < 3 || (kernel == Kernel::Temperature && temperatures.len() < points.len()) {
            return None;
        }
        // The correlation length of the temperature kernel is proportional to the range of the temperature.
        let end = |fold: fn(f64, f64) -> f64, start: f64| temperatures.iter().copied().fold(start, fold);
        let spread = end(f64::max, f64::NEG_INFINITY) - end(f64::min, f64::INFINITY);
        let most = if kernel == Kernel::RandomWalk { MOST_WAVES } else { MOST };
        let alike = |a: &Moment, others: &[Moment], to: &mut [f64]| covariances(kernel, spread, a, others, to);
        let smooth = Smooth::new(points, alike, most)?;
        let moves = moments.moves.iter().map(|way| smooth.at(way, alike)).collect();
        Some(Self { rests: smooth.at(&moments.rests, alike), moves })
    }

    /// Number of eigenfunctions.
    pub(super) fn width(&self) -> usize {
        self.rests.nrows()
    }

    /// The products eigenfunction x factor, for each evaluation time, axis and eigenfunction. `numbers` contains the
    /// factors of the three axes at each evaluation time.
    pub(super) fn times(&self, place: Place, numbers: impl Iterator<Item = Vector3<f64>>) -> Vec<f64> {
        let shares = match place {
            Place::Rests => &self.rests,
            Place::Move(k) => &self.moves[k],
        };
        let mut all = Vec::with_capacity(3 * shares.nrows() * shares.ncols());
        for (m, numbers) in (0..shares.ncols()).zip(numbers) {
            for number in &numbers {
                all.extend(shares.col_as_slice(m).iter().map(|share| share * number));
            }
        }
        all
    }
}

/// Covariances of the parameter's deviation at the moment `a` with its deviations at the moments `others`. The
/// correlation length of the temperature kernel is a quarter of `temperatures_k`, the range of the temperatures, K.
fn covariances(kernel: Kernel, temperatures_k: f64, a: &Moment, others: &[Moment], to: &mut [f64]) {
    let side = |m: &Moment| m.up.cross(&m.ahead);
    let tilt = |b: &Moment| (a.up - b.up).norm_squared();
    match kernel {
        // The random-walk kernel represents all variations in time here. If a random walk explains the residuals,
        // `ForwardSearch::course` determines which variation in time fits best.
        Kernel::RandomWalk | Kernel::Time | Kernel::Switching | Kernel::White => {
            each(to, others, |b| if a.recording == b.recording { a.time_s.min(b.time_s) } else { 0.0 });
        }
        Kernel::Session => each(to, others, |b| if a.recording == b.recording { 1.0 } else { 0.0 }),
        Kernel::LastMotion => each(to, others, |b| a.signs.dot(&b.signs)),
        Kernel::Heading => {
            let own = side(a);
            each(to, others, |b| a.ahead.dot(&b.ahead) + own.dot(&side(b)));
        }
        Kernel::Attitude => near(to, others, LENGTH, |b| tilt(b) + (a.ahead - b.ahead).norm_squared()),
        Kernel::GravityDirection | Kernel::Rate | Kernel::Force => near(to, others, LENGTH, tilt),
        Kernel::Temperature => {
            let difference = |b: &Moment| a.temperature_degc.zip(b.temperature_degc).map_or(0.0, |(a, b)| a - b);
            let length = if temperatures_k > 0.0 { temperatures_k / 4.0 } else { f64::INFINITY };
            near(to, others, length, |b| difference(b).powi(2));
        }
    }
}

fn each(to: &mut [f64], others: &[Moment], of: impl Fn(&Moment) -> f64) {
    to.iter_mut().zip(others).for_each(|(to, other)| *to = of(other));
}

/// Gaussian kernel: `square` is the squared distance to another moment, and `length` is the correlation length.
fn near(to: &mut [f64], others: &[Moment], length: f64, square: impl Fn(&Moment) -> f64) {
    each(to, others, |other| square(other) / (length * length));
    gaussian_kernels(to);
}
