#![no_main]

#[path = "../../rust/imucal-core/tests/arbitrary/stored.rs"]
mod stored;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    stored::load(bytes);
});
