//! Detection of recordings of several units in one calibration, and of biases that changed between recordings of one
//! unit.
//!
//! If the recordings cannot be fitted together, each recording is fitted separately. If the recordings are of different
//! units, their sensitivities differ by far more than the standard deviations. If one unit was switched off between the
//! recordings, only the biases differ.

use imucal_core::calibration::Calibration;

use super::Outcome;
use super::unit_data::NOT_STILL;
use crate::error::Error;
use crate::finding::{Finding, general};
use crate::parameters::{ACCEL, BASE, GYRO_BIAS, WORDS};
use crate::recording::Recording;
use crate::verdict::Verdict;

/// A parameter differs between two recordings if |difference| / (standard deviation of the difference) is at least this
/// value. With 15 parameters and ten recordings of one unit, noise alone exceeds this limit in one of a million
/// calibrations.
const DIFFERENT: f64 = 6.0;
/// For a difference of sensitivities to be reported, |difference| / (mean scale) must also be at least this value. A
/// smaller difference has no practical effect, even if it is significant.
const LEAST_SHARE: f64 = 2e-4;
/// Recordings fit together if (chi2 per degree of freedom of the fit to all recordings) / (chi2 per degree of freedom
/// of the separate fits) is at most this value. An effect that the model lacks increases both values equally, so the
/// ratio stays near one.
const WORSE_TOGETHER: f64 = 4.0;
/// Recordings fit together only if the fit to all recordings excludes at most this share of the rests that the separate
/// fits use. Without this limit, the rests of a second unit could be excluded as outliers, and chi2 would describe only
/// the first unit.
const EXCLUDED: f64 = 0.1;
/// Different scales are no evidence of different units if the mean temperatures of the recordings differ by more than
/// this value, K. Scales of MEMS sensors change by up to 0.05 %/K, whereas misalignments hardly change.
const WARMER_K: f64 = 5.0;
/// Maximum number of differing parameters that a message about two recordings names.
const NAMED: usize = 3;

/// A recording and its separate fit, which uses no other recording.
struct Alone<'a> {
    name: &'a str,
    outcome: Outcome,
    /// Mean temperature, degC; `None` if it is not known.
    temperature_degc: Option<f64>,
}

/// A parameter that differs between two recordings.
struct Difference {
    words: String,
    /// Difference divided by its standard deviation.
    times_sigma: f64,
}

/// Returns findings about recordings that cannot be fitted together. Recordings of several units are an error, and
/// changed biases of one unit are a warning. `together` is the result of the fit without effects to all recordings.
/// `fit_alone` performs the fit to a single recording, in the symmetric frame.
///
/// # Errors
/// [`Error::Cancelled`] if the calculation was cancelled.
pub(super) fn several_units(
    recordings: &[Recording<'_>],
    together: Result<&Outcome, &Error>,
    fit_alone: impl Fn(&Recording<'_>) -> Result<Outcome, Error>,
) -> Result<Vec<Finding>, Error> {
    // Only failures of the fit are examined here. A fault of the data, for example an altered copy of another
    // recording, has already been reported and does not indicate several units.
    let is_of_fit = |error: &Error| matches!(error, Error::Fit(_) | Error::NotEnoughMotion(_));
    let fits_together = together.map_or_else(|error| !is_of_fit(error), |outcome| outcome.verdict() == Verdict::Good);
    if recordings.len() < 2 {
        return Ok(Vec::new());
    }
    let unused = together.map_or_else(|_| Vec::new(), |outcome| unused_recordings(recordings, outcome));
    if fits_together {
        return Ok(unused);
    }
    let mut alone = Vec::new();
    for recording in recordings {
        match fit_alone(recording) {
            Ok(outcome) if !matches!(outcome.verdict(), Verdict::Poor(_)) => {
                alone.push(Alone { name: recording.name, outcome, temperature_degc: mean_temperature(recording) });
            }
            Err(error) if !is_of_fit(&error) && !matches!(error, Error::Data(_)) => return Err(error),
            // The recording has too few poses or a fault, so it provides no information about the unit.
            _ => {}
        }
    }
    if alone.len() < 2 || together.is_ok_and(|outcome| !is_worse_together(outcome, &alone)) {
        return Ok(unused);
    }
    let groups = groups(&alone);
    if groups.len() > 1 {
        return Ok(vec![different_units(&alone, &groups)]);
    }
    let moved = together.ok().and_then(|_| biases_moved(&alone));
    Ok(moved.into_iter().chain(unused).collect())
}

/// Returns a warning for each recording whose rests are all excluded from the fit.
fn unused_recordings(recordings: &[Recording<'_>], outcome: &Outcome) -> Vec<Finding> {
    let unused = |(index, recording): (usize, &Recording<'_>)| {
        let rests = || outcome.rests.iter().filter(|rest| rest.recording == index);
        let count = rests().count();
        let contradicts = |reason: &str| reason == NOT_STILL || reason.starts_with("contradicts");
        (count > 0 && rests().all(|rest| rest.excluded.is_some_and(contradicts))).then(|| Finding {
            count,
            value: count as f64,
            unit: "rests",
            message: format!("all {count} rests are excluded because they contradict the other recordings"),
            way_out: "check that this recording is of the same unit, or leave it out: the result does not contain it"
                .into(),
            ..Finding::warning("recording_unused", recording.name)
        })
    };
    recordings.iter().enumerate().filter_map(unused).collect()
}

/// Whether the fit to all recordings is much worse than the separate fits, or excludes many rests that the separate
/// fits use.
fn is_worse_together(together: &Outcome, alone: &[Alone<'_>]) -> bool {
    let used = |outcome: &Outcome| outcome.rests.iter().filter(|rest| rest.excluded.is_none()).count();
    let by_each: usize = alone.iter().map(|fit| used(&fit.outcome)).sum();
    if (used(together) as f64) < (1.0 - EXCLUDED) * by_each as f64 {
        return true;
    }
    let sums = |outcomes: &mut dyn Iterator<Item = &Outcome>| {
        let of = |(chi2, dof): (f64, usize), outcome: &Outcome| {
            outcome.misfit.map_or((chi2, dof), |misfit| (chi2 + misfit.chi2, dof + misfit.degrees_of_freedom))
        };
        let (chi2, dof) = outcomes.fold((0.0, 0), of);
        chi2 / dof.max(1) as f64
    };
    let each = sums(&mut alone.iter().map(|fit| &fit.outcome)).max(1.0);
    sums(&mut std::iter::once(together)) > WORSE_TOGETHER * each
}

/// Groups the recordings by unit, and returns their indices. A recording belongs to a unit if its sensitivities agree
/// with those of the first recording of this unit.
fn groups(alone: &[Alone<'_>]) -> Vec<Vec<usize>> {
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for k in 0..alone.len() {
        let is_same = |group: &&mut Vec<usize>| sensitivities(&alone[group[0]], &alone[k]).is_empty();
        match groups.iter_mut().find(is_same) {
            Some(group) => group.push(k),
            None => groups.push(vec![k]),
        }
    }
    groups
}

fn different_units(alone: &[Alone<'_>], groups: &[Vec<usize>]) -> Finding {
    let names = |group: &Vec<usize>| group.iter().map(|k| alone[*k].name).collect::<Vec<_>>().join(" and ");
    let units: Vec<String> = groups.iter().map(names).collect();
    let mut largest = 0.0f64;
    let mut pairs = Vec::new();
    for group in &groups[1..] {
        let (first, other) = (&alone[groups[0][0]], &alone[group[0]]);
        let differences = sensitivities(first, other);
        largest = differences.iter().map(|d| d.times_sigma).fold(largest, f64::max);
        pairs.push(format!("{} and {} differ in {}", first.name, other.name, list(&differences)));
    }
    Finding {
        count: units.len(),
        value: largest,
        unit: "standard deviations",
        message: format!(
            "each recording fits alone, all together do not: these are {} different units ({}): {}",
            units.len(),
            units.join("; "),
            pairs.join("; ")
        ),
        way_out:
            "calibrate each unit from its own recordings; if it is one unit, its sensitivities changed between the \
                  recordings, as with another range, after a shock or at another temperature"
                .into(),
        ..Finding::error("several_units", &all_names(alone))
    }
}

fn biases_moved(alone: &[Alone<'_>]) -> Option<Finding> {
    let of = alone[1..].iter().map(|other| (other.name, biases(&alone[0], other)));
    let moved: Vec<(&str, Vec<Difference>)> = of.filter(|(_, differences)| !differences.is_empty()).collect();
    let largest = moved.iter().flat_map(|(_, differences)| differences).map(|d| d.times_sigma).fold(0.0, f64::max);
    let pair = |(name, differences): &(&str, Vec<Difference>)| {
        format!("{} and {name} differ in {}", alone[0].name, list(differences))
    };
    (!moved.is_empty()).then(|| Finding {
        count: moved.len() + 1,
        value: largest,
        unit: "standard deviations",
        message: format!(
            "the biases moved between the recordings, the sensitivities agree: {}",
            moved.iter().map(pair).collect::<Vec<_>>().join("; ")
        ),
        way_out: "the result has one bias for all recordings: record without switching the unit off in between, or \
                  calibrate from one recording and estimate the bias anew after each start"
            .into(),
        ..Finding::warning("biases_moved", &all_names(alone))
    })
}

fn all_names(alone: &[Alone<'_>]) -> String {
    alone.iter().map(|fit| fit.name).collect::<Vec<_>>().join(" and ")
}

/// Returns a text that names the [`NAMED`] most significant differences and states how many more there are.
fn list(differences: &[Difference]) -> String {
    let mut words: Vec<&str> = differences.iter().take(NAMED).map(|difference| difference.words.as_str()).collect();
    let others = format!("{} more", differences.len().saturating_sub(NAMED));
    if differences.len() > NAMED {
        words.push(&others);
    }
    match words.split_last() {
        Some((last, [])) => (*last).to_owned(),
        Some((last, others)) => format!("{} and {last}", others.join(", ")),
        None => String::new(),
    }
}

/// Finds the sensitivities that differ between two recordings, in descending order of significance. Scales are ignored
/// if the mean temperatures of the recordings differ by more than [`WARMER_K`].
fn sensitivities(a: &Alone<'_>, b: &Alone<'_>) -> Vec<Difference> {
    let is_warmer = a.temperature_degc.zip(b.temperature_degc).is_some_and(|(a, b)| (a - b).abs() > WARMER_K);
    let differs = |p: usize| -> Option<Difference> {
        let (values, sigma) = pair(a, b, p);
        let share = (values[1] - values[0]).abs() / scales(&a.outcome.calibration)[usize::from(p >= ACCEL.end)];
        let word = word(p);
        let is_scale = word.starts_with("scale ");
        let times_sigma = (values[1] - values[0]).abs() / sigma;
        let size = match is_scale {
            true => format!("{} %", general(100.0 * share, 2)),
            false => format!("{} mrad", general(1e3 * share, 2)),
        };
        let differs = times_sigma >= DIFFERENT && share >= LEAST_SHARE && !(is_scale && is_warmer);
        differs.then(|| described(p, &size, times_sigma))
    };
    sorted((0..BASE).filter(|p| !is_bias(*p)).filter_map(differs))
}

/// Finds the biases that differ between two recordings, in descending order of significance.
fn biases(a: &Alone<'_>, b: &Alone<'_>) -> Vec<Difference> {
    let differs = |p: usize| -> Option<Difference> {
        let (values, sigma) = pair(a, b, p);
        let is_of_gyroscope = GYRO_BIAS.contains(&p);
        let change = (values[1] - values[0]).abs() / scales(&a.outcome.calibration)[usize::from(is_of_gyroscope)];
        let times_sigma = (values[1] - values[0]).abs() / sigma;
        let size = match is_of_gyroscope {
            true => format!("{} deg/s", general(change.to_degrees(), 2)),
            false => format!("{} mg", general(change / super::STANDARD_GRAVITY_MPS2 * 1e3, 2)),
        };
        (times_sigma >= DIFFERENT).then(|| described(p, &size, times_sigma))
    };
    sorted((0..BASE).filter(|p| is_bias(*p)).filter_map(differs))
}

fn sorted(differences: impl Iterator<Item = Difference>) -> Vec<Difference> {
    let mut all: Vec<Difference> = differences.collect();
    all.sort_by(|a, b| b.times_sigma.total_cmp(&a.times_sigma));
    all
}

/// Returns the values of parameter `p` in the fits `a` and `b`, and the standard deviation of their difference.
fn pair(a: &Alone<'_>, b: &Alone<'_>, p: usize) -> ([f64; 2], f64) {
    let variance = a.outcome.covariance[p][p] + b.outcome.covariance[p][p];
    ([a.outcome.values[p], b.outcome.values[p]], variance.sqrt())
}

fn is_bias(p: usize) -> bool {
    p < 3 || GYRO_BIAS.contains(&p)
}

/// Mean scales of the accelerometer and of the gyroscope, raw units per SI unit.
fn scales(calibration: &Calibration<f64>) -> [f64; 2] {
    [&calibration.accelerometer, &calibration.gyroscope].map(|triad| triad.sensitivity().norm() / 3f64.sqrt())
}

/// Name of a base parameter in words, without the name of its sensor.
fn word(p: usize) -> &'static str {
    match p {
        0..9 => WORDS[p],
        9..12 => WORDS[p - 9],
        _ => WORDS[p - 3],
    }
}

fn described(p: usize, size: &str, times_sigma: f64) -> Difference {
    let sensor = if ACCEL.contains(&p) { "accelerometer" } else { "gyroscope" };
    Difference { words: format!("{sensor} {} by {size} ({times_sigma:.0} sigma)", word(p)), times_sigma }
}

/// Mean of the known temperatures of a recording, degC.
fn mean_temperature(recording: &Recording<'_>) -> Option<f64> {
    let known = || recording.temperature_degc.into_iter().flatten().filter(|degc| degc.is_finite());
    let count = known().count();
    (count > 0).then(|| known().sum::<f64>() / count as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::{Options, calibrate};
    use crate::finding::Severity;
    use crate::simulate::{Program, RandomMoves, Simulation, Unit, simulate};

    fn run(unit: &Unit, seed: u64) -> Simulation {
        let program = Program::random(&RandomMoves { moves: 24, ..RandomMoves::default() }, seed).unwrap();
        simulate(&program, unit, 100.0, 9.80665, seed).unwrap()
    }

    /// A simulated unit that differs from `Unit::paper` by 0.4 % and 0.3 % in two scales and by 3 mrad in one axis.
    fn other() -> Unit {
        let mut unit = Unit::paper();
        unit.gyroscope.sensitivity[(0, 0)] *= 1.004;
        unit.gyroscope.sensitivity[(1, 2)] += 0.003 * unit.gyroscope.sensitivity[(1, 1)];
        unit.accelerometer.sensitivity[(2, 2)] *= 0.997;
        unit
    }

    #[test]
    fn recordings_of_two_units_are_named_with_the_parameters_that_differ() {
        let runs = [run(&Unit::paper(), 1), run(&other(), 2), run(&Unit::paper(), 3)];
        let recordings = [runs[0].recording("a"), runs[1].recording("b"), runs[2].recording("c")];
        let Err(Error::Data(findings)) = calibrate(&recordings, &Options::default()) else { panic!("accepted") };
        assert_eq!((findings.len(), findings[0].code, findings[0].count), (1, "several_units", 2));
        let message = &findings[0].message;
        assert!(message.contains("2 different units (a and c; b): a and b differ in"), "{message}");
        assert!(findings[0].value > 20.0 && message.contains("sigma"), "{message}");
    }

    #[test]
    fn a_unit_whose_biases_moved_is_one_unit() {
        let mut later = Unit::paper();
        later.gyroscope.bias.x += 0.02 * later.gyroscope.sensitivity[(0, 0)];
        let runs = [run(&Unit::paper(), 1), run(&later, 2)];
        let recordings = [runs[0].recording("a"), runs[1].recording("b")];
        let outcome = calibrate(&recordings, &Options::default()).unwrap();
        let moved = outcome.findings.iter().find(|finding| finding.code == "biases_moved").unwrap();
        assert_eq!((moved.severity, moved.count), (Severity::Warning, 2));
        assert!(moved.message.contains("a and b differ in gyroscope bias x by 1.1 deg/s"), "{moved}");
    }

    #[test]
    fn good_recordings_of_one_unit_are_not_examined() {
        let runs = [run(&Unit::paper(), 1), run(&Unit::paper(), 2)];
        let recordings = [runs[0].recording("a"), runs[1].recording("b")];
        let outcome = calibrate(&recordings, &Options::default()).unwrap();
        assert_eq!(outcome.verdict(), Verdict::Good);
        let fit_alone = |_: &Recording<'_>| -> Result<Outcome, Error> { panic!("fitted alone") };
        assert!(several_units(&recordings, Ok(&outcome), fit_alone).unwrap().is_empty());
    }
}
