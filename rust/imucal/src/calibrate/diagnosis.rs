//! Finds parameters that a calibration determines poorly, and the motion that would improve them (model.md (12)).
//!
//! ```text
//! traded_off   |C_ij| > 0.95 sqrt(C_ii C_jj)
//! flat         sqrt(C_jj) > usual size of the parameter
//! at_bound     a time constant longer than the recordings, or shorter than a hundredth of them (except
//!              for lags of the temperature)
//! ```
//!
//! C is the covariance of the estimated parameters. A poorly determined parameter is not an error. The diagnosis only
//! describes the covariance in words.

use imucal_core::effects::{Effect, Need};

use crate::calibrate::{Outcome, TermEstimate};
use crate::recording::Recording;

/// Two parameters are reported as not separately observable if |correlation| of their estimates is larger than this
/// value.
const TRADED: f64 = 0.95;
/// Usual error of a sensitivity of a MEMS sensor before calibration, as a fraction of the sensitivity. A larger
/// standard deviation is reported.
const USUAL_SENSITIVITY_ERROR: f64 = 0.01;
/// Usual biases of a MEMS accelerometer, m/s^2, and of a MEMS gyroscope, rad/s. A larger standard deviation of a bias
/// is reported.
const USUAL_BIAS: [f64; 2] = [0.2, 0.02];
/// A time constant is reported if (time constant) / (duration of the longest recording) is below this value. An effect
/// with such a short time constant decays so early in the recording that few samples show it.
const SHORTEST_SHARE: f64 = 0.01;

/// A parameter, or a group of parameters, that a calibration determines poorly.
#[derive(Clone, Debug, PartialEq)]
pub struct Diagnosis {
    /// Reason code: `traded_off`, `flat` or `at_bound`.
    pub code: &'static str,
    /// Names of the parameters.
    pub parameters: Vec<String>,
    /// The value that is beyond its limit. For `traded_off`, it is the largest correlation. For `flat`, it is (standard
    /// deviation) / (usual size of the parameter). For `at_bound`, it is the time constant, s.
    pub value: f64,
    /// Description with the value.
    pub message: String,
    /// The motion that would improve the estimate.
    pub way_out: String,
}

/// Returns the diagnoses of the calibration `outcome`, which was estimated from `recordings`. The list is empty if all
/// parameters are determined well.
pub fn diagnose(outcome: &Outcome, recordings: &[Recording<'_>]) -> Vec<Diagnosis> {
    let longest_s = recordings.iter().filter_map(|r| Some(r.time_s.last()? - r.time_s.first()?)).fold(0.0, f64::max);
    let mut found = traded_off(outcome);
    found.extend(flat(outcome));
    found.extend(outcome.effects.iter().filter_map(|effect| at_bound(effect, longest_s)));
    found
}

/// Returns one diagnosis for each group of parameters whose estimates are linked by correlations above [`TRADED`].
fn traded_off(outcome: &Outcome) -> Vec<Diagnosis> {
    let (names, covariance) = (&outcome.names, &outcome.covariance);
    let correlation = |i: usize, j: usize| covariance[i][j] / (covariance[i][i] * covariance[j][j]).sqrt();
    let mut left: Vec<usize> = (0..names.len()).collect();
    let mut found = Vec::new();
    while let Some(first) = left.first().copied() {
        left.remove(0);
        let mut group = vec![first];
        let mut next = 0;
        while next < group.len() {
            let is_coupled = |&j: &usize| correlation(group[next], j).abs() > TRADED;
            let (joined, others): (Vec<usize>, Vec<usize>) = left.into_iter().partition(is_coupled);
            group.extend(joined);
            left = others;
            next += 1;
        }
        if group.len() < 2 {
            continue;
        }
        group.sort_unstable();
        let pairs = group.iter().flat_map(|&i| group.iter().filter(move |&&j| j > i).map(move |&j| correlation(i, j)));
        let largest = pairs.fold(0.0, |most: f64, c| if c.abs() > most.abs() { c } else { most });
        let members: Vec<String> = group.iter().map(|&p| names[p].clone()).collect();
        found.push(Diagnosis {
            code: "traded_off",
            value: largest,
            message: format!("{} cannot be estimated separately: their correlation is {largest:.3}", listed(&members)),
            way_out: way_out(outcome, &group),
            parameters: members,
        });
    }
    found
}

/// Returns one diagnosis for each parameter that has no prior and a standard deviation above its usual size
/// ([`usual_size`]).
fn flat(outcome: &Outcome) -> Vec<Diagnosis> {
    let mut found = Vec::new();
    for (p, name) in outcome.names.iter().enumerate() {
        let is_held = outcome.held.iter().any(|held| held.prior.parameter() == p);
        let Some(usual) = usual_size(outcome, p).filter(|_| !is_held) else { continue };
        let sigma = outcome.covariance[p][p].sqrt();
        if sigma > usual {
            found.push(Diagnosis {
                code: "flat",
                parameters: vec![name.clone()],
                value: sigma / usual,
                message: format!(
                    "{name} is poorly determined: its standard deviation {sigma:.2e} exceeds its usual size {usual:.2e}"
                ),
                way_out: way_out(outcome, &[p]),
            });
        }
    }
    found
}

/// Returns the diagnosis for a time constant outside the range that the recordings can determine; `None` if it is
/// inside the range or the effect has no time constant.
fn at_bound(effect: &TermEstimate, longest_s: f64) -> Option<Diagnosis> {
    let tau_s = effect.shape?;
    let name = effect.parameter_names.last()?;
    // Most effects with a time constant act only once, after power-on, so a short time constant affects few samples of
    // a long recording. A sensor that lags behind the temperature is different: its lag appears again at every change
    // of the temperature, so a short time constant is also observable in a long recording.
    let acts_again = Effect::<f64>::find(&effect.name).is_some_and(|own| own.needs.contains(&Need::TemperatureHistory));
    let (bound, way_out) = if tau_s > longest_s {
        ("longer than", "record from power-on until the sensors have settled, or estimate a drift instead")
    } else if tau_s < SHORTEST_SHARE * longest_s && !acts_again {
        ("less than a hundredth of", "start recording at power-on, with short rests at first, or leave the effect out")
    } else {
        return None;
    };
    Some(Diagnosis {
        code: "at_bound",
        parameters: vec![name.clone()],
        value: tau_s,
        message: format!("{name} = {tau_s:.1} s is {bound} the longest recording ({longest_s:.0} s)"),
        way_out: way_out.into(),
    })
}

/// Returns the effect to which parameter `p` belongs, and the index of `p` among the parameters of this effect.
fn effect_of(outcome: &Outcome, p: usize) -> Option<(&TermEstimate, usize)> {
    outcome.effects.iter().find_map(|e| Some((e, e.parameter_names.iter().position(|name| *name == outcome.names[p])?)))
}

/// Returns the usual size of parameter `p`, in the unit of the parameter: its typical error in an uncalibrated sensor.
/// `None` for user-defined effects and for time constants.
fn usual_size(outcome: &Outcome, p: usize) -> Option<f64> {
    let scale = |triad: &imucal_core::sensor::Triad<f64>| triad.sensitivity().norm() / 3f64.sqrt();
    let (accelerometer, gyroscope) = (scale(&outcome.calibration.accelerometer), scale(&outcome.calibration.gyroscope));
    match p {
        0..3 => Some(USUAL_BIAS[0] * accelerometer),
        3..9 => Some(USUAL_SENSITIVITY_ERROR * accelerometer),
        9..12 => Some(USUAL_BIAS[1] * gyroscope),
        12..21 => Some(USUAL_SENSITIVITY_ERROR * gyroscope),
        _ => {
            let (term, place) = effect_of(outcome, p)?;
            Effect::<f64>::find(&term.name)?
                .parameters
                .get(place)
                .filter(|_| place < term.values.len())
                .map(|q| q.typical)
        }
    }
}

/// Returns a text that recommends motion. With this motion, the parameters with the indices `parameters` can be
/// distinguished from each other and from all other parameters.
fn way_out(outcome: &Outcome, parameters: &[usize]) -> String {
    let free = outcome.frame.free_entries();
    const AXES: [&str; 3] = ["x", "y", "z"];
    let mut motions: Vec<String> = Vec::new();
    // If the group contains a parameter of an effect, no motion is recommended for the base parameters of the group.
    // The motion that separates the effect from the base parameters also determines the base parameters.
    let with_effect = parameters.iter().any(|&p| p >= 21);
    for &p in parameters.iter().filter(|&&p| p >= 21 || !with_effect) {
        let motion = match p {
            0..3 => format!("add rests with {0} up and with {0} down", AXES[p]),
            3..9 => {
                let (i, j) = free[p - 3];
                if i == j {
                    format!("add rests with {0} up and with {0} down", AXES[i])
                } else {
                    format!("add rests with the edge between {} and {} up", AXES[i], AXES[j])
                }
            }
            9..12 => "add longer rests".into(),
            12..21 => format!("add moves of 90 deg or more about body {}", AXES[(p - 12) % 3]),
            _ => match effect_of(outcome, p).and_then(|(term, _)| Effect::<f64>::find(&term.name)) {
                Some(effect) => separation(outcome, effect, parameters),
                None => "record motion in which the field of this effect changes independently of all others".into(),
            },
        };
        if !motions.contains(&motion) {
            motions.push(motion);
        }
    }
    motions.join("; ")
}

/// Returns a text that recommends the motion that separates an effect from the other parameters of a group of
/// correlated parameters. If no such motion is known, the text recommends the motion that makes the effect observable.
fn separation(outcome: &Outcome, effect: &Effect<f64>, group: &[usize]) -> String {
    let is_in_group =
        |name: &str| group.iter().any(|&p| effect_of(outcome, p).is_some_and(|(term, _)| term.name == name));
    match effect.aliases.iter().find(|alias| is_in_group(alias.with)) {
        Some(alias) => format!("{} is separated from {} by {}", effect.name, alias.with, alias.told_apart_by),
        None => format!("{} needs {}", effect.name, effect.observable),
    }
}

fn listed(names: &[String]) -> String {
    match names.split_last() {
        Some((last, others)) if !others.is_empty() => format!("{} and {last}", others.join(", ")),
        _ => names.concat(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::{EffectChoice, Options, calibrate};
    use crate::simulate::{Program, RandomMoves, Unit, simulate};

    fn outcome(effects: &[&str]) -> (Outcome, f64) {
        let program = Program::random(&RandomMoves::default(), 1).unwrap();
        let run = simulate(&program, &Unit::paper(), 100.0, 9.80665, 1).unwrap();
        let choice = |name: &&str| EffectChoice::plain(Effect::find(name).unwrap());
        let options = Options { effects: effects.iter().map(choice).collect(), ..Options::default() };
        let recording = run.recording("run");
        let longest_s = recording.time_s[recording.len() - 1];
        (calibrate(&[recording], &options).unwrap(), longest_s)
    }

    #[test]
    fn a_good_calibration_has_none() {
        let (outcome, _) = outcome(&[]);
        assert_eq!(diagnose(&outcome, &[]), []);
    }

    #[test]
    fn a_correlation_and_a_large_sigma_are_said_with_the_motion() {
        let (mut outcome, _) = outcome(&[]);
        let sigma = outcome.covariance[4][4].sqrt() * outcome.covariance[14][14].sqrt();
        (outcome.covariance[4][14], outcome.covariance[14][4]) = (-0.97 * sigma, -0.97 * sigma);
        outcome.covariance[1][1] = 0.25;
        let [traded, flat] = <[Diagnosis; 2]>::try_from(diagnose(&outcome, &[])).unwrap();
        assert_eq!((traded.code, traded.parameters.len()), ("traded_off", 2));
        assert_eq!(
            traded.message,
            "accel_sensitivity_yy and gyro_sensitivity_xz cannot be estimated separately: their correlation is -0.970"
        );
        assert_eq!(traded.way_out, "add rests with y up and with y down; add moves of 90 deg or more about body z");
        assert_eq!((flat.code, &flat.parameters[0][..]), ("flat", "accel_bias_y"));
        assert!((flat.value - 2.5).abs() < 0.1, "{}", flat.value);
    }

    #[test]
    fn a_time_constant_is_judged_by_the_length_of_the_recording() {
        let (outcome, longest_s) = outcome(&["gyro_bias_warmup"]);
        let warmup = TermEstimate { shape: Some(2.0 * longest_s), ..outcome.effects[0].clone() };
        let found = at_bound(&warmup, longest_s).unwrap();
        assert_eq!((found.code, &found.parameters[0][..]), ("at_bound", "gyro_bias_warmup_tau"));
        assert!(found.way_out.contains("record from power-on"));
        let inside = TermEstimate { shape: Some(0.3 * longest_s), ..warmup };
        assert_eq!(at_bound(&inside, longest_s), None);
    }
}
