//! Which way each motor of a stand went last, from what its encoders read.
//!
//! Where a motor turns back the reading jumps by the backlash, and with it the column of it (model.md (21)): one sample
//! with the wrong sign is an error of the whole jump. A motor starts so slowly that the difference of two readings shows
//! its motion only late, so its start is looked for, as the sample `o` with the smallest sum of squares of
//!
//! ```text
//! level + noise before o,   c_0 + c_2 t^2 + c_3 t^3 + c_4 t^4 + noise from o on,   t since o
//! ```
//!
//! for a motor starts from rest, and what the jump is nobody knows yet: it may lead back over the level.

use std::ops::Range;

use nalgebra::{Matrix4, Vector3, Vector4};

use crate::numerics::stats::{median, quantile, sample_interval_s};

/// So many of the rests are ordinary ones.
const ORDINARY: f64 = 0.9;
/// A motor clearly turns if its reading changes by more than at rest in this time, s: a slow turn of half a degree does.
const SPAN_S: f64 = 0.3;
/// The fewest samples of stillness that have a level.
const FEWEST: usize = 8;
/// Two samples in a row that are off the level by so many standard deviations have left it.
const OFF: f64 = 3.0;
/// A motor may have started earlier than it is seen to leave the level: by as many samples as it takes from there until it
/// clearly turns, and these.
const EARLIER: usize = 5;
/// The start is what comes before the reading has gone so many times as far as it does at rest: the curve of later motion is
/// of more powers.
const START: f64 = 100.0;
/// What noise cannot be smaller than, rad: a perfect encoder has digits, too.
const FINEST_RAD: f64 = 1e-12;

/// Which way each motor went last, for every sample of a recording with these rests; zero before its first motion.
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

/// The largest change within a span of an ordinary rest: what is no motion.
fn still_rad(readings: &[f64], span: usize, rests: &[Range<usize>]) -> f64 {
    let largest = |rest: &Range<usize>| {
        let ends = readings[rest.clone()].iter().zip(readings[rest.clone()].iter().skip(span));
        ends.map(|(from, to)| (to - from).abs()).fold(0.0, f64::max)
    };
    let mut largest: Vec<f64> = rests.iter().map(largest).collect();
    1e-10 + if largest.is_empty() { 0.0 } else { 1.5 * quantile(&mut largest, ORDINARY) }
}

/// What the encoder of a motor reads, the samples of a span, and the largest change within it that is no motion.
struct Motor {
    readings: Vec<f64>,
    span: usize,
    still_rad: f64,
}

impl Motor {
    /// The sign of its last motion, for every sample.
    ///
    /// It clearly turns at a sample if it does so before and after it; the change after it says which way, for that before
    /// may be the backlash itself.
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

    /// The first sample of the motion that is clear at the end of this stretch, in which it is not; the end where the
    /// stretch is too short to tell.
    fn start(&self, stretch: Range<usize>) -> usize {
        let (readings, clear) = (&self.readings, stretch.end);
        // The end of the motion before is in the first half.
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
        let cost = |o: usize| about_level(&readings[middle..o]) + about_start(&readings[o..end]);
        let costs = (earliest..=clear).map(|o| (o, cost(o)));
        costs.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(clear, |(o, _)| o)
    }
}

/// Sum of squares about the mean.
fn about_level(readings: &[f64]) -> f64 {
    let mean = readings.iter().map(|r| r - readings[0]).sum::<f64>() / readings.len() as f64 + readings[0];
    readings.iter().map(|r| (r - mean).powi(2)).sum()
}

/// Sum of squares about a motion that starts from rest at the first reading, at any angle.
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
    // Fewer than four readings are met by a curve of fewer powers.
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

    /// Numbers between -1 and 1 with a variance of a third, that look like chance.
    fn chance(i: usize) -> f64 {
        let mixed = (i as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        let mixed = (mixed ^ (mixed >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        ((mixed >> 11) as f64) / (1u64 << 52) as f64 - 1.0
    }

    /// Turns of 50 deg there and back, 2 s long after 3 s of rest, as a stand makes them: smooth, from rest to rest. What
    /// the encoder reads with this backlash, and the true directions.
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

    /// What wrong signs do to the readings, all squares together, in squares of the noise.
    fn harm(backlash_rad: f64) -> f64 {
        let (readings, truth) = there_and_back(backlash_rad);
        let found = Motor { readings, span: 30, still_rad: 8e-4 }.signs();
        let wrong = found.iter().zip(&truth).map(|(a, b)| ((a - b) * backlash_rad / NOISE_RAD).powi(2));
        wrong.sum::<f64>()
    }

    /// Of a large jump no sample is missed, of a small one few, whichever way it goes.
    #[test]
    fn the_start_of_a_turn_is_found_at_the_jump_of_its_reading() {
        for backlash_rad in [1e-3, -1e-3, 4e-4, -4e-4] {
            assert_eq!(harm(backlash_rad), 0.0, "{backlash_rad}");
        }
        // Half the encoder's noise and as much as it is: one or two samples of the jump, what noise itself amounts to.
        for backlash_rad in [5e-5, -5e-5, 1e-4, -1e-4] {
            let harm = harm(backlash_rad);
            assert!(harm < 10.0 * TURNS as f64, "{backlash_rad}: {harm}");
        }
    }
}
