//! What a calibration knows badly, in words with the motion that would help.
//!
//! ```text
//! traded off   |C_ij| > 0.95 sqrt(C_ii C_jj)
//! flat         sqrt(C_jj) > the size that the parameter usually has
//! at a bound   a time constant longer than the recordings, or shorter than a hundredth of them
//! ```
//!
//! Such a result is no error: its covariance says all of it. But few read a covariance.

use imucal_core::effects::Effect;

use crate::calibrate::{Outcome, TermEstimate};
use crate::recording::Recording;

/// Correlation from which on two parameters count as traded off.
const TRADED: f64 = 0.95;
/// Usual error of a MEMS sensor before calibration, in parts of its sensitivity.
const USUAL_SENSITIVITY_ERROR: f64 = 0.01;
/// Usual bias of an accelerometer, m/s^2, and of a gyroscope, rad/s.
const USUAL_BIAS: [f64; 2] = [0.2, 0.02];
/// A time constant below this share of the longest recording leaves nothing to see.
const SHORTEST_SHARE: f64 = 0.01;

/// One thing that a calibration knows badly.
#[derive(Clone, Debug, PartialEq)]
pub struct Diagnosis {
    /// Reason code: `traded_off`, `flat` or `at_bound`.
    pub code: &'static str,
    /// Names of the parameters concerned.
    pub parameters: Vec<String>,
    /// The number that decided: the largest correlation, the standard deviation over the usual size, the time constant in s.
    pub value: f64,
    /// What is known badly, with the number.
    pub message: String,
    /// The motion that would help.
    pub way_out: String,
}

/// What this calibration, made from `recordings`, knows badly; nothing for a good one.
pub fn diagnose(outcome: &Outcome, recordings: &[Recording<'_>]) -> Vec<Diagnosis> {
    let longest_s = recordings.iter().filter_map(|r| Some(r.time_s.last()? - r.time_s.first()?)).fold(0.0, f64::max);
    let mut found = traded_off(outcome);
    found.extend(flat(outcome));
    found.extend(outcome.effects.iter().filter_map(|effect| at_bound(effect, longest_s)));
    found
}

/// Groups of parameters that are known only together.
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
            let hangs_on = |&j: &usize| correlation(group[next], j).abs() > TRADED;
            let (joined, others): (Vec<usize>, Vec<usize>) = left.into_iter().partition(hangs_on);
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
            message: format!("{} are known only together: their correlation is {largest:.3}", listed(&members)),
            way_out: way_out(outcome, &group),
            parameters: members,
        });
    }
    found
}

/// Parameters that are less certain than they usually are large.
fn flat(outcome: &Outcome) -> Vec<Diagnosis> {
    let mut found = Vec::new();
    for (p, name) in outcome.names.iter().enumerate() {
        let Some(usual) = usual_size(outcome, p) else { continue };
        let sigma = outcome.covariance[p][p].sqrt();
        if sigma > usual {
            found.push(Diagnosis {
                code: "flat",
                parameters: vec![name.clone()],
                value: sigma / usual,
                message: format!(
                    "{name} is hardly determined: its standard deviation {sigma:.2e} is larger than the {usual:.2e} that it \
                     usually is"
                ),
                way_out: way_out(outcome, &[p]),
            });
        }
    }
    found
}

/// A time constant that the recordings are too short or too long for.
fn at_bound(effect: &TermEstimate, longest_s: f64) -> Option<Diagnosis> {
    let tau_s = effect.shape?;
    let name = effect.parameter_names.last()?;
    let (bound, way_out) = if tau_s > longest_s {
        ("longer than", "record from power-on until nothing drifts any more, or estimate a drift instead")
    } else if tau_s < SHORTEST_SHARE * longest_s {
        ("less than a hundredth of", "begin to record at power-on, with short rests at first, or leave the effect out")
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

/// The effect that a parameter belongs to, and its place there.
fn effect_of(outcome: &Outcome, p: usize) -> Option<(&TermEstimate, usize)> {
    outcome.effects.iter().find_map(|e| Some((e, e.parameter_names.iter().position(|name| *name == outcome.names[p])?)))
}

/// What a parameter usually is, raw units; `None` for a user's own and for time constants.
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

/// The motion that would tell these parameters apart from all others.
fn way_out(outcome: &Outcome, parameters: &[usize]) -> String {
    let free = outcome.frame.free_entries();
    const AXES: [&str; 3] = ["x", "y", "z"];
    let mut motions: Vec<String> = Vec::new();
    // What tells an effect from the base parameters says what these need, too.
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
            9..12 => "rest for longer".into(),
            12..21 => format!("add moves of 90 deg or more about body {}", AXES[(p - 12) % 3]),
            _ => match effect_of(outcome, p).and_then(|(term, _)| Effect::<f64>::find(&term.name)) {
                Some(effect) => told_apart(outcome, effect, parameters),
                None => "record motion that changes the field of the effect alone".into(),
            },
        };
        if !motions.contains(&motion) {
            motions.push(motion);
        }
    }
    motions.join("; ")
}

/// What tells an effect from the others of a group, or else what it needs to be seen.
fn told_apart(outcome: &Outcome, effect: &Effect<f64>, group: &[usize]) -> String {
    let is_in_group =
        |name: &str| group.iter().any(|&p| effect_of(outcome, p).is_some_and(|(term, _)| term.name == name));
    match effect.aliases.iter().find(|alias| is_in_group(alias.with)) {
        Some(alias) => format!("{} is told apart from {} by {}", effect.name, alias.with, alias.told_apart_by),
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
        let choice = |name: &&str| EffectChoice { effect: Effect::find(name).unwrap(), full: false };
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
            "accel_sensitivity_yy and gyro_sensitivity_xz are known only together: their correlation is -0.970"
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
