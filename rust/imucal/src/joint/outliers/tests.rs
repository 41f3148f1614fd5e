//! Tests that the outlier statistic agrees with repeated fits, and that simulated errors are excluded.

use imucal_core::effects::Effect;
use nalgebra::Rotation3;

use super::*;
use crate::calibrate::{Options, Outcome, calibrate, prepare};
use crate::evaluate::MoveReport;
use crate::joint::EffectChoice;
use crate::recording::Recording;
use crate::rests::unit_rest::UnitRest;
use crate::simulate::{Program, RandomMoves, Simulation, Unit, simulate};

type Vector = nalgebra::Vector3<f64>;

const RATE_HZ: f64 = 100.0;
const NONE: Kinds = Kinds { in_motion: false, encoders: false };

fn run(moves: &RandomMoves, seed: u64) -> Simulation {
    simulate(&Program::random(moves, seed).unwrap(), &Unit::paper(), RATE_HZ, 9.80665, seed).unwrap()
}

/// Simulates the gyroscope program of the paper cited in docs/model.md: 46 rests and 45 moves.
fn paper(seed: u64) -> Simulation {
    run(&RandomMoves::default(), seed)
}

impl Simulation {
    fn calibrate(&self) -> Outcome {
        calibrate(&[self.recording("run")], &Options::default()).unwrap()
    }

    /// Rotates the simulated force at a rest by 0.5 deg. The gyroscope samples contain no such rotation.
    fn with_bad_direction(mut self, rest: usize) -> Self {
        let (start_s, end_s) = self.rests[rest];
        let inside = (start_s * RATE_HZ).ceil() as usize..(end_s * RATE_HZ).floor() as usize;
        let up = Vector::from(self.true_specific_force[inside.start]).normalize();
        let turn = Rotation3::new(up.cross(&Vector::ith(up.iamin(), 1.0)).normalize() * 0.5_f64.to_radians());
        self.specific_force[inside].iter_mut().for_each(|f| *f = (turn * Vector::from(*f)).into());
        self
    }

    /// Adds 100 deg/s to one gyroscope axis for 50 ms in the move after the rest `from`.
    fn with_bad_move(mut self, from: usize) -> Self {
        let middle_s = (self.rests[from].1 + self.rests[from + 1].0) / 2.0;
        let first = (middle_s * RATE_HZ) as usize;
        self.angular_rate[first..first + 5].iter_mut().for_each(|w| w[1] += 100_f64.to_radians());
        self
    }
}

/// Excluded rests (index, reason) and excluded moves (rest before, rest after, reason).
type LeftOut = (Vec<(usize, &'static str)>, Vec<(usize, usize, &'static str)>);

fn left_out(outcome: &Outcome) -> LeftOut {
    let rests = outcome.rests.iter().enumerate().filter_map(|(k, rest)| Some((k, rest.excluded?)));
    let of_move = |m: &MoveReport| Some((m.from_rest, m.to_rest, m.excluded?));
    (rests.collect(), outcome.moves.iter().filter_map(of_move).collect())
}

#[test]
fn nothing_is_named_in_clean_runs() {
    for seed in 1..=16 {
        assert_eq!(left_out(&paper(seed).calibrate()), (vec![], vec![]), "seed {seed}");
    }
}

#[test]
fn a_bad_move_is_named() {
    for (seed, from) in [(1, 0), (2, 20), (3, 44)] {
        let expected = (vec![], vec![(from, from + 1, "contradicts_other_moves")]);
        assert_eq!(left_out(&paper(seed).with_bad_move(from).calibrate()), expected);
    }
}

/// With the effect `accel_lever_arm`, the fit also uses the force in blocks inside the moves. The residuals of these
/// blocks do not show a short disturbance of the gyroscope, so the outlier test uses the gravity directions at the ends
/// of the move.
#[test]
fn a_bad_move_is_named_where_an_effect_acts_inside_the_moves() {
    let run = paper(1).with_bad_move(20);
    let effects = vec![EffectChoice::plain(Effect::find("accel_lever_arm").unwrap())];
    let outcome = calibrate(&[run.recording("run")], &Options { effects, ..Options::default() }).unwrap();
    assert_eq!(left_out(&outcome), (vec![], vec![(20, 21, "contradicts_other_moves")]));
}

/// The direction of gravity at one rest is wrong, and the fit excludes this rest. The moves before and after it are
/// accurate and are not reported as excluded. A single move from the previous rest to the next rest replaces them.
#[test]
fn a_rest_with_a_wrong_direction_is_named() {
    for (seed, rest) in [(1, 1), (2, 20), (3, 44)] {
        let outcome = paper(seed).with_bad_direction(rest).calibrate();
        assert_eq!(left_out(&outcome), (vec![(rest, "contradicts_other_rests")], vec![]));
        assert!(outcome.moves.iter().any(|m| (m.from_rest, m.to_rest) == (rest - 1, rest + 1)));
    }
}

/// Three cases: two consecutive moves are bad, a rest and the move after it are bad, or two consecutive rests are bad.
#[test]
fn bad_neighbours_are_told_apart_or_leave_nothing_behind() {
    for seed in 1..=6 {
        let clean = paper(seed).calibrate();
        for run in [
            paper(seed).with_bad_move(20).with_bad_move(21),
            paper(seed).with_bad_direction(20).with_bad_move(20),
            paper(seed).with_bad_direction(20).with_bad_direction(21),
        ] {
            let outcome = run.calibrate();
            let (rests, moves) = left_out(&outcome);
            let near = |k: usize| (19..=22).contains(&k);
            assert!(rests.iter().all(|(k, _)| near(*k)) && moves.iter().all(|(from, to, _)| near(*from) && near(*to)));
            // No bad residual remains, so noise explains the residuals of the moves. The variances of the parameters
            // grow by less than a factor of 3, because only the data of a few rests and moves are missing.
            assert_eq!(outcome.joint_scales.unwrap().moves, 1.0, "seed {seed}: {rests:?} {moves:?}");
            for (p, row) in outcome.covariance.iter().enumerate() {
                assert!(row[p] < 3.0 * clean.covariance[p][p], "seed {seed} {p}");
            }
        }
    }
}

#[test]
fn bad_ones_do_not_hide_each_other() {
    for seed in 1..=3 {
        let outcome = paper(seed).with_bad_direction(10).with_bad_direction(12).with_bad_move(20).calibrate();
        let rests = [10, 12].map(|k| (k, "contradicts_other_rests")).to_vec();
        assert_eq!(left_out(&outcome), (rests, vec![(20, 21, "contradicts_other_moves")]));
    }
}

/// Fits the simulated run `run`, and calls `work` with the inputs of this joint fit and the estimated model.
fn with(run: &Simulation, work: impl FnOnce(&Prepared<'_>, &Terms<'_>, &Model)) {
    let recording: Recording<'_> = run.recording("run");
    let terms = Terms::try_new(&[], &[], &[run.time_s.len()], NONE).unwrap();
    prepare(&[recording], NONE, |prepared, accelerometer, gyroscope| {
        work(prepared, &terms, &crate::joint::fit(prepared, &terms, [accelerometer, gyroscope], None)?.model);
        Ok(())
    })
    .unwrap();
}

/// An error of five standard deviations is added to the mean rate of one rest, on each axis. It is added after the
/// rests have been detected. The rest must be excluded.
#[test]
fn a_rest_with_a_wrong_rate_is_named() {
    for rest in [0, 20, 45] {
        with(&paper(1), |prepared, terms, model| {
            let mut rests: Vec<UnitRest> = prepared.rests.to_vec();
            let rate = &mut rests[rest].rest.angular_rate;
            rate.mean += 5.0 * rate.variance_of_mean.map(f64::sqrt);
            let prepared = Prepared { rests: &rests, encoders: None, ..*prepared };
            assert_eq!(outliers(&prepared, terms, model, None).unwrap(), [Item::Rest(rest)]);
        });
    }
}

/// The outliers found from the final residuals of a fit equal the outliers found after the samples are integrated
/// again.
#[test]
fn the_end_of_a_fit_is_judged_as_if_linearised_anew() {
    let run = paper(2).with_bad_move(20);
    let recording: Recording<'_> = run.recording("run");
    let terms = Terms::try_new(&[], &[], &[run.time_s.len()], NONE).unwrap();
    prepare(&[recording], NONE, |prepared, accelerometer, gyroscope| {
        let fit = crate::joint::fit(prepared, &terms, [accelerometer, gyroscope], None)?;
        let anew = prepared.linearise(&terms, &fit.model.parameters())?;
        let lines = |linear: &Linear| -> Vec<_> {
            linear.lines.iter().chain(linear.rates.iter().flat_map(|(_, lines)| lines)).cloned().collect()
        };
        for (known, new) in lines(&fit.linear).iter().zip(lines(&anew)) {
            assert!((known.residual - new.residual).abs() < 1e-10, "{} {}", known.residual, new.residual);
            for (known, new) in known.jacobian.iter().zip(&new.jacobian) {
                assert!((known - new).abs() < 1e-8 * (1.0 + new.abs()), "{known} {new}");
            }
        }
        let found = |known| outliers(prepared, &terms, &fit.model, known).unwrap();
        assert_eq!(found(Some(&fit.linear)), found(None));
        Ok(())
    })
    .unwrap();
}

/// Chi-square of a weighted least-squares fit to the residuals with the indices `rows` only.
fn chi2(covariance: &DMatrix<f64>, jacobian: &DMatrix<f64>, residuals: &DVector<f64>, rows: &[usize]) -> f64 {
    let n = rows.len();
    let factor = DMatrix::from_fn(n, n, |i, j| covariance[(rows[i], rows[j])]).cholesky().unwrap();
    let half = |m: &DMatrix<f64>| factor.l().solve_lower_triangular(&m.select_rows(rows)).unwrap();
    let residuals = DMatrix::from_column_slice(residuals.len(), 1, residuals.as_slice());
    let (mut columns, residuals) = (half(jacobian), half(&residuals));
    columns.column_iter_mut().for_each(|mut column| column /= column.norm());
    let q = columns.qr().q();
    residuals.norm_squared() - (q.transpose() * &residuals).norm_squared()
}

/// The outlier statistic of a group equals the decrease of chi-square in a repeated fit. A group contains the residuals
/// of a rest or move that are tested together, or the error of a rest's mean force. The repeated fit omits these
/// residuals, or it estimates this error as three additional parameters. All groups are tested, also after the removal
/// of other groups.
#[test]
fn the_statistic_is_that_of_a_fit_without_the_item() {
    let small = run(&RandomMoves { moves: 13, ..RandomMoves::default() }, 4).with_bad_move(6);
    with(&small, |prepared, terms, model| {
        let parameters = model.parameters();
        let linear = Arc::new(prepared.linearise(terms, &parameters).unwrap());
        let problem = Joint::of_noise(prepared, terms, Arc::clone(&linear)).unwrap();
        let lines: Vec<_> = linear.lines.iter().chain(linear.rates.iter().flat_map(|(_, lines)| lines)).collect();
        let n = lines.len();
        let residuals = DVector::from_fn(n, |i, _| lines[i].residual);
        let jacobian = DMatrix::from_fn(n, parameters.len(), |i, p| lines[i].jacobian[p]);
        let mut whitening = DMatrix::zeros(n, n);
        for (column, (first, values)) in problem.whitened_units(&linear).iter().enumerate() {
            values.iter().enumerate().for_each(|(i, value)| whitening[(first + i, column)] = *value);
        }
        let root = whitening.try_inverse().unwrap();
        let covariance = &root * root.transpose();
        // Column indices from n on belong to the mean forces of the rests.
        let refit = |without: &[usize]| {
            let rows: Vec<usize> = (0..n).filter(|row| !without.contains(row)).collect();
            let mut all = jacobian.clone();
            for mean in without.iter().filter_map(|column| column.checked_sub(n)) {
                let rest = linear.rates[mean / 3].0;
                let by =
                    |i: usize| lines[i].by_means.iter().filter(|(k, _)| *k == rest).map(|(_, by)| by[mean % 3]).sum();
                let place = all.ncols();
                all = all.insert_column(place, 0.0);
                (0..n).for_each(|i| all[(i, place)] = by(i));
            }
            chi2(&covariance, &all, &residuals, &rows)
        };

        let groups = groups(&linear);
        let (residuals, jacobian) = problem.whiten(&linear);
        let mut without = LeaveOut::new(&problem, &linear, (&residuals, &jacobian));
        let mut gone: Vec<usize> = Vec::new();
        let mut judged = 0;
        let mean = groups.iter().position(|group| group.kind == Kind::Mean && group.item == Item::Rest(9));
        for next in [None, Some(6), mean] {
            if let Some(k) = next {
                groups[k].columns.iter().for_each(|&column| without.leave_out(column));
                gone.extend(&groups[k].columns);
            }
            let before = refit(&gone);
            for group in groups.iter().filter(|group| !group.columns.iter().any(|column| gone.contains(column))) {
                let (misfit, freedom) = without.misfit(&group.columns);
                // Groups with a leverage of one in some direction cannot be tested.
                if freedom == group.columns.len() {
                    let after = refit(&[&gone[..], &group.columns].concat());
                    assert!((misfit - (before - after)).abs() < 1e-6 * before, "{:?}: {misfit}", group.item);
                    judged += 1;
                }
            }
        }
        assert!(judged > 100, "{judged}");
    });
}

/// If the p-value underflows to zero, its logarithm is computed from an asymptotic expansion.
#[test]
fn the_chance_of_what_is_far_too_bad_still_falls() {
    for freedom in 1..=3 {
        let at = |misfit: f64| log_p_value(misfit, freedom);
        assert!((at(900.0) - at(930.0) - 15.0).abs() < 0.1);
        assert!((at(5000.0) - at(5030.0) - 15.0).abs() < 0.1);
    }
    assert_eq!(log_p_value(0.0, 0), 0.0);
}
