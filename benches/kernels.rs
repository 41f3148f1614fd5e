//! Time of the integration kernels beside a plain sum (`cargo bench --bench kernels`).

use imucal::carry::{Instructions, Pace, Path};
use imucal_core::sensor::Triad;
use nalgebra::{Matrix3, Vector3};
use std::hint::black_box;
use std::time::Instant;
fn main() {
    let n = 10_000_000;
    let raw: Vec<[f64; 3]> = (0..n)
        .map(|k| {
            let t = k as f64 * 1.25e-4;
            [t.sin() + 1e-3 * (k as f64).sin(), 1.0, 0.1 * t.cos()]
        })
        .collect();
    let stamps: Vec<f64> = (0..n).map(|k| k as f64 * 1.25e-4).collect();
    let triad = Triad::try_new(
        Matrix3::new(1.1, 0.05, -0.02, 0.03, 0.9, 0.04, -0.06, 0.01, 1.05),
        Vector3::new(0.1, -0.2, 0.05),
    )
    .unwrap();
    let c = n / 45;
    for set in Instructions::available() {
        let mut all = vec![];
        for _ in 0..7 {
            let time = |work: &dyn Fn(usize) -> f64| {
                let t = Instant::now();
                let mut s = 0.0;
                for j in 0..45 {
                    s += work(j * c);
                }
                black_box(s);
                t.elapsed().as_secs_f64() * 1e9 / (45 * c) as f64
            };
            let sum = time(&|j| {
                let mut acc = [0.0f64; 48];
                for chunk in raw[j..j + c].as_flattened().chunks_exact(48) {
                    for i in 0..48 {
                        acc[i] += chunk[i];
                    }
                }
                acc.iter().sum()
            });
            let even = |j: usize| Path::straight(&raw[j..j + c], Pace::Even(1.25e-4)).with(set);
            let uneven = |j: usize| Path::straight(&raw[j..j + c], Pace::Stamps(&stamps[j..j + c])).with(set);
            let cubic = |j: usize| Path::cubic(&raw[j..j + c], Pace::Even(1.25e-4)).with(set);
            all.push([
                sum,
                time(&|j| even(j).rotation(&triad).m11),
                time(&|j| uneven(j).rotation(&triad).m11),
                time(&|j| even(j).carry(&triad).rotation.m11),
                time(&|j| uneven(j).carry(&triad).rotation.m11),
                time(&|j| cubic(j).carry(&triad).rotation.m11),
            ]);
        }
        let m: Vec<f64> = (0..6)
            .map(|i| {
                let mut v: Vec<f64> = all.iter().map(|a| a[i]).collect();
                v.sort_by(f64::total_cmp);
                v[3]
            })
            .collect();
        println!(
            "{set:?} sum {:.2} rot {:.2} rot stamps {:.2} sums {:.2} sums stamps {:.2} cubic {:.2}",
            m[0], m[1], m[2], m[3], m[4], m[5]
        );
    }
}
