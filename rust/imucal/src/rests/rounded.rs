//! Estimates the rounding errors at the rests of a recording whose noise is smaller than the quantisation step, and
//! reports such noise as a finding.

use std::ops::Range;

use nalgebra::Vector6;

use crate::check::CHANNELS;
use crate::finding::{Finding, general};
use crate::numerics::stats::median;
use crate::recording::{RawUnit, Recording, Samples};
use crate::rests::rest::Rest;
use crate::rounding::levels::Levels;
use crate::rounding::{AxisRounding, Rounding};

/// Share of a rest that is omitted at each end when the samples at each level (multiple of the quantisation step) are
/// counted. A low-pass filter in the sensor delays the readings, so the first samples of a rest still contain the end
/// of the previous move. With a filter bandwidth of 5 Hz, these samples cover 0.2 s.
const EDGE: f64 = 0.15;

/// Ratio (c_noise - 1) / (c_rounded - 1). c is the factor by which the correlation of noise increases the variance of a
/// mean (model.md (10)): c_noise before rounding, and c_rounded for the rounded samples. The value holds for a mean
/// midway between two levels (multiples of the quantisation step). Rounding then keeps only the sign of the noise, and
/// the sign is less correlated than the noise. For any other mean, the ratio is larger.
const SIGN: f64 = 1.28;

/// Returns the factor c that the noise of each channel has before rounding (model.md (10)). c is the factor by which
/// the correlation of the noise increases the variance of a mean. If the noise is below the quantisation step, c is
/// estimated from the rounded samples. This estimate is largest if the mean is midway between two levels (multiples of
/// the step). If the mean is farther from the middle, the rounded samples are less correlated, and the estimate is too
/// small. The three axes of a sensor have equal filters and therefore equal factors c, so the largest estimate among
/// the axes is the most accurate estimate. `colour` contains the estimates from the samples. `steps` contains the
/// quantisation step of each channel whose noise is below its step, and zero for all other channels.
pub(super) fn of_rounded(colour: &Vector6<f64>, steps: &Vector6<f64>) -> Vector6<f64> {
    let coarse = |channel: &usize| steps[*channel] > 0.0;
    Vector6::from_fn(|channel, _| {
        let triad = channel / 3 * 3..channel / 3 * 3 + 3;
        let largest = triad.filter(coarse).map(|other| colour[other]).fold(1.0, f64::max);
        if coarse(&channel) { 1.0 + SIGN * (largest - 1.0) } else { colour[channel] }
    })
}

/// Statistics of the rounding errors of the six channels, in the order gyroscope x, y, z, accelerometer x, y, z.
pub(super) struct Roundings([AxisRounding; 6]);

impl Roundings {
    /// Estimates the statistics of the rounding errors. For each channel whose noise is below its quantisation step,
    /// `steps` contains this step. For all other channels it contains zero. `colour` contains the factor c by which
    /// the correlation of the noise increases the variance of a mean (model.md (10)).
    pub(super) fn of(recording: &Recording<'_>, rests: &[&Rest], steps: &Vector6<f64>, colour: &Vector6<f64>) -> Self {
        let of_channel = |channel: usize| {
            let (rows, axis) = of_channel(recording, channel);
            let step = Some(steps[channel]).filter(|step| *step > 0.0)?;
            Some((step, levels(rows, axis, rests, step, colour[channel])))
        };
        let [[a, b, c], [d, e, f]] =
            [0, 3].map(|first| Rounding::of_levels([0, 1, 2].map(|axis| of_channel(first + axis))));
        Self([a, b, c, d, e, f])
    }

    /// Statistics of the rounding errors at a rest with usual noise, which is the noise that most rests have in common.
    pub(super) fn common(&self) -> [Rounding; 6] {
        self.0.each_ref().map(|axis| axis.common)
    }

    /// Sets the statistics of the rounding errors of `rest`. `index` is the index of this rest in the list of rests
    /// from which the statistics were estimated. If all samples of an accelerometer channel have the same value, the
    /// mean reading of the channel does not determine its rounding error. The reading of a gyroscope channel always
    /// determines the rounding error, because the true rate is zero at every rest, so that the converter of the channel
    /// has nearly the same input (the bias) at all rests.
    pub(super) fn set(&self, recording: &Recording<'_>, rest: &mut Rest, index: usize) {
        let of_channel = |channel: usize| {
            let (rows, axis) = of_channel(recording, channel);
            let mut values = rows.slice(inner(rest)).axis(axis);
            let first = values.next();
            let is_determined = channel < 3 || values.any(|value| Some(value) != first);
            Rounding { is_determined, ..self.0[channel].at_rests.get(index).copied().unwrap_or_default() }
        };
        let [a, b, c, d, e, f] = [0, 1, 2, 3, 4, 5].map(of_channel);
        (rest.angular_rate.rounding, rest.specific_force.rounding) = ([a, b, c], [d, e, f]);
    }
}

/// Sample range of a rest, without the share [`EDGE`] of its samples at each end.
fn inner(rest: &Rest) -> Range<usize> {
    let edge = (EDGE * (rest.end - rest.first) as f64) as usize;
    rest.first + edge..rest.end - edge
}

/// The samples of the sensor to which a channel belongs, and the axis of the channel. Channels are in the order
/// gyroscope x, y, z, accelerometer x, y, z.
pub(super) fn of_channel<'a>(recording: &Recording<'a>, channel: usize) -> (Samples<'a>, usize) {
    let rows = if channel < 3 { recording.angular_rate } else { recording.specific_force };
    (rows, channel % 3)
}

/// For each rest: the number of independent samples at each level (multiple of the quantisation step). Because the
/// noise is correlated, each sample is equivalent to 1 / `colour` independent samples.
fn levels(rows: Samples<'_>, axis: usize, rests: &[&Rest], step: f64, colour: f64) -> Vec<Levels> {
    let Some(zero) = rests.first().map(|rest| rows.at(rest.first)[axis]) else { return Vec::new() };
    let level = |value: f64| (((value - zero) / step).round() as i64, 1.0 / colour);
    rests.iter().map(|rest| Levels::of(rows.slice(inner(rest)).axis(axis).map(level))).collect()
}

/// Reports axes whose noise is far below the step of the converter, so that the rounding error of the mean over a rest
/// exceeds the noise of this mean.
pub(super) fn noise_below_lsb(recording: &Recording<'_>, rests: &[Rest], rounding: &[Rounding; 6]) -> Option<Finding> {
    let mut samples: Vec<f64> = rests.iter().map(|rest| (rest.end - rest.first) as f64).collect();
    let samples = if samples.is_empty() { 1.0 } else { median(&mut samples) };
    // In the finding, channels are in the order of the columns of a recording, with the accelerometer first.
    let of = |column: usize| rounding[(column + 3) % 6];
    let decides = |column: &usize| {
        let Rounding { step, noise, error_variance, .. } = of(*column);
        // If the rounding errors of the n samples of a rest were independent, their mean would have the variance
        // step^2 / (12 n). White noise alone gives the mean the variance noise^2 / n. An axis is reported if the
        // estimated variance of the rounding error of the mean exceeds the larger of these two variances.
        error_variance > (noise * noise).max(step * step / 12.0) / samples
    };
    let columns: Vec<usize> = (0..6).filter(decides).collect();
    let worst = columns.iter().copied().min_by(|a, b| {
        let relative = |column: usize| of(column).noise / of(column).step;
        relative(*a).total_cmp(&relative(*b))
    })?;
    let lsb = |column: usize| match (column < 3, if column < 3 { recording.accel_unit } else { recording.gyro_unit }) {
        (_, RawUnit::Lsb) => format!("{} lsb", general(of(column).step, 3)),
        (true, RawUnit::Si) => {
            format!("{} mg", general(of(column).step / imucal_core::STANDARD_GRAVITY_MPS2 * 1e3, 3))
        }
        (false, RawUnit::Si) => format!("{} deg/s", general(of(column).step.to_degrees(), 3)),
    };
    let parts: Vec<String> = columns
        .iter()
        .map(|&column| {
            let Rounding { step, noise, error_variance, .. } = of(column);
            format!(
                "{} has a step of {} and noise of {:.2} steps, so rounding leaves an error of {:.2} steps rms in the \
                 mean of a rest",
                CHANNELS[column],
                lsb(column),
                noise / step,
                error_variance.sqrt() / step
            )
        })
        .collect();
    Some(Finding {
        columns: columns.iter().map(|&column| CHANNELS[column].to_owned()).collect(),
        count: recording.len(),
        value: of(worst).noise / of(worst).step,
        unit: "lsb",
        message: parts.join("; "),
        way_out: "this error does not average down and is contained in the standard deviations; to reduce it, use a \
                  smaller range or a wider filter bandwidth, so that the noise of a sample exceeds half a step, or \
                  add dither (slight vibration) at rest"
            .into(),
        ..Finding::warning("noise_below_lsb", recording.name)
    })
}
