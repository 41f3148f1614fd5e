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
        if [before, after].iter().all(|step| (step - h).abs() <= UNEVEN * h) {
            let (inner, outer) = (13.0 / 24.0, -1.0 / 24.0);
            (Self::Cubic, [outer, inner, inner, outer])
        } else if [before, after].iter().all(|step| (h / MOST_UNEVEN..=h * MOST_UNEVEN).contains(step)) {
            (Self::UnevenCubic, shares_of_cubic([t0, t1, t2, t3]))
        } else {
            straight
        }
    }
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
