//! The module of one unit, which `imucal export --to rust` wrote, behind a C interface.
#![no_std]

use imucal_core::{calibration::Calibration, effects::Surroundings};
use nalgebra::Vector3;

mod unit {
    include!(env!("IMUCAL_EXPORT"));
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    loop {}
}

static mut UNIT: Option<Calibration<f32>> = None;

/// Prepares the calibration; 0 if it can be used.
#[unsafe(no_mangle)]
pub extern "C" fn rust_start() -> i32 {
    // SAFETY: the program has one thread, and no reference to UNIT exists.
    unsafe { UNIT = unit::calibration().ok() };
    0
}

/// Corrects one sample in place, at 40 degC.
#[unsafe(no_mangle)]
pub extern "C" fn rust_correct(rate: &mut [f32; 3], force: &mut [f32; 3]) {
    // SAFETY: the program has one thread, and `rust_start` has returned.
    let Some(unit) = (unsafe { &*(&raw const UNIT) }) else { return };
    let at = Surroundings { temperature_difference_k: Some(15.0), ..Surroundings::unknown() };
    let raw = |v: &[f32; 3]| Vector3::new(v[0], v[1], v[2]);
    let (r, f) = unit.correct_at(raw(rate), raw(force), &at);
    (*rate, *force) = ([r.x, r.y, r.z], [f.x, f.y, f.z]);
}
