//! Calibrates a recording with the crate imu-calib and prints the result.
//!
//! Standard input: rows of seven f64 in the byte order of the processor: time, s; specific force, m/s^2; angular rate,
//! rad/s. Arguments: local gravity, m/s^2; the length of the rest at the start from which the thresholds for rests
//! follow, s; and the number of repetitions. Output: one line of numbers per result: the 3x3 matrices `M_a` and
//! `M_g C_gyro_i` by rows, both biases, and the time of the calibration, s.

use std::io::Read;
use std::time::Instant;

use imu_calib::estimate::{RecordingConfig, Sample, calibrate_recording};

/// Repetitions, of which the median time is reported, unless the third argument gives their number.
const ROUNDS: usize = 9;

fn main() -> anyhow::Result<()> {
    let gravity: f64 = std::env::args().nth(1).unwrap_or_default().parse()?;
    let mut bytes = Vec::new();
    std::io::stdin().read_to_end(&mut bytes)?;
    let numbers: Vec<f64> = bytes.chunks_exact(8).map(|b| f64::from_ne_bytes(std::array::from_fn(|k| b[k]))).collect();
    let samples: Vec<Sample> =
        numbers.chunks_exact(7).map(|row| (row[0], [row[1], row[2], row[3]], [row[4], row[5], row[6]])).collect();
    let mut config = RecordingConfig { gravity, ..RecordingConfig::default() };
    if let Some(seconds) = std::env::args().nth(2) {
        config.init_seconds = seconds.parse()?;
    }
    let rounds: usize = std::env::args().nth(3).map_or(Ok(ROUNDS), |text| text.parse())?;
    let start = Instant::now();
    let mut found = calibrate_recording(&samples, &config)?;
    let mut seconds = vec![start.elapsed().as_secs_f64()];
    for _ in 1..rounds {
        let start = Instant::now();
        found = calibrate_recording(&samples, &config)?;
        seconds.push(start.elapsed().as_secs_f64());
    }
    seconds.sort_by(f64::total_cmp);
    if let Some(reason) = &found.report.gyro_error {
        anyhow::bail!("the gyroscope was not calibrated: {reason}");
    }
    let of = &found.intrinsics;
    let entry = |i: usize, j: usize| (0..3).map(|k| of.gyro_m[i][k] * of.c_gyro_i[k][j]).sum::<f64>();
    let gyroscope = (0..9).map(|n| entry(n / 3, n % 3));
    let numbers = of.accel_m.iter().flatten().copied().chain(gyroscope).chain(of.accel_bias).chain(of.gyro_bias);
    let words: Vec<String> = numbers.chain([seconds[seconds.len() / 2]]).map(|number| format!("{number:e}")).collect();
    println!("{}", words.join(" "));
    Ok(())
}
