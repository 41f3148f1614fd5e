#![allow(clippy::expect_used)]

extern crate std;

use super::*;
use std::vec::Vec;

type Sample = (Vector3<f64>, Vector3<f64>);

const RATE_STD: f64 = 0.003;
const FORCE_STD: f64 = 0.02;
const REST_S: [f64; 5] = [2.0, 1.2, 5.0, 1.7, 3.1];
const MOVE_S: f64 = 1.5;

/// A linear congruential generator of random numbers. The sum of twelve uniform numbers is approximately Gaussian.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        let mut uniform = || {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 11) as f64 / (1u64 << 53) as f64
        };
        (0..12).map(|_| uniform()).sum::<f64>() - 6.0
    }

    fn vector(&mut self, std: f64) -> Vector3<f64> {
        Vector3::new(self.next(), self.next(), self.next()) * std
    }
}

/// Simulates samples of alternating moves and rests; the run starts and ends with a move. For each rest, the second
/// result contains the index of its first sample and the index of its last sample plus one.
fn stand_run(rate_hz: f64) -> (Vec<Sample>, Vec<(usize, usize)>) {
    let mut noise = Noise(7);
    let (mut samples, mut rests) = (Vec::new(), Vec::new());
    let mut up = Vector3::new(0.0, 0.6, 0.8) * 9.80665;
    let moving = |samples: &mut Vec<Sample>, noise: &mut Noise, up: &mut Vector3<f64>| {
        for _ in 0..(MOVE_S * rate_hz) as usize {
            let rate = Vector3::new(0.5, -1.0, 0.7);
            *up = nalgebra::UnitQuaternion::from_scaled_axis(-rate / rate_hz) * *up;
            // The motors vibrate the stand while they turn.
            samples.push((rate + noise.vector(0.2), *up + noise.vector(0.5)));
        }
    };
    for rest_s in REST_S {
        moving(&mut samples, &mut noise, &mut up);
        let first = samples.len();
        for _ in 0..(rest_s * rate_hz) as usize {
            samples.push((Vector3::repeat(0.01) + noise.vector(RATE_STD), up + noise.vector(FORCE_STD)));
        }
        rests.push((first, samples.len()));
    }
    moving(&mut samples, &mut noise, &mut up);
    (samples, rests)
}

fn detector(block_samples: usize) -> RestDetector<f64> {
    let (rate, force) = (RATE_STD * RATE_STD, FORCE_STD * FORCE_STD);
    let noise_variance = Vector6::new(rate, rate, rate, force, force, force);
    let config = RestDetectorConfig { block_samples, window_blocks: 10, noise_variance, threshold: 3.0 };
    RestDetector::try_new(config).expect("a usable configuration")
}

fn rests_in(samples: &[Sample], mut detector: RestDetector<f64>) -> Vec<Rest<f64>> {
    let mut rests: Vec<_> = samples.iter().filter_map(|&(rate, force)| detector.push(rate, force)).collect();
    rests.extend(detector.finish());
    rests
}

#[test]
fn rests_are_found_within_one_block_at_every_rate() {
    for rate_hz in [25.0, 100.0, 400.0, 1000.0, 8000.0] {
        let (samples, truth) = stand_run(rate_hz);
        let block = (0.05 * rate_hz) as usize;
        let rests = rests_in(&samples, detector(block));
        assert_eq!(rests.len(), truth.len(), "at {rate_hz} Hz: {rests:?}");
        for (rest, (first, end)) in rests.iter().zip(truth) {
            // The detector trims one block at each end of a rest. Without these two blocks, the detected rest is inside
            // the true rest. With them, it starts within one block of the true start and ends within one block of the
            // true end.
            assert!(rest.first_sample >= first && rest.first_sample - block < first + block, "{rate_hz} Hz: {rest:?}");
            assert!(rest.end_sample <= end && rest.end_sample + block + block > end, "{rate_hz} Hz: {rest:?}");
        }
    }
}

#[test]
fn means_are_those_of_two_passes_over_the_stretch() {
    let (samples, _) = stand_run(400.0);
    for rest in rests_in(&samples, detector(20)) {
        let inside = &samples[rest.first_sample..rest.end_sample];
        let rate = inside.iter().map(|s| s.0).sum::<Vector3<f64>>() / inside.len() as f64;
        let force = inside.iter().map(|s| s.1).sum::<Vector3<f64>>() / inside.len() as f64;
        assert!((rest.mean_rate - rate).norm() < 1e-15, "{rest:?}");
        assert!((rest.mean_force - force).norm() < 1e-13, "{rest:?}");
    }
}

#[test]
fn unsigned_counts_in_f32_give_the_same_rests() {
    // Unsigned readings of 16-bit converters, as firmware reads them. A rate or force of zero reads 32768 counts.
    let (rate_lsb, force_lsb) = (32.8 * 57.3, 16384.0 / 9.80665);
    let (samples, _) = stand_run(400.0);
    let counts = samples.iter().map(|(rate, force)| {
        let count = |x: &Vector3<f64>, lsb: f64| (x * lsb).map(|c| (c.round() + 32768.0) as f32);
        (count(rate, rate_lsb), count(force, force_lsb))
    });
    let (rate, force) = ((RATE_STD * rate_lsb).powi(2) as f32, (FORCE_STD * force_lsb).powi(2) as f32);
    let noise_variance = Vector6::new(rate, rate, rate, force, force, force);
    let config = RestDetectorConfig { block_samples: 20, window_blocks: 10, noise_variance, threshold: 3.0 };
    let mut in_counts = RestDetector::try_new(config).expect("a usable configuration");

    let found: Vec<_> = counts.filter_map(|(rate, force)| in_counts.push(rate, force)).collect();
    let wanted = rests_in(&samples, detector(20));
    assert_eq!(found.len(), wanted.len());
    for (found, wanted) in found.iter().zip(wanted) {
        assert_eq!((found.first_sample, found.end_sample), (wanted.first_sample, wanted.end_sample));
        let rate = found.mean_rate.map(|c| f64::from(c) - 32768.0) - wanted.mean_rate * rate_lsb;
        let force = found.mean_force.map(|c| f64::from(c) - 32768.0) - wanted.mean_force * force_lsb;
        // The limit of 0.06 counts allows for two errors: rounding to counts, averaged over a rest, and the spacing of
        // f32 numbers at 32768, which is 1/256 count.
        assert!(rate.amax() < 0.06 && force.amax() < 0.06, "{rate} {force}");
    }
}

#[test]
fn the_guard_blocks_stay_out_of_the_means() {
    // All samples are zero, except one in the first and one in the last block of the rest. The rest statistic of the
    // windows that contain these two samples is below the threshold.
    let block = 10;
    let mut samples = [(Vector3::zeros(), Vector3::zeros()); 300];
    samples[9].0.x = 0.02;
    samples[299].0.x = 0.02;
    let rests = rests_in(&samples, detector(block));
    assert_eq!(rests.len(), 1);
    assert_eq!((rests[0].first_sample, rests[0].end_sample), (10, 290));
    assert_eq!(rests[0].mean_rate, Vector3::zeros());
}

#[test]
fn a_nudge_parts_two_rests_and_a_short_pause_is_none() {
    let still = (Vector3::zeros(), Vector3::zeros());
    let nudge = (Vector3::repeat(1.0), Vector3::zeros());
    let mut samples = std::vec![still; 200];
    samples.push(nudge);
    samples.extend(std::vec![still; 90]);
    samples.push(nudge);
    samples.extend(std::vec![still; 200]);
    // 90 still samples are fewer than the 100 of one window (ten blocks of ten samples), so they are not a rest.
    let spans: Vec<_> = rests_in(&samples, detector(10)).iter().map(|r| (r.first_sample, r.end_sample)).collect();
    assert_eq!(spans, [(10, 190), (310, 480)]);
}

#[test]
fn a_sample_that_is_not_a_number_is_no_rest() {
    let mut samples = std::vec![(Vector3::zeros(), Vector3::zeros()); 400];
    samples[200].1.y = f64::NAN;
    let rests = rests_in(&samples, detector(10));
    assert_eq!(rests.iter().map(|r| (r.first_sample, r.end_sample)).collect::<Vec<_>>(), [(10, 190), (220, 390)]);
    assert!(rests.iter().all(|r| r.mean_force == Vector3::zeros()));
}

#[test]
fn finish_ends_a_part_and_sample_numbers_run_on() {
    let mut detector = detector(10);
    (0..205).for_each(|_| assert_eq!(detector.push(Vector3::zeros(), Vector3::zeros()), None));
    assert!(detector.is_still());
    assert_eq!(detector.finish().map(|r| (r.first_sample, r.end_sample)), Some((10, 190)));
    assert!(!detector.is_still());
    (0..100).for_each(|_| assert_eq!(detector.push(Vector3::repeat(1.0), Vector3::zeros()), None));
    assert_eq!(detector.finish().map(|r| (r.first_sample, r.end_sample)), Some((215, 295)));
    assert_eq!(detector.finish(), None);
}

#[test]
fn a_configuration_that_cannot_work_is_named() {
    let good = detector(10).config;
    let refused = |config| RestDetector::<f64>::try_new(config).err();
    assert_eq!(refused(RestDetectorConfig { block_samples: 0, ..good }), Some(RestConfigError::BlockSamples));
    for given in [2, 11] {
        let config = RestDetectorConfig { window_blocks: given, ..good };
        assert_eq!(refused(config), Some(RestConfigError::WindowBlocks { given }));
    }
    for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let mut noise_variance = good.noise_variance;
        noise_variance[4] = bad;
        let config = RestDetectorConfig { noise_variance, ..good };
        assert_eq!(refused(config), Some(RestConfigError::NoiseVariance { channel: 4 }));
        assert_eq!(refused(RestDetectorConfig { threshold: bad, ..good }), Some(RestConfigError::Threshold));
    }
}
