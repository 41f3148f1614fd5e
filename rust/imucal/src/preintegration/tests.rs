//! Tests that compare the vectorised integration with independent calculations.

use super::interpolation::cubic_weights;
use super::reference::{Samples, reference};
use super::sums::STEPS_OF_A_NODE;
use super::*;
use imucal_core::integrate::Integrator;
use pulp::{Simd, WithSimd};

/// Simulates a tumbling gyroscope with large scale and misalignment errors, at 100 Hz for 2 s. Returns the times, the
/// raw samples, and the sensitivity and bias.
fn tumble() -> (Vec<f64>, Vec<[f64; 3]>, Triad<f64>) {
    let time: Vec<f64> = (0..200).map(|k| k as f64 * 0.01).collect();
    let sensitivity = Matrix3::new(1.1, 0.05, -0.02, 0.03, 0.9, 0.04, -0.06, 0.01, 1.05);
    let triad = Triad::try_new(sensitivity, Vector3::new(0.1, -0.2, 0.05)).unwrap();
    let rate = |t: &f64| Vector3::new((3.0 * t).sin() * 4.0, (2.0 * t).cos() * 3.0, (5.0 * t).sin() * 2.0);
    let raw = time.iter().map(|t| triad.measure(rate(t)).into()).collect();
    (time, raw, triad)
}

fn carry_with(triad: &Triad<f64>, time: &[f64], raw: &[[f64; 3]]) -> Preintegrated {
    let recording = Recording::try_new("tumble", time, raw, raw).unwrap();
    RateSegment::of(&recording, 0, time.len() - 1).preintegrate(triad)
}

#[test]
fn the_rotation_is_that_of_the_streaming_integrator() {
    let (time, raw, triad) = tumble();
    let mut integrator = Integrator::new();
    raw.iter().for_each(|raw| integrator.push(0.01, triad.correct(Vector3::from(*raw))));
    let streamed = *integrator.rotation().to_rotation_matrix().matrix();
    let batch = carry_with(&triad, &time, &raw).rotation;
    let difference = batch.transpose() * streamed;
    assert!((difference - Matrix3::identity()).norm() < 1e-13, "{difference}");
}

#[test]
fn derivatives_meet_finite_differences_from_rest_to_rest() {
    let (time, raw, triad) = tumble();
    // The rate starts and ends at zero, as in the moves of a run.
    let gently = |k: usize| (std::f64::consts::PI * k as f64 / (time.len() - 1) as f64).sin().powi(4);
    let slowed = |(k, raw): (usize, &[f64; 3])| triad.measure(triad.correct(Vector3::from(*raw)) * gently(k)).into();
    let raw: Vec<[f64; 3]> = raw.iter().enumerate().map(slowed).collect();
    let carry = |triad: &Triad<f64>| RateSegment::cubic(&raw, SampleTimes::of(&time)).preintegrate(triad);
    let carried = carry(&triad);
    let delta = |sensitivity: Matrix3<f64>, bias: Vector3<f64>| {
        let moved = carry(&Triad::try_new(sensitivity, bias).unwrap()).rotation;
        // For a tiny rotation, the antisymmetric part of the matrix is the rotation vector. An angle from an arc cosine
        // would lose half of the digits.
        let turn = carried.rotation.transpose() * moved;
        Vector3::new(turn.m32 - turn.m23, turn.m13 - turn.m31, turn.m21 - turn.m12) / 2.0
    };
    let step = 1e-6;
    let unit = |i: usize| Vector3::from_fn(|k, _| f64::from(u8::from(k == i)));
    for i in 0..3 {
        let column = triad.inverse() * unit(i);
        for j in 0..3 {
            let mut change = Matrix3::zeros();
            change[(i, j)] = step;
            let (plus, minus) = (triad.sensitivity() + change, triad.sensitivity() - change);
            let difference = (delta(plus, *triad.bias()) - delta(minus, *triad.bias())) / (2.0 * step);
            let analytic = -carried.rotation.tr_mul(&(carried.sensitivity_sums[j] * column));
            assert!((difference - analytic).norm() < 1e-7, "T_{i}{j}: {difference} {analytic}");
        }
        let (plus, minus) = (triad.bias() + unit(i) * step, triad.bias() - unit(i) * step);
        let sensitivity = *triad.sensitivity();
        let difference = (delta(sensitivity, plus) - delta(sensitivity, minus)) / (2.0 * step);
        let analytic = -carried.rotation.tr_mul(&(carried.bias_sum * column));
        assert!((difference - analytic).norm() < 1e-7, "b_{i}: {difference} {analytic}");
    }
}

#[test]
fn no_time_turns_nothing() {
    let (_, raw, triad) = tumble();
    for samples in [1, 2, 40] {
        let stamps_s = vec![7.5; samples];
        let carried = RateSegment::linear(&raw[..samples], SampleTimes::of(&stamps_s)).preintegrate(&triad);
        assert!((carried.rotation - Matrix3::identity()).norm() < 1e-15);
        assert!(carried.sensitivity_sums.iter().chain([&carried.bias_sum]).all(|sum| sum.norm() < 1e-15));
    }
}

#[test]
fn a_cubic_through_uneven_samples_is_exact_for_cubics() {
    let even = cubic_weights([0.0, 1.0, 2.0, 3.0]);
    assert!(even.iter().zip([-1.0, 13.0, 13.0, -1.0]).all(|(share, exact)| (share * 24.0 - exact).abs() < 1e-14));
    let times: [f64; 4] = [-0.7, 0.2, 0.9, 3.0];
    let shares = cubic_weights(times);
    for power in 0..4 {
        let integral = |t: f64| t.powi(power + 1) / f64::from(power + 1);
        let mean = (integral(times[2]) - integral(times[1])) / (times[2] - times[1]);
        let shared: f64 = times.iter().zip(shares).map(|(t, share)| t.powi(power) * share).sum();
        assert!((shared - mean).abs() < 1e-14, "t^{power}: {shared} {mean}");
    }
}

#[test]
fn uneven_steps_are_as_exact_as_even_ones() {
    let unit = Triad::identity();
    // Rotation by 2.5 rad in 5 s about one axis, so that the angle is the integral of the rate.
    let angle = |t: f64| 1.25 * (1.0 - (std::f64::consts::PI * t / 5.0).cos());
    let rate = |t: &f64| [0.0, 0.0, 1.25 * std::f64::consts::PI / 5.0 * (std::f64::consts::PI * t / 5.0).sin()];
    let error = |samples: f64, interpolation: Interpolation| {
        let at = |k: f64| 5.0 * (k + 0.2 * (k * 1.7).sin()) / samples;
        let times: Vec<f64> = (-1..=samples as i32 + 1).map(|k| at(f64::from(k))).collect();
        let raw: Vec<[f64; 3]> = times.iter().map(rate).collect();
        let within = if interpolation == Interpolation::Linear { 1..times.len() - 1 } else { 0..times.len() };
        let path =
            RateSegment::of_samples((&raw[within.clone()]).into(), SampleTimes::Stamps(&times[within]), interpolation);
        let turned = angle(times[times.len() - 2]) - angle(times[1]);
        let found = path.rotation(&unit);
        (found.m21.atan2(found.m11) - turned).abs()
    };
    let (coarse, fine) = (error(50.0, Interpolation::UnevenCubic), error(100.0, Interpolation::UnevenCubic));
    assert!(coarse < 1e-6 && fine < coarse / 12.0, "{coarse:e} {fine:e}");
    assert!(error(50.0, Interpolation::Linear) > 100.0 * coarse);
}

struct CountLanes;

impl WithSimd for CountLanes {
    type Output = usize;

    fn with_simd<S: Simd>(self, _: S) -> usize {
        S::F64_LANES
    }
}

impl Samples<'_> {
    fn path(&self) -> RateSegment<'_> {
        let sample_times = match self.time_s {
            Ok(interval_s) => SampleTimes::Even(interval_s),
            Err(stamps_s) => SampleTimes::Stamps(stamps_s),
        };
        if self.is_cubic {
            RateSegment::cubic(self.raw, sample_times)
        } else {
            RateSegment::linear(self.raw, sample_times)
        }
    }

    /// Returns, for each instruction set, the largest error of the rotation, rad, and the largest error of the sums,
    /// rad and s. If `by_nodes` is true, the reference sums are computed over the same nodes (groups of 16 steps) as
    /// the tested sums, otherwise sample by sample.
    fn errors(&self, by_nodes: bool) -> Vec<(Instructions, f64, f64)> {
        let error = |instructions: Instructions| {
            let at_nodes = if by_nodes { self.steps_at_nodes(instructions) } else { 0 };
            let reference = reference(self, at_nodes).map(|m| Matrix3::from_fn(|r, c| m[r][c].value()));
            let path = self.path().with(instructions);
            let carried = path.preintegrate(&self.triad);
            let turn = |rotation: Matrix3<f64>| (rotation - reference[0]).amax();
            let rotation = turn(carried.rotation).max(turn(path.rotation(&self.triad)));
            let [x, y, z] = carried.sensitivity_sums;
            let sums = [x, y, z, carried.bias_sum];
            let worst = sums.iter().zip(&reference[1..]).map(|(m, exact)| (m - exact).amax()).fold(0.0, f64::max);
            (instructions, rotation, worst)
        };
        Instructions::available().into_iter().map(error).collect()
    }

    /// Number of steps that the vectorised integration sums in nodes (groups of 16 steps). The segment must fit into
    /// one block, and all its step angles must be in the first of the `ANGLE_RANGES`.
    fn steps_at_nodes(&self, instructions: Instructions) -> usize {
        let (steps, lanes) = (self.raw.len() - 1 - 2 * usize::from(self.is_cubic), instructions.run(CountLanes));
        let is_short = self.time_s.is_ok_and(|interval_s| interval_s < 1e-3);
        if is_short { lanes * (steps / lanes / STEPS_OF_A_NODE * STEPS_OF_A_NODE) } else { 0 }
    }
}

/// Simulates a tumble with noise, and returns `samples` raw samples. The norm of the rate is at most 5.4 rad/s times
/// `speed`, plus the noise.
fn shaken(samples: usize, interval_s: f64, speed: f64, noise_rad_per_s: f64) -> Vec<[f64; 3]> {
    let (_, _, triad) = tumble();
    let noise = |k: usize| (k as f64 * 12.9898).sin() * 43758.5453 % 1.0 * noise_rad_per_s;
    let rate = |k: usize| {
        let t = k as f64 * interval_s;
        Vector3::new((3.0 * t).sin() * 4.0, (2.0 * t).cos() * 3.0, (5.0 * t).sin() * 2.0) * speed
            + Vector3::new(noise(3 * k), noise(3 * k + 1), noise(3 * k + 2))
    };
    (0..samples).map(|k| triad.measure(rate(k)).into()).collect()
}

#[test]
fn rotations_and_sums_are_exact_with_all_instructions() {
    let (_, _, triad) = tumble();
    // These numbers of steps test four cases: fewer steps than lanes, last steps that do not fill all lanes, last steps
    // of a lane that do not fill a tile (8 steps), and many tiles per lane.
    for steps in [0, 1, 5, 15, 16, 17, 63, 64, 65, 200, 1023, 8_005] {
        for (interval_s, speed) in [(1.25e-4, 1.0), (1.25e-4, 1.4), (0.01, 1.0), (0.01, 3.9)] {
            for is_cubic in [false, true] {
                let raw = shaken(steps + 1 + 2 * usize::from(is_cubic), interval_s, speed, 0.01);
                let uneven: Vec<f64> =
                    (0..raw.len()).map(|k| (k as f64 + 0.3 * (k as f64 * 1.7).sin()) * interval_s).collect();
                for time_s in [Ok(interval_s), Err(uneven.as_slice())] {
                    let samples = Samples { raw: &raw, time_s, triad, is_cubic };
                    for (instructions, rotation, sums) in samples.errors(true) {
                        let what = format!("{steps} steps of {interval_s} s x {speed}, {instructions:?}, {is_cubic}");
                        assert!(rotation < 1e-12 && sums < 1e-12, "{what}: {rotation:e} {sums:e}");
                    }
                }
            }
        }
    }
}

#[test]
fn sums_at_nodes_are_those_of_all_samples() {
    let (_, _, triad) = tumble();
    let worst = |raw: &[[f64; 3]], is_cubic: bool| {
        let samples = Samples { raw, time_s: Ok(1.25e-4), triad, is_cubic };
        samples.errors(false).into_iter().map(|(_, _, sums)| sums).fold(0.0, f64::max)
    };
    // Segments that start and end at rest, with fewer and with more steps than one block.
    for (steps, speed) in [(16_000, 0.5), (24_011, 1.0), (40_013, 1.4)] {
        let gently = |k: usize| (std::f64::consts::PI * k as f64 / f64::from(steps)).sin().powi(4);
        let slowed =
            |(k, raw): (usize, &[f64; 3])| triad.measure(triad.correct(Vector3::from(*raw)) * gently(k)).into();
        let raw: Vec<[f64; 3]> =
            shaken(steps as usize + 1, 1.25e-4, speed, 0.0).iter().enumerate().map(slowed).collect();
        let error = worst(&raw, false);
        assert!(error < 1e-12, "{steps}: {error:e}");
    }
    // A segment during a rotation at up to 2.4 rad/s, as in the moves of the benchmark.
    let error = worst(&shaken(20_001, 1.25e-4, 0.45, 0.0), false);
    assert!(error < 1e-12, "{error:e}");
    // Segments with rates of up to 7.5 rad/s, some with last steps that do not fill all lanes. With noise, the error
    // must be below 1 % of the change of the sums that is due to the noise.
    for steps in [127, 128, 200, 1023, 8_005] {
        for is_cubic in [false, true] {
            let raw = |noise| shaken(steps + 1 + 2 * usize::from(is_cubic), 1.25e-4, 1.4, noise);
            let error = worst(&raw(0.0), is_cubic);
            assert!(error < 3e-11, "{steps}: {error:e}");
            let sums = |noise| {
                let Preintegrated { sensitivity_sums, .. } =
                    Samples { raw: &raw(noise), time_s: Ok(1.25e-4), triad, is_cubic }.path().preintegrate(&triad);
                sensitivity_sums
            };
            let (quiet, noisy) = (sums(0.0), sums(0.01));
            let changed = quiet.iter().zip(&noisy).map(|(a, b)| (a - b).amax()).fold(0.0, f64::max);
            let error = worst(&raw(0.01), is_cubic);
            assert!(error < 0.01 * changed, "{steps}: {error:e} {changed:e}");
        }
    }
}
