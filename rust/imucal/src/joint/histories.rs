//! Computes the temperature history of each recording of a fit.
//!
//! A temperature history contains a lag for each sensor, the rate of change of the temperature, and the direction of
//! its last change. A lag is the low-pass filtered temperature minus the temperature. The history is computed from all
//! temperatures of a recording, in the same way as when a calibration is applied to the recording. It is stored only at
//! nodes, which are some of the samples, and is interpolated linearly between the nodes.

use std::sync::{Arc, Mutex, PoisonError};

use imucal_core::temperature_memory::{TemperatureHistory, TemperatureMemory};

use crate::correct::temperature_history_of;
use crate::recording::Recording;

/// Maximum time between two nodes, s. The rate of the temperature is low-pass filtered twice with a time constant of
/// 0.5 s. After a sudden change of the true rate, the interpolation error is therefore at most 2e-4 of this change.
const NODE_S: f64 = 0.02;
/// Maximum number of nodes of a recording, which limits the memory of the process. In recordings longer than half an
/// hour, the nodes are therefore further apart than `NODE_S`.
const MOST_NODES: usize = 100_000;

/// Samples of a recording for which user-defined effects and temperature histories are evaluated. A user-defined effect
/// is evaluated at the first sample, and a temperature history is averaged over all samples.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sample {
    pub(crate) recording: usize,
    pub(crate) index: usize,
    /// Number of samples, at least 1.
    pub(crate) count: usize,
}

/// The temperature history of each recording of a fit. The lags of both sensors have the same time constant.
#[derive(Clone, Debug)]
pub(super) struct TemperatureHistories(Arc<Vec<Option<Nodes>>>);

/// Temperature histories that do not depend on the fitted parameters: without lags, or with a fixed time constant of
/// the lags. They are computed when first needed and then stored. Each entry contains the time constant of the lags, s,
/// and the histories of all recordings.
#[derive(Debug, Default)]
pub(crate) struct SharedHistories(Mutex<Vec<(Option<f64>, TemperatureHistories)>>);

/// The temperature history at every `stride`-th sample of a recording, from the first sample on.
#[derive(Debug)]
struct Nodes {
    stride: usize,
    history: Vec<TemperatureHistory<f64>>,
}

impl SharedHistories {
    pub(super) fn get(&self, recordings: &[Recording<'_>], tau_s: Option<f64>) -> TemperatureHistories {
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, histories)) = known.iter().find(|(own, _)| *own == tau_s) {
            return histories.clone();
        }
        let histories = TemperatureHistories::new(recordings, tau_s);
        known.push((tau_s, histories.clone()));
        histories
    }
}

impl TemperatureHistories {
    /// Computes the temperature histories of the recordings. `tau_s` is the time constant of the lags, s; `None`
    /// without lags.
    pub(super) fn new(recordings: &[Recording<'_>], tau_s: Option<f64>) -> Self {
        Self::map(recordings, TemperatureMemory::with_time_constants(tau_s, None), |history| TemperatureHistory {
            accelerometer_lag_k: history.gyroscope_lag_k,
            ..history
        })
    }

    /// Computes the derivatives of the histories with respect to the time constant of the lags, per second, as central
    /// differences with the step `step_s`.
    pub(super) fn derivative(recordings: &[Recording<'_>], tau_s: f64, step_s: f64) -> Self {
        let memory = TemperatureMemory::with_time_constants(Some(tau_s + step_s), Some(tau_s - step_s));
        Self::map(recordings, memory, |history| {
            let by_tau = (history.gyroscope_lag_k - history.accelerometer_lag_k) / (2.0 * step_s);
            TemperatureHistory {
                gyroscope_lag_k: by_tau,
                accelerometer_lag_k: by_tau,
                ..TemperatureHistory::constant()
            }
        })
    }

    fn map(
        recordings: &[Recording<'_>],
        memory: TemperatureMemory<f64>,
        of: impl Fn(TemperatureHistory<f64>) -> TemperatureHistory<f64>,
    ) -> Self {
        let nodes = |recording: &Recording<'_>| {
            let stride = stride_of(recording);
            let history = temperature_history_of(memory, recording.time_s, recording.temperature_degc?);
            Some(Nodes { stride, history: history.step_by(stride).map(&of).collect() })
        };
        Self(Arc::new(recordings.iter().map(nodes).collect()))
    }

    /// Returns the temperature history, averaged over these samples of a recording. `None` if the temperature of the
    /// recording is unknown.
    pub(super) fn at(&self, Sample { recording, index, count }: Sample) -> Option<TemperatureHistory<f64>> {
        let nodes = self.0.get(recording)?.as_ref()?;
        // The samples are divided into equal sections that are at most as long as the distance between two nodes. The
        // result is the mean of the values at the centres of the sections.
        let points = count.div_ceil(nodes.stride).max(1);
        let place = |point: usize| index as f64 + (point as f64 + 0.5) * count as f64 / points as f64 - 0.5;
        let mut mean = nodes.at(place(0));
        for point in 1..points {
            mean = mean.between(&nodes.at(place(point)), 1.0 / (point + 1) as f64);
        }
        Some(mean)
    }
}

impl Nodes {
    /// Temperature history at the sample with the index `sample`, or between two samples if `sample` is not an integer.
    /// After the last node, the history is extrapolated from the last two nodes.
    fn at(&self, sample: f64) -> TemperatureHistory<f64> {
        let place = sample / self.stride as f64;
        let before = (place as usize).min(self.history.len().saturating_sub(2));
        let after = (before + 1).min(self.history.len() - 1);
        self.history[before].between(&self.history[after], place - before as f64)
    }
}

/// Number of samples from one node (stored value of the history) to the next.
fn stride_of(recording: &Recording<'_>) -> usize {
    let [first_s, last_s] = recording.span_s();
    let intervals = recording.len().saturating_sub(1);
    let within_limit = (NODE_S * intervals as f64 / (last_s - first_s).max(f64::MIN_POSITIVE)) as usize;
    within_limit.max(recording.len().div_ceil(MOST_NODES)).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_history_of_a_fit_is_that_of_the_correction() {
        // The sampling rate is 500 Hz, so that neighbouring nodes are ten samples apart.
        let time_s: Vec<f64> = (0..30_000).map(|k| 100.0 + 0.002 * f64::from(k)).collect();
        let degc: Vec<f64> = time_s.iter().map(|t| 25.0 + 20.0 * (t / 10.0).sin()).collect();
        let zeros = vec![[0.0; 3]; time_s.len()];
        let mut recording = Recording::try_new("run", &time_s, &zeros, &zeros).unwrap();
        recording.temperature_degc = Some(&degc);
        let memory = TemperatureMemory::with_time_constants(Some(11.0), None);
        let exact: Vec<_> = temperature_history_of(memory, &time_s, &degc).collect();
        let histories = TemperatureHistories::new(&[recording], Some(11.0));
        for (index, count) in [(0, 1), (4321, 1), (17_000, 313), (12_345, 20), (29_000, 1000)] {
            let own = histories.at(Sample { recording: 0, index, count }).unwrap();
            let samples = &exact[index..index + count];
            let mean = |of: fn(&TemperatureHistory<f64>) -> f64| samples.iter().map(of).sum::<f64>() / count as f64;
            assert!((own.gyroscope_lag_k - mean(|h| h.gyroscope_lag_k)).abs() < 2e-5, "{index}: {own:?}");
            assert!((own.rate_kps - mean(|h| h.rate_kps)).abs() < 1e-5, "{index}: {own:?}");
            assert!((own.direction - mean(|h| h.direction)).abs() < 2e-4, "{index}: {own:?}");
            assert_eq!(own.accelerometer_lag_k, own.gyroscope_lag_k);
        }
    }

    #[test]
    fn a_recording_without_temperatures_has_no_history() {
        let zeros = [[0.0; 3]; 2];
        let recording = Recording::try_new("run", &[0.0, 1.0], &zeros, &zeros).unwrap();
        let histories = TemperatureHistories::new(&[recording], None);
        assert_eq!(histories.at(Sample { recording: 0, index: 0, count: 2 }), None);
    }
}
