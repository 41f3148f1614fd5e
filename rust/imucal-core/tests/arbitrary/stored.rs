//! Reads arbitrary bytes as a calibration. The test `stored_bytes` and the cargo-fuzz target both call the function
//! `load`.

use imucal_core::{effects::Surroundings, stored::StoredCalibration};
use nalgebra::Vector3;

/// Reads the bytes twice: unchanged, and with a valid start, length and check sum, which random bytes almost never
/// have. If the changed bytes are a valid calibration, samples are corrected with it. Returns whether the changed bytes
/// are a valid calibration.
pub(crate) fn load(bytes: &[u8]) -> bool {
    let _ = StoredCalibration::<f32>::from_bytes(bytes);
    let mut sealed = bytes.to_vec();
    sealed.resize(bytes.len().clamp(8, 4000), 0);
    sealed[..5].copy_from_slice(b"IMUC\x01");
    let length = (sealed.len() + 4) as u16;
    sealed[6..8].copy_from_slice(&length.to_le_bytes());
    let crc = sealed.iter().fold(u32::MAX, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| if crc & 1 == 0 { crc >> 1 } else { (crc >> 1) ^ 0xEDB8_8320 })
    });
    sealed.extend((!crc).to_le_bytes());
    let Ok(unit) = StoredCalibration::<f32>::from_bytes(&sealed) else {
        return false;
    };
    let surroundings = Surroundings {
        temperature_difference_k: Some(1e9),
        time_s: Some(-1e9),
        angular_acceleration: Some(Vector3::repeat(1e9)),
        ..Surroundings::unknown()
    };
    unit.correct(Vector3::repeat(1e6), Vector3::repeat(f32::NAN), &surroundings);
    let _ = unit.correct_counts([i16::MIN; 3], [i16::MAX; 3], &surroundings);
    StoredCalibration::<f64>::from_bytes(&sealed).is_ok()
}
