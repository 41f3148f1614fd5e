use super::*;
use crate::numerics::lsq::{EXACT, Residuals, minimize, minimize_within};

/// Simulated problem with three residuals: `(1 - x, steep (y - x^2), 3 + kink |x - 1/2|)`. The first two residuals form
/// Rosenbrock's curved valley, whose walls are `steep` times as steep as its floor. The third residual has a kink at x
/// = 1/2.
struct Valley {
    steep: f64,
    kink: f64,
}

impl Residuals for Valley {
    fn evaluate(&self, p: &[f64], r: &mut Mat<f64>, j: &mut Mat<f64>) {
        let Self { steep, kink } = self;
        let (x, y) = (p[0], p[1]);
        let rows = [
            (1.0 - x, [-1.0, 0.0]),
            (steep * (y - x * x), [-2.0 * steep * x, *steep]),
            (3.0 + kink * (x - 0.5).abs(), [kink * (x - 0.5).signum(), 0.0]),
        ];
        for (k, (residual, slopes)) in rows.into_iter().enumerate() {
            r[(k, 0)] = residual;
            (j[(k, 0)], j[(k, 1)]) = slopes.into();
        }
    }

    fn count(&self) -> usize {
        3
    }
}

const START: [f64; 2] = [-1.2, 1.0];

fn fitted(valley: &Valley, iterations: Option<u64>) -> FitReport {
    FitReport::of(&match iterations {
        Some(most) => minimize_within(valley, &START, EXACT, most).unwrap(),
        None => minimize(valley, &START, EXACT).unwrap(),
    })
}

#[test]
fn a_fit_that_ends_at_its_optimum_has_no_reason() {
    let report = fitted(&Valley { steep: 10.0, kink: 0.0 }, None);
    assert_eq!((report.termination, report.reason("the fit")), (Termination::Converged, None), "{report:?}");
    assert!(report.predicted_decrease < 1e-12, "{report:?}");
}

#[test]
fn a_fit_with_a_bound_of_five_iterations_has_not_converged() {
    let report = fitted(&Valley { steep: 10.0, kink: 0.0 }, Some(5));
    assert_eq!((report.termination, report.iterations), (Termination::IterationLimit, 5), "{report:?}");
    let reason = report.reason("the fit").unwrap();
    assert!(reason.starts_with("the fit reached its limit of 5 iterations"), "{reason}");
}

/// The walls are a million times as steep as the floor. The steps along the curved floor are therefore tiny, and the
/// fit does not reach its optimum within the iteration limit.
#[test]
fn a_fit_in_a_flat_valley_has_not_converged() {
    let report = fitted(&Valley { steep: 1e6, kink: 0.0 }, None);
    assert_eq!(report.termination, Termination::IterationLimit, "{report:?}");
    assert!(report.predicted_decrease > 1.0, "{report:?}");
    assert!(report.reason("the fit").unwrap().contains("further decrease of chi2 by"));
}

/// At the kink no step decreases chi2, although the gradient is nonzero on both sides.
#[test]
fn a_fit_at_a_kink_stalls() {
    let report = fitted(&Valley { steep: 10.0, kink: 20.0 }, None);
    assert_eq!(report.termination, Termination::Stalled, "{report:?}");
    let reason = report.reason("the fit").unwrap();
    assert!(reason.starts_with("the fit stalled after"), "{reason}");
}

#[test]
fn a_direction_without_derivative_has_no_gradient() {
    let jacobian = Mat::from_fn(4, 3, |i, j| if j == 1 { 0.0 } else { ((i * i * (j + 1) + 1) as f64).sin() });
    let free = Mat::from_fn(4, 2, |i, j| jacobian[(i, 2 * j)]);
    let residuals = Mat::from_fn(4, 1, |i, _| 1.0 + i as f64);
    let expected = (&free * (crate::numerics::lsq::gain(&free) * &residuals)).squared_norm_l2();
    assert!((predicted_decrease(&residuals, &jacobian) / expected - 1.0).abs() < 1e-12);
    assert_eq!(predicted_decrease(&Mat::from_fn(4, 1, |_, _| f64::NAN), &jacobian), f64::INFINITY);
}

/// A fit whose weights still change, or whose residuals are not finite, is reported with its own reason, even if the
/// result passes the gradient test.
#[test]
fn every_other_ending_has_a_reason_of_its_own() {
    let converged = fitted(&Valley { steep: 10.0, kink: 0.0 }, None);
    let reasons = [Termination::WeightsNotSettled, Termination::NotFinite].map(|termination| {
        let reason = FitReport { termination, ..converged }.reason("the joint fit").unwrap();
        assert!(reason.contains("the result is not its optimum"), "{reason}");
        reason
    });
    assert!(reasons[0].contains("weights"), "{reasons:?}");
    assert!(reasons[1].contains("not finite"), "{reasons:?}");
}
