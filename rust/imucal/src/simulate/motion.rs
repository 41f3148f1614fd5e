//! How the unit moves, as an exact function of time.
//!
//! ```text
//! R_wb(t),   w = vee(R_wb^T dR_wb/dt),   dw/dt,   x''(t)
//! ```
//!
//! Each is a closed form, so that the rate is the derivative of the attitude to rounding, and nothing depends on a sample rate.

use imucal_core::effects::StandState;
use nalgebra::{UnitQuaternion, Vector3};

use super::program::Program;
use super::stand::Stand;
use super::tumble::Tumble;
use crate::error::Error;

/// A motion of the unit.
#[derive(Clone, Debug, PartialEq)]
pub enum Motion {
    /// On a stand that runs a program.
    Stand {
        /// What the motors do.
        program: Program,
        /// What is wrong with the stand.
        stand: Stand,
    },
    /// By hand.
    Tumble(Tumble),
    /// Not at all.
    Static {
        /// The attitude, `v_w = r_wb * v_b`.
        rotation_world_from_body: UnitQuaternion<f64>,
        /// How long, s.
        duration_s: f64,
    },
}

/// What the unit undergoes at an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// Attitude: takes a vector from the body to the world, `v_w = r_wb * v_b`.
    pub rotation_world_from_body: UnitQuaternion<f64>,
    /// Angular rate of the body against the world, in the body frame, rad/s.
    pub angular_rate: Vector3<f64>,
    /// Its derivative in the body frame, rad/s^2.
    pub angular_acceleration: Vector3<f64>,
    /// Acceleration of the unit against the world, in the world frame, m/s^2.
    pub acceleration: Vector3<f64>,
    /// Motors of the stand, if there is one.
    pub stand: Option<StandState<f64>>,
}

impl Motion {
    /// How long it takes, s.
    pub fn duration_s(&self) -> f64 {
        match self {
            Self::Stand { program, .. } => program.duration_s(),
            Self::Tumble(tumble) => tumble.duration_s(),
            Self::Static { duration_s, .. } => *duration_s,
        }
    }

    /// Start and end of each rest, s. A trembling hand does not rest: these are the poses that it holds.
    pub fn rests(&self) -> Vec<(f64, f64)> {
        match self {
            Self::Stand { program, .. } => program.rests(),
            Self::Tumble(tumble) => tumble.rests(),
            Self::Static { duration_s, .. } => vec![(0.0, *duration_s)],
        }
    }

    /// The moment at a time; before the start and after the end it is that of the start and the end.
    pub fn at(&self, time_s: f64) -> Moment {
        match self {
            Self::Stand { program, stand } => stand.moment(&program.phase(time_s)),
            Self::Tumble(tumble) => tumble.moment(time_s),
            Self::Static { rotation_world_from_body, .. } => Moment {
                rotation_world_from_body: *rotation_world_from_body,
                angular_rate: Vector3::zeros(),
                angular_acceleration: Vector3::zeros(),
                acceleration: Vector3::zeros(),
                stand: None,
            },
        }
    }

    /// Until when [`at`](Self::at) gives the very same moment, that instant included: who asks for one instant after the other
    /// need not ask again. `None` while something moves.
    pub fn still_until(&self, time_s: f64) -> Option<f64> {
        match self {
            Self::Stand { program, .. } => program.still_until(time_s),
            Self::Tumble(tumble) => tumble.still_until(time_s),
            Self::Static { .. } => Some(f64::INFINITY),
        }
    }

    /// Refuses what cannot be simulated.
    pub(super) fn check(&self) -> Result<(), Error> {
        match self {
            Self::Stand { stand, .. } => stand.check(),
            Self::Tumble(_) => Ok(()),
            Self::Static { duration_s, .. } if *duration_s > 0.0 && duration_s.is_finite() => Ok(()),
            Self::Static { duration_s, .. } => {
                Err(Error::Input(format!("the unit rests for {duration_s} s: a positive time is needed")))
            }
        }
    }
}
