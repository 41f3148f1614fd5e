//! Duration of the on-device integrator per sample, in f32 and f64 (`cargo bench --bench integrate`).

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use imucal_core::integrate::Integrator;
use nalgebra::{RealField, Vector3, convert};

const SAMPLES: usize = 10_000;

fn rates<F: RealField + Copy>() -> Vec<Vector3<F>> {
    let rate = |k: usize| {
        let t = k as f64 * 1e-3;
        Vector3::new((1.3 * t).sin(), 2.0 * (0.9 * t).cos(), 1.5 * (2.1 * t).sin()).map(convert)
    };
    (0..SAMPLES).map(rate).collect()
}

fn bench<F: RealField + Copy>(criterion: &mut Criterion, name: &str) {
    let (rates, dt_s) = (rates::<F>(), convert(1e-3));
    let mut group = criterion.benchmark_group("integrate");
    group.throughput(Throughput::Elements(SAMPLES as u64));
    group.bench_function(name, |b| {
        b.iter(|| {
            let mut integrator = Integrator::new();
            black_box(&rates).iter().for_each(|&rate| integrator.push(dt_s, rate));
            integrator.rotation()
        });
    });
    group.finish();
}

fn both(criterion: &mut Criterion) {
    bench::<f32>(criterion, "f32");
    bench::<f64>(criterion, "f64");
}

criterion_group!(benches, both);
criterion_main!(benches);
