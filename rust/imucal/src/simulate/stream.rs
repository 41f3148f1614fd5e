//! Random numbers: one ChaCha stream of the run's seed per purpose.
//!
//! So a value depends on the seed and on what it is for, never on what else is drawn, in which order or on which thread.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// One of the two sensors of a unit.
#[derive(Clone, Copy, Debug)]
pub(super) enum Triad {
    Accelerometer,
    Gyroscope,
}

/// What random numbers are for. The stream numbers are part of every simulated record: keep them.
#[derive(Clone, Copy, Debug)]
pub(super) enum Stream {
    /// Turns of a random program.
    Program,
    /// Poses and tremor of a run by hand.
    Tumble,
    /// White noise of one axis.
    White(Triad, u8),
    /// Flicker noise of one axis.
    Flicker(Triad, u8),
    /// Random walk of one axis.
    Walk(Triad, u8),
    /// Noise of the encoder of one motor.
    Encoder(u8),
    /// Sampling instants.
    Jitter,
    /// Which samples are lost.
    Missing,
    /// Which samples are written twice.
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
