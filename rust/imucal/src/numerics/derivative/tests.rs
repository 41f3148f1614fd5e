use std::cell::Cell;

use super::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

const AMPLITUDE_RADPS: f64 = 2.0;
/// Standard deviation of the simulated noise of a sample, rad/s. It is that of a low-cost gyroscope with a two-sided
/// noise density of 0.026 deg/s/sqrt(Hz) at 400 Hz.
const NOISE_RADPS: f64 = 9e-3;

/// Simulates a sine with noise, sampled at 400 Hz. Returns the times, the noisy values and the true derivatives.
fn sine(frequency_hz: f64, seed: u64) -> (Vec<f64>, Vec<Vector3<f64>>, Vec<Vector3<f64>>) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut noise = || Vector3::from_fn(|_, _| NOISE_RADPS * random.sample::<f64, _>(StandardNormal));
    let w = std::f64::consts::TAU * frequency_hz;
    let time_s: Vec<f64> = (0..2000).map(|k| 12.0 + f64::from(k) / 400.0).collect();
    let phases = [0.0, 1.0, 2.0];
    let rates = time_s.iter().map(|t| Vector3::from(phases.map(|p| AMPLITUDE_RADPS * (w * t + p).sin())) + noise());
    let slopes = time_s.iter().map(|t| Vector3::from(phases.map(|p| AMPLITUDE_RADPS * w * (w * t + p).cos())));
    (time_s.clone(), rates.collect(), slopes.collect())
}

/// Root mean square error of the derivative `found`, and the relative amount by which its amplitude is too small.
fn errors(found: &[Vector3<f64>], truth: &[Vector3<f64>]) -> (f64, f64) {
    let of = |product: fn(&Vector3<f64>, &Vector3<f64>) -> f64| -> f64 {
        found.iter().zip(truth).map(|(found, truth)| product(found, truth)).sum()
    };
    let squares = of(|_, truth| truth.norm_squared());
    let rms = (of(|found, truth| (found - truth).norm_squared()) / (3 * truth.len()) as f64).sqrt();
    (rms, 1.0 - of(|found, truth| found.dot(truth)) / squares)
}

#[test]
fn noise_goes_as_far_as_the_motion_allows() {
    // `times_less` is the factor by which smoothing must at least reduce the rms error of the derivative. Slow motion
    // permits more smoothing than fast motion. The truncation error must be below 0.2 %.
    for (frequency_hz, times_less) in [(0.3, 80.0), (1.0, 25.0), (5.0, 4.0)] {
        let (time_s, rates, truth) = sine(frequency_hz, 1);
        let neighbours = errors(&Derivative::narrow(&time_s).of(&rates), &truth);
        let (rms, too_small) = errors(&Derivative::smooth(&time_s, &rates).of(&rates), &truth);
        assert!(rms < neighbours.0 / times_less, "{frequency_hz} Hz: {rms}, {neighbours:?}");
        assert!(too_small.abs() < 2e-3, "{frequency_hz} Hz: {too_small}");
    }
}

#[test]
fn how_smooth_a_motion_is_is_asked_once() {
    let (time_s, rates, _) = sine(1.0, 4);
    let (width, asked) = (Width::default(), Cell::new(0));
    let slopes = [(); 2].map(|()| {
        let values = || {
            asked.set(asked.get() + 1);
            rates.clone()
        };
        width.derivative(&time_s, values).of(&rates)
    });
    assert_eq!(asked.get(), 1);
    let each_time = Derivative::smooth(&time_s, &rates).of(&rates);
    assert!(slopes.iter().all(|slopes| *slopes == each_time));
    assert!(each_time != Derivative::narrow(&time_s).of(&rates));
}

#[test]
fn that_of_neighbours_is_wrong_by_the_fourth_power_of_the_step() {
    // The truncation error is the fifth derivative multiplied by a factor. With the time step h, the factor is h^4 / 30
    // in the middle of the data, h^4 / 5 at the first and the last sample, and h^4 / 20 at the second and the second
    // last sample.
    let (h, frequency) = (2e-3, 20.0);
    let time_s: Vec<f64> = (0..1000).map(|i| f64::from(i) * h).collect();
    let rates: Vec<Vector3<f64>> = time_s.iter().map(|t| Vector3::repeat((frequency * t + 0.4).sin())).collect();
    let fifth = f64::powi(frequency, 5);
    let mut worst: [f64; 3] = [0.0; 3];
    for (i, slope) in Derivative::narrow(&time_s).of(&rates).into_iter().enumerate() {
        let place = i.min(999 - i).min(2);
        worst[place] = worst[place].max((slope.x - frequency * (frequency * time_s[i] + 0.4).cos()).abs());
    }
    for (error, share) in worst.into_iter().zip([5.0, 20.0, 30.0]) {
        let limit = fifth * f64::powi(h, 4) / share;
        assert!(error < 1.2 * limit, "{error:e}, {limit:e}");
    }
    assert!(worst[2] > 0.9 * fifth * f64::powi(h, 4) / 30.0);
}

#[test]
fn the_fastest_stretch_decides() {
    let (time_s, slow, _) = sine(0.3, 2);
    let (_, fast, truth) = sine(8.0, 2);
    let mixed: Vec<Vector3<f64>> = slow[..1500].iter().chain(&fast[1500..]).copied().collect();
    let (_, too_small) = errors(&Derivative::smooth(&time_s, &mixed).of(&mixed)[1550..], &truth[1550..]);
    assert!(too_small.abs() < 5e-3, "{too_small}");
}

#[test]
fn without_noise_it_is_that_of_the_neighbours() {
    let time_s: Vec<f64> = (0..400).map(|k| f64::from(k) * 0.01).collect();
    let rates: Vec<Vector3<f64>> = time_s.iter().map(|t| Vector3::new((9.0 * t).sin(), (7.0 * t).cos(), *t)).collect();
    let (smooth, narrow) = (Derivative::smooth(&time_s, &rates).of(&rates), Derivative::narrow(&time_s).of(&rates));
    let largest = smooth.iter().zip(&narrow).map(|(a, b)| (a - b).amax()).fold(0.0, f64::max);
    assert!(largest < 1e-9, "{largest:e}");
}

#[test]
fn a_missing_value_leaves_the_others_their_slopes() {
    let (time_s, mut rates, truth) = sine(0.3, 3);
    rates[900].y = f64::NAN;
    let found = Derivative::smooth(&time_s, &rates).of(&rates);
    let missing: Vec<usize> = (0..found.len()).filter(|k| found[*k].iter().any(|v| !v.is_finite())).collect();
    assert!(missing.contains(&900) && missing.len() < 250, "{missing:?}");
    assert!((found[100] - truth[100]).amax() < 0.1 && (found[1900] - truth[1900]).amax() < 0.1);
}
