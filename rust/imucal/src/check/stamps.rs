//! Recommendations for time stamps that are not the sampling instants, for example arrival times. The recommendation
//! states the mean sampling rate, which the user can give instead of the time stamps.

use crate::finding::general;
use crate::recording::Recording;

/// The recommendation states the mean rate only if the longest time step is below this share of the duration. With a
/// longer step, the mean rate is not accurate enough.
const LONGEST_SHARE: f64 = 0.02;

/// Text that recommends to record the sampling instants, or to replace the time stamps by the mean rate.
pub(crate) fn from_sensor(recording: &Recording) -> String {
    format!("take the time stamp from the sensor's own clock, not on arrival; or, {}", even(recording))
}

/// Text that recommends to replace the time stamps by the mean rate, if the sensor samples at equal intervals.
pub(super) fn even(recording: &Recording) -> String {
    let rate = even_rate_hz(recording)
        .map_or("rate_hz=RATE with its rate".to_owned(), |rate_hz| format!("rate_hz={}", general(rate_hz, 6)));
    format!(
        "if the sensor samples evenly and no sample is lost, leave out the time column (columns='-,accel_x_mps2,...') and pass \
         {rate}"
    )
}

/// Mean sampling rate from a straight line fitted to the time stamps, Hz. Jitter of the first and the last stamp hardly
/// affects it. `None` if single time steps are so long that the rate is inaccurate.
fn even_rate_hz(recording: &Recording) -> Option<f64> {
    let time_s = recording.time_s;
    let [start_s, end_s] = recording.span_s();
    let longest_s = time_s.windows(2).map(|pair| pair[1] - pair[0]).fold(0.0, f64::max);
    let centre = (time_s.len() - 1) as f64 / 2.0;
    let (mut product, mut square) = (0.0, 0.0);
    for (i, stamp_s) in time_s.iter().enumerate() {
        let from_centre = i as f64 - centre;
        product += from_centre * (stamp_s - start_s);
        square += from_centre * from_centre;
    }
    let rate_hz = square / product;
    (rate_hz.is_finite() && rate_hz > 0.0 && longest_s < LONGEST_SHARE * (end_s - start_s)).then_some(rate_hz)
}
