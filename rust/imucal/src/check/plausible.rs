//! Limits of plausible noise densities and biases of inertial sensors at rest. A value beyond the limits may be due to
//! a column that was read in a wrong unit. The check therefore proposes the unit in which the value would be plausible.
//!
//! ```text
//! quantity                   highest                 lowest                     sources
//! gyroscope, density         0.1 deg/s/sqrt(Hz)      1e-6 deg/s/sqrt(Hz)        (1), (2)
//! accelerometer, density     10 mg/sqrt(Hz)          10 ng/sqrt(Hz)             (3), (4)
//! gyroscope, bias            50 deg/s                -                          (5)
//!
//! (1) Consumer MEMS: 0.0028 (ICM-42688-P) to 0.03 deg/s/sqrt(Hz) (L3GD20, ITG-3200), one-sided; automotive and
//!     industrial MEMS: up to 0.1 (ADXRS300). Only sensors for fast rotation are noisier (ADXRS649, +-20000 deg/s:
//!     0.25).
//! (2) Space-grade fibre-optic and hemispherical resonator gyroscopes: an angle random walk of 1e-4 deg/sqrt(h), which
//!     is 1.7e-6 deg/s/sqrt(Hz).
//! (3) Consumer MEMS: 0.06 to 0.4 mg/sqrt(Hz) (MPU-6050); high-g MEMS: up to 5 mg/sqrt(Hz) (ADXL377, +-200 g: 2.7
//!     to 4.3).
//! (4) Seismic MEMS and servo accelerometers: 15 to 300 ng/sqrt(Hz).
//! (5) Consumer MEMS: +-20 (MPU-6050) to +-40 deg/s (ITG-3200) of zero-rate output.
//! ```

use std::f64::consts::PI;

use imucal_core::STANDARD_GRAVITY_MPS2;

use super::units::{given_accel_unit, given_gyro_unit, if_only};
use super::values::converter_step;
use super::{CHANNELS, names};
use crate::finding::{Finding, general};
use crate::numerics::stats::median;
use crate::recording::{RawUnit, Recording};

const DEGREE_RAD: f64 = PI / 180.0;
/// Plausible noise densities of an accelerometer, m/s^2/sqrt(Hz); sources (3) and (4) above.
const ACCEL_DENSITY: [f64; 2] = [1e-8 * STANDARD_GRAVITY_MPS2, 1e-2 * STANDARD_GRAVITY_MPS2];
/// Plausible noise densities of a gyroscope, rad/s/sqrt(Hz); sources (1) and (2) above.
const GYRO_DENSITY: [f64; 2] = [1e-6 * DEGREE_RAD, 0.1 * DEGREE_RAD];
/// Largest plausible bias of a gyroscope, rad/s; source (5) above.
const GYRO_BIAS_RADPS: f64 = 50.0 * DEGREE_RAD;
/// Range of the noise densities of usual MEMS gyroscopes, deg/s/sqrt(Hz). A unit of measurement is recommended if the
/// density is in this range when the columns are read in this unit of measurement.
const USUAL: [f64; 2] = [1e-3, 0.1];
/// Highest noise density of common MEMS accelerometers, m/s^2/sqrt(Hz); source (3) above.
const USUAL_ACCEL_DENSITY: f64 = 3e-3 * STANDARD_GRAVITY_MPS2;
/// If the median specific force, in g, is in this range, it can be gravity. The range is wide, because the median
/// includes samples in which the unit moves.
const GRAVITY_RATIO: [f64; 2] = [0.7, 1.4];
/// Recommended action if the unit moves in the detected rests.
const NEVER_RESTS: &str = "the unit never rests: hold it still on something rigid, away from motors and hands";
/// Angular rate of one count (LSB) of usual gyroscopes, deg/s. The list contains the full scales 125, 250, ... 2000
/// deg/s divided by 32768 counts, and the rounded sensitivities in the datasheets of TDK InvenSense (131, 65.5, 32.8,
/// 16.4 and 14.375 counts per deg/s), STMicroelectronics (4.375, 8.75, 17.5, 35 and 70 mdeg/s) and NXP (7.8125 to 62.5
/// mdeg/s).
const GYRO_COUNTS_DPS: [(f64, &str); 19] = [
    (1.0 / 131.0, "1/131"),
    (1.0 / 65.5, "1/65.5"),
    (1.0 / 32.8, "1/32.8"),
    (1.0 / 16.4, "1/16.4"),
    (125.0 / 32_768.0, "125/32768"),
    (250.0 / 32_768.0, "250/32768"),
    (500.0 / 32_768.0, "500/32768"),
    (1000.0 / 32_768.0, "1000/32768"),
    (2000.0 / 32_768.0, "2000/32768"),
    (0.004_375, "0.004375"),
    (0.008_75, "0.00875"),
    (0.0175, "0.0175"),
    (0.035, "0.035"),
    (0.07, "0.07"),
    (0.007_812_5, "0.0078125"),
    (0.015_625, "0.015625"),
    (0.031_25, "0.03125"),
    (0.0625, "0.0625"),
    (1.0 / 14.375, "1/14.375"),
];
/// The smallest step between the values of a column counts as equal to a value of [`GYRO_COUNTS_DPS`] if their relative
/// difference is below this limit. The limit allows for text columns that are rounded to three digits.
const SAME_COUNT: f64 = 3e-3;

/// Noise density and mean of one sensor axis at rest.
#[derive(Clone, Copy, Debug)]
pub struct RestNoise {
    /// White-noise density, in the unit of the axis per sqrt(Hz); `None` if it is not known.
    pub density: Option<f64>,
    /// Mean reading at rest, in the unit of the axis; `None` if it is not known.
    pub mean: Option<f64>,
}

/// Reports noise densities and biases at rest that no sensor has, and recommends the unit of measurement in which they
/// would be plausible. Only columns in SI units are checked, because a count may have any size.
///
/// `columns` contains the noise densities and means of the accelerometer axes x, y, z and then of the gyroscope axes x,
/// y, z. Codes, all of them warnings: `noise_implausible`, `bias_implausible`.
///
/// # Example
/// A gyroscope in deg/s whose columns are read as rad/s appears to have a density of 0.3 deg/s/sqrt(Hz). No gyroscope
/// is that noisy, so the recommended action is to name the columns `gyro_x_dps`, `gyro_y_dps`, `gyro_z_dps`.
pub fn check_noise(recording: &Recording, columns: &[RestNoise; 6]) -> Vec<Finding> {
    let [ax, ay, az, gx, gy, gz] = *columns;
    let (accel, gyro) = ([ax, ay, az], [gx, gy, gz]);
    let mut findings = Vec::new();
    if recording.accel_unit == RawUnit::Si {
        let shown = Shown { name: "accelerometer", unit: "mg/sqrt(Hz)", si: 1e-3 * STANDARD_GRAVITY_MPS2 };
        let way_out = |density: f64| accel_way_out(recording, density);
        findings.extend(densities(recording, 0, &accel, ACCEL_DENSITY, &shown, way_out));
    }
    if recording.gyro_unit == RawUnit::Si {
        let shown = Shown { name: "gyroscope", unit: "deg/s/sqrt(Hz)", si: DEGREE_RAD };
        let way_out = |density: f64| gyro_way_out(recording, density, &accel);
        findings.extend(densities(recording, 3, &gyro, GYRO_DENSITY, &shown, way_out));
        findings.extend(biases(recording, &gyro));
    }
    findings
}

/// How the densities of a triad are written in messages: the name of the sensor, the unit, and the size of the unit in
/// SI units.
struct Shown {
    name: &'static str,
    unit: &'static str,
    si: f64,
}

fn densities(
    recording: &Recording,
    first: usize,
    triad: &[RestNoise; 3],
    [low, high]: [f64; 2],
    shown: &Shown,
    way_out: impl Fn(f64) -> String,
) -> Option<Finding> {
    // A density of zero belongs to a constant column, which other findings report.
    let is_wrong = |density: f64| density > 0.0 && !(low..=high).contains(&density);
    let wrong: Vec<(usize, f64)> =
        triad.iter().enumerate().filter_map(|(k, axis)| Some((k, axis.density.filter(|d| is_wrong(*d))?))).collect();
    let (_, worst) = *wrong.iter().max_by(|(_, a), (_, b)| a.total_cmp(b))?;
    let (limit, beyond) = if worst > high { (high, "above") } else { (low, "below") };
    Some(Finding {
        columns: names(wrong.iter().map(|(k, _)| CHANNELS[first + k])),
        count: wrong.len(),
        value: worst / shown.si,
        unit: shown.unit,
        message: format!(
            "the noise density at rest is {} {}, {beyond} {} {}: no usual {} has that",
            general(worst / shown.si, 3),
            shown.unit,
            general(limit / shown.si, 3),
            shown.unit,
            shown.name
        ),
        way_out: way_out(worst),
        ..Finding::warning("noise_implausible", recording.name)
    })
}

/// Whether the noise of the accelerometer shows that the unit moves in the detected rests.
#[derive(PartialEq)]
enum Motion {
    /// The noise is that of a usual sensor at rest, or the unit of measurement of the accelerometer is not confirmed.
    /// This unit is confirmed if it is SI and the median specific force equals gravity.
    None,
    /// The unit of measurement is confirmed, and the noise is higher than that of usual sensors.
    Possible,
    /// The unit of measurement is confirmed, and the noise is higher than that of any sensor.
    Certain,
}

impl Motion {
    fn of(recording: &Recording, accel: &[RestNoise; 3]) -> Self {
        let density = accel.iter().filter_map(|axis| axis.density).fold(0.0, f64::max);
        if recording.accel_unit != RawUnit::Si || density <= USUAL_ACCEL_DENSITY || !is_gravity(median_force(recording))
        {
            Self::None
        } else if density > ACCEL_DENSITY[1] {
            Self::Certain
        } else {
            Self::Possible
        }
    }
}

/// Median norm of the specific force over all samples, moves included, m/s^2.
fn median_force(recording: &Recording) -> f64 {
    let sizes = recording.specific_force.iter().map(|[x, y, z]| (x * x + y * y + z * z).sqrt());
    median(&mut sizes.filter(|size| size.is_finite()).collect::<Vec<_>>())
}

/// Whether a median specific force, m/s^2, can be gravity.
fn is_gravity(force_mps2: f64) -> bool {
    (GRAVITY_RATIO[0]..=GRAVITY_RATIO[1]).contains(&(force_mps2 / STANDARD_GRAVITY_MPS2))
}

/// Recommends the unit of measurement in which an unusual noise density of a gyroscope, rad/s/sqrt(Hz), would be usual.
/// If motion explains the density, the advice is to hold the sensor still.
fn gyro_way_out(recording: &Recording, density: f64, accel: &[RestNoise; 3]) -> String {
    let usual = |density: f64| (USUAL[0]..=USUAL[1]).contains(&density);
    let (given, size_radps, _) = given_gyro_unit(recording);
    // Noise density of the numbers as they are in the file, before the conversion to rad/s. It does not depend on the
    // unit of measurement in which the columns were read.
    let in_file = density / size_radps;
    let is_radps = *given == "radps";
    let count = (0..3).find_map(|axis| known_count(converter_step(recording.angular_rate, axis))).filter(|_| is_radps);
    let motion = Motion::of(recording, accel);
    if motion == Motion::Certain && count.is_none() {
        return NEVER_RESTS.into();
    }
    if is_radps && (count.is_some() || usual(in_file)) {
        let counts = count.map_or_else(String::new, |text| {
            format!(", and the values are multiples of {text}, a usual size of a count in deg/s")
        });
        let names = "name the columns gyro_x_dps, gyro_y_dps, gyro_z_dps";
        let or_else = match motion {
            _ if count.is_some() => String::new(),
            Motion::Possible => format!("; or, because the accelerometer is noisier than usual, too, {NEVER_RESTS}"),
            _ => "; if the columns are in rad/s, the gyroscope is noisy: look for vibration or a fault of its supply or wiring"
                .into(),
        };
        return format!(
            "in deg/s the density would be {} deg/s/sqrt(Hz){counts}: {names}{or_else}",
            general(in_file, 3)
        );
    }
    if *given != "mdps" && usual(in_file / 1000.0) {
        return format!(
            "in mdeg/s the density would be {} deg/s/sqrt(Hz): name the columns gyro_x_mdps, gyro_y_mdps, gyro_z_mdps",
            general(in_file / 1000.0, 3)
        );
    }
    if density > GYRO_DENSITY[1] {
        return "give the columns in the unit of their names (gyro_x_dps, gyro_x_mdps or gyro_x_lsb), or record the unit \
                on something rigid, away from motors"
            .into();
    }
    "the rates are too small by a factor of 57.3 or more: give the columns in the unit of their names, gyro_x_radps, _dps \
     or _lsb; a filtered or averaged output also has a smaller density"
        .into()
}

/// Recommends the unit of measurement in which the implausible noise density `density` of an accelerometer,
/// m/s^2/sqrt(Hz), would be that of a usual sensor. If the median specific force equals gravity, the unit of the
/// columns is correct, so a density that is too high is due to motion. The text then recommends holding the sensor
/// still.
fn accel_way_out(recording: &Recording, density: f64) -> String {
    let usual = |density_mg: f64| (0.03..=3.0).contains(&density_mg);
    let force = median_force(recording);
    if density > ACCEL_DENSITY[1] && is_gravity(force) {
        return NEVER_RESTS.into();
    }
    let (given, per_number) = given_accel_unit(recording);
    let in_file = density / per_number;
    if given != "mg" && usual(in_file) && is_gravity(1e-3 * STANDARD_GRAVITY_MPS2 * force / per_number) {
        return format!(
            "in mg the density would be {} mg/sqrt(Hz): name the columns accel_x_mg, accel_y_mg, accel_z_mg",
            general(in_file, 3)
        );
    }
    if density > ACCEL_DENSITY[1] {
        return "give the columns in the unit of their names (accel_x_mps2, accel_x_g, accel_x_mg or accel_x_lsb), or \
                record the unit on something rigid, away from motors"
            .into();
    }
    "give the columns in the unit of their names: accel_x_mps2, _g, _mg or _lsb; a filtered or averaged output also has a \
     smaller density"
        .into()
}

/// The text of the entry of [`GYRO_COUNTS_DPS`] whose number equals `step`, the smallest step between the values of a
/// column. `None` if there is no such entry.
fn known_count(step: f64) -> Option<&'static str> {
    let same = |(size, _): &&(f64, &str)| (step / size - 1.0).abs() < SAME_COUNT;
    // The nearest known size is chosen, because 1/131 and 250/32768 differ by only 0.05 %.
    let nearest = |a: &&(f64, &str), b: &&(f64, &str)| (step / a.0 - 1.0).abs().total_cmp(&(step / b.0 - 1.0).abs());
    GYRO_COUNTS_DPS.iter().filter(same).min_by(nearest).map(|(_, text)| *text)
}

fn biases(recording: &Recording, triad: &[RestNoise; 3]) -> Option<Finding> {
    let wrong: Vec<(usize, f64)> = triad
        .iter()
        .enumerate()
        .filter_map(|(k, axis)| Some((k, axis.mean.filter(|mean| mean.abs() > GYRO_BIAS_RADPS)?)))
        .collect();
    let (_, worst) = *wrong.iter().max_by(|(_, a), (_, b)| a.abs().total_cmp(&b.abs()))?;
    let axes: Vec<&str> = wrong.iter().map(|(k, _)| CHANNELS[3 + k]).collect();
    let way_out = if worst.abs() < GYRO_BIAS_RADPS / DEGREE_RAD {
        format!(
            "in deg/s it would be {} deg/s: name the columns gyro_x_dps, gyro_y_dps, gyro_z_dps; raw counts are gyro_x_lsb",
            general(worst, 3)
        )
    } else {
        "give the columns in the unit of their names: gyro_x_dps, gyro_x_mdps or, for raw counts, gyro_x_lsb".into()
    };
    Some(Finding {
        columns: names(axes.iter().copied()),
        count: wrong.len(),
        value: worst / DEGREE_RAD,
        unit: "deg/s",
        message: format!(
            "the mean rate at rest is {} deg/s, above {:.0} deg/s: no gyroscope has such a bias",
            general(worst / DEGREE_RAD, 3),
            GYRO_BIAS_RADPS / DEGREE_RAD
        ),
        way_out: way_out + &if_only(&axes),
        ..Finding::warning("bias_implausible", recording.name)
    })
}

#[cfg(test)]
mod tests {
    use super::super::example::Columns;
    use super::*;
    use crate::finding::Severity;

    fn found(accel: f64, gyro: f64, mean: f64, count: f64) -> Vec<Finding> {
        let mut columns = Columns::tumbling();
        if count > 0.0 {
            columns = columns.quantised(0.01, count);
        }
        let of = |density| RestNoise { density: Some(density), mean: Some(mean) };
        check_noise(&columns.recording(), &[of(accel), of(accel), of(accel), of(gyro), of(gyro), of(gyro)])
    }

    #[test]
    fn sensors_on_the_market_are_plausible() {
        // Datasheet densities (one-sided), ug/sqrt(Hz) and deg/s/sqrt(Hz). The factor `share` makes them two-sided.
        for (accel_ug, gyro_dps) in [(400.0, 0.005), (70.0, 0.0028), (126.0, 0.025), (4300.0, 0.1), (0.1, 2e-5)] {
            let share = 0.5_f64.sqrt();
            let accel = accel_ug * 1e-6 * STANDARD_GRAVITY_MPS2 * share;
            assert!(found(accel, gyro_dps * DEGREE_RAD * share, 40.0 * DEGREE_RAD, 0.0).is_empty(), "{accel_ug}");
        }
    }

    #[test]
    fn degrees_read_as_radians_are_named_with_their_counts() {
        let findings = found(1e-3, 6e-3, 0.07, 0.007_633_6);
        assert_eq!((findings.len(), findings[0].code), (1, "noise_implausible"));
        assert_eq!((findings[0].severity, findings[0].count), (Severity::Warning, 3));
        assert!(findings[0].way_out.contains("gyro_x_dps") && findings[0].way_out.contains("1/131"), "{findings:?}");
        assert!(found(1e-3, 6.0, 0.07, 0.0)[0].way_out.contains("gyro_x_mdps"));
    }

    #[test]
    fn motion_is_not_called_a_wrong_unit() {
        let moving = found(0.2, 6e-3, 0.0, 0.0);
        assert_eq!(moving.iter().map(|f| f.way_out.as_str()).collect::<Vec<_>>(), [NEVER_RESTS; 2]);
        let undecided = &found(0.05, 6e-3, 0.0, 0.0)[0].way_out;
        assert!(undecided.contains("gyro_x_dps") && undecided.ends_with(NEVER_RESTS), "{undecided}");
        // The step between the values, 1/131, is the size of a count of usual gyroscopes in deg/s. It reveals the unit
        // although the sensor moves.
        assert!(found(0.2, 6e-3, 0.0, 0.007_633_6)[1].way_out.contains("gyro_x_dps"));
    }

    #[test]
    fn columns_are_not_advised_to_have_the_unit_that_they_have() {
        let mut columns = Columns::tumbling();
        let noise = RestNoise { density: Some(6e-3), mean: Some(0.0) };
        let recording = Recording { column_units: [Some("g"), Some("dps")], ..columns.recording() };
        let way_out = &check_noise(&recording, &[noise; 6])[0].way_out;
        assert!(!way_out.contains("name the columns gyro_x_dps"), "{way_out}");
        columns.force.iter_mut().flatten().for_each(|f| *f *= 102.0);
        let in_mg = RestNoise { density: Some(0.2), mean: Some(0.0) };
        let way_out = &check_noise(&columns.recording(), &[in_mg; 6])[0].way_out;
        assert!(way_out.contains("accel_x_mg"), "{way_out}");
    }

    #[test]
    fn what_is_quieter_than_any_sensor_is_named_too() {
        let findings = found(1e-9, 1e-9, 0.0, 0.0);
        assert_eq!(findings.iter().map(|f| f.code).collect::<Vec<_>>(), ["noise_implausible"; 2]);
        assert!(found(0.0, 0.0, 0.0, 0.0).is_empty());
    }

    #[test]
    fn a_bias_of_more_than_50_degrees_per_second_is_none() {
        let findings = found(1e-3, 1e-4, 1.2, 0.0);
        assert_eq!((findings[0].code, findings[0].columns.len()), ("bias_implausible", 3));
        assert!(findings[0].way_out.contains("gyro_x_dps"));
    }
}
