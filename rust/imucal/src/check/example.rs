//! A synthetic recording for the tests of the checks: rests and moves of a unit that tumbles, with noise.

use crate::recording::Recording;

/// The columns of the synthetic recording, which a test can modify.
pub(super) struct Columns {
    pub(super) time_s: Vec<f64>,
    pub(super) force: Vec<[f64; 3]>,
    pub(super) rate: Vec<[f64; 3]>,
}

impl Columns {
    /// Simulates 40 s at 100 Hz, in which rests of 1 s and moves of 1 s alternate. The rate of an axis is at most 3
    /// rad/s. The standard deviations of noise are 0.02 m/s^2 and 0.003 rad/s.
    pub(super) fn tumbling() -> Self {
        let mut state = 1u64;
        let mut noise = move || {
            let uniform: f64 = (0..12)
                .map(|_| {
                    state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                    (state >> 11) as f64 / (1u64 << 53) as f64
                })
                .sum();
            uniform - 6.0
        };
        let mut columns = Self { time_s: Vec::new(), force: Vec::new(), rate: Vec::new() };
        for i in 0..4000 {
            let time = i as f64 * 0.01;
            let (lap, phase) = ((time / 2.0).floor(), time % 2.0);
            let turned = (phase - 1.0).max(0.0);
            // The cosine has a full period per move, so the rate is zero at both ends of every move.
            let speed = 1.5 * (1.0 - (2.0 * std::f64::consts::PI * turned).cos());
            let (tilt, heading) = (0.5 * (lap + turned), 0.9 * (lap + turned));
            let up = [tilt.sin() * heading.cos(), tilt.sin() * heading.sin(), tilt.cos()];
            let axis = [lap.sin(), (2.0 * lap).cos(), (3.0 * lap + 1.0).sin()];
            columns.time_s.push(time);
            columns.force.push(up.map(|u| 9.80665 * u + 0.02 * noise()));
            columns.rate.push(axis.map(|a| speed * a + 0.003 * noise()));
        }
        columns
    }

    /// Rounds the channels of each sensor to multiples of its step, as a converter does.
    pub(super) fn quantised(mut self, force_step: f64, rate_step: f64) -> Self {
        for row in &mut self.force {
            *row = row.map(|v| (v / force_step).round() * force_step);
        }
        for row in &mut self.rate {
            *row = row.map(|v| (v / rate_step).round() * rate_step);
        }
        self
    }

    pub(super) fn recording(&self) -> Recording<'_> {
        Recording::try_new("example", &self.time_s, &self.force, &self.rate).unwrap()
    }

    /// The index ranges of the rests in [`tumbling`](Self::tumbling): the first second of every two seconds, without
    /// 0.05 s at each end.
    pub(super) fn rests() -> Vec<std::ops::Range<usize>> {
        (0..20).map(|k| 200 * k + 5..200 * k + 95).collect()
    }
}
