//! Converts two parts of the result of a search for missing effects to mappings for JSON documents: the residuals,
//! grouped by kind, rest and move, and the predicted errors of corrected samples.

use imucal::gap as library;
use imucal::recording::Recording;
use pyo3::prelude::*;

use crate::mappings::{Fields, fields, known};

const AXES: [&str; 3] = ["x", "y", "z"];

/// Size of the residuals of one kind (a channel) on one body axis. Residuals of the force norm have no axis. See
/// `imucal::gap::ChannelResidual`.
#[derive(IntoPyObject)]
struct Channel {
    channel: &'static str,
    axis: Option<&'static str>,
    unit: &'static str,
    rms: Option<f64>,
    noise_rms: Option<f64>,
    times_noise: Option<f64>,
    stands_out: bool,
    times_noise_after: Option<f64>,
}

/// A significant linear dependence of the residuals of one kind and axis on another quantity (`on`), for example the
/// temperature.
#[derive(IntoPyObject)]
struct Dependence {
    channel: &'static str,
    axis: Option<&'static str>,
    on: &'static str,
    share: f64,
    p_value: f64,
}

/// A rest whose residuals significantly exceed noise.
#[derive(IntoPyObject)]
struct Rest<'a> {
    recording: &'a str,
    index: usize,
    times_noise: f64,
    norm_error_mps2: f64,
    left_out: bool,
}

/// A move whose residuals significantly exceed noise.
#[derive(IntoPyObject)]
struct Move<'a> {
    recording: &'a str,
    index: usize,
    times_noise: f64,
    direction_error_deg: f64,
    left_out: bool,
}

#[derive(IntoPyObject)]
struct Where {
    channels: Vec<Fields>,
    depends: Vec<Fields>,
    rests: Vec<Fields>,
    moves: Vec<Fields>,
    turns_about: Option<&'static str>,
}

/// The residuals, grouped by kind, rest and move, as a mapping. `recordings` gives the names of the recordings.
pub(super) fn residuals(
    py: Python<'_>,
    found: &library::ResidualsByPlace,
    recordings: &[Recording<'_>],
) -> PyResult<Fields> {
    let axis = |axis: Option<usize>| axis.map(|axis| AXES[axis]);
    let channel = |c: &library::ChannelResidual| {
        let row = Channel {
            channel: c.kind.name(),
            axis: axis(c.axis),
            unit: c.kind.unit(),
            rms: known(c.rms),
            noise_rms: known(c.noise_rms),
            times_noise: known(c.times_noise),
            stands_out: c.is_significant,
            times_noise_after: c.times_noise_after.and_then(known),
        };
        fields(py, row)
    };
    let dependence = |d: &library::Dependence| {
        let library::Dependence { share, p_value, .. } = *d;
        fields(py, Dependence { channel: d.kind.name(), axis: axis(d.axis), on: d.regressor.name(), share, p_value })
    };
    let rest = |item: &library::ItemResidual| {
        let library::ItemResidual { recording, index, times_noise, error: norm_error_mps2, left_out } = *item;
        let recording = recordings[recording].name;
        fields(py, Rest { recording, index, times_noise, norm_error_mps2, left_out })
    };
    let of_move = |item: &library::ItemResidual| {
        let library::ItemResidual { recording, index, times_noise, error: direction_error_deg, left_out } = *item;
        let recording = recordings[recording].name;
        fields(py, Move { recording, index, times_noise, direction_error_deg, left_out })
    };
    let all = Where {
        channels: found.channels.iter().map(channel).collect::<PyResult<_>>()?,
        depends: found.dependences.iter().map(dependence).collect::<PyResult<_>>()?,
        rests: found.rests.iter().map(rest).collect::<PyResult<_>>()?,
        moves: found.moves.iter().map(of_move).collect::<PyResult<_>>()?,
        turns_about: axis(found.rotation_axis),
    };
    fields(py, all)
}

/// Predicted rms error of one corrected signal: `before` if the correction does not remove the effects, `after` if it
/// does.
#[derive(IntoPyObject)]
struct PredictedError {
    before: f64,
    after: f64,
    factor: f64,
    factor_low: f64,
    factor_high: f64,
}

#[derive(IntoPyObject)]
struct PredictedErrors {
    angular_rate_rms_radps: Fields,
    specific_force_rms_mps2: Fields,
}

/// Predicted errors of the corrected angular rate and specific force.
pub(super) fn predicted_errors(py: Python<'_>, found: &library::PredictedErrors) -> PyResult<Fields> {
    let signal = |error: &library::PredictedError| {
        let library::PredictedError { before, after, factor, factor_low, factor_high } = *error;
        fields(py, PredictedError { before, after, factor, factor_low, factor_high })
    };
    let all = PredictedErrors {
        angular_rate_rms_radps: signal(&found.angular_rate)?,
        specific_force_rms_mps2: signal(&found.specific_force)?,
    };
    fields(py, all)
}
