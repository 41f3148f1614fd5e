//! Random numbers: one ChaCha stream of the run's seed per purpose.
//!
//! So a value depends on the seed and on what it is for, never on what else is drawn, in which order or on which thread.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// What random numbers are for. The stream numbers are part of every simulated record: keep them.
#[derive(Clone, Copy, Debug)]
pub(super) enum Stream {
    /// Turns of a random program.
    Program,
    /// Poses and tremor of a run by hand.
    Tumble,
    /// White noise of one accelerometer axis.
    AccelerometerNoise(u8),
    /// White noise of one gyroscope axis.
    GyroscopeNoise(u8),
}

impl Stream {
    pub(super) fn generator(self, seed: u64) -> ChaCha8Rng {
        let number = match self {
            Self::Program => 0,
            Self::Tumble => 64,
            Self::AccelerometerNoise(axis) => 1 + u64::from(axis),
            Self::GyroscopeNoise(axis) => 4 + u64::from(axis),
        };
        let mut generator = ChaCha8Rng::seed_from_u64(seed);
        generator.set_stream(number);
        generator
    }
}
