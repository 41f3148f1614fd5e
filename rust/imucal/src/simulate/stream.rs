//! Random numbers. Each purpose has its own ChaCha stream, and all streams use the seed of the run.
//!
//! A random value therefore depends only on the seed and its purpose. It does not depend on other random values, on the
//! order in which they are drawn, or on the thread.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// The two triads of a unit.
#[derive(Clone, Copy, Debug)]
pub(super) enum Triad {
    Accelerometer,
    Gyroscope,
}

/// Purpose of a random stream. The stream numbers determine every simulated recording, so they must not be changed.
#[derive(Clone, Copy, Debug)]
pub(super) enum Stream {
    /// Turns of a random program.
    Program,
    /// Poses and tremor of a hand-held run.
    Tumble,
    /// White noise of one axis.
    White(Triad, u8),
    /// Flicker noise of one axis.
    Flicker(Triad, u8),
    /// Random walk of one axis.
    Walk(Triad, u8),
    /// Noise of the encoder of one motor.
    Encoder(u8),
    /// Jitter of the sampling instants.
    Jitter,
    /// Selection of lost samples.
    Missing,
    /// Selection of repeated samples.
    Duplicated,
    /// Tremor of a stand.
    Tremor,
}

impl Stream {
    pub(super) fn generator(self, seed: u64) -> ChaCha8Rng {
        let channel = |triad: Triad, axis: u8| 3 * triad as u64 + u64::from(axis);
        let number = match self {
            Self::Program => 0,
            Self::Tumble => 64,
            Self::White(triad, axis) => 1 + channel(triad, axis),
            Self::Flicker(triad, axis) => 7 + channel(triad, axis),
            Self::Walk(triad, axis) => 13 + channel(triad, axis),
            Self::Encoder(motor) => 19 + u64::from(motor),
            Self::Jitter => 22,
            Self::Missing => 23,
            Self::Duplicated => 24,
            Self::Tremor => 25,
        };
        let mut generator = ChaCha8Rng::seed_from_u64(seed);
        generator.set_stream(number);
        generator
    }
}
