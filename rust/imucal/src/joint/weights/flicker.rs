//! How the mean rates at the rests scatter together where the biases wander.

use faer::Mat;

use crate::joint::prepared::Prepared;
use crate::joint::wander::{BiasWander, MOST_ROWS};

/// Covariance of the mean biases at the rests that take part, in their order, for a bias instability of one; `None` where there
/// are too many.
pub(crate) fn flicker_of_rests(prepared: &Prepared<'_>) -> Option<Mat<f64>> {
    let places: Vec<usize> = (0..prepared.rests.len()).filter(|&k| prepared.used[k]).collect();
    if rows(places.len(), prepared.moves.len()) > MOST_ROWS {
        return None;
    }
    let unit = BiasWander { bias_instability: [1.0; 3], random_walk: [0.0; 3] };
    let mut covariance = Mat::zeros(places.len(), places.len());
    for (index, recording) in prepared.recordings.iter().enumerate() {
        let (rests, spans) = prepared.rests_of(index);
        let at: Vec<usize> = rests.iter().map(|k| places.partition_point(|place| place < k)).collect();
        let own = unit.of_rests(0, &spans, recording.span_s());
        for (i, j) in (0..at.len()).flat_map(|i| (0..at.len()).map(move |j| (i, j))) {
            covariance[(at[i], at[j])] = own[(i, j)];
        }
    }
    Some(covariance)
}

/// A norm and three rates for each rest, and two lines for each move.
fn rows(rests: usize, moves: usize) -> usize {
    4 * rests + 2 * moves
}
