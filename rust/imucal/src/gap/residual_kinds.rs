//! Kinds of residuals, the quantities on which residuals may depend, and the calibration from which residuals are
//! computed.

use crate::calibrate::Outcome;
use crate::recording::Recording;

/// A calibration, and the recordings from which it was estimated, corrected by this calibration.
#[derive(Clone, Copy)]
pub struct CorrectedFit<'a> {
    /// The calibration, in the symmetric body frame. In this frame, the accelerometer's sensitivity matrix is
    /// symmetric.
    pub outcome: &'a Outcome,
    /// The corrected recordings, in SI units and in the body frame. Their order is the order in which the calibration
    /// used them.
    pub corrected: &'a [Recording<'a>],
    /// Local gravity with which the calibration was estimated, m/s^2.
    pub gravity_mps2: f64,
}

/// Kind of a residual.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResidualKind {
    /// Norm of the specific force at a rest minus local gravity, m/s^2.
    RestNorm,
    /// Mean angular rate at a rest, rad/s. The expected value is zero.
    RestRate,
    /// Angle, rad, between the measured and the predicted direction of gravity after a move. The prediction rotates the
    /// direction of gravity before the move by the integrated angular rate.
    MoveDirection,
    /// Specific force inside a move minus gravity at the predicted attitude, m/s^2.
    MoveForce,
}

impl ResidualKind {
    /// Name in JSON documents.
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

/// A quantity on which residuals may depend. For direction residuals after moves, the rate error inside the move is
/// assumed to be proportional to the quantity, and the regressor is the resulting attitude error at the end of the
/// move.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Regressor {
    /// Angular acceleration, three components.
    AngularAcceleration,
    /// Direction of gravity in the body frame. For direction residuals after moves: components of the specific force
    /// inside the move.
    Gravity,
    /// Squares and products of the components of gravity.
    GravitySquared,
    /// Squares of the components of the angular rate. For residuals of the specific force inside moves, the regressor
    /// also contains the products of two components.
    RateSquared,
    /// Sign of each component of the rotation vector of the last move before a rest.
    SignOfTheLastTurn,
    /// Magnitude of the angular rate on each axis. Residuals depend on this magnitude if the gyroscope scale differs
    /// between positive and negative rates.
    SignOfTheRate,
    /// Temperature. At rests: mean over the rest, degC. Inside moves: difference from the mean of the recording, K.
    Temperature,
    /// Time from the start of the recording to the first sample of the rest, or of the 40 ms block inside a move, s.
    Time,
}

impl Regressor {
    /// Name in JSON documents.
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
