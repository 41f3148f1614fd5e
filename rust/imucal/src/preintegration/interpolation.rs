//! Selects the interpolation of the rate between two samples: linear or cubic.

/// Maximum relative difference between two time steps that are treated as equal.
const UNEVEN: f64 = 0.01;
/// Cubic interpolation is used only if adjacent time steps differ by at most this factor. Otherwise, linear
/// interpolation is used, because it is more robust.
const MOST_UNEVEN: f64 = 3.0;

/// Interpolation of the rate between two samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Interpolation {
    /// Linear between the two samples.
    Linear,
    /// Cubic through four samples with nearly equal steps.
    Cubic,
    /// Cubic through four samples at unequal times. Steps with this interpolation are integrated without SIMD.
    UnevenCubic,
}

impl Interpolation {
    /// Selects the interpolation of the rate for the step from sample `i` to sample `i + 1`. The second result contains
    /// the weights with which the four samples `i - 1` to `i + 2` enter the mean rate over this step.
    #[inline]
    pub(crate) fn of(time_s: &[f64], i: usize) -> (Self, [f64; 4]) {
        let linear = (Self::Linear, [0.0, 0.5, 0.5, 0.0]);
        let Some(&[t0, t1, t2, t3]) = i.checked_sub(1).and_then(|first| time_s[first..].first_chunk()) else {
            return linear;
        };
        let (before, h, after) = (t1 - t0, t2 - t1, t3 - t2);
        if are_even(&[t0, t1, t2, t3]) {
            let (inner, outer) = (13.0 / 24.0, -1.0 / 24.0);
            (Self::Cubic, [outer, inner, inner, outer])
        } else if [before, after].iter().all(|step| (h / MOST_UNEVEN..=h * MOST_UNEVEN).contains(step)) {
            (Self::UnevenCubic, cubic_weights([t0, t1, t2, t3]))
        } else {
            linear
        }
    }
}

/// Whether the three time steps between four samples are nearly equal.
#[inline(always)]
fn are_even([t0, t1, t2, t3]: &[f64; 4]) -> bool {
    let (before, h, after) = (t1 - t0, t2 - t1, t3 - t2);
    are_equal_steps(before, h) & are_equal_steps(after, h)
}

/// Whether two time steps, s, are nearly equal.
#[inline(always)]
pub(crate) fn are_equal_steps(step: f64, other: f64) -> bool {
    (step - other).abs() <= UNEVEN * other
}

/// Number of time steps that [`end_of_equal_steps`] compares in one vectorised operation.
const AT_ONCE: usize = 32;

/// Finds the first step, at or after step `start`, whose interpolation differs from `interpolation`. Returns `end` if
/// no step before `end` differs. `start` must not be zero. Nearly all recordings have only equal steps, which a
/// vectorised comparison of many steps detects quickly.
pub(super) fn end_of_equal_steps(time_s: &[f64], start: usize, end: usize, interpolation: Interpolation) -> usize {
    let mut next = start;
    while interpolation == Interpolation::Cubic
        && next + AT_ONCE <= end
        && let Some(around) = time_s.get(next - 1..next + AT_ONCE + 2)
        && around.windows(4).fold(true, |even, t| even & are_even(&[t[0], t[1], t[2], t[3]]))
    {
        next += AT_ONCE;
    }
    (next..end).find(|&i| Interpolation::of(time_s, i).0 != interpolation).unwrap_or(end)
}

/// Computes the weights with which four samples at these times enter the mean rate over the middle time step. The rate
/// is assumed to be the cubic polynomial through the four samples.
pub(crate) fn cubic_weights([before, start, end, after]: [f64; 4]) -> [f64; 4] {
    let (a, h, b) = (start - before, end - start, after - end);
    // Mean of the cubic over the middle step = mean of the linear interpolation - h^2/6 x D. D is the weighted mean of
    // the second divided differences of the first three samples (weight 1 - `late`) and of the last three samples
    // (weight `late`).
    let late = (h / 2.0 + a) / (a + h + b);
    let (left, right) = ((1.0 - late) * h * h / 6.0, late * h * h / 6.0);
    [
        -left / (a * (a + h)),
        0.5 + left / (a * h) - right / (h * (h + b)),
        0.5 - left / (h * (a + h)) + right / (h * b),
        -right / (b * (h + b)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_that_is_not_even_is_found_wherever_it_is() {
        let end = 3 * AT_ONCE;
        let even = |i: usize| i as f64 * 0.01;
        for late in 0..=end + 2 {
            // From sample `late` on, all times are later by three quarters of a step.
            let time_s: Vec<f64> = (0..end + 3).map(|i| even(i) + if i >= late { 0.0075 } else { 0.0 }).collect();
            let is_other = |i: &usize| Interpolation::of(&time_s, *i).0 != Interpolation::Cubic;
            for start in [1, 2, AT_ONCE] {
                let expected = (start..end).find(is_other).unwrap_or(end);
                assert_eq!(end_of_equal_steps(&time_s, start, end, Interpolation::Cubic), expected, "{late} {start}");
            }
        }
    }
}
