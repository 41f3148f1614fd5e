//! Determines the direction of the most recent motion of each motor of a stand, for every sample, from the encoder
//! readings.
//!
//! When a motor reverses, its reading jumps by twice the backlash (model.md (21)). If the wrong direction is assigned
//! to a sample, its corrected angle has an error of this size. A motor starts slowly, so differences of readings detect
//! the motion too late. The first sample of the motion is therefore estimated by least squares. It is the sample `o`
//! for which the following model has the smallest sum of squared residuals (noise):
//!
//! ```text
//! before o    level + noise
//! from o on   c_0 + c_2 t^2 + c_3 t^3 + c_4 t^4 + noise
//! ```
//!
//! The level is a constant. The time t is counted from sample o. The polynomial has no linear term, because a motor
//! starts from standstill. c_0 is free, because the size and the sign of the jump are unknown.

use std::ops::Range;

use nalgebra::{Matrix4, Vector3, Vector4};

use crate::cancellation::checkpoint;
use crate::numerics::stats::{median, quantile, sample_interval_s};

/// Probability (0 to 1) of a quantile over the rests. For each rest, the largest change of a reading within `SPAN_S` is
/// computed. The quantile of these changes is taken as the largest change at an undisturbed rest. With 0.9, up to a
/// tenth of the rests may be disturbed.
const ORDINARY: f64 = 0.9;
/// Motion is detected from the change of a reading over this time interval, s. A rotation of half a degree or more
/// changes the reading within this interval by more than the largest change at rest.
const SPAN_S: f64 = 0.3;
/// Minimum number of samples at standstill from which the level (the constant reading before a motion) is computed.
const FEWEST: usize = 8;
/// A reading has left the level if two consecutive samples deviate from the level by more than this number of standard
/// deviations of the readings at standstill.
const OFF: f64 = 3.0;
/// Margin of the search for the first sample of a motion, in samples. If the reading leaves the level n samples before
/// the motion is detected, the search begins another n samples earlier, plus this margin.
const EARLIER: usize = 5;
/// Angle over which the start of a motion is fitted, in multiples of `still_rad`, the limit for the change of a reading
/// at standstill. For larger angles, a polynomial of fourth degree no longer describes the motion.
const START: f64 = 100.0;
/// Lower limit of the noise of a reading, rad, for noise-free simulated encoders.
const FINEST_RAD: f64 = 1e-12;

/// Determines the direction of the most recent motion of each motor (+1 or -1), for every sample of a recording. It is
/// zero before the first motion. `rests` are the sample ranges of the rests.
pub(super) fn directions(time_s: &[f64], stand_rad: &[[f64; 3]], rests: &[Range<usize>]) -> Vec<Vector3<f64>> {
    let mut all = vec![Vector3::zeros(); stand_rad.len()];
    let span = ((SPAN_S / sample_interval_s(time_s)).round() as usize).max(1);
    for motor in 0..3 {
        let readings: Vec<f64> = stand_rad.iter().map(|row| row[motor]).collect();
        let still_rad = still_rad(&readings, span, rests);
        for (row, sign) in all.iter_mut().zip((Motor { readings, span, still_rad }).signs()) {
            row[motor] = sign;
        }
    }
    all
}

/// Computes the limit for the change of a reading within `span` samples at standstill, rad. It is 1.5 times the largest
/// change at an undisturbed rest (see [`ORDINARY`]).
fn still_rad(readings: &[f64], span: usize, rests: &[Range<usize>]) -> f64 {
    let largest = |rest: &Range<usize>| {
        let ends = readings[rest.clone()].iter().zip(readings[rest.clone()].iter().skip(span));
        ends.map(|(from, to)| (to - from).abs()).fold(0.0, f64::max)
    };
    let mut largest: Vec<f64> = rests.iter().map(largest).collect();
    1e-10 + if largest.is_empty() { 0.0 } else { 1.5 * quantile(&mut largest, ORDINARY) }
}

/// Encoder readings of one motor, rad. `span` is a number of samples, and `still_rad` is the limit for the change of a
/// reading within a span at standstill, rad.
struct Motor {
    readings: Vec<f64>,
    span: usize,
    still_rad: f64,
}

impl Motor {
    /// Sign of the last motion, for every sample.
    ///
    /// Motion is detected at a sample from the changes of the reading over the `span` samples before it and over the
    /// `span` samples after it. Both changes must exceed `still_rad`. The sign is that of the later change, because the
    /// earlier change may contain the jump of the backlash.
    fn signs(&self) -> Vec<f64> {
        let readings = &self.readings;
        let mut signs = vec![0.0; readings.len()];
        let (mut last, mut still_from) = (0.0, 0);
        for i in 0..readings.len() {
            let before = readings[i] - readings[i.saturating_sub(self.span)];
            let after = readings[(i + self.span).min(readings.len() - 1)] - readings[i];
            if before.abs() > self.still_rad && after.abs() > self.still_rad {
                if after.signum() != last {
                    last = after.signum();
                    let start = self.start(still_from..i);
                    signs[start..i].fill(last);
                }
                still_from = i + 1;
            }
            signs[i] = last;
        }
        signs
    }

    /// Estimates the first sample of a motion. `stretch` ends at the sample at which the motion is detected, and
    /// contains the slow start of the motion. If `stretch` is too short for an estimate, its end is returned.
    fn start(&self, stretch: Range<usize>) -> usize {
        let (readings, clear) = (&self.readings, stretch.end);
        // The first half of `stretch` is not used because it contains the end of the previous motion.
        let middle = usize::midpoint(stretch.start, clear);
        let quarter = usize::midpoint(middle, clear);
        if quarter - middle < FEWEST {
            return clear;
        }
        let still = &readings[middle..quarter];
        let level = median(&mut still.to_vec());
        let variance = still.iter().map(|r| (r - level).powi(2)).sum::<f64>() / still.len() as f64;
        let off = |i: usize| (readings[i] - level).abs() > OFF * (variance.sqrt() + FINEST_RAD);
        let left = (quarter..clear).find(|&i| off(i) && off(i + 1)).unwrap_or(clear);
        let earliest = left.saturating_sub(clear - left + EARLIER).max(middle + FEWEST);
        let near = |reading: &&f64| (*reading - readings[clear]).abs() < START * self.still_rad;
        let end = clear + readings[clear..].iter().take(self.span).take_while(near).count();
        let cost = |o: usize| {
            checkpoint();
            about_level(&readings[middle..o]) + about_start(&readings[o..end])
        };
        let costs = (earliest..=clear).map(|o| (o, cost(o)));
        costs.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(clear, |(o, _)| o)
    }
}

/// Sum of squared deviations from the mean, for readings before the motion starts.
fn about_level(readings: &[f64]) -> f64 {
    let mean = readings.iter().map(|r| r - readings[0]).sum::<f64>() / readings.len() as f64 + readings[0];
    readings.iter().map(|r| (r - mean).powi(2)).sum()
}

/// Sum of squared deviations from the fitted polynomial of a motion that starts from standstill at the first reading.
/// The angle at the start is a free parameter, because the jump by the backlash is unknown.
fn about_start(readings: &[f64]) -> f64 {
    let powers = |k: usize| {
        let t = k as f64 / readings.len() as f64;
        Vector4::new(1.0, t * t, t.powi(3), t.powi(4))
    };
    let (mut normal, mut right) = (Matrix4::zeros(), Vector4::zeros());
    for (k, reading) in readings.iter().enumerate() {
        let row = powers(k);
        normal += row * row.transpose();
        right += row * (reading - readings[0]);
    }
    // With fewer than four readings the polynomial is not unique; the small diagonal term keeps the matrix invertible.
    let trace = normal.trace();
    let Some(factor) = (normal + Matrix4::identity() * (1e-13 * trace)).cholesky() else { return 0.0 };
    let solved = factor.solve(&right);
    readings.iter().enumerate().map(|(k, r)| (r - readings[0] - powers(k).dot(&solved)).powi(2)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOISE_RAD: f64 = 9e-5;
    const TURNS: usize = 12;

    /// Pseudorandom numbers, uniform between -1 and 1 (variance 1/3).
    fn chance(i: usize) -> f64 {
        let mixed = (i as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        let mixed = (mixed ^ (mixed >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        ((mixed >> 11) as f64) / (1u64 << 52) as f64 - 1.0
    }

    /// Simulates readings of rotations by 0.9 rad (52 deg) and back. Returns the readings and the true directions. Each
    /// rotation takes 2 s (200 samples), starts after 3 s of rest, and has a smooth start and end. The encoder has the
    /// given backlash.
    fn there_and_back(backlash_rad: f64) -> (Vec<f64>, Vec<f64>) {
        let (rest, turn) = (300, 200);
        let at = |i: usize| {
            let (whole, k) = (i / (rest + turn), i % (rest + turn));
            let s = if k < rest { 0.0 } else { (k - rest) as f64 / turn as f64 };
            let way = 0.9 * s.powi(3) * (10.0 - 15.0 * s + 6.0 * s * s);
            let back = whole % 2 == 1;
            let now = if back { -1.0 } else { 1.0 };
            let sign = if k > rest {
                now
            } else if whole == 0 {
                0.0
            } else {
                -now
            };
            (if back { 0.9 - way } else { way }, sign)
        };
        let samples = TURNS * (rest + turn);
        let noise = |i: usize| 3f64.sqrt() * NOISE_RAD * chance(i);
        (0..samples).map(|i| (at(i).0 + backlash_rad * at(i).1 + noise(i), at(i).1)).unzip()
    }

    /// Determines the directions from simulated readings with this backlash. Returns the sum of the squared errors of
    /// the readings due to wrong signs, divided by the noise variance.
    fn harm(backlash_rad: f64) -> f64 {
        let (readings, truth) = there_and_back(backlash_rad);
        let found = Motor { readings, span: 30, still_rad: 8e-4 }.signs();
        let wrong = found.iter().zip(&truth).map(|(a, b)| ((a - b) * backlash_rad / NOISE_RAD).powi(2));
        wrong.sum::<f64>()
    }

    /// With large backlash of either sign, no sample may have a wrong direction. With small backlash, only a few
    /// samples may have a wrong direction.
    #[test]
    fn the_start_of_a_turn_is_found_at_the_jump_of_its_reading() {
        for backlash_rad in [1e-3, -1e-3, 4e-4, -4e-4] {
            assert_eq!(harm(backlash_rad), 0.0, "{backlash_rad}");
        }
        // The backlash is about half the encoder noise, or about equal to it. A wrong sign causes an error of twice the
        // backlash, which is one or two standard deviations of the noise. A few wrong signs per rotation are therefore
        // accepted.
        for backlash_rad in [5e-5, -5e-5, 1e-4, -1e-4] {
            let harm = harm(backlash_rad);
            assert!(harm < 10.0 * TURNS as f64, "{backlash_rad}: {harm}");
        }
    }
}
