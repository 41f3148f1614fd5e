//! Seeded rounds of the targets of cargo-fuzz (`fuzz/`), which `make fuzz` continues with other bytes.

#[path = "arbitrary/recordings.rs"]
mod recordings;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Number of cases; a case of a calibration takes some milliseconds.
const CASES: u64 = 150;

/// Inputs that have caused a panic: the first samples of a run have time stamps near zero.
const FOUND: [&[u8]; 1] = [b"[\x02\0\0\0\xd3\0\0\x0010\0\0\0\x0f"];

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

#[test]
fn inputs_that_caused_a_panic_are_accepted() {
    for bytes in FOUND {
        recordings::check(bytes);
        recordings::inspect(bytes);
        recordings::calibrate(bytes);
    }
}
