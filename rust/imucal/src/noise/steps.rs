//! Collects the steps and drifts of the mean readings of all six axes, and writes the findings about them. If several
//! axes have steps at nearly the same time, these steps are combined into one.

use std::f64::consts::PI;
use std::ops::Range;

use imucal_core::STANDARD_GRAVITY_MPS2;

use super::departures::{ABRUPT_S, Component, Shape};
use crate::check::{CHANNELS, unit_name};
use crate::finding::{Finding, Place, general};
use crate::recording::Recording;

/// Margin that is cut out before and after a step, s. The unit may still move within this margin.
const MARGIN_S: f64 = 1.0;
/// The exact sample of a step is determined from the samples in this number of blocks before the step, and in as many
/// blocks after it. A block consists of consecutive samples; the search for steps uses the block means.
const NEAR_BLOCKS: usize = 8;

/// A step of the mean reading of a unit at rest, for example after a bump against the table.
#[derive(Clone, Debug, PartialEq)]
pub struct Step {
    /// Time of the first sample after the step, s.
    pub time_s: f64,
    /// Index of the first sample after the step, in the recording.
    pub sample: usize,
    /// Size of the step in each axis in which the step is significant.
    pub axes: Vec<Departure>,
}

/// A slow change of the mean reading of one axis of a unit at rest, for example while the unit warms up.
#[derive(Clone, Debug, PartialEq)]
pub struct Drift {
    /// Time at which the change starts, s.
    pub start_s: f64,
    /// Time at which the change ends, s.
    pub end_s: f64,
    /// Time constant of an exponential approach, s; `None` for a change at a constant rate.
    pub time_constant_s: Option<f64>,
    /// The axis that drifts, and the change of its mean from the start to the end.
    pub axis: Departure,
}

/// Change of the mean of one axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Departure {
    /// Index of the axis in the order accelerometer x, y, z, gyroscope x, y, z.
    pub channel: usize,
    /// Change of the mean reading, in the unit of the recording.
    pub size: f64,
    /// Standard deviation of the error of `size`. If `size` is the sum of several steps that nearly coincide, this is
    /// the standard deviation of the first of these steps.
    pub std: f64,
    /// Increase of 2 ln L when this change is added to the noise model, where L is the likelihood. If `size` is the sum
    /// of several steps, this is the largest of their increases.
    pub gain: f64,
}

/// Returns the steps and drifts in the samples `rest` of a recording. `axes` contains, for each of the six axes, the
/// components (steps and drifts) that were found in this axis, from means over blocks of `block` samples.
pub(super) fn gather(
    recording: &Recording<'_>,
    rest: &Range<usize>,
    block: usize,
    axes: &[Vec<Component>],
) -> (Vec<Step>, Vec<Drift>) {
    let (mut found, mut drifts) = (Vec::new(), Vec::new());
    let time_of = |sample: usize| recording.time_s[sample.min(rest.end - 1)];
    for (channel, components) in axes.iter().enumerate() {
        for component in components {
            let axis = Departure { channel, size: component.size, std: component.sigma, gain: component.gain };
            match component.shape {
                Shape::Step { first, .. } => {
                    found.push((sharpened(recording, rest, block, first, channel), axis));
                }
                Shape::Ramp { first, blocks } => drifts.push(Drift {
                    start_s: time_of(rest.start + (first - 1) * block),
                    end_s: time_of(rest.start + (first + blocks) * block),
                    time_constant_s: None,
                    axis,
                }),
                Shape::WarmUp { time_constant } => {
                    let interval_s = (time_of(rest.end) - time_of(rest.start)) / (rest.len() - 1) as f64;
                    drifts.push(Drift {
                        start_s: time_of(rest.start),
                        end_s: time_of(rest.end),
                        time_constant_s: (!Shape::is_linear(time_constant, rest.len() / block))
                            .then_some(time_constant * block as f64 * interval_s),
                        axis,
                    });
                }
            }
        }
    }
    found.sort_by_key(|(sample, _)| *sample);
    let mut steps: Vec<Step> = Vec::new();
    for (sample, axis) in found {
        let same =
            |step: &&mut Step| sample - step.sample <= 2 * block || recording.time_s[sample] - step.time_s <= ABRUPT_S;
        match steps.last_mut().filter(same) {
            Some(step) => {
                // The axis with the largest gain determines the time of the step.
                if step.axes.iter().all(|other| other.gain < axis.gain) {
                    (step.sample, step.time_s) = (sample, recording.time_s[sample]);
                }
                match step.axes.iter_mut().find(|other| other.channel == axis.channel) {
                    Some(other) => {
                        other.size += axis.size;
                        other.gain = other.gain.max(axis.gain);
                    }
                    None => step.axes.push(axis),
                }
            }
            None => steps.push(Step { time_s: recording.time_s[sample], sample, axes: vec![axis] }),
        }
    }
    steps.iter_mut().for_each(|step| step.axes.sort_by_key(|axis| axis.channel));
    (steps, drifts)
}

/// Finds the first sample after a step near the start of block `first`, and returns its index. All samples up to two
/// blocks from this start are tried. For each of these samples, the mean of the values before this sample is compared
/// with the mean of the values from this sample on. Only values within [`NEAR_BLOCKS`] blocks of the start of block
/// `first` are used. The result is the sample for which these two means differ most significantly.
fn sharpened(recording: &Recording<'_>, rest: &Range<usize>, block: usize, first: usize, channel: usize) -> usize {
    let rows = if channel < 3 { recording.specific_force } else { recording.angular_rate };
    let middle = rest.start + first * block;
    let start = middle.saturating_sub(NEAR_BLOCKS * block).max(rest.start);
    let end = (middle + NEAR_BLOCKS * block).min(rest.end);
    let values: Vec<f64> = rows.slice(start..end).axis(channel % 3).collect();
    let total: f64 = values.iter().sum();
    let (count, mut before) = (values.len() as f64, 0.0);
    let mut best = (0.0, middle);
    for (k, value) in values.iter().enumerate() {
        if k > 0 && (start + k).abs_diff(middle) <= 2 * block {
            let left = k as f64;
            let difference = (total - before) / (count - left) - before / left;
            let score = difference * difference * left * (count - left);
            if score > best.0 {
                best = (score, start + k);
            }
        }
        before += value;
    }
    best.1.clamp(rest.start + 1, rest.end - 1)
}

/// The longest part of the sample range `rest` that contains no step and no sample within [`MARGIN_S`] of a step.
pub(super) fn longest_without(recording: &Recording<'_>, rest: &Range<usize>, steps: &[Step]) -> Range<usize> {
    let mut best = 0..0;
    let mut start = rest.start;
    let starts_and_ends = steps.iter().map(|step| (step.time_s - MARGIN_S, step.time_s + MARGIN_S));
    for (end_s, next_s) in starts_and_ends.chain([(f64::INFINITY, f64::INFINITY)]) {
        let end = rest.start + recording.time_s[rest.clone()].partition_point(|time_s| *time_s < end_s);
        if end.saturating_sub(start) > best.len() {
            best = start..end;
        }
        start = rest.start + recording.time_s[rest.clone()].partition_point(|time_s| *time_s <= next_s);
    }
    best
}

/// The finding about one step. If steps are cut out, `used` is the part without steps that is analysed.
pub(super) fn finding(recording: &Recording<'_>, step: &Step, used: Option<&Range<usize>>) -> Finding {
    let largest = step.axes.iter().max_by(|a, b| a.gain.total_cmp(&b.gain));
    let sizes: Vec<String> = step.axes.iter().map(|axis| shown(recording, axis)).collect();
    let (code, then, way_out) = match used {
        Some(used) => (
            "steps_cut",
            format!(
                "; only the longest part without a step, from {:.2} s to {:.2} s, is used",
                recording.time_s[used.start],
                recording.time_s[used.end - 1]
            ),
            "nothing to do; record again without touching the table if the part is too short",
        ),
        None => (
            "step",
            ": a step is not noise, but it increases the estimated random walk".to_owned(),
            "use only the longest part without a step: --cut-steps (cut_steps=True); or record again without touching the \
             table",
        ),
    };
    Finding {
        columns: step.axes.iter().map(|axis| CHANNELS[axis.channel].to_owned()).collect(),
        place: Some(Place {
            first_sample: step.sample,
            last_sample: step.sample,
            start_s: step.time_s,
            end_s: step.time_s,
        }),
        count: 1,
        value: largest.map_or(0.0, |axis| axis.size),
        unit: largest.map_or("", |axis| unit_of(recording, axis.channel)),
        message: format!("the mean changes in a step at {:.2} s, {}{then}", step.time_s, sizes.join(", ")),
        way_out: way_out.into(),
        ..Finding::warning(code, recording.name)
    }
}

/// The finding about all drifts; `None` if there are none.
pub(super) fn drift(recording: &Recording<'_>, drifts: &[Drift]) -> Option<Finding> {
    let mut columns: Vec<String> = drifts.iter().map(|drift| CHANNELS[drift.axis.channel].to_owned()).collect();
    columns.dedup();
    let worst = drifts.iter().max_by(|a, b| a.axis.gain.total_cmp(&b.axis.gain))?;
    let how = match worst.time_constant_s {
        Some(constant_s) => format!("exponentially with a time constant of {constant_s:.0} s"),
        None => format!("from {:.0} s to {:.0} s", worst.start_s, worst.end_s),
    };
    Some(Finding {
        count: columns.len(),
        value: worst.axis.size,
        unit: unit_of(recording, worst.axis.channel),
        message: format!(
            "{}: the mean drifts as of a unit that warms up, most clearly {} {how}: the random walk and the bias \
             instability of these axes contain this drift",
            columns.join(", "),
            shown(recording, &worst.axis)
        ),
        columns,
        way_out: "let the unit run until its temperature is constant, usually 30 minutes, and record again".into(),
        ..Finding::warning("drift", recording.name)
    })
}

fn unit_of(recording: &Recording<'_>, channel: usize) -> &'static str {
    match channel < 3 {
        true => unit_name(recording.accel_unit, "m/s^2"),
        false => unit_name(recording.gyro_unit, "rad/s"),
    }
}

/// Text with the axis, the size and the standard deviation of a change, in the units of datasheets.
fn shown(recording: &Recording<'_>, axis: &Departure) -> String {
    let (factor, unit) = match unit_of(recording, axis.channel) {
        "m/s^2" => (1e3 / STANDARD_GRAVITY_MPS2, "mg"),
        "rad/s" => (180.0 / PI, "deg/s"),
        _ => (1.0, "lsb"),
    };
    let name = CHANNELS[axis.channel];
    format!("{name} {} +- {} {unit}", general(axis.size * factor, 3), general(axis.std * factor, 1))
}

#[cfg(test)]
mod tests {
    use std::num::NonZeroUsize;

    use nalgebra::Vector3;

    use crate::noise::{Noise, Options, identify};
    use crate::recording::Recording;
    use crate::simulate::{Program, Sensor, Simulation, Step, Unit, simulate};

    const RATE_HZ: f64 = 50.0;
    const DURATION_S: f64 = 600.0;
    /// Two-sided noise density of all axes, in the unit of the axis per sqrt(Hz). At 50 Hz, the standard deviation of a
    /// sample is sqrt(50) = 7 times this number.
    const DENSITY: f64 = 1e-3;

    fn still(instability: f64, walk: f64, seed: u64) -> Simulation {
        let sensor = Sensor {
            noise_density: DENSITY,
            bias_instability: instability,
            random_walk: Vector3::repeat(walk),
            ..Sensor::ideal()
        };
        let unit = Unit { accelerometer: sensor, gyroscope: sensor, ..Unit::paper() };
        simulate(&Program::try_new(vec![Step::hold(DURATION_S)]).unwrap(), &unit, RATE_HZ, 9.80665, seed).unwrap()
    }

    /// Identifies the noise of the simulated `run`, with `change` added to accelerometer x and subtracted from
    /// gyroscope z.
    fn noise_with(run: &Simulation, change: impl Fn(f64) -> f64, cut_steps: bool) -> Noise {
        let (mut force, mut rate) = (run.specific_force.clone(), run.angular_rate.clone());
        for (k, time_s) in run.time_s.iter().enumerate() {
            force[k][0] += change(*time_s);
            rate[k][2] -= change(*time_s);
        }
        let recording = Recording::try_new("still", &run.time_s, &force, &rate).unwrap();
        identify(&recording, &Options { min_rest_s: 1.0, cut_steps }, NonZeroUsize::MIN).unwrap()
    }

    #[test]
    fn noise_has_no_steps_and_no_drifts() {
        for (instability, walk) in [(0.0, 0.0), (5e-4, 0.0), (0.0, 1e-4), (0.0, 1e-3), (5e-4, 1e-4)] {
            for seed in 0..4 {
                let noise = noise_with(&still(instability, walk, seed), |_| 0.0, false);
                assert!(noise.steps.is_empty() && noise.drifts.is_empty(), "{instability} {walk} {seed}");
            }
        }
    }

    #[test]
    fn a_step_is_found_with_its_time_and_its_size_in_both_sensors() {
        for (seed, size, walk) in [(1, 2e-3, 0.0), (2, 5e-3, 2e-5), (3, -2e-2, 1e-4), (4, 8e-3, 5e-5)] {
            let at_s = 137.31 + 90.0 * seed as f64;
            let run = still(0.0, walk, seed);
            let noise = noise_with(&run, |time_s| if time_s >= at_s { size } else { 0.0 }, false);
            assert_eq!((noise.steps.len(), noise.drifts.len()), (1, 0), "{seed}: {:?} {:?}", noise.steps, noise.drifts);
            let step = &noise.steps[0];
            assert!((step.time_s - at_s).abs() < 2.0, "{seed}: {}", step.time_s);
            assert_eq!(step.axes.iter().map(|axis| axis.channel).collect::<Vec<_>>(), [0, 5]);
            for (axis, sign) in step.axes.iter().zip([1.0, -1.0]) {
                assert!((axis.size - sign * size).abs() < 4.5 * axis.std, "{seed}: {axis:?}");
            }
            let finding = noise.findings.iter().find(|finding| finding.code == "step").unwrap();
            assert_eq!(finding.columns, ["accel_x", "gyro_z"]);
            assert!(noise.gyroscope.as_ref().unwrap()[2].random_walk.value.is_some(), "the figures contain the step");

            let cut = noise_with(&run, |time_s| if time_s >= at_s { size } else { 0.0 }, true);
            assert!(cut.steps.is_empty() && cut.cut_steps.len() == 1);
            assert!(cut.end_s < at_s || cut.start_s > at_s, "{} to {}", cut.start_s, cut.end_s);
            if walk == 0.0 {
                assert!(cut.gyroscope.as_ref().unwrap()[2].random_walk.value.is_none());
            }
            assert!(cut.findings.iter().any(|finding| finding.code == "steps_cut"));
        }
    }

    #[test]
    fn warming_up_is_a_drift_and_no_step() {
        let changes: [&dyn Fn(f64) -> f64; 3] = [
            &|time_s| 2e-2 * (1.0 - (-time_s / 100.0).exp()),
            &|time_s| 1e-2 * (1.0 - (-time_s / 600.0).exp()),
            &|time_s| 1e-2 * time_s / DURATION_S,
        ];
        for (seed, change) in changes.iter().enumerate() {
            let noise = noise_with(&still(0.0, 0.0, seed as u64), change, false);
            assert!(noise.steps.is_empty(), "{seed}: {:?}", noise.steps);
            let channels: Vec<usize> = noise.drifts.iter().map(|drift| drift.axis.channel).collect();
            assert!(channels.contains(&0) && channels.contains(&5), "{seed}: {channels:?}");
            assert!(noise.findings.iter().any(|finding| finding.code == "drift"));
        }
    }
}
