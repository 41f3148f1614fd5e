//! Covariance kernels of generic hypotheses. A generic hypothesis is a variation of a sensor parameter (bias or scale)
//! that no effect of the catalogue describes. The kernel is the covariance of this variation (docs/model.md (24)).

/// Covariance of a parameter's deviations at two times. It is computed from the values of a quantity, for example the
/// temperature, at the two times.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kernel {
    /// Deviations follow a random walk in time.
    RandomWalk,
    /// Deviations are a smooth function of the direction of gravity in the body frame.
    GravityDirection,
    /// Deviations are a smooth function of the attitude, including heading.
    Attitude,
    /// Deviations are a smooth function of temperature.
    Temperature,
    /// Deviations depend on the sign of the last rotation about each axis.
    LastMotion,
    /// Deviations are linear in the body-frame components of two fixed horizontal directions of the world frame. These
    /// components depend on heading.
    Heading,
    /// Deviations are a function of the angular rate and the angular acceleration.
    Rate,
    /// Deviations are a smooth function of the specific force.
    Force,
    /// Deviations are constant within each recording and differ between recordings.
    Session,
    /// Deviations are a smooth function of time.
    Time,
    /// Deviations switch between two levels.
    Switching,
    /// Deviations in different rests or moves are independent.
    White,
}

impl Kernel {
    /// Name of the kernel in JSON documents.
    pub fn name(self) -> &'static str {
        match self {
            Self::RandomWalk => "random_walk",
            Self::GravityDirection => "gravity_direction",
            Self::Attitude | Self::Heading => "attitude",
            Self::Temperature => "temperature",
            Self::LastMotion => "last_motion",
            Self::Rate => "rate",
            Self::Force => "force",
            Self::Session => "between_sessions",
            Self::Time => "time",
            Self::Switching => "switching",
            Self::White => "white",
        }
    }
}
