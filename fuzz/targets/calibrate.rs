#![no_main]

#[path = "../../rust/imucal/tests/arbitrary/recordings.rs"]
mod recordings;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| recordings::calibrate(bytes));
