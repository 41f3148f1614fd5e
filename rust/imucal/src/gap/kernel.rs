//! How deviations at two moments are correlated.

/// Covariance of the deviations at two moments.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kernel {
    /// A random walk in time.
    RandomWalk,
    /// Equal at equal directions of gravity in the body.
    GravityDirection,
    /// Equal at equal attitudes, heading included.
    Attitude,
    /// Equal at equal temperatures.
    Temperature,
    /// Equal after equal rotations.
    LastMotion,
    /// Proportional to horizontal directions of the world in the body frame.
    Heading,
    /// Equal at equal angular rates and angular accelerations.
    Rate,
    /// Equal at equal specific forces.
    Force,
}

impl Kernel {
    /// The name in results.
    pub fn name(self) -> &'static str {
        match self {
            Self::RandomWalk => "random_walk",
            Self::GravityDirection => "gravity_direction",
            Self::Attitude | Self::Heading => "attitude",
            Self::Temperature => "temperature",
            Self::LastMotion => "last_motion",
            Self::Rate => "rate",
            Self::Force => "force",
        }
    }
}
