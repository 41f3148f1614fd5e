//! What the rate does between two samples.

/// Steps that differ by less than this share are taken as even.
const UNEVEN: f64 = 0.01;
/// Where they differ by more than this factor, a straight line is safer than a cubic.
const MOST_UNEVEN: f64 = 3.0;

/// What the rate does between two samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Between {
    /// It goes straight.
    Straight,
    /// It is the cubic through four samples as far from each other, or nearly.
    Cubic,
    /// It is the cubic through four samples at their own times. These steps are taken one by one.
    UnevenCubic,
}

impl Between {
    /// Of the step after sample `i`, and the shares of the four samples around it in its mean there.
    #[inline]
    pub(crate) fn of(time_s: &[f64], i: usize) -> (Self, [f64; 4]) {
        let straight = (Self::Straight, [0.0, 0.5, 0.5, 0.0]);
        let Some(&[t0, t1, t2, t3]) = i.checked_sub(1).and_then(|first| time_s[first..].first_chunk()) else {
            return straight;
        };
        let (before, h, after) = (t1 - t0, t2 - t1, t3 - t2);
        if are_even(&[t0, t1, t2, t3]) {
            let (inner, outer) = (13.0 / 24.0, -1.0 / 24.0);
            (Self::Cubic, [outer, inner, inner, outer])
        } else if [before, after].iter().all(|step| (h / MOST_UNEVEN..=h * MOST_UNEVEN).contains(step)) {
            (Self::UnevenCubic, shares_of_cubic([t0, t1, t2, t3]))
        } else {
            straight
        }
    }
}

/// Whether the steps between four samples are even, or nearly.
#[inline(always)]
fn are_even([t0, t1, t2, t3]: &[f64; 4]) -> bool {
    let (before, h, after) = (t1 - t0, t2 - t1, t3 - t2);
    are_alike(before, h) & are_alike(after, h)
}

/// Whether a step is as long as another, or nearly.
#[inline(always)]
pub(crate) fn are_alike(step: f64, other: f64) -> bool {
    (step - other).abs() <= UNEVEN * other
}

/// Steps that are asked about at once.
const AT_ONCE: usize = 32;

/// The first step from `start`, which is not zero, that is not like `between`; `end` if all before that are. Nearly always all are even,
/// which many together say in next to no time.
pub(super) fn until_other(time_s: &[f64], start: usize, end: usize, between: Between) -> usize {
    let mut next = start;
    while between == Between::Cubic
        && next + AT_ONCE <= end
        && let Some(around) = time_s.get(next - 1..next + AT_ONCE + 2)
        && around.windows(4).fold(true, |even, t| even & are_even(&[t[0], t[1], t[2], t[3]]))
    {
        next += AT_ONCE;
    }
    (next..end).find(|&i| Between::of(time_s, i).0 != between).unwrap_or(end)
}

/// Shares of four samples, taken at these times, in the mean of the cubic through all of them over the step between the middle two.
pub(crate) fn shares_of_cubic([before, start, end, after]: [f64; 4]) -> [f64; 4] {
    let (a, h, b) = (start - before, end - start, after - end);
    // The straight line's, less a sixth of h^2 times the second divided difference: of either side by how far the other reaches.
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
            // From there on everything is later by three quarters of a step.
            let time_s: Vec<f64> = (0..end + 3).map(|i| even(i) + if i >= late { 0.0075 } else { 0.0 }).collect();
            let is_other = |i: &usize| Between::of(&time_s, *i).0 != Between::Cubic;
            for start in [1, 2, AT_ONCE] {
                let expected = (start..end).find(is_other).unwrap_or(end);
                assert_eq!(until_other(&time_s, start, end, Between::Cubic), expected, "{late} {start}");
            }
        }
    }
}
