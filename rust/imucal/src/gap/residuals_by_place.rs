//! Computes the residuals of recordings by kind and body axis, by rest and by move, and tests on which quantities the
//! residuals depend. These results show where the recordings disagree with a calibration, and on what the disagreement
//! depends.
//!
//! A channel consists of all residuals of one kind on one body axis. A channel, a rest or a move is significant if the
//! chi2 of its residuals exceeds a threshold. With noise as the only error, the probability is 0.1 % that any channel
//! is significant, 0.1 % that any rest is significant, and 0.1 % that any move is significant. Dependence is tested by
//! linear regression of a channel on each [`Regressor`]. Let `r` be the share of the sum of squared residuals over `n`
//! rests or moves that the regression explains. Under the null hypothesis of no dependence, `-n ln(1 - r)` has a chi2
//! distribution with one degree of freedom for each independent component of the regressor.

use std::collections::HashMap;

use faer::Mat;
use nalgebra::Vector3;

use super::residual_channels::{Channel, Item, Residuals};
use super::residual_kinds::{CorrectedFit, Regressor, ResidualKind};
use crate::correct::is_left_in_data;
use crate::numerics::lsq::singular;
use crate::numerics::stats::{p_value, rms};

/// Maximum p-value of a significant test. For channels, rests and moves, it is divided by the number of channels, rests
/// or moves (Bonferroni). For the dependences of a channel on a regressor, it is not divided.
const SIGNIFICANCE: f64 = 1e-3;
/// Maximum number of regressors (explanatory quantities) that are reported for a channel of residuals.
const MOST_REGRESSORS: usize = 3;
/// A regressor is reported only if it explains more than this share of the sum of the squared residuals.
const LEAST_SHARE: f64 = 0.1;
/// Threshold of the rank decision: a singular value of the matrix of a regressor's values counts as zero if it is below
/// this share of the largest one.
const DEPENDENT_COLUMNS: f64 = 1e-6;
/// Body axis i is the common rotation axis of several moves if v_i^2 / |v|^2 > ALONG_ONE_AXIS for the rotation vector v
/// of each move.
const ALONG_ONE_AXIS: f64 = 0.8;

/// Residuals of a calibration on the recordings from which it was estimated. If a second calibration is given, these
/// residuals are compared with the residuals of the second calibration.
#[derive(Clone, Debug)]
pub struct ResidualsByPlace {
    /// Residuals by kind and body axis.
    pub channels: Vec<ChannelResidual>,
    /// Quantities on which the residuals of significant channels depend, such as the temperature. Only significant
    /// dependences are listed. For each channel, the dependence that explains the largest share of the sum of squared
    /// residuals comes first.
    pub dependences: Vec<Dependence>,
    /// Rests whose residuals are significant.
    pub rests: Vec<ItemResidual>,
    /// Moves whose residuals are significant.
    pub moves: Vec<ItemResidual>,
    /// Body axis 0, 1 or 2 about which the unit rotates in all significant moves; `None` if there is no common axis.
    pub rotation_axis: Option<usize>,
}

/// Residuals of one kind on one axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChannelResidual {
    /// Kind of residual, with its unit.
    pub kind: ResidualKind,
    /// Body axis 0, 1 or 2; `None` for the norm of the specific force.
    pub axis: Option<usize>,
    /// Root mean square of the residuals, in the unit of the kind.
    pub rms: f64,
    /// Root mean square of sigma, the standard deviation of each residual from sensor noise, in the unit of the kind.
    pub noise_rms: f64,
    /// Root mean square of residual / sigma; 1 if noise is the only error.
    pub times_noise: f64,
    /// Whether chi2 of the channel exceeds the significance threshold.
    pub is_significant: bool,
    /// `times_noise` for the second calibration (`after` in [`residuals_by_place`]). If there is no second calibration,
    /// it equals `times_noise`. `None` if the model contains effects for which samples cannot be corrected.
    pub times_noise_after: Option<f64>,
}

/// A significant linear dependence of a channel on a regressor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dependence {
    /// Kind of residual of the channel.
    pub kind: ResidualKind,
    /// Body axis of the channel, 0, 1 or 2; `None` for the norm of the specific force.
    pub axis: Option<usize>,
    /// The quantity that the residuals depend on.
    pub regressor: Regressor,
    /// Share of the sum of squares of the residuals about their mean that the regression explains, between 0 and 1.
    pub share: f64,
    /// p-value of `share` under the null hypothesis of no dependence.
    pub p_value: f64,
}

/// A rest or move whose residuals are significant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ItemResidual {
    /// Index of the recording.
    pub recording: usize,
    /// Index of the rest or move in the calibration's list of rests or of moves.
    pub index: usize,
    /// Square root of chi2 per degree of freedom.
    pub times_noise: f64,
    /// For a rest: `|f| - g`, m/s^2. For a move: angle between predicted and measured gravity direction after the move,
    /// deg.
    pub error: f64,
    /// Whether the fit excluded the rest or move as an outlier.
    pub left_out: bool,
}

/// Residuals of the calibration `before` on the recordings from which it was estimated. If `after` is given, they are
/// compared with the residuals of `after`, a second calibration from the same recordings.
///
/// `inside_moves` is true if the moves rotate the unit without translation. The specific force inside moves is then
/// also compared with gravity.
pub fn residuals_by_place(
    before: &CorrectedFit<'_>,
    after: Option<&CorrectedFit<'_>>,
    inside_moves: bool,
) -> ResidualsByPlace {
    let last = after.unwrap_or(before);
    // The bias instability is taken from `after` if it is given. In a calibration without effects, the residuals of
    // missing effects would increase the estimated bias instability.
    let instability = last.outcome.bias_instability_radps;
    let residuals = Residuals::new(before, instability, inside_moves);
    let remaining = after.map(|after| Residuals::new(after, instability, inside_moves));
    let of_after = &remaining.as_ref().unwrap_or(&residuals).channels;
    let is_removable = last.outcome.calibration.effects.iter().all(|values| !is_left_in_data(values.effect()));
    let count = residuals.channels.len() as f64;
    let channels: Vec<ChannelResidual> = residuals
        .channels
        .iter()
        .map(|channel| {
            let times_noise = channel.times_noise();
            let statistic = times_noise.powi(2) * channel.items as f64;
            let same = |other: &&Channel| (other.kind, other.axis) == (channel.kind, channel.axis);
            ChannelResidual {
                kind: channel.kind,
                axis: channel.axis,
                rms: rms(channel.values.iter().copied()),
                noise_rms: rms(channel.sigma.iter().copied()),
                times_noise,
                is_significant: p_value(statistic, channel.items) < SIGNIFICANCE / count,
                times_noise_after: of_after.iter().find(same).filter(|_| is_removable).map(Channel::times_noise),
            }
        })
        .collect();
    let significant = channels.iter().zip(&residuals.channels).filter(|(row, _)| row.is_significant);
    let dependences = significant.flat_map(|(_, channel)| dependences(channel)).collect();
    let moves = significant_items(&residuals.moves);
    ResidualsByPlace {
        channels,
        dependences,
        rests: significant_items(&residuals.rests),
        rotation_axis: common_axis(&moves, &residuals.rotation_vectors),
        moves,
    }
}

/// Significant dependences of a channel, in descending order of the explained share.
fn dependences(channel: &Channel) -> Vec<Dependence> {
    let mut found: Vec<Dependence> = channel
        .regressors
        .iter()
        .filter_map(|(regressor, rows)| {
            let (share, parameters) = explained_share(channel, rows)?;
            let statistic = -(channel.items as f64) * (1.0 - share).max(1e-300).ln();
            let p_value = p_value(statistic, parameters);
            let (kind, axis, regressor) = (channel.kind, channel.axis, *regressor);
            (p_value < SIGNIFICANCE && share > LEAST_SHARE).then_some(Dependence {
                kind,
                axis,
                regressor,
                share,
                p_value,
            })
        })
        .collect();
    found.sort_by(|a, b| b.share.total_cmp(&a.share));
    found.truncate(MOST_REGRESSORS);
    found
}

/// Linear regression of the residuals of a channel on a regressor and a constant. `rows` contains the components of the
/// regressor for each residual. Returns the explained share of the residuals' weighted sum of squares about their mean,
/// and the number of linearly independent components.
fn explained_share(channel: &Channel, rows: &[Vec<f64>]) -> Option<(f64, usize)> {
    let (n, width) = (rows.len(), rows.first()?.len());
    let weights: Vec<f64> = channel.sigma.iter().map(|sigma| sigma.powi(-2)).collect();
    let weight: f64 = weights.iter().sum();
    // (value - weighted mean) / sigma. A constant that is added to all values does not change the result.
    let centred = |value: &dyn Fn(usize) -> f64| -> Vec<f64> {
        let mean = weights.iter().enumerate().map(|(i, w)| w * value(i)).sum::<f64>() / weight;
        channel.sigma.iter().enumerate().map(|(i, sigma)| (value(i) - mean) / sigma).collect()
    };
    let z = centred(&|i| channel.values[i]);
    let columns: Vec<Vec<f64>> = (0..width).map(|j| centred(&|i| rows[i][j])).collect();
    let (sizes, right) = singular(&Mat::from_fn(n, width, |i, j| columns[j][i])).ok()?;
    let independent = sizes.iter().filter(|size| **size > DEPENDENT_COLUMNS * sizes[0].max(1e-300)).count();
    if independent == 0 || independent + 2 >= n {
        return None;
    }
    // A is the matrix of `columns`, and A = U S V^T is its singular value decomposition, with S = `sizes` and V =
    // `right`. z are the centred residuals, and `products` is A^T z. The components of z along the columns of U are
    // then U^T z = S^-1 V^T A^T z.
    let products: Vec<f64> = columns.iter().map(|column| column.iter().zip(&z).map(|(a, z)| a * z).sum()).collect();
    let explained: f64 = (0..independent)
        .map(|k| ((0..width).map(|j| right[(j, k)] * products[j]).sum::<f64>() / sizes[k]).powi(2))
        .sum();
    Some((explained / z.iter().map(|z| z * z).sum::<f64>(), independent))
}

fn significant_items(items: &[Item]) -> Vec<ItemResidual> {
    let limit = SIGNIFICANCE / items.len() as f64;
    items
        .iter()
        .filter(|item| p_value(item.chi2, item.dof) < limit)
        .map(|item| ItemResidual {
            recording: item.recording,
            index: item.index,
            times_noise: (item.chi2 / item.dof as f64).sqrt(),
            error: item.error,
            left_out: item.left_out,
        })
        .collect()
}

/// The body axis about which the unit rotates in all given moves; `None` if there is no common axis.
fn common_axis(moves: &[ItemResidual], rotation_vectors: &HashMap<usize, Vector3<f64>>) -> Option<usize> {
    let shares: Vec<Vector3<f64>> = moves
        .iter()
        .map(|item| {
            rotation_vectors.get(&item.index).map_or_else(Vector3::zeros, |v| v.component_mul(v) / v.norm_squared())
        })
        .collect();
    let axis = shares.iter().sum::<Vector3<f64>>().imax();
    (!shares.is_empty() && shares.iter().all(|share| share[axis] > ALONG_ONE_AXIS)).then_some(axis)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::{EffectChoice, Options, calibrate};
    use crate::correct::correct;
    use crate::recording::Recording;
    use crate::simulate::{Program, RandomMoves, Unit, simulate};
    use imucal_core::effects::{Effect, EffectValues};

    const GRAVITY: f64 = 9.80665;

    fn corrected<'a>(recording: &Recording<'a>, samples: &'a (Vec<[f64; 3]>, Vec<[f64; 3]>)) -> [Recording<'a>; 1] {
        let (rate, force) = samples;
        [Recording { angular_rate: rate.into(), specific_force: force.into(), ..*recording }]
    }

    /// Simulates a unit with this effect. Returns the residuals of a calibration without the effect and of a
    /// calibration with it.
    fn residuals(effect: Option<(&str, &[f64])>) -> ResidualsByPlace {
        let mut unit = Unit::paper();
        let row = effect.map(|(name, values)| (Effect::find(name).unwrap(), values));
        if let Some((row, values)) = row {
            unit.effects.push(EffectValues::try_new(row, values, None).unwrap()).unwrap();
        }
        let program = Program::random(&RandomMoves::default(), 3).unwrap();
        let run = simulate(&program, &unit, 100.0, GRAVITY, 3).unwrap();
        let recording = run.recording("run");
        let with = |effects: Vec<EffectChoice>| {
            let outcome = calibrate(&[recording], &Options { effects, ..Options::default() }).unwrap();
            let samples = correct(&recording, &outcome.calibration);
            (outcome, samples)
        };
        let before = with(vec![]);
        let after = row.map(|(effect, _)| with(vec![EffectChoice::plain(effect)]));
        let of_before = corrected(&recording, &before.1);
        let fit = |outcome, corrected| CorrectedFit { outcome, corrected, gravity_mps2: GRAVITY };
        match &after {
            None => residuals_by_place(&fit(&before.0, &of_before), None, true),
            Some(after) => {
                let of_after = corrected(&recording, &after.1);
                residuals_by_place(&fit(&before.0, &of_before), Some(&fit(&after.0, &of_after)), true)
            }
        }
    }

    #[test]
    fn residuals_that_noise_explains_are_not_significant() {
        let found = residuals(None);
        assert_eq!(found.channels.len(), 10);
        assert!(found.channels.iter().all(|channel| !channel.is_significant), "{:?}", found.channels);
        assert!(found.dependences.is_empty() && found.rests.is_empty() && found.moves.is_empty());
        assert!(found.channels.iter().all(|channel| channel.times_noise_after == Some(channel.times_noise)));
    }

    #[test]
    fn a_g_sensitivity_shows_in_the_rates_at_rest_as_a_function_of_gravity_and_is_gone_with_it_in_the_model() {
        let found = residuals(Some(("gyro_g_sensitivity", &[2e-4, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])));
        let channel = |axis| {
            let is_it = |c: &&ChannelResidual| (c.kind, c.axis) == (ResidualKind::RestRate, Some(axis));
            found.channels.iter().find(is_it).unwrap()
        };
        assert!(channel(0).is_significant && channel(0).times_noise > 5.0, "{:?}", channel(0));
        assert!(!channel(1).is_significant && !channel(2).is_significant);
        assert!(channel(0).times_noise_after.unwrap() < 1.3, "{:?}", channel(0));
        let of_rates = found.dependences.iter().find(|d| d.kind == ResidualKind::RestRate).unwrap();
        assert_eq!((of_rates.axis, of_rates.regressor), (Some(0), Regressor::Gravity));
        assert!(of_rates.share > 0.9 && of_rates.p_value < 1e-10);
    }

    #[test]
    fn moves_about_one_axis_share_it() {
        let item = |index| ItemResidual { recording: 0, index, times_noise: 9.0, error: 1.0, left_out: false };
        let vectors = HashMap::from([(2, Vector3::new(0.1, 0.0, -1.5)), (5, Vector3::new(0.2, -0.1, 0.9))]);
        assert_eq!(common_axis(&[item(2), item(5)], &vectors), Some(2));
        let vectors = HashMap::from([(2, Vector3::new(0.1, 0.0, -1.5)), (5, Vector3::new(0.9, -0.1, 0.9))]);
        assert_eq!(common_axis(&[item(2), item(5)], &vectors), None);
        assert_eq!(common_axis(&[], &vectors), None);
    }
}
