//! Kinds of residuals, the quantities that they may be correlated with, and the fit that they are computed from.

use crate::calibrate::Outcome;
use crate::recording::Recording;

/// A calibration with the recordings that it was made from, corrected by it.
#[derive(Clone, Copy)]
pub struct CorrectedFit<'a> {
    /// The calibration, in the symmetric frame.
    pub outcome: &'a Outcome,
    /// Its recordings after correction, SI units, body frame; in the order of the calibration.
    pub corrected: &'a [Recording<'a>],
    /// Local gravity of the calibration, m/s^2.
    pub gravity_mps2: f64,
}

/// Kind of a residual.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResidualKind {
    /// Length of the specific force at a rest less gravity, m/s^2.
    RestNorm,
    /// Mean angular rate at a rest, rad/s.
    RestRate,
    /// Direction of gravity after a move, predicted by the gyroscope, against the measured one, rad.
    MoveDirection,
    /// Specific force inside a move less gravity, m/s^2.
    MoveForce,
}

impl ResidualKind {
    /// The name in documents.
    pub fn name(self) -> &'static str {
        match self {
            Self::RestNorm => "rest_norm",
            Self::RestRate => "rest_rate",
            Self::MoveDirection => "move_direction",
            Self::MoveForce => "move_force",
        }
    }

    /// The SI unit of the residual.
    pub fn unit(self) -> &'static str {
        match self {
            Self::RestNorm | Self::MoveForce => "m/s^2",
            Self::RestRate => "rad/s",
            Self::MoveDirection => "rad",
        }
    }
}

/// A quantity that residuals may be correlated with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Regressor {
    /// Angular acceleration, three components.
    AngularAcceleration,
    /// Direction of gravity in the body frame; of moves, specific force on rate errors about each axis.
    Gravity,
    /// Squares and products of the components of gravity.
    GravitySquared,
    /// Squares of the angular rate; inside the moves with the products of its components.
    RateSquared,
    /// Sign of the rotation vector of the move before a rest.
    SignOfTheLastTurn,
    /// Sign of the angular rate.
    SignOfTheRate,
    /// Temperature.
    Temperature,
    /// Time in the recording.
    Time,
}

impl Regressor {
    /// The name in documents.
    pub fn name(self) -> &'static str {
        match self {
            Self::AngularAcceleration => "angular_acceleration",
            Self::Gravity => "gravity",
            Self::GravitySquared => "gravity_squared",
            Self::RateSquared => "rate_squared",
            Self::SignOfTheLastTurn => "sign_of_the_last_turn",
            Self::SignOfTheRate => "sign_of_the_rate",
            Self::Temperature => "temperature",
            Self::Time => "time",
        }
    }
}
