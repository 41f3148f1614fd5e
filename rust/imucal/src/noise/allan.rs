//! Computes the overlapping Allan deviation (`docs/model.md` (29)).
//!
//! ```text
//! sigma^2(m) = 1 / (2 m^2 (N - 2m + 1))  sum over i = 0 to N - 2m of (p_(i+2m) - 2 p_(i+m) + p_i)^2
//! p_i = x_1 + ... + x_i,   p_0 = 0
//! ```
//!
//! x_1 to x_N are the samples at equal intervals (rates or specific forces), with their mean subtracted. The averaging
//! time tau is m sampling intervals. Sources: IEEE Std 1139, and IEEE Std 952 for inertial sensors.

use std::num::NonZeroUsize;

use crate::error::Error;
use crate::numerics::workers::in_order;

/// Number of second differences (terms of the sum over i) in a block. The sums for all averaging times are computed
/// over one block before the next block, so that the data of the block stay in the processor's cache.
const BLOCK: usize = 4096;
/// Number of blocks in a job, the part of the sums that a thread computes at a time. The results of the jobs are added
/// in a fixed order. The sums, including their rounding errors, therefore do not depend on the number of threads.
const BLOCKS_PER_JOB: usize = 64;
/// Number of partial sums that [`block_sum`] accumulates in parallel. Eight `f64` values fill one vector register of
/// 512 bits.
const LANES: usize = 8;

/// Averaging times 1, 2, 4, 8, ... in samples, up to half of `samples`, the length of the record. With this limit, the
/// record is long enough for two consecutive means.
pub fn octave_factors(samples: usize) -> Vec<usize> {
    std::iter::successors(Some(1), |&m: &usize| m.checked_mul(2))
        .take_while(|m| m.saturating_mul(2) <= samples)
        .collect()
}

/// Averaging times in samples, about four per octave: 1, 2, 3, 4, 5, 6, 7, 8, 10, 11, 13, 16, ..., up to half of
/// `samples`. Four points per octave are sufficient to show the slopes in an Allan plot.
pub fn quarter_octave_factors(samples: usize) -> Vec<usize> {
    let mut factors: Vec<usize> = octave_factors(samples)
        .into_iter()
        .flat_map(|m| [0.0, 0.25, 0.5, 0.75].map(|part: f64| (m as f64 * part.exp2()).round() as usize))
        .filter(|m| m.saturating_mul(2) <= samples)
        .collect();
    factors.dedup();
    factors
}

/// Averaging times 1, 2, 4, 10, 20, 40, 100, ... in samples, up to half of `samples`, the length of the record.
pub fn decade_factors(samples: usize) -> Vec<usize> {
    std::iter::successors(Some(1), |&decade: &usize| decade.checked_mul(10))
        .take_while(|&decade| decade <= samples)
        .flat_map(|decade| [1, 2, 4].map(|m| decade.saturating_mul(m)))
        .filter(|m| m.saturating_mul(2) <= samples)
        .collect()
}

/// Overlapping Allan deviations of `values`, in the unit of the values. The averaging times are `factors`, in samples.
///
/// The values are not copied. Memory is only needed for their cumulative sums, one f64 per sample. The result does not
/// depend on the number of `threads`.
///
/// # Errors
/// [`Error::Input`] for a value that is not finite, and for a factor that is zero or exceeds half of the samples.
pub fn overlapping_deviations(
    values: impl ExactSizeIterator<Item = f64> + Clone,
    factors: &[usize],
    threads: NonZeroUsize,
) -> Result<Vec<f64>, Error> {
    let samples = values.len();
    if let Some(factor) = factors.iter().find(|&&m| m == 0 || m.saturating_mul(2) > samples) {
        return Err(Error::Input(format!(
            "an average of {factor} samples is requested, but there are only {samples}: give 1 to {}",
            samples / 2
        )));
    }
    let phase = sums(values)?;
    let squares = squared_differences(&phase, factors, threads.get());
    let deviation = |(&m, sum): (&usize, f64)| {
        let count = (phase.len() - 2 * m) as f64;
        (sum / (2.0 * count)).sqrt() / m as f64
    };
    Ok(factors.iter().zip(squares).map(deviation).collect())
}

/// Cumulative sums p_0 = 0 to p_N. The mean is subtracted first, which keeps the sums and their rounding errors small.
fn sums(values: impl ExactSizeIterator<Item = f64> + Clone) -> Result<Vec<f64>, Error> {
    let samples = values.len();
    let mean = values.clone().sum::<f64>() / samples.max(1) as f64;
    if !mean.is_finite() {
        let at = values.clone().position(|value| !value.is_finite());
        return Err(Error::Input(at.map_or_else(
            || "the values are too large to be summed: give SI units or counts".to_owned(),
            |at| format!("value {at} is not finite: leave out the samples around it, or interpolate them"),
        )));
    }
    let mut phase = vec![0.0; samples + 1];
    let mut sum = 0.0;
    phase[1..].iter_mut().zip(values).for_each(|(place, value)| {
        sum += value - mean;
        *place = sum;
    });
    Ok(phase)
}

/// Computes, for each averaging time in `factors` (in samples), the sum over i in the formula of the module
/// documentation. `phase` contains the cumulative sums p.
fn squared_differences(phase: &[f64], factors: &[usize], threads: usize) -> Vec<f64> {
    // The averaging times are processed in ascending order. The sum for the next averaging time then reads many of the
    // values of `phase` that are already in the cache.
    let mut order: Vec<usize> = (0..factors.len()).collect();
    order.sort_unstable_by_key(|&k| factors[k]);
    let job_len = BLOCK * BLOCKS_PER_JOB;
    let of_job = |job: usize| {
        let mut sums = vec![0.0; factors.len()];
        for start in (job * job_len..((job + 1) * job_len).min(phase.len())).step_by(BLOCK) {
            for &k in &order {
                let m = factors[k];
                let end = (start + BLOCK).min(phase.len() - 2 * m);
                if start < end {
                    sums[k] +=
                        block_sum(&phase[start..end], &phase[start + m..end + m], &phase[start + 2 * m..end + 2 * m]);
                }
            }
        }
        sums
    };
    let mut total = vec![0.0; factors.len()];
    for sums in in_order(threads, phase.len().div_ceil(job_len), of_job) {
        total.iter_mut().zip(sums).for_each(|(total, sum)| *total += sum);
    }
    total
}

/// Sum of (third - 2 second + first)^2 over the elements of a block. With several partial sums, the compiler can use
/// vector instructions.
fn block_sum(first: &[f64], second: &[f64], third: &[f64]) -> f64 {
    let (a, a_rest) = first.as_chunks::<LANES>();
    let (b, b_rest) = second.as_chunks::<LANES>();
    let (c, c_rest) = third.as_chunks::<LANES>();
    let mut sums = [0.0; LANES];
    for ((a, b), c) in a.iter().zip(b).zip(c) {
        for lane in 0..LANES {
            let difference = (c[lane] - b[lane]) - (b[lane] - a[lane]);
            sums[lane] += difference * difference;
        }
    }
    let rest = a_rest.iter().zip(b_rest).zip(c_rest).map(|((a, b), c)| ((c - b) - (b - a)).powi(2));
    sums.iter().sum::<f64>() + rest.sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    const ONE: NonZeroUsize = NonZeroUsize::MIN;

    fn deviations(values: &[f64], factors: &[usize]) -> Vec<f64> {
        overlapping_deviations(values.iter().copied(), factors, ONE).unwrap()
    }

    /// Test data that vary strongly from sample to sample but are not random.
    fn rough(n: usize) -> Vec<f64> {
        (0..n).map(|i| ((i * i) as f64 * 0.37).sin() + (i as f64 * 1e-3).cos() + 9.81).collect()
    }

    /// The nine frequencies are from NBS Monograph 140, Annex 8.E, and their Allan deviations from NIST SP 1065, table
    /// 31.
    #[test]
    fn nine_published_points_have_the_published_deviations() {
        let values = [892.0, 809.0, 823.0, 798.0, 671.0, 644.0, 883.0, 903.0, 677.0];
        let found = deviations(&values, &[1, 2]);
        assert!((found[0] - 91.22945).abs() < 5e-6 && (found[1] - 85.95287).abs() < 5e-6, "{found:?}");
    }

    #[test]
    fn deviations_are_those_of_the_definition() {
        let values = rough(20_000);
        let factors = [1, 7, 64, 1000, 9_999, 10_000];
        for (m, found) in factors.into_iter().zip(deviations(&values, &factors)) {
            let mean = |start: usize| values[start..start + m].iter().sum::<f64>() / m as f64;
            let starts = values.len() - 2 * m + 1;
            let sum: f64 = (0..starts).map(|i| (mean(i + m) - mean(i)).powi(2)).sum();
            let expected = (sum / (2.0 * starts as f64)).sqrt();
            assert!((found / expected - 1.0).abs() < 1e-11, "{m}: {found}, not {expected}");
        }
    }

    #[test]
    fn threads_change_no_bit() {
        let values = rough(600_000);
        let factors = octave_factors(values.len());
        let found = |threads| overlapping_deviations(values.iter().copied(), &factors, threads).unwrap();
        assert_eq!(found(ONE), found(NonZeroUsize::new(3).unwrap()));
    }

    #[test]
    fn factors_end_where_two_means_do() {
        assert_eq!(octave_factors(9), [1, 2, 4]);
        assert_eq!(quarter_octave_factors(33), [1, 2, 3, 4, 5, 6, 7, 8, 10, 11, 13, 16]);
        assert_eq!(decade_factors(40), [1, 2, 4, 10, 20]);
        assert!(octave_factors(1).is_empty() && decade_factors(0).is_empty() && quarter_octave_factors(1).is_empty());
    }

    #[test]
    fn bad_input_is_named() {
        let message = |values: &[f64], factor| {
            overlapping_deviations(values.iter().copied(), &[factor], ONE).unwrap_err().to_string()
        };
        assert!(message(&[1.0, 2.0], 2).contains("average of 2 samples"));
        assert!(message(&[1.0, 2.0], 0).contains("average of 0 samples"));
        assert!(message(&[1.0, f64::NAN, 2.0], 1).contains("value 1 is not finite"));
        assert!(message(&[f64::MAX, f64::MAX], 1).contains("too large"));
    }
}
