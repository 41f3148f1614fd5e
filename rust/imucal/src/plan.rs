//! Planning a motion: what a program will determine, and the program that determines most (model.md (33)).
//!
//! * [`Sensors`]: what the unit makes of a motion, and its white noise.
//! * [`predict()`]: standard deviation of every parameter after any [`Motion`](crate::simulate::Motion), from the model alone.
//! * [`Limits`]: how far, how fast and where to the motors may turn.
//! * [`optimal()`]: the program with the most information in a given time, or the shortest one that reaches given standard
//!   deviations.
//!
//! The information is that of the joint fit: the force at rests, the rate at rests, and gravity carried from rest to rest, with the
//! direction at each rest unknown. It is summed up along the run, so a run of any length costs a pass over it and no large matrix.
//!
//! ```
//! use imucal::plan::{Goal, Limits, Search, Sensors, optimal};
//! use imucal::simulate::Unit;
//!
//! let sensors = Sensors::of(&Unit::paper(), 200.0, 9.80665);
//! let limits = Limits::paper();
//! let search = Search { goal: Goal::MostIn { duration_s: 60.0 }, seed: 1, proposals: 500 };
//! let found = optimal(&sensors, &limits, &search)?;
//! assert!(found.program.duration_s() <= 60.0);
//! # Ok::<(), imucal::error::Error>(())
//! ```

mod chain;
mod goal;
mod leg;
mod limits;
mod predict;
mod search;
mod sensors;
mod trial;

pub use goal::Goal;
pub use limits::{Axis, Limits, Zone};
pub use predict::{Prediction, predict};
pub use search::{Found, Search, optimal};
pub use sensors::Sensors;

/// The direction of gravity: two angles, which come before the parameters in every row.
pub(crate) const DIRECTION: usize = 2;
