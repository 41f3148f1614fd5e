//! Temperature histories of the recordings of a fit, at any time and for any time constant of a lag.
//!
//! The temperature is averaged over intervals of a second, which form the nodes. The lag is computed at the nodes for a
//! geometric series of time constants. Between nodes it is interpolated linearly in time, and between time constants by
//! a cubic polynomial in the logarithm, whose relative error is below 1e-4.

use std::sync::Arc;

use imucal_core::effects::{Effect, Need};
use imucal_core::temperature_memory::{TemperatureHistory, TemperatureMemory};

use crate::recording::{REFERENCE_TEMPERATURE_DEGC, Recording};

/// Minimum distance of two nodes, s.
const NODE_S: f64 = 1.0;
/// Maximum number of nodes of a recording. In longer recordings the nodes are further apart.
const MOST_NODES: f64 = 20_000.0;
/// Smallest time constant of the series, s, its ratio, and its length. The largest is 1e5 s.
const FIRST_S: f64 = 1.0;
const RATIO: f64 = 1.25;
const TAUS: usize = 52;

/// The temperature history of each recording of a fit.
#[derive(Clone, Debug)]
pub(crate) struct TemperatureHistories(Arc<Vec<Option<Nodes>>>);

#[derive(Debug)]
struct Nodes {
    /// Time since the first sample, s.
    time_s: Vec<f64>,
    /// Rate and direction at each node.
    history: Vec<TemperatureHistory<f64>>,
    /// Lag at each node for each time constant, K.
    lag_k: Vec<[f64; TAUS]>,
}

impl TemperatureHistories {
    /// The histories of recordings, if any of the effects depends on them.
    pub(crate) fn for_effects<'e>(
        mut effects: impl Iterator<Item = &'e Effect<f64>>,
        recordings: &[Recording<'_>],
    ) -> Self {
        let is_needed = effects.any(|effect| effect.needs.contains(&Need::TemperatureHistory));
        let nodes = |recording: &Recording<'_>| {
            recording.temperature_degc.filter(|_| is_needed).and_then(|degc| Nodes::of(recording.time_s, degc))
        };
        Self(Arc::new(recordings.iter().map(nodes).collect()))
    }

    /// The history of a recording at a time since its first sample, in which both lags have the time constant `tau_s`.
    /// `None` if the temperature of the recording is unknown.
    pub(super) fn at(&self, recording: usize, time_s: f64, tau_s: f64) -> Option<TemperatureHistory<f64>> {
        self.0.get(recording)?.as_ref().map(|nodes| nodes.at(time_s, tau_s))
    }
}

impl Nodes {
    fn of(time_s: &[f64], degc: &[f64]) -> Option<Self> {
        let start_s = *time_s.first()?;
        let node_s = ((time_s[time_s.len() - 1] - start_s) / MOST_NODES).max(NODE_S);
        let (mut times, mut means) = (Vec::new(), Vec::new());
        let known = time_s.iter().zip(degc).filter(|(_, degc)| degc.is_finite());
        let differences: Vec<(f64, f64)> =
            known.map(|(time_s, degc)| (time_s - start_s, degc - REFERENCE_TEMPERATURE_DEGC)).collect();
        for own in differences.chunk_by(|a, b| (a.0 / node_s).floor() == (b.0 / node_s).floor()) {
            let (time_s, degc) = own.iter().fold((0.0, 0.0), |sum, value| (sum.0 + value.0, sum.1 + value.1));
            times.push(time_s / own.len() as f64);
            means.push(degc / own.len() as f64);
        }
        // The low-passes start at the first temperature, half an interval before the first mean.
        let known_s = differences.first()?.0;
        if times.len() > 1 {
            let (lead_s, step_s) = (times[0] - known_s, times[1] - times[0]);
            if lead_s > 0.0 && lead_s <= step_s {
                means.insert(0, means[0] - (means[1] - means[0]) * lead_s / step_s);
                times.insert(0, known_s);
            }
        }
        let mut lag_k = vec![[0.0; TAUS]; times.len()];
        let mut history = Vec::new();
        for pair in (0..TAUS).step_by(2) {
            let tau_s = |k: usize| FIRST_S * RATIO.powi(k as i32);
            let mut memory = TemperatureMemory::with_time_constants(Some(tau_s(pair)), Some(tau_s(pair + 1)));
            let steps =
                times.iter().scan(*times.first()?, |last, time_s| Some(time_s - std::mem::replace(last, *time_s)));
            history = steps.zip(&means).map(|(step_s, mean)| memory.update(step_s, *mean)).collect();
            for (lag_k, history) in lag_k.iter_mut().zip(&history) {
                lag_k[pair] = history.gyroscope_lag_k;
                lag_k[pair + 1] = history.accelerometer_lag_k;
            }
        }
        Some(Self { time_s: times, history, lag_k })
    }

    fn at(&self, time_s: f64, tau_s: f64) -> TemperatureHistory<f64> {
        let last = self.time_s.len() - 1;
        let after = self.time_s.partition_point(|node| *node <= time_s).clamp(1, last.max(1)).min(last);
        let before = after.saturating_sub(1);
        let step_s = self.time_s[after] - self.time_s[before];
        let share = if step_s > 0.0 { ((time_s - self.time_s[before]) / step_s).clamp(0.0, 1.0) } else { 0.0 };
        let between = |of: &dyn Fn(usize) -> f64| of(before) + (of(after) - of(before)) * share;
        let lag_k = between(&|node| lag_between(&self.lag_k[node], tau_s));
        TemperatureHistory {
            rate_kps: between(&|node| self.history[node].rate_kps),
            direction: between(&|node| self.history[node].direction),
            gyroscope_lag_k: lag_k,
            accelerometer_lag_k: lag_k,
        }
    }
}

/// The lag for a time constant, by a cubic polynomial through the four nearest members of the series. Time constants
/// beyond the ends of the series have the lag of the end.
fn lag_between(series: &[f64; TAUS], tau_s: f64) -> f64 {
    let place = ((tau_s / FIRST_S).ln() / RATIO.ln()).clamp(0.0, (TAUS - 1) as f64);
    let first = (place.floor() as usize).saturating_sub(1).min(TAUS - 4);
    let x = place - first as f64;
    let [a, b, c, d] = [series[first], series[first + 1], series[first + 2], series[first + 3]];
    let (x1, x2, x3) = (x - 1.0, x - 2.0, x - 3.0);
    -a * x1 * x2 * x3 / 6.0 + b * x * x2 * x3 / 2.0 - c * x * x1 * x3 / 2.0 + d * x * x1 * x2 / 6.0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The lag behind `sin(w t)`: the steady response and the decaying start.
    fn lag_of_sine(time_s: f64, omega: f64, tau_s: f64) -> f64 {
        let x = omega * tau_s;
        let output =
            ((omega * time_s).sin() - x * (omega * time_s).cos() + x * (-time_s / tau_s).exp()) / (1.0 + x * x);
        output - (omega * time_s).sin()
    }

    #[test]
    fn the_lag_is_the_exact_one_at_any_time_and_time_constant() {
        let omega = 2.0 * std::f64::consts::PI / 700.0;
        let time_s: Vec<f64> = (0..60_000).map(|k| 100.0 + 0.02 * f64::from(k)).collect();
        let degc: Vec<f64> = time_s.iter().map(|t| 25.0 + 20.0 * (omega * (t - 100.0)).sin()).collect();
        let nodes = Nodes::of(&time_s, &degc).unwrap();
        for tau_s in [3.0, 11.3, 60.0, 222.0, 1500.0] {
            for at_s in [60.3, 400.0, 777.7, 1190.1] {
                let (got, expected) = (nodes.at(at_s, tau_s), 20.0 * lag_of_sine(at_s, omega, tau_s));
                assert!((got.gyroscope_lag_k - expected).abs() < 3e-3, "{tau_s} {at_s}: {got:?} {expected}");
            }
        }
    }

    #[test]
    fn few_samples_have_a_history() {
        for n in 1..5 {
            let time_s: Vec<f64> = (0..n).map(f64::from).collect();
            let nodes = Nodes::of(&time_s, &vec![20.0; time_s.len()]).unwrap();
            assert_eq!(nodes.at(0.7, 10.0), TemperatureHistory::constant());
        }
        assert!(Nodes::of(&[0.0, 1.0], &[f64::NAN; 2]).is_none());
    }
}
