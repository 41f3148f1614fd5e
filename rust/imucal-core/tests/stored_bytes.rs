//! Tests that no bytes make [`imucal_core::stored::StoredCalibration::from_bytes`] panic. The random bytes have a fixed
//! seed. `make fuzz` runs the same function with cargo-fuzz.

#[path = "arbitrary/stored.rs"]
mod stored;

/// Pseudorandom 64-bit numbers (xorshift).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    fn below(&mut self, end: usize) -> usize {
        (self.next() % end as u64) as usize
    }
}

/// The bytes of a valid calibration without the check sum. Its matrices are identities, and it contains the same
/// temperature effect `effects` times.
fn valid(effects: u8) -> Vec<u8> {
    let mut all = Vec::from(*b"IMUC\x01\x07\0\0\0\0\x01\x02\x03\0\0\0");
    all[8] = effects;
    let identity = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0];
    for value in [0.0, 50.0, 25.0_f32].into_iter().chain(identity).chain(identity) {
        all.extend(value.to_le_bytes());
    }
    for _ in 0..effects {
        all.extend([12, 3, 0, 0]);
        [1.0, 1e-3, 2e-3, 3e-3_f32].iter().for_each(|value| all.extend(value.to_le_bytes()));
    }
    all
}

#[test]
fn arbitrary_bytes_are_read_or_refused() {
    // A longer run: IMUCAL_FUZZ_SECONDS=3600 cargo test -p imucal-core --test stored_bytes -- --nocapture
    let seconds = std::env::var("IMUCAL_FUZZ_SECONDS").ok().and_then(|text| text.parse().ok()).unwrap_or(0);
    let start = std::time::Instant::now();
    let mut random = Random(0x9E37_79B9_7F4A_7C15);
    let (mut runs, mut read) = (0_u64, 0_u64);
    assert!(stored::load(&valid(0)) && stored::load(&valid(12)) && !stored::load(&valid(13)));
    while runs < 20_000 || start.elapsed().as_secs() < seconds {
        let mut bytes = if random.below(8) == 0 {
            (0..random.below(300)).map(|_| random.next() as u8).collect()
        } else {
            valid(random.below(14) as u8)
        };
        for _ in 0..random.below(6) {
            if bytes.is_empty() {
                break;
            }
            let place = random.below(bytes.len());
            match random.below(5) {
                0 => bytes.truncate(place),
                1 => bytes.insert(place, random.next() as u8),
                2 => bytes[place] = [0, 1, 0x7F, 0x80, 0xFF][random.below(5)],
                3 => bytes[place] ^= 1 << random.below(8),
                _ => bytes[place] = random.next() as u8,
            }
        }
        runs += 1;
        read += u64::from(stored::load(&bytes));
    }
    println!("{runs} inputs, {read} of them calibrations, no panic");
    assert!(read > runs / 20 && read < runs);
}
