use super::*;
use std::vec::Vec;

/// Builds the binary form of a calibration with a g-sensitivity and a temperature effect, for raw data in counts and
/// the axes y, -x, z.
fn bytes() -> Vec<u8> {
    let mut all = Vec::from(*b"IMUC\x01\x07\x00\x00\x02\x00\x02\xFF\x03\x00\x00\x00");
    let floats = |all: &mut Vec<u8>, values: &[f32]| values.iter().for_each(|v| all.extend(v.to_le_bytes()));
    floats(&mut all, &[-10.0, 60.0, 25.0]);
    floats(&mut all, &[1e-3, 1e-5, 0.0, 0.0, 1e-3, 0.0, 0.0, 0.0, 1e-3, 20.0, -30.0, 4.0]);
    floats(&mut all, &[5e-3, 0.0, 0.0, 1e-5, 5e-3, 0.0, 0.0, 0.0, 5e-3, 100.0, 7.0, -9.0]);
    all.extend([1, 9, 0, 0]);
    floats(&mut all, &[1.0, 1e-3, 0.0, 0.0, 0.0, 1e-3, 0.0, 0.0, 0.0, 1e-3]);
    all.extend([12, 3, 0, 0]);
    floats(&mut all, &[1.0, 1e-3, 2e-3, 3e-3]);
    sealed(all)
}

/// Completes the binary form: sets its length and appends the check sum.
fn sealed(mut all: Vec<u8>) -> Vec<u8> {
    let length = (all.len() + 4) as u16;
    all[6..8].copy_from_slice(&length.to_le_bytes());
    let crc = crc32(&all);
    all.extend(crc.to_le_bytes());
    all
}

fn read(bytes: &[u8]) -> Result<StoredCalibration<f64>, StoredError> {
    StoredCalibration::from_bytes(bytes)
}

fn at(degc: f64) -> Surroundings<f64> {
    Surroundings { temperature_difference_k: Some(degc - 25.0), ..Surroundings::unknown() }
}

#[test]
fn the_crc_is_that_of_zlib() {
    assert_eq!(crc32(b"123456789"), 0xCBF4_3926);
}

#[test]
fn a_stored_calibration_corrects_along_its_axes() {
    let unit = read(&bytes()).unwrap();
    let (rate, force) = unit.correct_counts([1020, -30, 4], [100, 7, 1991], &at(25.0)).unwrap();
    // The expected rate is the body rate (1, 0, 0) minus 1e-3 times the body force (0, 0, 10), along the axes y, -x, z.
    assert!((rate - Vector3::new(0.0, -1.0, -0.01)).norm() < 1e-6, "{rate:?}");
    assert!((force - Vector3::new(0.0, 0.0, 10.0)).norm() < 1e-6, "{force:?}");
}

#[test]
fn the_temperature_is_limited_to_that_of_the_recordings() {
    let unit = read(&bytes()).unwrap();
    let rate = |degc| unit.correct(Vector3::zeros(), Vector3::zeros(), &at(degc)).0;
    assert_eq!((rate(60.0), rate(-10.0)), (rate(90.0), rate(-40.0)));
    assert!(rate(60.0) != rate(59.0) && rate(-10.0) != rate(-9.0));
}

#[test]
fn counts_are_refused_by_a_calibration_of_si_units() {
    let mut all = bytes();
    all.truncate(all.len() - 4);
    all[5] = 4;
    let unit = read(&sealed(all)).unwrap();
    assert!(unit.correct_counts([0; 3], [0; 3], &at(25.0)).is_none());
}

#[test]
fn every_damaged_byte_and_every_shorter_length_is_refused() {
    let good = bytes();
    for place in 0..good.len() {
        for change in [1, 0x80, 0xFF] {
            let mut bad = good.clone();
            bad[place] ^= change;
            assert!(read(&bad).is_err(), "byte {place}");
        }
        assert!(read(&good[..place]).is_err());
    }
    let mut page = good.clone();
    page.extend([0xFF; 100]);
    assert_eq!(read(&page), read(&good));
    assert_eq!(read(&[0xFF; 256]), Err(StoredError::Magic));
}

#[test]
fn content_that_is_no_calibration_is_refused() {
    let changed = |place: usize, with: &[u8]| {
        let mut all = bytes();
        all.truncate(all.len() - 4);
        all[place..place + with.len()].copy_from_slice(with);
        read(&sealed(all))
    };
    assert_eq!(changed(4, &[2]), Err(StoredError::Version { given: 2 }));
    assert_eq!(changed(124, &[99]), Err(StoredError::Effect { number: 99 }));
    let nan = f32::NAN.to_le_bytes();
    for (place, with) in [
        (8, &[1u8][..]),
        (8, &[3]),
        (10, &[1, 1, 3]),
        (10, &[0, 1, 2]),
        (10, &[4, 1, 2]),
        (125, &[8]),
        (125, &[200]),
        (16, &nan),
        (24, &nan),
        (28, &nan),
        (132, &nan),
        (28, &[0; 12]),
    ] {
        assert!(matches!(changed(place, with), Err(StoredError::Content | StoredError::Length)), "byte {place}");
    }
}

#[test]
fn numbers_of_effects_are_unique_and_lead_to_their_rows() {
    for effect in Effect::<f64>::catalogue().filter(|effect| effect.number != 0 && effect.name != "earth_rate") {
        assert_eq!(Effect::<f64>::numbered(effect.number), Some(effect));
    }
    let unnumbered = (0..=255).filter_map(Effect::<f64>::numbered).count();
    assert_eq!(unnumbered, Effect::<f64>::catalogue().filter(|effect| !effect.name.starts_with("en")).count() - 1);
}
