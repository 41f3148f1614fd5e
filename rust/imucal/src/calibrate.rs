//! From recordings to a calibration, in the order of the method: check, find rests, fit the accelerometer to them,
//! carry gravity from rest to rest to fit the gyroscope, say how sure all of it is.

use faer::Mat;
use imucal_core::calibration::Calibration;
use imucal_core::sensor::Triad;
use nalgebra::{Matrix3, Vector3};

use crate::accelerometer::{self, AccelerometerFit};
use crate::carry::rotate;
use crate::check::{self, Finding, Severity};
use crate::ellipsoid::Start;
use crate::error::Error;
use crate::evaluate::{Figures, MoveReport, RestReport, figures, move_report, rest_report, unusable_report};
use crate::frame::{self, Frame, Sensitivities};
use crate::gyroscope::{self, Ends, GyroscopeBias, GyroscopeFit, Move};
use crate::kinematics::rate_from_gravity;
use crate::lsq::Termination;
use crate::moves::{Directions, UnitRest, Unusable, between, direction_error_rad, rests_of};
use crate::recording::{RawUnit, Recording};
use crate::segment::{NoiseDensity, Rest, Segments, Threshold};
use crate::stats::rms;
use crate::uncertainty;

/// Standard gravity, m/s^2.
pub const STANDARD_GRAVITY_MPS2: f64 = 9.80665;

/// Moves that the gyroscope's nine entries need at least, two numbers each.
const FEWEST_MOVES: usize = 5;
/// From the highest mountain of the tropics (9.76) to the poles (9.84), with some room, m/s^2.
const GRAVITY_ON_EARTH_MPS2: [f64; 2] = [9.7, 9.9];

/// What a calibration may be told.
#[derive(Clone, Debug)]
pub struct Options {
    /// Local gravity, m/s^2. Every accelerometer scale is in proportion to it.
    pub gravity_mps2: f64,
    /// Body frame of the result.
    pub frame: Frame,
    /// Shortest rest, s.
    pub min_rest_s: f64,
    /// Leave out rests and moves with saturated samples instead of refusing the recording.
    pub exclude_saturated: bool,
    /// Nominal sensitivity of an accelerometer in counts, lsb per m/s^2; start values come from the data without it.
    pub accel_nominal: Option<f64>,
    /// Nominal sensitivity of a gyroscope in counts, lsb per rad/s.
    pub gyro_nominal: Option<f64>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            gravity_mps2: STANDARD_GRAVITY_MPS2,
            frame: Frame::Symmetric,
            min_rest_s: 1.0,
            exclude_saturated: false,
            accel_nominal: None,
            gyro_nominal: None,
        }
    }
}

/// How one of the two fits ended.
#[derive(Clone, Copy, Debug)]
pub struct FitReport {
    /// Sum of the squared residuals in units of what noise explains.
    pub chi2: f64,
    /// Residuals less parameters.
    pub degrees_of_freedom: usize,
    /// By how much standard deviations were widened because the residuals exceed the noise; 1 if they do not.
    pub inflation: f64,
    /// Iterations of the solver.
    pub iterations: u64,
    /// Why it ended.
    pub termination: Termination,
}

/// A calibration and all that is known about it.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Both triads, in `frame`.
    pub calibration: Calibration<f64>,
    /// The body frame.
    pub frame: Frame,
    /// Names of the 21 parameters.
    pub names: [String; 21],
    /// Their values, in the same order, raw units.
    pub values: [f64; 21],
    /// Their covariance, row by row.
    pub covariance: Vec<[f64; 21]>,
    /// Every rest found.
    pub rests: Vec<RestReport>,
    /// Every stretch between neighbouring rests.
    pub moves: Vec<MoveReport>,
    /// How each recording's rests were found.
    pub thresholds: Vec<Threshold>,
    /// White-noise density of the unit, SI units per sqrt(Hz), median over the recordings.
    pub noise_density: NoiseDensity,
    /// The accelerometer's fit.
    pub accelerometer_fit: FitReport,
    /// The gyroscope's fit.
    pub gyroscope_fit: FitReport,
    /// How well the calibration explains its own data.
    pub figures: Figures,
    /// Warnings about the data.
    pub findings: Vec<Finding>,
}

/// Calibrates one unit from one or more of its recordings.
///
/// # Errors
/// [`Error::Data`] lists faults that would make the result wrong, [`Error::NotEnoughMotion`] names what is missing,
/// [`Error::Fit`] says why a fit has no acceptable end.
pub fn calibrate(recordings: &[Recording<'_>], options: &Options) -> Result<Outcome, Error> {
    refuse(crate::check::check_shared(recordings))?;
    let outcome = estimate(recordings, options)?;
    refuse(recordings.first().map_or_else(Vec::new, |first| crate::check::check_gains(first, &outcome.calibration)))?;
    Ok(outcome)
}

/// Too few moves for want of usable ones is another thing than too few moves.
fn require_moves(usable: usize, unusable: &[crate::moves::Unusable]) -> Result<(), Error> {
    let Some(first) = unusable.first() else {
        return Ok(());
    };
    if usable >= FEWEST_MOVES {
        return Ok(());
    }
    let count = |reason: &str| unusable.iter().filter(|u| u.reason == reason).count();
    let reasons: Vec<String> = [("samples_missing", "gaps in time"), ("saturation", "saturated samples")]
        .into_iter()
        .filter(|(reason, _)| count(reason) > 0)
        .map(|(reason, words)| format!("{} for {words} [{reason}]", count(reason)))
        .collect();
    Err(Error::NotEnoughMotion(format!(
        "{usable} of {} moves are usable and do not determine the gyroscope, at least {FEWEST_MOVES} are needed, better 12; \
         left out: {} (the first between rests {} and {}): record again without them",
        usable + unusable.len(),
        reasons.join(", "),
        first.span.from,
        first.span.to,
    )))
}

fn refuse(errors: Vec<crate::check::Finding>) -> Result<(), Error> {
    if errors.is_empty() { Ok(()) } else { Err(Error::Data(errors)) }
}

/// The estimation, in the order of the method.
fn estimate(recordings: &[Recording<'_>], options: &Options) -> Result<Outcome, Error> {
    let data = UnitData::try_new(recordings, options)?;
    let accelerometer = data.fit_accelerometer(options)?;
    let (moves, unusable) = data.moves(&accelerometer);
    require_moves(moves.len(), &unusable)?;
    let gyroscope = data.fit_gyroscope(&moves, &accelerometer, options)?;
    data.report(&accelerometer, &gyroscope, &moves, &unusable, options)
}

/// How well moves are predicted that the gyroscope's fit has not seen.
#[derive(Clone, Debug)]
pub struct CrossValidation {
    /// Rms over all moves of the angle between carried and measured gravity, each with the fit that left it out, deg.
    pub gravity_direction_rms_deg: f64,
    /// The angle of each move, deg.
    pub direction_error_deg: Vec<f64>,
}

/// Fits the gyroscope `folds` times, each time without every `folds`-th move, and judges it on the moves left out.
///
/// # Errors
/// As [`calibrate`]; [`Error::Input`] for fewer than two folds.
pub fn cross_validate(recordings: &[Recording<'_>], options: &Options, folds: usize) -> Result<CrossValidation, Error> {
    if folds < 2 {
        return Err(Error::Input(format!("folds = {folds}: at least 2 are needed to leave moves out")));
    }
    let data = UnitData::try_new(recordings, options)?;
    let accelerometer = data.fit_accelerometer(options)?;
    let (moves, _) = data.moves(&accelerometer);
    let mut direction_error_deg = vec![f64::NAN; moves.len()];
    for fold in 0..folds {
        let seen: Vec<Move> = (0..moves.len()).filter(|k| k % folds != fold).map(|k| moves[k]).collect();
        let fit = data.fit_gyroscope(&seen, &accelerometer, options)?.fit;
        let (ends, _) = data.ends(&moves, &accelerometer, fit.triad.inverse());
        for k in (fold..moves.len()).step_by(folds) {
            let m = &moves[k];
            let rotation = rotate(&recordings[m.recording], m.first, m.last, &fit.triad);
            direction_error_deg[k] = direction_error_rad(&ends[k], &rotation).to_degrees();
        }
    }
    Ok(CrossValidation { gravity_direction_rms_deg: rms(direction_error_deg.iter().copied()), direction_error_deg })
}

/// Checked recordings of one unit and the rests in them.
struct UnitData<'a> {
    recordings: &'a [Recording<'a>],
    segments: Vec<Segments>,
    rests: Vec<UnitRest>,
    /// Why a rest takes no part; `None` if it does.
    excluded: Vec<Option<&'static str>>,
    bias: GyroscopeBias,
    saturated: Vec<Vec<std::ops::Range<usize>>>,
    findings: Vec<Finding>,
}

/// The gyroscope's fit and what it was fitted to.
struct Gyroscope {
    fit: GyroscopeFit,
    ends: Vec<Ends>,
    random_walk_rad: Vec<f64>,
    findings: Vec<Finding>,
}

impl<'a> UnitData<'a> {
    fn try_new(recordings: &'a [Recording<'a>], options: &Options) -> Result<Self, Error> {
        check_options(recordings, options)?;
        let mut findings = Vec::new();
        for recording in recordings {
            findings.extend(check::check_columns(recording));
        }
        if options.exclude_saturated {
            for finding in findings.iter_mut().filter(|finding| finding.code.ends_with("_saturation")) {
                finding.severity = Severity::Warning;
            }
        }
        refuse_errors(&findings)?;
        let segments: Vec<Segments> = recordings
            .iter()
            .map(|recording| Segments::find(recording, options.min_rest_s))
            .collect::<Result<_, _>>()?;
        for (recording, segments) in recordings.iter().zip(&segments) {
            let ranges: Vec<_> = segments.rests.iter().map(|rest| rest.first..rest.end).collect();
            findings.extend(check::check_rests(recording, &ranges, options.gravity_mps2));
        }
        refuse_errors(&findings)?;
        let rests = rests_of(&segments);
        let saturated: Vec<Vec<_>> = recordings.iter().map(check::saturated_samples).collect();
        let bias = gyroscope::bias_from_rests(&rests.iter().map(|rest| &rest.rest).collect::<Vec<_>>());
        let excluded = rests
            .iter()
            .zip(&bias.weights)
            .map(|(r, weight)| {
                if saturated[r.recording].iter().any(|s| s.start < r.rest.end && s.end > r.rest.first) {
                    Some("saturation")
                } else if weight.min() == 0.0 {
                    // Its mean rate is far from all others': a slow, even turn looks like a rest.
                    Some("rest_not_still")
                } else {
                    None
                }
            })
            .collect();
        Ok(Self { recordings, segments, rests, excluded, bias, saturated, findings })
    }

    fn raw_is_si(&self, unit: impl Fn(&Recording<'_>) -> RawUnit) -> bool {
        self.recordings.first().is_some_and(|recording| unit(recording) == RawUnit::Si)
    }

    fn fit_accelerometer(&self, options: &Options) -> Result<AccelerometerFit, Error> {
        let clean: Vec<usize> = (0..self.rests.len()).filter(|&k| self.excluded[k].is_none()).collect();
        let rests: Vec<&Rest> = clean.iter().map(|&k| &self.rests[k].rest).collect();
        let nominal = options
            .accel_nominal
            .map(|scale| Start { sensitivity: Matrix3::from_diagonal_element(scale), bias: Vector3::zeros() });
        let si = self.raw_is_si(|recording| recording.accel_unit);
        let mut fit = accelerometer::fit(&rests, options.gravity_mps2, nominal, si)
            .map_err(|error| self.with_short_rests(error, options))?;
        // From here on there is one entry per rest found, clean or not.
        let mut used = vec![false; self.rests.len()];
        let mut gain = Mat::zeros(9, self.rests.len());
        for (column, &k) in clean.iter().enumerate() {
            used[k] = fit.used[column];
            for i in 0..9 {
                gain[(i, k)] = fit.gain[(i, column)];
            }
        }
        (fit.used, fit.gain) = (used, gain);
        Ok(fit)
    }

    /// Stretches that are a little too short to be rests are worth a word where rests are missing.
    fn with_short_rests(&self, error: Error, options: &Options) -> Error {
        let Error::NotEnoughMotion(message) = error else {
            return error;
        };
        for (recording, segments) in self.recordings.iter().zip(&self.segments) {
            if let Some(range) = segments.too_short.iter().max_by_key(|range| range.len()) {
                let (start_s, end_s) = (recording.time_s[range.start], recording.time_s[range.end - 1]);
                return Error::NotEnoughMotion(format!(
                    "{message}; {} still stretches are too short to be rests, the longest ({start_s:.2} s to {end_s:.2} s) \
                     has {} samples: hold each pose for {} s, or pass min_rest_s={:.2}",
                    segments.too_short.len(),
                    range.len(),
                    options.min_rest_s,
                    0.9 * (end_s - start_s)
                ));
            }
        }
        Error::NotEnoughMotion(message)
    }

    fn moves(&self, accelerometer: &AccelerometerFit) -> (Vec<Move>, Vec<Unusable>) {
        between(self.recordings, &self.rests, &accelerometer.used, &self.saturated)
    }

    fn ends(&self, moves: &[Move], accelerometer: &AccelerometerFit, inverse: &Matrix3<f64>) -> (Vec<Ends>, Vec<f64>) {
        let noise: Vec<NoiseDensity> = self.segments.iter().map(|segments| segments.noise_density).collect();
        let directions = Directions {
            recordings: self.recordings,
            rests: &self.rests,
            noise: &noise,
            accelerometer: &accelerometer.triad,
            gyroscope_inverse: inverse,
        };
        directions.ends_of(moves)
    }

    fn fit_gyroscope(
        &self,
        moves: &[Move],
        accelerometer: &AccelerometerFit,
        options: &Options,
    ) -> Result<Gyroscope, Error> {
        if moves.len() < 5 {
            return Err(Error::NotEnoughMotion(format!(
                "{} usable moves between {} rests do not determine the gyroscope: at least 5 between different poses \
                 are needed, better 12; move the unit about all three axes, resting in between",
                moves.len(),
                self.rests.len()
            )));
        }
        let bias = &self.bias;
        let kinematic = rate_from_gravity(self.recordings, moves, &accelerometer.triad, bias.bias);
        let mut findings = Vec::new();
        if let Some(rate_from_raw) = &kinematic {
            findings = check::check_kinematics(&self.recordings[0], rate_from_raw);
            refuse_errors(&findings)?;
        }
        let si = self.raw_is_si(|recording| recording.gyro_unit);
        let nominal = options.gyro_nominal.or(si.then_some(1.0)).map(Matrix3::from_diagonal_element);
        let starts: Vec<Matrix3<f64>> =
            kinematic.and_then(|p| p.try_inverse()).into_iter().chain(nominal).filter(well_conditioned).collect();
        if starts.is_empty() {
            return Err(Error::NotEnoughMotion(format!(
                "{} moves do not determine the gyroscope's scale in raw counts: add moves of 90 deg or more about \
                 each axis, or pass its nominal sensitivity",
                moves.len()
            )));
        }
        // The weights need the scale, the scale needs a fit: the second round starts at the first one's result.
        let (ends, _) = self.ends(moves, accelerometer, &inverse(&starts[0])?);
        let first = gyroscope::fit(self.recordings, moves, &ends, bias.bias, &starts)?;
        let (ends, random_walk_rad) = self.ends(moves, accelerometer, first.triad.inverse());
        let fit = gyroscope::fit(self.recordings, moves, &ends, bias.bias, &[*first.triad.sensitivity()])?;
        Ok(Gyroscope { fit, ends, random_walk_rad, findings })
    }

    fn report(
        mut self,
        accelerometer: &AccelerometerFit,
        gyroscope: &Gyroscope,
        moves: &[Move],
        unusable: &[Unusable],
        options: &Options,
    ) -> Result<Outcome, Error> {
        let fit = &gyroscope.fit;
        let rests: Vec<&Rest> = self.rests.iter().map(|rest| &rest.rest).collect();
        let covariance = uncertainty::covariance(
            &rests,
            moves,
            &gyroscope.ends,
            accelerometer,
            &self.bias,
            fit,
            &gyroscope.random_walk_rad,
        );
        let rest_reports: Vec<RestReport> = (0..self.rests.len())
            .map(|k| {
                let contradicts = (!accelerometer.used[k]).then_some("contradicts_other_rests");
                let excluded = self.excluded[k].or(contradicts);
                rest_report(&self.rests[k], &accelerometer.triad, options.gravity_mps2, excluded)
            })
            .collect();
        let mut move_reports: Vec<MoveReport> = (0..moves.len())
            .map(|k| {
                let excluded = (!fit.used[k]).then_some("contradicts_other_moves");
                move_report(&moves[k], &gyroscope.ends[k], &fit.carried[k].rotation, excluded)
            })
            .collect();
        move_reports.extend(unusable.iter().map(|u| unusable_report(&u.span, u.reason)));
        move_reports.sort_by_key(|report| (report.recording, report.first));
        let residuals: Vec<f64> = (0..moves.len())
            .filter(|&k| fit.used[k])
            .flat_map(|k| {
                let z = gyroscope.ends[k].residual(&fit.carried[k].rotation) / gyroscope.ends[k].sigma_rad;
                [z.x, z.y]
            })
            .collect();
        let figures = figures(&rest_reports, &move_reports, &residuals, 18);

        let symmetric =
            Sensitivities { accelerometer: *accelerometer.triad.sensitivity(), gyroscope: *fit.triad.sensitivity() };
        let (sensitivities, covariance) = match options.frame {
            Frame::Symmetric => (symmetric, covariance),
            frame => {
                let converted = frame::convert(&symmetric, frame)?;
                let jacobian = frame::parameter_jacobian(&symmetric, &converted, frame)?;
                let turn = inverse(&converted.accelerometer)? * symmetric.accelerometer;
                for report in &mut move_reports {
                    report.gravity_before = turn * report.gravity_before;
                    report.gravity_after = turn * report.gravity_after;
                }
                (converted, &jacobian * covariance * jacobian.transpose())
            }
        };
        let calibration = Calibration {
            accelerometer: triad(sensitivities.accelerometer, *accelerometer.triad.bias())?,
            gyroscope: triad(sensitivities.gyroscope, self.bias.bias)?,
        };
        self.findings.extend(gyroscope.findings.iter().cloned());
        Ok(Outcome {
            frame: options.frame,
            names: parameter_names(options.frame),
            values: parameter_values(&calibration, options.frame),
            covariance: (0..21).map(|i| std::array::from_fn(|j| covariance[(i, j)])).collect(),
            rests: rest_reports,
            moves: move_reports,
            noise_density: self.noise_density(&calibration),
            thresholds: self.segments.into_iter().map(|segments| segments.threshold).collect(),
            accelerometer_fit: FitReport {
                chi2: accelerometer.chi2,
                degrees_of_freedom: accelerometer.degrees_of_freedom,
                inflation: accelerometer.inflation(),
                iterations: accelerometer.iterations,
                termination: accelerometer.termination,
            },
            gyroscope_fit: FitReport {
                chi2: fit.chi2,
                degrees_of_freedom: fit.degrees_of_freedom,
                inflation: fit.inflation(),
                iterations: fit.iterations,
                termination: fit.termination,
            },
            figures,
            findings: self.findings,
            calibration,
        })
    }

    /// Median over the recordings, in SI units of the calibrated sensors.
    fn noise_density(&self, calibration: &Calibration<f64>) -> NoiseDensity {
        let median_of = |pick: fn(&NoiseDensity) -> Vector3<f64>| {
            Vector3::from_fn(|axis, _| {
                let mut values: Vec<f64> = self.segments.iter().map(|s| pick(&s.noise_density)[axis]).collect();
                crate::stats::median(&mut values)
            })
        };
        let si = |raw: Vector3<f64>, triad: &Triad<f64>| raw.component_div(&triad.sensitivity().diagonal().abs());
        NoiseDensity {
            specific_force: si(median_of(|noise| noise.specific_force), &calibration.accelerometer),
            angular_rate: si(median_of(|noise| noise.angular_rate), &calibration.gyroscope),
        }
    }
}

fn check_options(recordings: &[Recording<'_>], options: &Options) -> Result<(), Error> {
    let Some(first) = recordings.first() else {
        return Err(Error::Input("no recording was given".into()));
    };
    if let Some(other) = recordings.iter().find(|r| (r.accel_unit, r.gyro_unit) != (first.accel_unit, first.gyro_unit))
    {
        return Err(Error::Input(format!(
            "{} and {} are in different raw units: recordings of one unit must agree",
            first.name, other.name
        )));
    }
    // No data can tell a wrong gravity from a wrong scale, so a value that no place has is refused.
    let [least, most] = GRAVITY_ON_EARTH_MPS2;
    if !(options.gravity_mps2 >= least && options.gravity_mps2 <= most) {
        return Err(Error::Input(format!(
            "gravity_mps2 = {}: on Earth gravity is between {least} and {most} m/s^2, give that of your place or leave \
             {STANDARD_GRAVITY_MPS2}",
            options.gravity_mps2
        )));
    }
    for (name, nominal) in [("accel_nominal", options.accel_nominal), ("gyro_nominal", options.gyro_nominal)] {
        if let Some(value) = nominal
            && !(value.is_finite() && value > 0.0)
        {
            return Err(Error::Input(format!("{name} = {value}: give lsb per SI unit, a positive number")));
        }
    }
    Ok(())
}

fn refuse_errors(findings: &[Finding]) -> Result<(), Error> {
    let errors: Vec<Finding> = findings.iter().filter(|f| f.severity == Severity::Error).cloned().collect();
    if errors.is_empty() { Ok(()) } else { Err(Error::Data(errors)) }
}

/// Whether a start value is far enough from singular to integrate with.
fn well_conditioned(sensitivity: &Matrix3<f64>) -> bool {
    let size = sensitivity.norm() / 3f64.sqrt();
    size.is_finite() && sensitivity.determinant().abs() > 0.05 * size.powi(3)
}

fn inverse(matrix: &Matrix3<f64>) -> Result<Matrix3<f64>, Error> {
    matrix.try_inverse().ok_or_else(|| Error::Fit("a sensitivity matrix is singular".into()))
}

fn triad(sensitivity: Matrix3<f64>, bias: Vector3<f64>) -> Result<Triad<f64>, Error> {
    Triad::try_new(sensitivity, bias).map_err(|error| Error::Fit(error.to_string()))
}

/// Names of the 21 parameters in their order.
pub fn parameter_names(frame: Frame) -> [String; 21] {
    const AXES: [char; 3] = ['x', 'y', 'z'];
    let free = frame.free_entries();
    std::array::from_fn(|p| match p {
        0..3 => format!("accel_bias_{}", AXES[p]),
        3..9 => format!("accel_sensitivity_{}{}", AXES[free[p - 3].0], AXES[free[p - 3].1]),
        9..12 => format!("gyro_bias_{}", AXES[p - 9]),
        _ => format!("gyro_sensitivity_{}{}", AXES[(p - 12) / 3], AXES[(p - 12) % 3]),
    })
}

/// Values of the 21 parameters in their order.
pub fn parameter_values(calibration: &Calibration<f64>, frame: Frame) -> [f64; 21] {
    let (accelerometer, gyroscope) = (&calibration.accelerometer, &calibration.gyroscope);
    let free = frame.free_entries();
    std::array::from_fn(|p| match p {
        0..3 => accelerometer.bias()[p],
        3..9 => accelerometer.sensitivity()[free[p - 3]],
        9..12 => gyroscope.bias()[p - 9],
        _ => gyroscope.sensitivity()[((p - 12) / 3, (p - 12) % 3)],
    })
}
