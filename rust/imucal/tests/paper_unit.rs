//! The unit of the paper is defined twice: in Rust and in a data file of the Python package. Both definitions must
//! agree.

#![allow(clippy::unwrap_used, reason = "a test")]

use std::f64::consts::FRAC_1_SQRT_2;

use imucal::simulate::{Sensor, Unit};
use imucal_core::STANDARD_GRAVITY_MPS2;

/// Numbers of the field `"name": {"value": NUMBERS, "unit": ...}` of one sensor in the data file.
fn figure(file: &str, sensor: &str, name: &str) -> Vec<f64> {
    let of_sensor = &file[file.find(&format!("\"{sensor}\": {{\n")).unwrap()..];
    let of_name = &of_sensor[of_sensor.find(&format!("\"{name}\": {{\"value\": ")).unwrap()..];
    let numbers = &of_name[of_name.find(": {\"value\": ").unwrap() + 12..of_name.find(", \"unit\"").unwrap()];
    numbers.split([',', '[', ']', ' ']).filter(|number| !number.is_empty()).map(|n| n.parse().unwrap()).collect()
}

fn assert_same(file: &str, name: &str, sensor: &Sensor, (bias, noise, lsb): (f64, f64, f64)) {
    let near = |found: f64, wanted: f64| assert!((found - wanted).abs() <= 1e-15 * wanted.abs(), "{found}, {wanted}");
    // Matrices are row-major in the file and column-major in memory.
    for (found, wanted) in figure(file, name, "sensitivity").iter().zip(sensor.sensitivity.transpose().iter()) {
        near(*found, *wanted);
    }
    for (found, wanted) in figure(file, name, "bias").iter().zip(sensor.bias.iter()) {
        near(found * bias, *wanted);
    }
    near(figure(file, name, "noise_density_one_sided")[0] * noise * FRAC_1_SQRT_2, sensor.noise_density);
    let converter = sensor.converter.unwrap();
    near(lsb, converter.lsb);
    assert_eq!(figure(file, name, "bits"), [f64::from(converter.bits)]);
}

#[test]
fn the_papers_unit_is_that_of_the_data_file() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../python/imucal/rig/shipped/paper.json");
    let file = std::fs::read_to_string(path).unwrap();
    let unit = Unit::paper();
    let g = STANDARD_GRAVITY_MPS2;
    let deg = 1_f64.to_radians();
    let counts_per_g = figure(&file, "accelerometer", "resolution")[0];
    assert_same(&file, "accelerometer", &unit.accelerometer, (g, 1e-6 * g, g / counts_per_g));
    let lsb_deg = figure(&file, "gyroscope", "resolution")[0];
    assert_same(&file, "gyroscope", &unit.gyroscope, (1.0, deg, lsb_deg * deg));
    for sensor in [unit.accelerometer, unit.gyroscope] {
        assert_eq!(sensor.noise_in_motion, 1.0);
        assert_eq!(sensor.bias_instability, 0.0);
        assert!(sensor.low_pass.is_none() && !sensor.averaging);
    }
    assert!(unit.effects.is_empty());
}
