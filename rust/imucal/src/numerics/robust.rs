//! Detects outliers, which are rests or moves that contradict all other rests or moves (model.md (14)).

use faer::Mat;

use crate::numerics::lsq;
use crate::numerics::stats::{MEDIAN_SIZE, median};

/// A rest or move is an outlier if its score, divided by the robust scale of all scores (see [`worst_outlier`]),
/// exceeds this limit. With normally distributed errors, the score of a valid rest or move exceeds the limit with a
/// probability of 2e-7 (one residual) or 1.3e-6 (two residuals).
const LIMIT: f64 = 5.2;

/// Score of each rest or move: the norm of its studentised residuals r / sqrt(1 - h). r is a residual of the fit, and h
/// is its leverage. A studentised residual is the residual in a fit without this measurement, divided by the standard
/// deviation of that residual. The residuals of a rest or move are `size` consecutive rows of `residuals`, and their
/// derivatives are the same rows of `jacobian`.
pub(crate) fn leave_one_out(residuals: &Mat<f64>, jacobian: &Mat<f64>, size: usize) -> Vec<f64> {
    let hat_rows = lsq::leverages(jacobian);
    (0..residuals.nrows() / size)
        .map(|item| {
            let rows = item * size..(item + 1) * size;
            // If the leverage of a measurement is near one, the fit reproduces any value of this measurement. The
            // residual is then no evidence of an outlier and is replaced by zero.
            rows.map(|row| {
                let free = (1.0 - hat_rows[row]).max(0.0);
                if free > 0.05 { residuals[(row, 0)].powi(2) / free } else { 0.0 }
            })
            .sum::<f64>()
            .sqrt()
        })
        .collect()
}

/// The rest or move with the largest score; `None` if it is not an outlier. `size` is the number of residuals of each
/// rest or move. Before the comparison with the limit, all scores are divided by the same scale. The scale is (median
/// of the scores) / (median expected for normally distributed errors), but at least one.
pub(crate) fn worst_outlier(scores: &[f64], size: usize) -> Option<usize> {
    // Median of the score for normally distributed errors. With one residual, the score is the absolute value of a
    // standard normal variable. With two residuals, the score is the square root of a chi2 variable with two degrees of
    // freedom.
    let median_of_clean = if size == 1 { MEDIAN_SIZE } else { 1.177_410_02 };
    let scale = (median(&mut scores.to_vec()) / median_of_clean).max(1.0);
    let worst = (0..scores.len()).max_by(|&a, &b| scores[a].total_cmp(&scores[b]))?;
    (scores[worst] > LIMIT * scale).then_some(worst)
}

/// Whether one more rest or move may be excluded. At most a fifth of all rests or moves may be excluded, and at least
/// `least` of them must remain. `used` is false for rests or moves that are already excluded.
pub(crate) fn may_exclude(used: &[bool], least: usize) -> bool {
    let kept = used.iter().filter(|&&kept| kept).count();
    kept > least && used.len() - kept < used.len() / 5
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_wild_value_is_found_and_a_wide_but_even_scatter_is_not() {
        let mut scores: Vec<f64> = (1..40).map(|k| f64::from(k % 7) * 3.0).collect();
        assert_eq!(worst_outlier(&scores, 1), None);
        scores[11] = 200.0;
        assert_eq!(worst_outlier(&scores, 1), Some(11));
    }

    #[test]
    fn an_item_that_the_fit_follows_blindly_is_not_judged() {
        // Only the last row depends on the second parameter, so every fit makes the residual of this row zero, except
        // for rounding errors.
        let jacobian = Mat::from_fn(5, 2, |i, j| f64::from(u8::from((i < 4) == (j == 0))));
        let residuals = Mat::from_fn(5, 1, |i, _| if i == 4 { 1e-9 } else { 1.0 });
        assert_eq!(leave_one_out(&residuals, &jacobian, 1)[4], 0.0);
    }
}
