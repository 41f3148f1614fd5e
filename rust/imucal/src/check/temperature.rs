//! Checks of the temperature column: its unit, jumps, and values that are not finite.

use super::{Tally, names};
use crate::finding::{Finding, general};
use crate::numerics::stats::quantile;
use crate::recording::Recording;

/// A difference between consecutive temperatures above this value, K, is reported as a jump. At usual sampling rates, a
/// sensor does not warm up so fast.
const TEMPERATURE_STEP_K: f64 = 5.0;
/// Plausible temperatures of an inertial sensor, degC. The widest operating range in datasheets is -55 to 125 degC, and
/// storage ranges are -40 to 125 degC or -65 to 150 degC. A temperature outside the limits is in another unit or is a
/// reading error.
pub const TEMPERATURE_DEGC: [f64; 2] = [-60.0, 150.0];
/// Usual temperatures of a sensor during a calibration, degC: the operating range of consumer and industrial sensors.
/// For implausible values, the finding recommends a unit in which the values, converted to degC, are in this range.
const USUAL_DEGC: [f64; 2] = [-40.0, 85.0];

/// Reports implausible temperatures, temperature jumps between consecutive samples, and temperatures that are not
/// finite.
///
/// Codes: `temperature_implausible`, `temperature_jump`.
pub(super) fn check(recording: &Recording) -> Vec<Finding> {
    check_temperature(recording).into_iter().chain(jumps(recording)).collect()
}

/// Reports temperatures outside [`TEMPERATURE_DEGC`], and recommends the unit in which they would be plausible.
///
/// Code: `temperature_implausible`. The finding is an error, because every estimated effect of temperature would be
/// wrong.
///
/// # Example
/// A median of 295 in the column `temp_degc` is plausible in kelvin, so the recommended action is to name the column
/// `temp_k`.
pub fn check_temperature(recording: &Recording) -> Option<Finding> {
    let temperature = recording.temperature_degc?;
    let [low, high] = TEMPERATURE_DEGC;
    let mut outside = Tally::default();
    let mut extremes = [f64::INFINITY, f64::NEG_INFINITY];
    for (i, degc) in temperature.iter().enumerate().filter(|(_, degc)| degc.is_finite()) {
        extremes = [extremes[0].min(*degc), extremes[1].max(*degc)];
        if !(low..=high).contains(degc) {
            outside.add(i);
        }
    }
    let (first, _) = outside.first?;
    let mut finite: Vec<f64> = temperature.iter().copied().filter(|degc| degc.is_finite()).collect();
    let median = quantile(&mut finite, 0.5);
    let is_few = (low..=high).contains(&median);
    let way_out = if is_few {
        let unit = likely_unit(if extremes[1] > high { extremes[1] } else { extremes[0] });
        format!(
            "if these values are reading errors, leave their cells empty; if the whole column is in another unit, {unit}"
        )
    } else {
        likely_unit(median)
    };
    Some(Finding {
        columns: names(["temp_degc"]),
        place: outside.place(recording),
        count: outside.samples,
        value: if is_few { temperature[first] } else { median },
        unit: "degC",
        message: format!(
            "the temperature is {} to {} degC, median {} degC: {} samples are outside {low:.0} to {high:.0} degC, where \
             sensors work, first {}",
            general(extremes[0], 5),
            general(extremes[1], 5),
            general(median, 5),
            outside.samples,
            outside.first_place(recording)
        ),
        way_out,
        ..Finding::error("temperature_implausible", recording.name)
    })
}

/// Returns advice on a value that is implausible as a temperature in degC. The advice names the unit in which the value
/// would be plausible.
fn likely_unit(value: f64) -> String {
    const COUNTS: &str =
        "give raw counts as temp_lsb with --temp-scale SLOPE,OFFSET of the datasheet (degC per count, degC)";
    let is = |degc: f64, [low, high]: [f64; 2]| (low..=high).contains(&degc);
    let (kelvin, fahrenheit) = (value - 273.15, (value - 32.0) / 1.8);
    let named = |unit: &str, column: &str, degc: f64| {
        let [value, degc] = [value, degc].map(|number| general(number, 5));
        format!("it looks like {unit}, {degc} degC instead of {value}: name the column temp_{column}")
    };
    for range in [USUAL_DEGC, TEMPERATURE_DEGC] {
        if is(kelvin, range) {
            return named("kelvin", "k", kelvin);
        }
        if is(fahrenheit, range) {
            return named("degrees Fahrenheit", "degf", fahrenheit);
        }
    }
    let divided = [(100.0, "hundredths"), (1000.0, "thousandths")].into_iter();
    let shares: Vec<String> = divided
        .filter(|(divisor, _)| is(value / divisor, USUAL_DEGC) && (value / divisor).abs() > 5.0)
        .map(|(divisor, name)| format!("{name} of a degree (--temp-scale {:?},0)", 1.0 / divisor))
        .collect();
    if shares.is_empty() {
        format!("it looks like raw counts: {COUNTS}; kelvin and degrees Fahrenheit are temp_k and temp_degf")
    } else {
        format!("it looks like raw counts or {}: {COUNTS}", shares.join(" or "))
    }
}

/// Reports temperature jumps above [`TEMPERATURE_STEP_K`] between consecutive samples, and values that are not finite.
fn jumps(recording: &Recording) -> Option<Finding> {
    let temperature = recording.temperature_degc?;
    let (mut jumps, mut largest, mut not_finite) = (Tally::default(), 0.0f64, 0);
    for i in 0..temperature.len() {
        let step = if i == 0 { 0.0 } else { (temperature[i] - temperature[i - 1]).abs() };
        if !temperature[i].is_finite() {
            not_finite += 1;
            jumps.add(i);
        } else if step.is_finite() && step > TEMPERATURE_STEP_K {
            largest = largest.max(step);
            jumps.add(i);
        }
    }
    let steps = jumps.samples - not_finite;
    let jumping = (steps > 0).then(|| {
        format!("jumps by more than {TEMPERATURE_STEP_K:.0} K {steps} times (at most {largest:.1} K), faster than a sensor warms up")
    });
    let empty = (not_finite > 0).then(|| format!("is not finite in {not_finite} samples"));
    let wrong: Vec<String> = jumping.into_iter().chain(empty).collect();
    (jumps.samples > 0).then(|| Finding {
        columns: names(["temp_degc"]),
        place: jumps.place(recording),
        count: jumps.samples,
        value: largest,
        unit: "K",
        message: format!("the temperature {}, first {}", wrong.join(" and "), jumps.first_place(recording)),
        way_out: "repair the temperature column, or drop it: effects of temperature need a value in every row".into(),
        ..Finding::warning("temperature_jump", recording.name)
    })
}

#[cfg(test)]
mod tests {
    use super::super::example::Columns;
    use super::*;
    use crate::finding::Severity;

    fn found(temperature: &[f64]) -> Vec<Finding> {
        let columns = Columns::tumbling();
        check(&Recording { temperature_degc: Some(temperature), ..columns.recording() })
    }

    #[test]
    fn temperature_may_drift_but_not_jump() {
        let mut temperature: Vec<f64> = (0..4000).map(|i| 20.0 + 0.005 * i as f64).collect();
        assert!(found(&temperature).is_empty());
        temperature[2000] = -40.0;
        temperature[3000] = f64::NAN;
        let finding = found(&temperature).remove(0);
        assert_eq!((finding.count, finding.severity), (3, Severity::Warning));
        assert!(finding.value > 60.0);
    }

    #[test]
    fn the_likely_unit_of_an_implausible_temperature_is_named() {
        for (value, expected) in [
            (295.0, "temp_k"),
            (240.0, "temp_k"),
            (400.0, "temp_k"),
            (160.0, "temp_degf"),
            (200.0, "temp_degf"),
            (2531.0, "hundredths"),
            (25_310.0, "thousandths"),
            (-3920.0, "temp_lsb"),
            (12_000.0, "temp_lsb"),
        ] {
            let findings = found(&vec![value; 4000]);
            assert_eq!((findings.len(), findings[0].code), (1, "temperature_implausible"), "{value}");
            assert_eq!((findings[0].severity, findings[0].count), (Severity::Error, 4000));
            assert!(findings[0].way_out.contains(expected), "{value}: {}", findings[0].way_out);
        }
        for degc in TEMPERATURE_DEGC {
            assert!(found(&vec![degc; 4000]).is_empty());
        }
    }

    #[test]
    fn a_single_reading_error_is_named_with_its_sample() {
        let mut temperature = vec![21.0; 4000];
        temperature[700] = -127.0;
        let findings = found(&temperature);
        assert_eq!(findings[0].code, "temperature_implausible");
        assert_eq!((findings[0].count, findings[0].place.unwrap().first_sample), (1, 700));
        assert!(findings[0].way_out.contains("leave their cells empty"));
    }
}
