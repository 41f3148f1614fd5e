//! Identifies the noise of a unit from a recording at rest: the kinds of noise, their magnitudes and confidence
//! intervals.
//!
//! ```text
//!                      power density, two-sided       Allan deviation              figure
//! white noise          N^2                            N / sqrt(tau)                noise_density, v/sqrt(Hz)
//! bias instability     B^2 / (2 pi |f|)               0.664 B                      bias_instability, v
//! rate random walk     K^2 / (2 pi f)^2               K sqrt(tau / 3)              random_walk, v/s/sqrt(Hz)
//! quantisation         Q^2 (2 pi f)^2 / rate          sqrt(3) Q / tau              quantisation, v s
//! ```
//!
//! N, B, K and Q are the coefficients of the four kinds of noise. f is the frequency in Hz, rate is the sampling rate
//! in Hz, and tau is the averaging time in s.
//!
//! The column "figure" names the field of the result that contains the coefficient, and gives the unit of this field.
//! In these units, v is the unit of the sensor's output. The definitions of the coefficients agree with
//! [`crate::simulate`] and with IEEE Std 952. For a gyroscope, N is the angle random walk. Quantisation in this table
//! is the rounding of an angle or a velocity by a sensor that outputs increments of angle or velocity. If a sensor
//! outputs a rate and rounds it to counts, the rounding error is white noise with the variance (size of a count)^2 / 12
//! per sample. N does not include this rounding error.
//!
//! The coefficients are maximum-likelihood estimates. They are fitted to a power spectrum, which is computed by a
//! cosine transform (sections (31) and (32) of `docs/model.md`). The variance of the estimates reaches the Cramer-Rao
//! bound. The Allan deviations are only for display, and their confidence bands are computed from the fitted model. If
//! a kind of noise is not significant, the value of its coefficient is `None`. The confidence band of this coefficient
//! starts at zero, and the upper end of the band is an upper limit at 95 % confidence.

pub mod allan;
mod axis;
mod cosines;
mod departures;
mod likelihood;
mod power_law;
mod steps;
mod stretch;

use std::num::NonZeroUsize;
use std::ops::Range;

use crate::check::{self, RestNoise};
use crate::error::Error;
use crate::finding::{Finding, Severity};
use crate::numerics::workers::in_order;
use crate::recording::Recording;
use crate::rests::segment::Segments;
use crate::rests::segment::epochs::is_noise;

pub use axis::{AllanPoint, AxisNoise, Estimate};
use cosines::Layout;
use departures::Blocks;
pub use steps::{Departure, Drift, Step};
use stretch::Stretch;

/// Minimum number of samples of a noise identification. Fewer samples would determine only the white noise, with poor
/// accuracy.
const FEWEST_SAMPLES: usize = 1000;
/// A warning is reported if the longest rest covers less than this share of the examined interval. The examined
/// interval is the longest part of the recording with at most 1 lost or repeated sample in 10 000.
const WHOLE_SHARE: f64 = 0.9;

/// The noise of the accelerometer and of the gyroscope of a unit.
#[derive(Clone, Debug)]
pub struct Noise {
    /// Time of the first sample used, s.
    pub start_s: f64,
    /// Time of the last sample used, s.
    pub end_s: f64,
    /// Number of samples used.
    pub samples: usize,
    /// Sample rate, Hz.
    pub rate_hz: f64,
    /// Noise of the accelerometer's axes x, y, z, in the recording's unit; `None` if only a gyroscope was recorded.
    pub accelerometer: Option<[AxisNoise; 3]>,
    /// Noise of the gyroscope's axes x, y, z, in the recording's unit; `None` if only an accelerometer was recorded.
    pub gyroscope: Option<[AxisNoise; 3]>,
    /// Steps of the mean reading within the used samples. They are not removed before the noise is estimated.
    pub steps: Vec<Step>,
    /// Steps of the mean reading that were cut out, so that the used samples contain none of them.
    pub cut_steps: Vec<Step>,
    /// Drifts of the mean reading, for example during warm-up. They are not removed before the noise is estimated.
    pub drifts: Vec<Drift>,
    /// Findings about the recording.
    pub findings: Vec<Finding>,
}

/// Options of a noise identification.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Minimum duration of a rest, s. Shorter intervals at rest are ignored.
    pub min_rest_s: f64,
    /// Whether steps of the mean reading are cut out. If true, only the longest part of the rest without a step in any
    /// axis is used.
    pub cut_steps: bool,
}

/// Identifies the noise in the longest rest of `recording`. The recording contains both sensors or only one.
///
/// If samples are lost or repeated, the longest interval with at most 1 such sample in 10 000 is used. Steps and drifts
/// of the mean are reported as findings. Drifts are not removed from the samples, so they increase the estimated noise.
/// The same holds for steps, unless `options` requests that steps are cut out. The result does not depend on the number
/// of `threads`.
///
/// # Errors
/// [`Error::Data`] for a recording with faults; [`Error::NotEnoughMotion`] if the unit is never at rest;
/// [`Error::Input`] if fewer than 1000 samples are left in the longest interval without lost samples, in the longest
/// rest, or in its longest part without a step.
pub fn identify(recording: &Recording<'_>, options: &Options, threads: NonZeroUsize) -> Result<Noise, Error> {
    let mut findings = check::check_one_or_both(recording);
    let errors: Vec<Finding> = findings.iter().filter(|f| f.severity == Severity::Error).cloned().collect();
    if !errors.is_empty() {
        return Err(Error::Data(errors));
    }
    let has_repeats = findings.iter().any(|finding| finding.code == "samples_duplicated");
    let stretch = stretch::longest(recording, has_repeats);
    if stretch.lost == 0 {
        // `check_one_or_both` reports `samples_missing` even if samples are present but have late time stamps. The
        // module `stretch` distinguishes late samples from missing samples. If `stretch` finds no missing samples, the
        // finding `samples_missing` is removed.
        findings.retain(|finding| finding.code != "samples_missing");
    }
    let is_whole = stretch.samples.len() == recording.len();
    if !is_whole {
        findings.push(interrupted(recording, &stretch));
    }
    let Stretch { samples: part, .. } = stretch;
    let samples = longest_rest(recording, &part, options.min_rest_s)?;
    if samples.len() < (WHOLE_SHARE * part.len() as f64) as usize {
        findings.push(moving(recording, &samples));
    }
    let mut result = analyse(recording, samples, threads)?;
    if options.cut_steps {
        let mut cut = Vec::new();
        // A large step may have masked a smaller step, so the remaining part is tested for steps again.
        while !result.steps.is_empty() {
            cut.append(&mut result.steps);
            let rest = steps::longest_without(recording, &result.samples, &cut);
            if rest.len() < FEWEST_SAMPLES {
                return Err(too_short(recording, &rest, "the longest part without a step"));
            }
            result = analyse(recording, rest, threads)?;
        }
        findings.extend(cut.iter().map(|step| steps::finding(recording, step, Some(&result.samples))));
        result.cut = cut;
    }
    findings.extend(result.steps.iter().map(|step| steps::finding(recording, step, None)));
    findings.extend(steps::drift(recording, &result.drifts));
    result.noise(recording, findings)
}

/// Result of the analysis of one range of samples: the noise, the steps and the drifts.
struct Analysis {
    samples: Range<usize>,
    rate_hz: f64,
    /// Noise of the six channels, accelerometer first; `None` for the channels of a missing sensor.
    axes: [Option<AxisNoise>; 6],
    steps: Vec<Step>,
    /// Steps that were cut out of the rest. The analysis covers the longest part without a step.
    cut: Vec<Step>,
    drifts: Vec<Drift>,
}

fn analyse(recording: &Recording<'_>, samples: Range<usize>, threads: NonZeroUsize) -> Result<Analysis, Error> {
    let duration_s = recording.time_s[samples.end - 1] - recording.time_s[samples.start];
    let rate_hz = (samples.len() - 1) as f64 / duration_s;
    let layout = Layout::new(samples.len());
    let blocks = Blocks::try_new(samples.len());
    let rows_of = |channel: usize| if channel < 3 { recording.specific_force } else { recording.angular_rate };
    let channels: Vec<usize> = (0..6).filter(|&channel| !rows_of(channel).is_absent()).collect();
    let of_channel = |k: usize| {
        let channel = channels[k];
        AxisNoise::identify(rows_of(channel).slice(samples.clone()), channel % 3, rate_hz, &layout, blocks.as_ref())
    };
    let (mut axes, mut components) = ([const { None }; 6], vec![Vec::new(); 6]);
    for (channel, found) in channels.iter().zip(in_order(threads.get(), channels.len(), of_channel)) {
        let (axis, own) = found?;
        (axes[*channel], components[*channel]) = (Some(axis), own);
    }
    let block = blocks.map_or(1, |blocks| blocks.samples);
    let (steps, drifts) = steps::gather(recording, &samples, block, &components);
    Ok(Analysis { samples, rate_hz, axes, steps, cut: Vec::new(), drifts })
}

impl Analysis {
    /// Converts the analysis to the result of the identification. The findings about the noise of the axes are added to
    /// `findings`.
    fn noise(self, recording: &Recording<'_>, mut findings: Vec<Finding>) -> Result<Noise, Error> {
        let Self { samples, rate_hz, axes, steps, cut, drifts } = self;
        let (start_s, end_s) = (recording.time_s[samples.start], recording.time_s[samples.end - 1]);
        findings.extend(remarks(recording, end_s - start_s, rate_hz, &axes));
        let at_rest: [RestNoise; 6] = std::array::from_fn(|channel| {
            let rows = if channel < 3 { recording.specific_force } else { recording.angular_rate };
            let sum: f64 = rows.slice(samples.clone()).axis(channel % 3).sum();
            let density = axes[channel].as_ref().and_then(|axis| axis.noise_density.value);
            RestNoise { density, mean: Some(sum / samples.len() as f64) }
        });
        findings.extend(check::check_noise(recording, &at_rest));
        let [ax, ay, az, gx, gy, gz] = axes;
        let triad = |x: Option<AxisNoise>, y: Option<AxisNoise>, z: Option<AxisNoise>| Some([x?, y?, z?]);
        Ok(Noise {
            start_s,
            end_s,
            samples: samples.len(),
            rate_hz,
            accelerometer: triad(ax, ay, az),
            gyroscope: triad(gx, gy, gz),
            steps,
            cut_steps: cut,
            drifts,
            findings,
        })
    }
}

/// Finds the longest rest within the samples `part` of the recording, and returns its sample range. Consecutive rests
/// are joined if only noise separates them.
fn longest_rest(recording: &Recording<'_>, part: &Range<usize>, min_rest_s: f64) -> Result<Range<usize>, Error> {
    if part.len() < FEWEST_SAMPLES && part.len() < recording.len() {
        return Err(too_short(recording, part, "the longest part without lost or repeated samples"));
    }
    let stretch = Recording {
        time_s: &recording.time_s[part.clone()],
        specific_force: recording.specific_force.slice(part.clone()),
        angular_rate: recording.angular_rate.slice(part.clone()),
        temperature_degc: None,
        stand_rad: None,
        ..*recording
    };
    let segments = Segments::find(&stretch, min_rest_s)?;
    let floor = &segments.threshold.noise_floor;
    let mut longest = 0..0;
    let mut current = 0..0;
    for rest in &segments.rests {
        let joins = !current.is_empty() && is_noise(&stretch, current.clone(), rest.first, floor);
        current = if joins { current.start..rest.end } else { rest.first..rest.end };
        if current.len() > longest.len() {
            longest = current.clone();
        }
    }
    let longest = longest.start + part.start..longest.end + part.start;
    if longest.len() >= FEWEST_SAMPLES {
        return Ok(longest);
    }
    Err(too_short(recording, &longest, "the longest rest"))
}

fn too_short(recording: &Recording<'_>, samples: &Range<usize>, what: &str) -> Error {
    Error::Input(format!(
        "{}: {what}, {}, has {} samples; {FEWEST_SAMPLES} are needed: let the unit rest for minutes to get the white \
         noise, for hours to get bias instability and random walk",
        recording.name,
        place(recording, samples),
        samples.len()
    ))
}

fn interrupted(recording: &Recording<'_>, stretch: &Stretch) -> Finding {
    let Stretch { samples, lost, repeated, places } = stretch;
    Finding {
        count: lost + repeated,
        value: samples.len() as f64 / recording.len() as f64,
        unit: "1",
        message: format!(
            "samples are lost or repeated in {places} places ({lost} lost, {repeated} repeated); only the longest part \
             without lost or repeated samples, {}, is used: {:.0} % of the recording",
            place(recording, samples),
            100.0 * samples.len() as f64 / recording.len() as f64
        ),
        way_out: "look for lost packets or a full buffer, and record again, if the part is too short".into(),
        ..Finding::warning("recording_interrupted", recording.name)
    }
}

fn place(recording: &Recording<'_>, rest: &Range<usize>) -> String {
    match recording.time_s.get(rest.clone()) {
        Some([first, .., last]) => format!("from {first:.2} s to {last:.2} s"),
        _ => "none".to_owned(),
    }
}

fn moving(recording: &Recording<'_>, rest: &Range<usize>) -> Finding {
    let share = rest.len() as f64 / recording.len() as f64;
    Finding {
        count: recording.len() - rest.len(),
        value: share,
        unit: "1",
        message: format!(
            "the longest rest, {}, covers {:.0} % of the recording; only this rest is used",
            place(recording, rest),
            100.0 * share
        ),
        way_out: "record the unit at rest on something rigid".into(),
        ..Finding::warning("recording_moves", recording.name)
    }
}

/// Returns the findings about the noise of the axes, for example that a filter has changed the spectrum. `axes` has the
/// order accelerometer x, y, z, gyroscope x, y, z.
fn remarks(recording: &Recording<'_>, duration_s: f64, rate_hz: f64, axes: &[Option<AxisNoise>]) -> Vec<Finding> {
    let columns = |of: &dyn Fn(&AxisNoise) -> bool| -> Vec<String> {
        let found = check::CHANNELS.iter().zip(axes).filter(|(_, axis)| axis.as_ref().is_some_and(of));
        found.map(|(name, _)| (*name).to_owned()).collect()
    };
    let kinds: [(&'static str, Vec<String>, &str, &str); 4] = [
        (
            "noise_below_lsb",
            columns(&|axis| axis.is_below_lsb),
            "white noise is less than half a count: this recording determines it no better than one count over sqrt(12), \
             and the other kinds of noise are not reliable",
            "choose a smaller range or a higher resolution, or take the noise from the datasheet",
        ),
        (
            "noise_filtered",
            columns(&|axis| axis.shortest_period_s * rate_hz > 2.5 && axis.misfit.abs() <= axis::MISFIT),
            "at high frequencies the spectrum is not that of white noise, bias instability, random walk and quantisation, \
             usually because of a low-pass filter: only lower frequencies are used",
            "nothing to do; record without the filter and at a higher rate if you need a more accurate noise density",
        ),
        (
            "noise_model",
            columns(&|axis| axis.misfit.abs() > axis::MISFIT),
            "the power spectrum is not that of white noise, bias instability, random walk and quantisation: the values are \
             approximate, and their confidence bands are too narrow",
            "look at the Allan plot; record at a constant temperature, on something rigid, away from motors",
        ),
        (
            "recording_short",
            columns(&|axis| axis.bias_instability.value.is_none()),
            "the recording is too short to determine the bias instability: only an upper limit is given, the upper end of \
             its band",
            "record for hours at a constant temperature if you need a value",
        ),
    ];
    let finding = |(code, columns, message, way_out): (&'static str, Vec<String>, &str, &str)| {
        (!columns.is_empty()).then(|| Finding {
            count: columns.len(),
            value: duration_s,
            unit: "s",
            message: format!("{}: {message} ({duration_s:.0} s)", columns.join(", ")),
            columns,
            way_out: way_out.into(),
            ..Finding::warning(code, recording.name)
        })
    };
    kinds.into_iter().filter_map(finding).collect()
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::simulate::{Converter, LowPass, Program, Sensor, Simulation, Step, Unit, simulate};

    const RATE_HZ: f64 = 100.0;
    const OPTIONS: Options = Options { min_rest_s: 1.0, cut_steps: false };

    fn still(sensor: Sensor, duration_s: f64, seed: u64) -> Simulation {
        let unit = Unit { accelerometer: sensor, gyroscope: sensor, ..Unit::paper() };
        simulate(&Program::try_new(vec![Step::hold(duration_s)]).unwrap(), &unit, RATE_HZ, 9.80665, seed).unwrap()
    }

    fn noise_of(run: &Simulation) -> Noise {
        identify(&run.recording("still"), &OPTIONS, NonZeroUsize::MIN).unwrap()
    }

    fn axes(noise: &Noise) -> impl Iterator<Item = &AxisNoise> {
        noise.accelerometer.iter().flatten().chain(noise.gyroscope.iter().flatten())
    }

    fn all_kinds() -> Sensor {
        Sensor { noise_density: 1e-3, bias_instability: 5e-4, random_walk: Vector3::repeat(1e-4), ..Sensor::ideal() }
    }

    /// In simulated recordings, the ratio (error of an estimate) / (reported standard deviation) must have a mean
    /// square of about one over all runs and axes. The mean square must be inside its 99.9 % interval.
    #[test]
    fn standard_deviations_are_those_of_the_errors() {
        let mut squares = [0.0; 3];
        let runs = 10;
        for seed in 0..runs {
            for axis in axes(&noise_of(&still(all_kinds(), 1800.0, seed))) {
                let figures = [(axis.noise_density, 1e-3), (axis.bias_instability, 5e-4), (axis.random_walk, 1e-4)];
                for (square, (found, truth)) in squares.iter_mut().zip(figures) {
                    let (value, std) = (found.value.unwrap(), found.std.unwrap());
                    *square += ((value - truth) / std).powi(2) / (6 * runs) as f64;
                    assert!(found.low < value && value < found.high, "{found:?}");
                }
            }
        }
        // The mean of 60 squares is between 0.49 and 1.74 with a probability of 99.9 %.
        assert!(squares.iter().all(|square| (0.49..1.74).contains(square)), "{squares:?}");
    }

    #[test]
    fn what_is_absent_has_a_bound_and_no_value() {
        let white = Sensor { noise_density: 1e-3, ..Sensor::ideal() };
        let noise = noise_of(&still(white, 600.0, 3));
        for axis in axes(&noise) {
            assert!(axis.noise_density.value.is_some());
            for absent in [axis.bias_instability, axis.random_walk, axis.quantisation] {
                assert_eq!((absent.value, absent.std, absent.low), (None, None, 0.0));
                assert!(absent.high > 0.0);
            }
        }
        assert_eq!(noise.findings[0].code, "recording_short");
    }

    #[test]
    fn rounding_to_counts_is_no_part_of_the_noise() {
        let noise_std = 1e-3 * RATE_HZ.sqrt();
        let counted = |counts: f64| Sensor {
            noise_density: 1e-3,
            converter: Some(Converter { lsb: noise_std * counts, bits: 24 }),
            ..Sensor::ideal()
        };
        // The rounding variance is 1/12 of the noise variance. If it were not subtracted, the estimate of the noise
        // density would be 4 % too large.
        for axis in axes(&noise_of(&still(counted(1.0), 1200.0, 5))) {
            let (value, std) = (axis.noise_density.value.unwrap(), axis.noise_density.std.unwrap());
            assert!(((value - 1e-3) / std).abs() < 4.0, "{value}");
            assert!((axis.lsb / noise_std - 1.0).abs() < 1e-6);
        }
        let coarse = noise_of(&still(counted(3.0), 1200.0, 5));
        assert!(coarse.findings.iter().any(|finding| finding.code == "noise_below_lsb"));
        for axis in axes(&coarse) {
            assert!(axis.is_below_lsb && axis.noise_density.value.is_none());
            assert!(axis.noise_density.high > 0.99e-3);
        }
    }

    #[test]
    fn only_the_longest_rest_is_used_and_that_is_said() {
        let turn = Step { turn_rad: [1.0, 0.5, -0.5], move_s: 2.0, hold_s: 60.0 };
        let program = Program::try_new(vec![Step::hold(10.0), turn, Step { hold_s: 5.0, ..turn }]).unwrap();
        let run = simulate(&program, &Unit::paper(), RATE_HZ, 9.80665, 1).unwrap();
        let noise = noise_of(&run);
        assert!(
            noise.start_s > 11.9 && noise.end_s < 72.2 && noise.samples > 5900,
            "{} {}",
            noise.start_s,
            noise.end_s
        );
        assert_eq!(noise.findings[0].code, "recording_moves");
    }

    #[test]
    fn a_long_rest_is_not_cut_by_its_own_noise() {
        let filtered =
            Sensor { low_pass: Some(LowPass { bandwidth_hz: 10.0 }), noise_density: 1e-3, ..Sensor::ideal() };
        let run = still(filtered, 3600.0, 1);
        let rests = Segments::find(&run.recording("still"), 1.0).unwrap().rests;
        assert_eq!(rests.len(), 1, "parts of a long rest are joined");
        let noise = noise_of(&run);
        assert!(noise.samples > 359_900, "{} to {}", noise.start_s, noise.end_s);
        assert!(axes(&noise).all(|axis| axis.shortest_period_s > 1.0));
        assert_eq!(noise.findings[0].code, "noise_filtered");
    }

    #[test]
    fn a_rest_that_is_too_short_is_refused_with_its_length() {
        let run = still(all_kinds(), 8.0, 1);
        let message = identify(&run.recording("short"), &OPTIONS, NonZeroUsize::MIN).unwrap_err().to_string();
        assert!(message.contains("short: the longest rest") && message.contains("1000 are needed"), "{message}");
    }

    #[test]
    fn the_longest_stretch_without_lost_samples_is_used() {
        let run = still(all_kinds(), 60.0, 1);
        let with_gap = |gap: std::ops::Range<usize>| {
            let kept: Vec<usize> = (0..run.time_s.len()).filter(|i| !gap.contains(i)).collect();
            let time: Vec<f64> = kept.iter().map(|&i| run.time_s[i]).collect();
            let force: Vec<[f64; 3]> = kept.iter().map(|&i| run.specific_force[i]).collect();
            let rate: Vec<[f64; 3]> = kept.iter().map(|&i| run.angular_rate[i]).collect();
            let recording = Recording::try_new("gap", &time, &force, &rate).unwrap();
            identify(&recording, &OPTIONS, NonZeroUsize::MIN)
        };
        let noise = with_gap(2000..2050).unwrap();
        assert!((noise.start_s - 20.5).abs() < 0.2 && noise.samples > 3900, "{} {}", noise.start_s, noise.samples);
        let finding = noise.findings.iter().find(|finding| finding.code == "recording_interrupted").unwrap();
        assert_eq!(finding.count, 50);
    }

    #[test]
    fn threads_change_no_bit() {
        let run = still(all_kinds(), 100.0, 1);
        let found = |threads| format!("{:?}", identify(&run.recording("r"), &OPTIONS, threads).unwrap());
        assert_eq!(found(NonZeroUsize::MIN), found(NonZeroUsize::new(4).unwrap()));
    }
}
