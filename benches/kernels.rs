//! Duration of the preintegration kernels, compared with a plain sum over the same array, which is limited by memory
//! bandwidth.
//!
//! `cargo bench --bench kernels` shows the throughput of each kernel. With `--table` it prints the table of
//! docs/results/speed.md (see kernels.py). With `--once NAME SAMPLES` it runs one kernel once, to count instructions.

use std::env;
use std::hint::black_box;
use std::process::ExitCode;
use std::time::Instant;

use criterion::{Criterion, Throughput};
use imucal::preintegration::{Instructions, RateSegment, SampleTimes};
use imucal_core::sensor::Triad;
use nalgebra::{Matrix3, Vector3};
use pulp::{Arch, Simd, WithSimd};

const SAMPLES: usize = 10_000_000;
const MOVES: usize = 45;
const INTERVAL_S: f64 = 1.25e-4;
const ROUNDS: usize = 15;

/// A recording at 8 kHz, in raw units, with large scale and misalignment errors.
struct Gyroscope {
    raw: Vec<[f64; 3]>,
    time_s: Vec<f64>,
    triad: Triad<f64>,
}

impl Gyroscope {
    fn new(samples: usize) -> Option<Self> {
        let sensitivity = Matrix3::new(1.1, 0.05, -0.02, 0.03, 0.9, 0.04, -0.06, 0.01, 1.05);
        let triad = Triad::try_new(sensitivity, Vector3::new(0.1, -0.2, 0.05)).ok()?;
        let time_s: Vec<f64> = (0..samples).map(|k| k as f64 * INTERVAL_S).collect();
        let rate = |t: &f64| Vector3::new((3.0 * t).sin(), 2.0 * (2.0 * t).cos(), (5.0 * t).sin());
        let raw = time_s.iter().map(|t| triad.measure(rate(t)).into()).collect();
        Some(Self { raw, time_s, triad })
    }

    /// Runs a kernel on every move. The result is only returned to prevent the compiler from removing the calculation.
    fn run(&self, kernel: Kernel, instructions: Instructions) -> f64 {
        let length = self.raw.len() / MOVES;
        let of_move = |k: usize| {
            let range = k * length..(k + 1) * length;
            let raw = &self.raw[range.clone()];
            let sample_times = if kernel.has_stamps() {
                SampleTimes::Stamps(&self.time_s[range])
            } else {
                SampleTimes::Even(INTERVAL_S)
            };
            let path = RateSegment::linear(raw, sample_times).with(instructions);
            match kernel {
                Kernel::Sum => Arch::new().dispatch(PlainSum(raw)),
                Kernel::Rotation | Kernel::RotationStamped => path.rotation(&self.triad).m11,
                Kernel::Sums | Kernel::SumsStamped => path.preintegrate(&self.triad).bias_sum.m11,
            }
        };
        (0..MOVES).map(of_move).sum()
    }
}

#[derive(Clone, Copy, PartialEq)]
enum Kernel {
    Sum,
    Rotation,
    RotationStamped,
    Sums,
    SumsStamped,
}

impl Kernel {
    const ALL: [Self; 5] = [Self::Sum, Self::Rotation, Self::RotationStamped, Self::Sums, Self::SumsStamped];

    fn name(self) -> &'static str {
        match self {
            Self::Sum => "plain sum",
            Self::Rotation => "rotation, even steps",
            Self::RotationStamped => "rotation, time stamps",
            Self::Sums => "rotation and 12 sums, even steps",
            Self::SumsStamped => "rotation and 12 sums, time stamps",
        }
    }

    fn has_stamps(self) -> bool {
        matches!(self, Self::RotationStamped | Self::SumsStamped)
    }
}

/// Sum of all numbers, in enough partial sums to hide the latency of an addition.
struct PlainSum<'a>(&'a [[f64; 3]]);

impl WithSimd for PlainSum<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f64 {
        let (vectors, rest) = S::as_simd_f64s(self.0.as_flattened());
        let mut parts = [simd.splat_f64s(0.0); 12];
        for chunk in vectors.chunks(parts.len()) {
            for (part, vector) in parts.iter_mut().zip(chunk) {
                *part = simd.add_f64s(*part, *vector);
            }
        }
        parts.iter().map(|part| simd.reduce_sum_f64s(*part)).sum::<f64>() + rest.iter().sum::<f64>()
    }
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// One line per instruction set and kernel: names, ns per sample, and ratio to the plain sum of the same round.
fn table(gyroscope: &Gyroscope) {
    for instructions in Instructions::available() {
        if matches!(instructions, Instructions::Best | Instructions::Scalar) {
            continue;
        }
        let mut rounds: Vec<[f64; Kernel::ALL.len()]> = Vec::new();
        for _ in 0..ROUNDS {
            rounds.push(Kernel::ALL.map(|kernel| {
                let start = Instant::now();
                black_box(gyroscope.run(kernel, instructions));
                start.elapsed().as_secs_f64() * 1e9 / gyroscope.raw.len() as f64
            }));
        }
        for (k, kernel) in Kernel::ALL.into_iter().enumerate() {
            let ns = median(rounds.iter().map(|round| round[k]).collect());
            let times = median(rounds.iter().map(|round| round[k] / round[0]).collect());
            println!("{instructions:?}\t{}\t{ns:.3}\t{times:.3}", kernel.name());
        }
    }
}

fn criterion(gyroscope: &Gyroscope) {
    let mut criterion = Criterion::default().configure_from_args().sample_size(10);
    let mut group = criterion.benchmark_group("kernels");
    group.throughput(Throughput::Bytes(size_of_val(gyroscope.raw.as_slice()) as u64));
    for kernel in Kernel::ALL {
        group.bench_function(kernel.name(), |b| b.iter(|| gyroscope.run(kernel, Instructions::Best)));
    }
    group.finish();
    criterion.final_summary();
}

fn main() -> ExitCode {
    let words: Vec<String> = env::args().skip(1).collect();
    let once = match words.iter().position(|word| word == "--once").map(|place| &words[place + 1..]) {
        Some([name, samples, ..]) => {
            let kernel = Kernel::ALL.into_iter().find(|kernel| kernel.name() == name);
            let Some((kernel, samples)) = kernel.zip(samples.parse().ok()) else { return ExitCode::FAILURE };
            Some((kernel, samples))
        }
        _ => None,
    };
    let Some(gyroscope) = Gyroscope::new(once.map_or(SAMPLES, |(_, samples)| samples)) else {
        return ExitCode::FAILURE;
    };
    match once {
        Some((kernel, _)) => {
            black_box(gyroscope.run(kernel, Instructions::Best));
        }
        None if words.iter().any(|word| word == "--table") => table(&gyroscope),
        None => criterion(&gyroscope),
    }
    ExitCode::SUCCESS
}
