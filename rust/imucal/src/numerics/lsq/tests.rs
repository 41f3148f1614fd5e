use super::*;

/// Rosenbrock's function as residuals, (1 - x, 10 (y - x^2)), with x in a badly scaled unit.
struct Rosenbrock(f64);

impl Residuals for Rosenbrock {
    fn evaluate(&self, p: &[f64], r: &mut Mat<f64>, j: &mut Mat<f64>) {
        let (x, y) = (p[0] / self.0, p[1]);
        r[(0, 0)] = 1.0 - x;
        r[(1, 0)] = 10.0 * (y - x * x);
        j[(0, 0)] = -1.0 / self.0;
        j[(0, 1)] = 0.0;
        j[(1, 0)] = -20.0 * x / self.0;
        j[(1, 1)] = 10.0;
    }
    fn count(&self) -> usize {
        2
    }
}

#[test]
fn finds_the_minimum_in_any_unit() {
    for unit in [1e-6, 1.0, 1e6] {
        let solution = minimize(&Rosenbrock(unit), &[-1.2 * unit, 1.0], EXACT).unwrap();
        assert_eq!(solution.termination, Termination::Converged);
        assert!((solution.parameters[0] / unit - 1.0).abs() < 1e-12);
        assert!((solution.parameters[1] - 1.0).abs() < 1e-12);
        assert!(solution.iterations < 60, "{} iterations", solution.iterations);
    }
}

#[test]
fn a_start_that_is_not_finite_is_said() {
    let solution = minimize(&Rosenbrock(1.0), &[f64::NAN, 1.0], EXACT).unwrap();
    assert_eq!(solution.termination, Termination::NotFinite);
}

#[test]
fn covariance_is_the_inverse_of_the_normal_matrix() {
    let j = Mat::from_fn(7, 3, |i, k| ((i * i * (k + 1) + 1) as f64).sin() * 10f64.powi(k as i32 * 3));
    let product = covariance(&j) * (j.transpose() * &j);
    for i in 0..3 {
        for k in 0..3 {
            let expected = if i == k { 1.0 } else { 0.0 };
            let tolerance = 1e-9 * 10f64.powi(3 * (k as i32 - i as i32)).max(1e-3);
            assert!((product[(i, k)] - expected).abs() < tolerance, "{i} {k} {}", product[(i, k)]);
        }
    }
}

#[test]
fn leverages_are_the_diagonal_of_the_projection() {
    // The third column is zero, because the third parameter has no effect on the residuals.
    let j =
        Mat::from_fn(
            9,
            4,
            |i, k| if k == 2 { 0.0 } else { ((i * i * (k + 1) + 1) as f64).sin() * 10f64.powi(3 * k as i32) },
        );
    let free = Mat::from_fn(9, 3, |i, k| j[(i, if k < 2 { k } else { 3 })]);
    let expected = &free * gain(&free);
    for (i, leverage) in leverages(&j).into_iter().enumerate() {
        assert!((leverage - expected[(i, i)]).abs() < 1e-12, "{i}: {leverage} {}", expected[(i, i)]);
    }
    assert_eq!(leverages(&free.subrows(0, 2).to_owned()), vec![1.0; 2]);
}

#[test]
fn singular_values_of_a_wide_matrix_end_in_zeros() {
    let (values, vectors) = singular(&Mat::from_fn(2, 3, |i, j| if i == j { 3.0 - i as f64 } else { 0.0 })).unwrap();
    assert!((values[0] - 3.0).abs() < 1e-14 && (values[1] - 2.0).abs() < 1e-14 && values[2].abs() < 1e-14);
    assert!((vectors[(2, 2)].abs() - 1.0).abs() < 1e-14);
}
