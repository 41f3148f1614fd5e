//! Proof that `imucal-core` needs neither std nor an allocator, and a C interface to test its numbers through.
//!
//! The panic handler below would be a second one if anything pulled std (E0152), and without a global allocator nothing
//! that pulls alloc builds. Arrays are row-major; a triad is its nine sensitivities, then its three biases.
#![no_std]

use core::slice::{from_raw_parts, from_raw_parts_mut};
use imucal_core::{
    calibration::Calibration,
    effects::{Effect, EffectValues},
    integrate::Integrator,
    rest::{RestDetector, RestDetectorConfig},
    sensor::{SensorError, Triad},
    so3,
};
use nalgebra::{Matrix3, RealField, Vector3, Vector6};

mod no_panic;

#[cfg(not(feature = "undefined_panic"))]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    loop {}
}

fn triad<F: RealField + Copy>(numbers: &[F; 12]) -> Result<Triad<F>, SensorError> {
    Triad::try_new(Matrix3::from_row_slice(&numbers[..9]), Vector3::from_column_slice(&numbers[9..]))
}

fn correct<F: RealField + Copy>(calibration: &Calibration<F>, rates: &mut [[F; 3]], forces: &mut [[F; 3]]) {
    for (rate, force) in rates.iter_mut().zip(forces) {
        let (true_rate, true_force) = calibration.correct((*rate).into(), (*force).into());
        (*rate, *force) = (true_rate.into(), true_force.into());
    }
}

/// The same C function for both floats: corrects `count` samples in place; 0, or -1 if a triad has no inverse.
macro_rules! export_correct {
    ($name:ident, $float:ty) => {
        /// # Safety
        /// The pointers are aligned and stand for as many numbers as said above.
        #[unsafe(no_mangle)]
        pub unsafe extern "C" fn $name(
            accelerometer: *const [$float; 12],
            gyroscope: *const [$float; 12],
            rates: *mut [$float; 3],
            forces: *mut [$float; 3],
            count: usize,
        ) -> i32 {
            let (Ok(accelerometer), Ok(gyroscope)) = (unsafe { (triad(&*accelerometer), triad(&*gyroscope)) }) else {
                return -1;
            };
            let (rates, forces) = unsafe { (from_raw_parts_mut(rates, count), from_raw_parts_mut(forces, count)) };
            correct(&Calibration::new(accelerometer, gyroscope), rates, forces);
            0
        }
    };
}

export_correct!(imucal_correct_f64, f64);
export_correct!(imucal_correct_f32, f32);

/// Corrects `count` samples in place for a g-sensitivity alone; 0, or -1 if the values are not its parameters.
///
/// # Safety
/// `values` stands for `value_count` numbers, `rates` and `forces` for `count` samples.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn imucal_correct_g_sensitivity(
    values: *const f64,
    value_count: usize,
    rates: *mut [f64; 3],
    forces: *mut [f64; 3],
    count: usize,
) -> i32 {
    let values = unsafe { from_raw_parts(values, value_count) };
    let mut calibration = Calibration::identity();
    let Ok(()) = EffectValues::try_new(Effect::GYRO_G_SENSITIVITY, values, None)
        .and_then(|values| calibration.effects.push(values))
    else {
        return -1;
    };
    let (rates, forces) = unsafe { (from_raw_parts_mut(rates, count), from_raw_parts_mut(forces, count)) };
    correct(&calibration, rates, forces);
    0
}

/// Integrates a move to the quaternion `[w, x, y, z]`.
///
/// # Safety
/// `time_s` and `rates` stand for `count` samples, `wxyz` for one quaternion.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn imucal_integrate(
    time_s: *const f64,
    rates: *const [f64; 3],
    count: usize,
    wxyz: *mut [f64; 4],
) {
    let (time_s, rates) = unsafe { (from_raw_parts(time_s, count), from_raw_parts(rates, count)) };
    let mut integrator = Integrator::new();
    let mut last_s = 0.0;
    for (&now_s, &rate) in time_s.iter().zip(rates) {
        integrator.push(now_s - last_s, rate.into());
        last_s = now_s;
    }
    unsafe { *wxyz = so3::to_wxyz(&integrator.rotation()) };
}

/// Finds rests: writes `[first_sample, end_sample]` of at most `capacity` rests and gives how many there are, or -1.
///
/// # Safety
/// `noise_variance` stands for six numbers, `rates` and `forces` for `count` samples, `rests` for `capacity` pairs.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn imucal_find_rests(
    noise_variance: *const [f64; 6],
    block_samples: usize,
    threshold: f64,
    rates: *const [f64; 3],
    forces: *const [f64; 3],
    count: usize,
    rests: *mut [usize; 2],
    capacity: usize,
) -> i32 {
    let noise_variance = Vector6::from(unsafe { *noise_variance });
    let config = RestDetectorConfig { block_samples, window_blocks: 10, noise_variance, threshold };
    let Ok(mut detector) = RestDetector::try_new(config) else {
        return -1;
    };
    let (rates, forces) = unsafe { (from_raw_parts(rates, count), from_raw_parts(forces, count)) };
    let rests = unsafe { from_raw_parts_mut(rests, capacity) };
    let mut found = 0;
    for sample in 0..=count {
        // One turn more than there are samples: the last rest ends with the stream.
        let over =
            if sample < count { detector.push(rates[sample].into(), forces[sample].into()) } else { detector.finish() };
        if let Some(rest) = over {
            if let Some(place) = rests.get_mut(found) {
                *place = [rest.first_sample, rest.end_sample];
            }
            found += 1;
        }
    }
    found as i32
}
