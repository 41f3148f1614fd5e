//! Plans motions: predicts the accuracy of a calibration from a program (a sequence of turns and holds of the unit),
//! and finds the program with the best accuracy (`docs/model.md` (33)).
//!
//! * [`Sensors`]: derivatives of the sensor readings with respect to the parameters, and the white noise of the
//!   sensors.
//! * [`predict()`]: predicted standard deviation of every parameter in a calibration from any
//!   [`Motion`](crate::simulate::Motion). The prediction uses only the model of the sensors, without any data.
//! * [`Limits`]: limits of the motors' angles, rates and accelerations.
//! * [`optimal()`]: the program with the most information in a given time, or the shortest program that reaches given
//!   standard deviations.
//!
//! Predictions and plans use the information matrix of the joint fit, which estimates all parameters of both sensors
//! from the whole run. The matrix contains the information from the mean force at each rest, from the mean rate at each
//! rest (only on a stand, because the true mean rate of a hand-held unit is unknown), and from the propagation of the
//! gravity direction from rest to rest with the gyroscope. If an effect depends on the angular acceleration, the matrix
//! also contains the information from the forces during moves. The gravity direction at each rest is unknown and is
//! eliminated. An information filter accumulates the matrix along the run. The computing time is therefore proportional
//! to the length of the run, and no large matrix is needed.
//!
//! ```
//! use imucal::plan::{Goal, Limits, Search, Sensors, optimal};
//! use imucal::simulate::Unit;
//!
//! let (rate_hz, gravity_mps2) = (200.0, 9.80665);
//! let sensors = Sensors::of(&Unit::paper(), rate_hz, gravity_mps2);
//! let limits = Limits::paper();
//! let search = Search { goal: Goal::MostIn { duration_s: 60.0 }, seed: 1, proposals: 500 };
//! let found = optimal(&sensors, &limits, &search)?;
//! assert!(found.program.duration_s() <= 60.0);
//! # Ok::<(), imucal::error::Error>(())
//! ```

mod goal;
mod information_filter;
mod limits;
mod predict;
mod propagation;
mod search;
mod sensors;
mod trial;

pub use goal::Goal;
pub use limits::{Axis, Limits, Zone};
pub use predict::{Prediction, predict};
pub use search::{Found, Search, optimal};
pub use sensors::Sensors;

/// Number of angles that describe the direction of gravity. In the row of derivatives of a measurement, the derivatives
/// with respect to these angles come first, and those with respect to the parameters follow.
pub(crate) const DIRECTION: usize = 2;
