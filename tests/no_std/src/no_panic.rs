//! Functions that must not contain a panic. The test links them alone, with a panic handler that calls a function that
//! does not exist: if any of them can panic, the linker reports this function as undefined.

use imucal_core::{
    calibration::Calibration,
    effects::{EffectValues, Surroundings},
    integrate::Integrator,
    rest::{Rest, RestDetector},
    stored::{StoredCalibration, StoredError},
    temperature_memory::TemperatureMemory,
};
use nalgebra::Vector3;

#[cfg(feature = "undefined_panic")]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    unsafe extern "C" {
        fn imucal_panic_is_reachable() -> !;
    }
    unsafe { imucal_panic_is_reachable() }
}

/// The same functions for both floats.
macro_rules! no_panic {
    ($float:ty, $correct:ident, $correct_at:ident, $push_effect:ident, $integrate:ident, $detect:ident, $finish:ident, $load:ident, $remember:ident) => {
        #[unsafe(no_mangle)]
        pub fn $correct(unit: &Calibration<$float>, rate: &mut Vector3<$float>, force: &mut Vector3<$float>) {
            (*rate, *force) = unit.correct(*rate, *force);
        }

        #[unsafe(no_mangle)]
        pub fn $correct_at(
            unit: &Calibration<$float>,
            rate: &mut Vector3<$float>,
            force: &mut Vector3<$float>,
            surroundings: &Surroundings<$float>,
        ) {
            (*rate, *force) = unit.correct_at(*rate, *force, surroundings);
        }

        #[unsafe(no_mangle)]
        pub fn $push_effect(unit: &mut Calibration<$float>, values: &EffectValues<$float>) -> bool {
            unit.effects.push(*values).is_ok()
        }

        #[unsafe(no_mangle)]
        pub fn $integrate(integrator: &mut Integrator<$float>, dt_s: $float, rate: &Vector3<$float>) {
            integrator.push(dt_s, *rate);
        }

        #[unsafe(no_mangle)]
        pub fn $detect(
            detector: &mut RestDetector<$float>,
            rate: &Vector3<$float>,
            force: &Vector3<$float>,
            rest: &mut Option<Rest<$float>>,
        ) {
            *rest = detector.push(*rate, *force);
        }

        #[unsafe(no_mangle)]
        pub fn $finish(detector: &mut RestDetector<$float>, rest: &mut Option<Rest<$float>>) {
            *rest = detector.finish();
        }

        #[unsafe(no_mangle)]
        pub fn $load(bytes: &[u8], unit: &mut Result<StoredCalibration<$float>, StoredError>) {
            *unit = StoredCalibration::from_bytes(bytes);
        }

        #[unsafe(no_mangle)]
        pub fn $remember(memory: &mut TemperatureMemory<$float>, dt_s: $float, temperature_k: $float) {
            memory.update(dt_s, temperature_k);
        }
    };
}

no_panic!(
    f32,
    no_panic_correct_f32,
    no_panic_correct_at_f32,
    no_panic_push_effect_f32,
    no_panic_integrate_f32,
    no_panic_detect_f32,
    no_panic_finish_f32,
    no_panic_load_f32,
    no_panic_remember_f32
);
no_panic!(
    f64,
    no_panic_correct_f64,
    no_panic_correct_at_f64,
    no_panic_push_effect_f64,
    no_panic_integrate_f64,
    no_panic_detect_f64,
    no_panic_finish_f64,
    no_panic_load_f64,
    no_panic_remember_f64
);
