//! `imucal._core`: Python bindings of the Rust library. The bindings only convert types and contain no calculations.
//!
//! Arrays are passed without a copy. The module `arrays` verifies that the arrays of a recording are C-contiguous. The
//! Python interpreter lock (GIL) is released during long calculations. The module `error` converts errors of the
//! library to the classes of `imucal.errors`.

mod arrays;
mod calibration;
mod effects;
mod error;
mod gap;
mod interrupt;
mod mappings;
mod noise;
mod number_columns;
mod options;
mod plan;
mod results;
mod simulation;
mod user_effects;

/// The extension module `imucal._core`.
#[pyo3::pymodule]
mod _core {
    use imucal as library;
    use imucal::calibrate::UserEffects;
    use imucal::check;
    use imucal::error::Error;
    use imucal::frame::{self, Sensitivities};
    use imucal::rests::Segments;
    use imucal_core::integrate::{Integrator, Order};
    use imucal_core::so3;
    use nalgebra::Vector3;
    use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
    use pyo3::prelude::*;

    use super::arrays::{MeanColumns, RecordingColumns, column, matrix, rows, to_rows};
    use super::calibration::{CalibrationArrays, TriadArrays};
    #[pymodule_export]
    use super::effects::{Effect, effect_field, effects, temperature_history};
    use super::error::{ToPython, finding};
    #[pymodule_export]
    use super::gap::{
        EffectScore, GapAnalysis, GapDesign, GapFit, GapResult, GenericFinding, Remainder, Search, SessionStep,
        find_gap, gap_design, mount_faults, stand_mismatch_deg,
    };
    use super::interrupt::interruptible;
    #[pymodule_export]
    use super::noise::{AxisNoise, Noise, NoiseEstimate, allan_deviations, allan_factors, identify_noise};
    #[pymodule_export]
    use super::number_columns::NumberColumns;
    use super::options::{CalibrateOptions, frame_named};
    #[pymodule_export]
    use super::plan::{optimal_program, plan_effect_parameters, predict_sigma, smallest_visible};
    #[pymodule_export]
    use super::results::{Carried, EffectEstimate, Estimate, Evaluation, HeldOut, Inspection, Outcome, Prospect};
    #[pymodule_export]
    use super::simulation::{
        Simulation, earth_rate_radps, gravity_mps2, grid_program, normal_gravity_sigma_mps2, random_program, simulate,
    };
    use super::user_effects::PythonEffects;

    #[pymodule_export]
    #[allow(non_upper_case_globals)]
    const __version__: &str = env!("CARGO_PKG_VERSION");

    /// Time constant of the low-passes of the temperature history, s.
    #[pymodule_export]
    const TEMPERATURE_SMOOTHING_S: f64 = imucal_core::temperature_memory::SMOOTHING_S;

    /// Half of the temperature change that reverses the direction of the temperature history from cooling (-1) to
    /// heating (1), K.
    #[pymodule_export]
    const TEMPERATURE_REVERSAL_K: f64 = imucal_core::temperature_memory::REVERSAL_K;

    /// Reference temperature of sensitivities and biases, degC. Temperature effects are functions of the temperature
    /// minus this reference.
    #[pymodule_export]
    const REFERENCE_TEMPERATURE_DEGC: f64 = library::recording::REFERENCE_TEMPERATURE_DEGC;

    /// Maximum number of effects of the catalogue in a calibration.
    #[pymodule_export]
    const MAX_EFFECTS: usize = imucal_core::effects::MAX_EFFECTS;

    /// Lowest and highest gravity that a calibration accepts, m/s^2.
    #[pymodule_export]
    const GRAVITY_ON_EARTH_MPS2: (f64, f64) =
        (library::calibrate::GRAVITY_ON_EARTH_MPS2[0], library::calibrate::GRAVITY_ON_EARTH_MPS2[1]);

    /// Maximum number of iterations with which the correction removes the effects from a sample.
    #[pymodule_export]
    const MAX_PASSES: usize = imucal_core::effects::MAX_PASSES;

    /// Default minimum duration of a rest, s.
    #[pymodule_export]
    const MIN_REST_S: f64 = library::rests::MIN_REST_S;

    /// Default maximum number of iterations of a joint fit.
    #[pymodule_export]
    const MAX_ITERATIONS: u64 = library::calibrate::MAX_ITERATIONS;

    /// Number of cross-validation folds of a search for effects. A search without control recordings divides the rests
    /// and moves into these folds.
    #[pymodule_export]
    const GAP_FOLDS: usize = library::gap::FOLDS;

    /// Biases of the gyroscope on the axes x, y and z, and the standard deviations of these biases, in raw units.
    type RestBias = ([f64; 3], [f64; 3]);
    type Rows<'py> = Bound<'py, PyArray2<f64>>;

    fn require_same_length(time: usize, rate: usize) -> Result<(), Error> {
        if time == rate {
            return Ok(());
        }
        Err(Error::Input(format!("time_s has {time} rows, angular_rate {rate}")))
    }

    /// Calibrates one unit from its recordings, with user-defined effects if there are any.
    #[pyfunction]
    #[pyo3(signature = (recordings, options, user_effects = None))]
    fn calibrate(
        py: Python<'_>,
        recordings: Vec<RecordingColumns<'_>>,
        options: CalibrateOptions<'_>,
        user_effects: Option<PythonEffects>,
    ) -> PyResult<Outcome> {
        let options = options.options(py)?;
        let recordings = RecordingColumns::views(py, &recordings)?;
        let work = || {
            let checked = library::calibrate::Checked::try_new(&recordings, &options)?;
            let outcome = match &user_effects {
                Some(source) => checked.calibrate_with(&options.model(), source, source.names(), None)?,
                None => checked.calibrate(&options.model(), None)?,
            };
            let diagnosis = library::calibrate::diagnosis::diagnose(&outcome, &recordings);
            Ok((outcome, diagnosis))
        };
        let (outcome, diagnosis) = interruptible(py, work)?;
        Outcome::new(py, outcome, diagnosis, &recordings, &options)
    }

    /// Calibrates an accelerometer from its recordings. The gyroscope columns are not used.
    #[pyfunction]
    fn calibrate_accelerometer(
        py: Python<'_>,
        recordings: Vec<RecordingColumns<'_>>,
        options: CalibrateOptions<'_>,
    ) -> PyResult<Outcome> {
        let options = options.options(py)?;
        let recordings = RecordingColumns::views_of_any(py, &recordings)?;
        let outcome = interruptible(py, || library::calibrate::calibrate_accelerometer(&recordings, &options))?;
        Outcome::of_accelerometer(py, outcome, &recordings, &options)
    }

    /// Calibrates an accelerometer from a table of mean readings. Returns the result, and the biases of the gyroscope
    /// with their standard deviations (None without a gyroscope). `noise_mps2` is the standard deviation of every mean.
    /// It is used if the table contains no standard deviations.
    #[pyfunction]
    fn calibrate_means(
        py: Python<'_>,
        table: MeanColumns<'_>,
        noise_mps2: Option<f64>,
        options: CalibrateOptions<'_>,
    ) -> PyResult<(Outcome, Option<RestBias>)> {
        let options = options.options(py)?;
        let table = table.view(py, noise_mps2)?;
        let (outcome, bias) = interruptible(py, || library::calibrate::calibrate_means(&table, &options))?;
        let outcome = Outcome::of_means(py, outcome, table.name, &options)?;
        Ok((outcome, bias.map(|bias| (bias.value.into(), bias.std.into()))))
    }

    /// Evaluates a calibrated accelerometer on recordings. The gyroscope columns are not used. `uncertainty` consists
    /// of the covariance matrix of the nine accelerometer parameters, by rows, and the name of the body frame in which
    /// these parameters are defined.
    #[pyfunction]
    fn evaluate_accelerometer(
        py: Python<'_>,
        accelerometer: TriadArrays<'_>,
        uncertainty: Option<(Vec<Vec<f64>>, String)>,
        recordings: Vec<RecordingColumns<'_>>,
        gravity_mps2: f64,
        min_rest_s: f64,
    ) -> PyResult<Evaluation> {
        let triad = accelerometer.triad(py, "accelerometer")?;
        let recordings = RecordingColumns::views_of_any(py, &recordings)?;
        let uncertainty = uncertainty.map(|(covariance, frame)| {
            frame_named(&frame).and_then(|frame| library::evaluate::Uncertainty::of_accelerometer(&covariance, frame))
        });
        let uncertainty = uncertainty.transpose().to_python(py)?;
        let work = || {
            let uncertainty = uncertainty.as_ref();
            library::evaluate::evaluate_accelerometer(&triad, uncertainty, &recordings, gravity_mps2, min_rest_s)
        };
        let evaluation = interruptible(py, work)?;
        Evaluation::new(py, evaluation, &recordings)
    }

    /// Predicts, before any fit, which parameters the recordings of one unit determine, and the standard deviations of
    /// the estimates. The result also names the parameters that the recordings do not determine.
    #[pyfunction]
    fn prospect(
        py: Python<'_>,
        recordings: Vec<RecordingColumns<'_>>,
        options: CalibrateOptions<'_>,
    ) -> PyResult<Prospect> {
        let options = options.options(py)?;
        let recordings = RecordingColumns::views(py, &recordings)?;
        Ok(interruptible(py, || library::calibrate::prospect(&recordings, &options))?.into())
    }

    /// Evaluates a calibration on recordings. If the calibration has user-defined effects, `corrected` contains the
    /// recordings after correction by the caller, because the library cannot correct user-defined effects.
    /// `uncertainty` consists of the covariance of the parameters of both triads, by rows, and the name of the body
    /// frame in which these parameters are defined.
    #[pyfunction]
    fn evaluate(
        py: Python<'_>,
        calibration: CalibrationArrays<'_>,
        uncertainty: Option<(Vec<Vec<f64>>, String)>,
        recordings: Vec<RecordingColumns<'_>>,
        corrected: Option<Vec<RecordingColumns<'_>>>,
        gravity_mps2: f64,
        min_rest_s: f64,
    ) -> PyResult<Evaluation> {
        let calibration = calibration.calibration(py)?;
        let recordings = RecordingColumns::views(py, &recordings)?;
        let corrected = corrected.as_ref().map(|columns| RecordingColumns::views(py, columns)).transpose()?;
        let uncertainty = uncertainty.map(|(covariance, frame)| {
            frame_named(&frame).and_then(|frame| library::evaluate::Uncertainty::try_new(&covariance, frame))
        });
        let uncertainty = uncertainty.transpose().to_python(py)?;
        let work = || match &corrected {
            None => {
                let recordings = &recordings;
                library::evaluate::evaluate(&calibration, uncertainty.as_ref(), recordings, gravity_mps2, min_rest_s)
            }
            Some(corrected) => library::evaluate::evaluate_corrected(
                &calibration,
                uncertainty.as_ref(),
                &recordings,
                corrected,
                gravity_mps2,
                min_rest_s,
            ),
        };
        let evaluation = interruptible(py, work)?;
        Evaluation::new(py, evaluation, &recordings)
    }

    /// Raises an error if a control recording is a part or an altered copy of a calibration recording. `rests` and
    /// `control_rests` contain a list of rests for each recording. A rest is given by the index of its first sample and
    /// the index of its last sample plus one.
    #[pyfunction]
    fn require_independent(
        py: Python<'_>,
        recordings: Vec<RecordingColumns<'_>>,
        rests: Vec<Vec<(usize, usize)>>,
        control: Vec<RecordingColumns<'_>>,
        control_rests: Vec<Vec<(usize, usize)>>,
    ) -> PyResult<()> {
        let recordings = RecordingColumns::views_of_any(py, &recordings)?;
        let control = RecordingColumns::views_of_any(py, &control)?;
        let ranges = |rests: Vec<Vec<(usize, usize)>>| -> Vec<Vec<std::ops::Range<usize>>> {
            rests.into_iter().map(|rests| rests.into_iter().map(|(first, end)| first..end).collect()).collect()
        };
        let (rests, control_rests) = (ranges(rests), ranges(control_rests));
        let check = || library::calibrate::require_independent((&recordings, &rests), (&control, &control_rests));
        py.detach(check).to_python(py)
    }

    /// Returns the reason why these figures of merit give the verdict `poor`; None if they do not give this verdict.
    /// `set` states which recordings the figures of merit refer to: `"calibration set"` or `"control set"`. If
    /// `has_gyroscope` is false, the verdict does not require any moves.
    #[pyfunction]
    #[pyo3(signature = (set, rests, moves, chi2_per_dof, has_gyroscope = true))]
    fn poor_figures(
        set: &str,
        rests: usize,
        moves: usize,
        chi2_per_dof: Option<f64>,
        has_gyroscope: bool,
    ) -> Option<String> {
        use library::evaluate::Figures;
        use library::verdict::RecordingSet;
        let set = if set == RecordingSet::Control.name() { RecordingSet::Control } else { RecordingSet::Calibration };
        let (chi2_per_dof, nan) = (chi2_per_dof.unwrap_or(f64::NAN), f64::NAN);
        let figures =
            Figures { chi2_per_dof, gravity_norm_rms_mps2: nan, gravity_direction_rms_deg: nan, rests, moves };
        let reason = if has_gyroscope { figures.reason(set, Vec::new) } else { figures.reason_of_accelerometer(set) };
        reason.map(|reason| reason.to_string())
    }

    /// Returns a finding if the temperatures of a recording are implausible in degC; otherwise None.
    #[pyfunction]
    fn check_temperature(py: Python<'_>, recording: RecordingColumns<'_>) -> PyResult<Option<Py<PyAny>>> {
        let views = RecordingColumns::views_of_any(py, std::slice::from_ref(&recording))?;
        check::check_temperature(&views[0]).map(|found| finding(py, &found)).transpose()
    }

    /// Runs all checks of a recording that need no fit, and detects its rests.
    ///
    /// `grows` states that the recording is still being written. Such a recording is not reported as too short.
    #[pyfunction]
    #[pyo3(signature = (recording, gravity_mps2, min_rest_s, grows = false))]
    fn inspect(
        py: Python<'_>,
        recording: RecordingColumns<'_>,
        gravity_mps2: f64,
        min_rest_s: f64,
        grows: bool,
    ) -> PyResult<Inspection> {
        let views = RecordingColumns::views_of_any(py, std::slice::from_ref(&recording))?;
        let recording = &views[0];
        let (findings, segments) = interruptible(py, || {
            let mut findings = check::check_one_or_both(recording);
            findings.retain(|finding| !(grows && finding.code == "too_short"));
            let readable = findings.iter().all(|finding| {
                !["empty", "lengths_differ", "non_finite", "time_not_increasing", "too_short", "value_impossible"]
                    .contains(&finding.code)
            });
            let segments = readable.then(|| Segments::find(recording, min_rest_s));
            if let Some(Ok(segments)) = &segments {
                let ranges: Vec<_> = segments.rests.iter().map(|rest| rest.first..rest.end).collect();
                findings.extend(check::check_rests(recording, &ranges, gravity_mps2));
                findings.extend(segments.check_noise(recording));
                findings.extend(segments.noise_below_lsb(recording));
            }
            Ok((findings, segments))
        })?;
        let findings = findings.iter().map(|f| finding(py, f)).collect::<PyResult<Vec<_>>>()?;
        Inspection::new(py, findings, segments)
    }

    /// Corrects the raw samples of both sensors, two arrays (N, 3). Returns `(angular_rate, specific_force)` in rad/s
    /// and m/s^2, in the body frame.
    #[pyfunction]
    fn correct<'py>(
        py: Python<'py>,
        calibration: CalibrationArrays<'py>,
        angular_rate: PyReadonlyArray2<'py, f64>,
        specific_force: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<(Rows<'py>, Rows<'py>)> {
        let calibration = calibration.calibration(py)?;
        let rate = rows(py, &angular_rate, "angular_rate")?;
        let force = rows(py, &specific_force, "specific_force")?;
        if rate.len() != force.len() {
            let message = format!("angular_rate has {} rows, specific_force {}", rate.len(), force.len());
            return Err(Error::Input(message)).to_python(py);
        }
        let (rate, force): (Vec<[f64; 3]>, Vec<[f64; 3]>) = py.detach(|| {
            let corrected = rate.iter().zip(force).map(|(rate, force)| {
                let (rate, force) = calibration.correct(Vector3::from(*rate), Vector3::from(*force));
                (<[f64; 3]>::from(rate), <[f64; 3]>::from(force))
            });
            corrected.unzip()
        });
        Ok((to_rows(py, rate)?, to_rows(py, force)?))
    }

    /// Corrects raw samples of one sensor, (N, 3), without effects. The result is in SI units in the body frame.
    #[pyfunction]
    fn correct_triad<'py>(
        py: Python<'py>,
        triad: TriadArrays<'py>,
        samples: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Rows<'py>> {
        let triad = triad.triad(py, "sensor")?;
        let samples = rows(py, &samples, "samples")?;
        let corrected = py.detach(|| samples.iter().map(|raw| triad.correct(Vector3::from(*raw)).into()).collect());
        to_rows(py, corrected)
    }

    /// Raises an error for a recording with negative counts that were read as unsigned numbers, because no correction
    /// can repair them.
    #[pyfunction]
    fn require_signed_counts(py: Python<'_>, recording: RecordingColumns<'_>) -> PyResult<()> {
        let views = RecordingColumns::views_of_any(py, std::slice::from_ref(&recording))?;
        let findings = py.detach(|| check::check_counts(&views[0]));
        if findings.is_empty() { Ok(()) } else { Err(Error::Data(findings)).to_python(py) }
    }

    /// Corrects a recording, including effects that depend on time, temperature or angular acceleration. If the
    /// recording is a part of a longer recording, `start_s` is the time of the first sample of the longer recording.
    #[pyfunction]
    #[pyo3(signature = (calibration, recording, start_s = None))]
    fn correct_recording<'py>(
        py: Python<'py>,
        calibration: CalibrationArrays<'py>,
        recording: RecordingColumns<'py>,
        start_s: Option<f64>,
    ) -> PyResult<(Rows<'py>, Rows<'py>)> {
        let calibration = calibration.calibration(py)?;
        let views = RecordingColumns::views(py, std::slice::from_ref(&recording))?;
        let (rate, force) = interruptible(py, || {
            let findings = check::check_counts(&views[0]);
            let correct = || library::correct::correct_from(start_s, &views[0], &calibration);
            if findings.is_empty() { Ok(correct()) } else { Err(Error::Data(findings)) }
        })?;
        Ok((to_rows(py, rate)?, to_rows(py, force)?))
    }

    /// Computes the time derivative of the angular rate at each sample, rad/s^2, (N, 3). The result is empty for a
    /// single sample.
    #[pyfunction]
    fn angular_acceleration<'py>(
        py: Python<'py>,
        time_s: PyReadonlyArray1<'py, f64>,
        angular_rate: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Rows<'py>> {
        let time = column(py, &time_s, "time_s")?;
        let rate = rows(py, &angular_rate, "angular_rate")?;
        require_same_length(time.len(), rate.len()).to_python(py)?;
        to_rows(py, py.detach(|| library::correct::angular_acceleration(time, rate)))
    }

    /// Converts the sensitivities of both triads to the body frame with the name `frame`. Returns `(accelerometer,
    /// gyroscope)`, each (3, 3).
    #[pyfunction]
    fn convert_frame<'py>(
        py: Python<'py>,
        accel_sensitivity: PyReadonlyArray2<'py, f64>,
        gyro_sensitivity: PyReadonlyArray2<'py, f64>,
        frame: &str,
    ) -> PyResult<(Rows<'py>, Rows<'py>)> {
        let from = Sensitivities {
            accelerometer: matrix(py, &accel_sensitivity, "accel_sensitivity")?,
            gyroscope: matrix(py, &gyro_sensitivity, "gyro_sensitivity")?,
        };
        let frame = frame_named(frame).to_python(py)?;
        let to = frame::convert(&from, frame).to_python(py)?;
        let array = |m: nalgebra::Matrix3<f64>| to_rows(py, m.transpose().data.0.to_vec());
        Ok((array(to.accelerometer)?, array(to.gyroscope)?))
    }

    /// Probability that a chi-square variable with `dof` degrees of freedom exceeds `statistic`.
    #[pyfunction]
    fn chi2_p_value(statistic: f64, dof: usize) -> f64 {
        library::numerics::stats::p_value(statistic, dof)
    }

    /// Integrates the angular rate to the rotation `[w, x, y, z]` from the body frame at the last sample to the body
    /// frame at the first sample: `v_start = rotation * v_end`. If `midpoint` is true, the coning correction is
    /// omitted.
    #[pyfunction]
    #[pyo3(signature = (time_s, angular_rate, midpoint=false))]
    fn integrate<'py>(
        py: Python<'py>,
        time_s: PyReadonlyArray1<'py, f64>,
        angular_rate: PyReadonlyArray2<'py, f64>,
        midpoint: bool,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let time = column(py, &time_s, "time_s")?;
        let rate = rows(py, &angular_rate, "angular_rate")?;
        require_same_length(time.len(), rate.len()).to_python(py)?;
        let rotation = py.detach(|| {
            let mut integrator = Integrator::of_order(if midpoint { Order::Midpoint } else { Order::Magnus4 });
            let mut last = time.first().copied().unwrap_or(0.0);
            for (&time, rate) in time.iter().zip(rate) {
                integrator.push(time - last, Vector3::from(*rate));
                last = time;
            }
            integrator.rotation()
        });
        Ok(PyArray1::from_slice(py, &so3::to_wxyz(&rotation)))
    }
}
