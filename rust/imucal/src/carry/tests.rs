//! The kernels against other roads to the same numbers.

use super::between::shares_of_cubic;
use super::*;
use imucal_core::integrate::Integrator;

/// A tumbling gyroscope, 100 Hz for 2 s, in raw units of a unit that is far from perfect.
fn tumble() -> (Vec<f64>, Vec<[f64; 3]>, Triad<f64>) {
    let time: Vec<f64> = (0..200).map(|k| k as f64 * 0.01).collect();
    let sensitivity = Matrix3::new(1.1, 0.05, -0.02, 0.03, 0.9, 0.04, -0.06, 0.01, 1.05);
    let triad = Triad::try_new(sensitivity, Vector3::new(0.1, -0.2, 0.05)).unwrap();
    let rate = |t: &f64| Vector3::new((3.0 * t).sin() * 4.0, (2.0 * t).cos() * 3.0, (5.0 * t).sin() * 2.0);
    let raw = time.iter().map(|t| triad.measure(rate(t)).into()).collect();
    (time, raw, triad)
}

fn carry_with(triad: &Triad<f64>, time: &[f64], raw: &[[f64; 3]]) -> Carried {
    let recording = Recording::try_new("tumble", time, raw, raw).unwrap();
    Path::of(&recording, 0, time.len() - 1).carry(triad)
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
    // Begun and ended gently, as the moves of a run are.
    let gently = |k: usize| (std::f64::consts::PI * k as f64 / (time.len() - 1) as f64).sin().powi(4);
    let slowed = |(k, raw): (usize, &[f64; 3])| triad.measure(triad.correct(Vector3::from(*raw)) * gently(k)).into();
    let raw: Vec<[f64; 3]> = raw.iter().enumerate().map(slowed).collect();
    let carry = |triad: &Triad<f64>| Path::cubic(&raw, Pace::of(&time)).carry(triad);
    let carried = carry(&triad);
    let delta = |sensitivity: Matrix3<f64>, bias: Vector3<f64>| {
        let moved = carry(&Triad::try_new(sensitivity, bias).unwrap()).rotation;
        // The turn is tiny: its vector is the antisymmetric part. An arc cosine would lose half of the digits.
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
        let carried = Path::straight(&raw[..samples], Pace::of(&stamps_s)).carry(&triad);
        assert!((carried.rotation - Matrix3::identity()).norm() < 1e-15);
        assert!(carried.sensitivity_sums.iter().chain([&carried.bias_sum]).all(|sum| sum.norm() < 1e-15));
    }
}

#[test]
fn a_cubic_through_uneven_samples_is_exact_for_cubics() {
    let even = shares_of_cubic([0.0, 1.0, 2.0, 3.0]);
    assert!(even.iter().zip([-1.0, 13.0, 13.0, -1.0]).all(|(share, exact)| (share * 24.0 - exact).abs() < 1e-14));
    let times: [f64; 4] = [-0.7, 0.2, 0.9, 3.0];
    let shares = shares_of_cubic(times);
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
    // About one axis, where the angle is the integral: 2.5 rad in 5 s.
    let angle = |t: f64| 1.25 * (1.0 - (std::f64::consts::PI * t / 5.0).cos());
    let rate = |t: &f64| [0.0, 0.0, 1.25 * std::f64::consts::PI / 5.0 * (std::f64::consts::PI * t / 5.0).sin()];
    let error = |samples: f64, between: Between| {
        let at = |k: f64| 5.0 * (k + 0.2 * (k * 1.7).sin()) / samples;
        let times: Vec<f64> = (-1..=samples as i32 + 1).map(|k| at(f64::from(k))).collect();
        let raw: Vec<[f64; 3]> = times.iter().map(rate).collect();
        let within = if between == Between::Straight { 1..times.len() - 1 } else { 0..times.len() };
        let path = Path::of_samples((&raw[within.clone()]).into(), Pace::Stamps(&times[within]), between);
        let turned = angle(times[times.len() - 2]) - angle(times[1]);
        let found = path.rotation(&unit);
        (found.m21.atan2(found.m11) - turned).abs()
    };
    let (coarse, fine) = (error(50.0, Between::UnevenCubic), error(100.0, Between::UnevenCubic));
    assert!(coarse < 1e-6 && fine < coarse / 12.0, "{coarse:e} {fine:e}");
    assert!(error(50.0, Between::Straight) > 100.0 * coarse);
}

/// A number as the sum of two, exact to 31 digits: what the kernels are judged by.
#[derive(Clone, Copy)]
struct Double(f64, f64);

impl Double {
    fn of(value: f64) -> Self {
        Self(value, 0.0)
    }
    fn sum(a: f64, b: f64) -> Self {
        let s = a + b;
        let t = s - a;
        Self(s, (a - (s - t)) + (b - t))
    }
    fn value(self) -> f64 {
        self.0 + self.1
    }
}

impl std::ops::Add for Double {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        let (high, low) = (Self::sum(self.0, other.0), Self::sum(self.1, other.1));
        let first = Self::sum(high.0, high.1 + low.0);
        Self::sum(first.0, first.1 + low.1)
    }
}

impl std::ops::Neg for Double {
    type Output = Self;
    fn neg(self) -> Self {
        Self(-self.0, -self.1)
    }
}

impl std::ops::Sub for Double {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl std::ops::Mul for Double {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        let product = self.0 * other.0;
        let error = self.0.mul_add(other.0, -product);
        Self::sum(product, error + (self.0 * other.1 + self.1 * other.0))
    }
}

type Vector = [Double; 3];
type Square = [Vector; 3];

fn product(a: &Square, b: &Square) -> Square {
    let entry = |r: usize, c: usize| (0..3).fold(Double::of(0.0), |sum, k| sum + a[r][k] * b[k][c]);
    std::array::from_fn(|r| std::array::from_fn(|c| entry(r, c)))
}

fn plus(a: &Square, b: &Square) -> Square {
    std::array::from_fn(|r| std::array::from_fn(|c| a[r][c] + b[r][c]))
}

fn hat_of(v: &Vector) -> Square {
    let zero = Double::of(0.0);
    [[zero, -v[2], v[1]], [v[2], zero, -v[0]], [-v[1], v[0], zero]]
}

fn scaled(a: &Square, factor: Double) -> Square {
    a.map(|row| row.map(|entry| entry * factor))
}

/// The matrix exponential.
fn exponential(m: &Square) -> Square {
    let mut term: Square = std::array::from_fn(|r| std::array::from_fn(|c| Double::of(if r == c { 1.0 } else { 0.0 })));
    let mut sum = term;
    for k in 1..30 {
        term = product(&term, m);
        // 1/n to 31 digits, from one step of Newton's.
        let n = Double::of(f64::from(k));
        let guess = Double::of(1.0 / n.0);
        term = scaled(&term, guess * (Double::of(2.0) - n * guess));
        sum = plus(&sum, &term);
    }
    sum
}

/// Rotation, G_x, G_y, G_z and G_b as the equations at the head of the module say, in twice the digits.
fn reference(path: &Samples<'_>) -> [Square; 5] {
    let Samples { raw, time_s, triad, is_cubic } = path;
    let third = Double::of(1.0 / 3.0) + Double::of(-1.0 / 3.0 * 3.0 + 1.0) * Double::of(1.0 / 3.0);
    let third = third * (Double::of(2.0) - Double::of(3.0) * third);
    let twelfth = third * Double::of(0.25);
    let rate = |k: usize| -> Vector {
        std::array::from_fn(|r| {
            (0..3).fold(Double::of(0.0), |sum, c| {
                sum + Double::of(triad.inverse()[(r, c)]) * (Double::of(raw[k][c]) - Double::of(triad.bias()[c]))
            })
        })
    };
    let zero: Square = [[Double::of(0.0); 3]; 3];
    let mut rotation = exponential(&zero);
    let mut sums = [zero; 4];
    let margin = usize::from(*is_cubic);
    for k in margin..raw.len() - 1 - margin {
        let h = match time_s {
            Ok(interval_s) => Double::of(*interval_s),
            Err(time_s) => Double::of(time_s[k + 1]) - Double::of(time_s[k]),
        };
        let (w0, w1) = (rate(k), rate(k + 1));
        let cubic = is_cubic.then(|| (rate(k - 1), rate(k + 2)));
        let s: Vector = std::array::from_fn(|c| {
            let inner = w0[c] + w1[c];
            match cubic {
                None => inner * h * Double::of(0.5),
                Some((before, after)) => {
                    (inner * Double::of(13.0) - (before[c] + after[c])) * h * twelfth * Double::of(0.5)
                }
            }
        });
        let square = h * h * twelfth;
        let cross: Vector = std::array::from_fn(|c| {
            let (i, j) = ((c + 1) % 3, (c + 2) % 3);
            (w0[i] * w1[j] - w0[j] * w1[i]) * square
        });
        let phi = hat_of(&std::array::from_fn(|c| s[c] + cross[c]));
        let mut add_sample = |rotation: &Square, rate: &Vector| {
            let weighted = scaled(rotation, h * Double::of(0.5));
            for j in 0..3 {
                sums[j] = plus(&sums[j], &scaled(&weighted, rate[j]));
            }
            sums[3] = plus(&sums[3], &weighted);
        };
        add_sample(&rotation, &w0);
        rotation = product(&rotation, &exponential(&phi));
        add_sample(&rotation, &w1);
    }
    let [x, y, z, bias] = sums;
    let [x, y, z] = with_the_turn([x, y, z], &rotation, &path::Frame::of(triad, 1.0).axes);
    [rotation, x, y, z, bias]
}

/// The sums of columns and parts of the rate below the diagonal from those above it, in the frame with these axes.
fn with_the_turn(sums: [Square; 3], rotation: &Square, axes: &Matrix3<f64>) -> [Square; 3] {
    let out: Square = std::array::from_fn(|r| std::array::from_fn(|c| Double::of(axes[(r, c)])));
    let back: Square = std::array::from_fn(|r| std::array::from_fn(|c| Double::of(axes[(c, r)])));
    let seen_along = |sums: &[Square; 3], shares: [Double; 3]| {
        plus(&plus(&scaled(&sums[0], shares[0]), &scaled(&sums[1], shares[1])), &scaled(&sums[2], shares[2]))
    };
    let within = |m: &Square| product(&product(&back, m), &out);
    let mut inside: [Square; 3] =
        std::array::from_fn(|i| within(&seen_along(&sums, std::array::from_fn(|j| out[j][i]))));
    let turned = within(rotation);
    let unit = |r: usize, c: usize| Double::of(f64::from(u8::from(r == c)));
    for r in 0..3 {
        // Each part of R' = R [w]x, summed.
        let of_x = turned[r][0] - unit(r, 0);
        let of_y = turned[r][1] - unit(r, 1);
        let of_z = turned[r][2] - unit(r, 2);
        inside[0][r][1] = inside[1][r][0] - of_z;
        inside[0][r][2] = inside[2][r][0] + of_y;
        inside[1][r][2] = inside[2][r][1] - of_x;
    }
    let outside = |m: &Square| product(&product(&out, m), &back);
    std::array::from_fn(|j| outside(&seen_along(&inside, out[j])))
}

/// What a path is made of; the time is one interval or stamps.
struct Samples<'a> {
    raw: &'a [[f64; 3]],
    time_s: Result<f64, &'a [f64]>,
    triad: Triad<f64>,
    is_cubic: bool,
}

impl Samples<'_> {
    fn path(&self) -> Path<'_> {
        let pace = match self.time_s {
            Ok(interval_s) => Pace::Even(interval_s),
            Err(stamps_s) => Pace::Stamps(stamps_s),
        };
        if self.is_cubic { Path::cubic(self.raw, pace) } else { Path::straight(self.raw, pace) }
    }

    /// The largest error of the rotation, rad, and of the sums, rad and s, with each set of instructions.
    fn errors(&self) -> Vec<(Instructions, f64, f64)> {
        let reference = reference(self).map(|m| Matrix3::from_fn(|r, c| m[r][c].value()));
        let error = |instructions: Instructions| {
            let path = self.path().with(instructions);
            let carried = path.carry(&self.triad);
            let turn = |rotation: Matrix3<f64>| (rotation - reference[0]).amax();
            let rotation = turn(carried.rotation).max(turn(path.rotation(&self.triad)));
            let [x, y, z] = carried.sensitivity_sums;
            let sums = [x, y, z, carried.bias_sum];
            let worst = sums.iter().zip(&reference[1..]).map(|(m, exact)| (m - exact).amax()).fold(0.0, f64::max);
            (instructions, rotation, worst)
        };
        Instructions::available().into_iter().map(error).collect()
    }
}

/// A tumble of `samples` samples with noise, in raw units; the largest rate is near 4 rad/s times `speed`.
fn shaken(samples: usize, interval_s: f64, speed: f64) -> Vec<[f64; 3]> {
    let (_, _, triad) = tumble();
    let noise = |k: usize| (k as f64 * 12.9898).sin() * 43758.5453 % 1.0 * 0.01;
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
    // Fewer steps than lanes, ragged ends, tiles that are not full, and more than a stretch for all lanes.
    for steps in [0, 1, 5, 15, 16, 17, 63, 64, 65, 200, 1023, 8_005] {
        for (interval_s, speed) in [(1.25e-4, 1.0), (1.25e-4, 1.4), (0.01, 1.0), (0.01, 3.9)] {
            for is_cubic in [false, true] {
                let raw = shaken(steps + 1 + 2 * usize::from(is_cubic), interval_s, speed);
                let uneven: Vec<f64> =
                    (0..raw.len()).map(|k| (k as f64 + 0.3 * (k as f64 * 1.7).sin()) * interval_s).collect();
                for time_s in [Ok(interval_s), Err(uneven.as_slice())] {
                    let samples = Samples { raw: &raw, time_s, triad, is_cubic };
                    for (instructions, rotation, sums) in samples.errors() {
                        let what = format!("{steps} steps of {interval_s} s x {speed}, {instructions:?}, {is_cubic}");
                        assert!(rotation < 1e-12 && sums < 1e-12, "{what}: {rotation:e} {sums:e}");
                    }
                }
            }
        }
    }
}
