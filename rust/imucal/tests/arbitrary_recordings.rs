//! Seeded rounds of the targets of cargo-fuzz (`fuzz/`), which `make fuzz` continues with other bytes.

#[path = "arbitrary/recordings.rs"]
mod recordings;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Number of cases; a case of a calibration takes some milliseconds.
const CASES: u64 = 150;

fn arbitrary_bytes(seed: u64) -> Vec<u8> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    // From a single change to a recording of arbitrary numbers.
    let mut bytes = vec![0; [15, 29, 57, 900][seed as usize % 4]];
    random.fill_bytes(&mut bytes);
    bytes
}

#[test]
fn checks_accept_any_numbers() {
    (0..4 * CASES).for_each(|seed| recordings::check(&arbitrary_bytes(seed)));
    recordings::check(&[]);
}

#[test]
fn rests_are_sought_in_any_numbers() {
    (0..4 * CASES).for_each(|seed| recordings::inspect(&arbitrary_bytes(seed)));
}

#[test]
fn a_calibration_of_any_numbers_ends() {
    (0..CASES).for_each(|seed| recordings::calibrate(&arbitrary_bytes(seed)));
}
