//! A unit turned by hand: rests in random poses, and between them turns that carry it along.
//!
//! ```text
//! R_wb(t) = R_k exp(turn s(u)) exp(sway b(u)) R_tremor(t)       u = (t - end of rest k) / move_s
//! x(t)    = x_k + (x_(k+1) - x_k) s(u)
//! ```
//!
//! s goes from 0 to 1, b from 0 to 1 and back, both with three derivatives that are zero at the ends, so that a rest is
//! exactly still. No hand turns about a fixed axis: the sway makes the axis wander. The tremor is a sum of sines about each
//! axis; it goes on all the time, and with it no rest is still.

use std::f64::consts::TAU;

use imucal_core::so3;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::attitude::Attitude;
use super::motion::Moment;
use super::profile::Course;
use super::stream::Stream;
use crate::error::Error;

/// Standard deviation of the sway's rotation vector per axis, rad.
const SWAY_RAD: f64 = 0.3;
/// A hand sways slowly and trembles at about 9 Hz: bands of frequency, Hz, and the share of the variance in each.
const TREMOR: [(f64, f64, f64); 3] = [(0.3, 0.8, 0.6), (1.5, 4.0, 0.3), (8.0, 11.0, 0.1)];

/// How a unit is turned by hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandMoves {
    /// How many poses.
    pub poses: usize,
    /// How long each pose is held, s.
    pub hold_s: f64,
    /// How long each move takes, s.
    pub move_s: f64,
    /// Standard deviation of the tremor about each axis, rad; 0 holds still.
    pub tremor_rad: f64,
    /// The poses are anywhere in a cube of this edge, m; 0 turns on the spot.
    pub translation_m: f64,
}

impl Default for HandMoves {
    fn default() -> Self {
        Self { poses: 40, hold_s: 4.0, move_s: 2.0, tremor_rad: 0.0, translation_m: 0.1 }
    }
}

/// A run by hand. It starts and ends with a rest.
#[derive(Clone, Debug, PartialEq)]
pub struct Tumble {
    moves: HandMoves,
    poses: Vec<Pose>,
    /// The sines about each axis.
    tremor: [[Sine; TREMOR.len()]; 3],
}

/// A pose, and the move from it to the next.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Pose {
    rotation: UnitQuaternion<f64>,
    turn_rad: Vector3<f64>,
    sway_rad: Vector3<f64>,
    carry_m: Vector3<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Sine {
    amplitude_rad: f64,
    frequency_radps: f64,
    phase_rad: f64,
}

impl Tumble {
    /// Random poses, uniform over all attitudes. The same seed gives the same run.
    ///
    /// # Errors
    /// [`Error::Input`] if there is no pose, a time is not positive, or tremor or translation is negative.
    pub fn random(moves: &HandMoves, seed: u64) -> Result<Self, Error> {
        check(moves)?;
        let mut generator = Stream::Tumble.generator(seed);
        let places: Vec<(UnitQuaternion<f64>, Vector3<f64>)> =
            (0..moves.poses).map(|_| (attitude(&mut generator), place(&mut generator) * moves.translation_m)).collect();
        let poses = (0..moves.poses).map(|k| {
            let (rotation, place_m) = places[k];
            // The last pose has no move after it.
            let (next_rotation, next_place_m) = places[(k + 1).min(moves.poses - 1)];
            Pose {
                rotation,
                turn_rad: so3::log(&(rotation.inverse() * next_rotation)),
                sway_rad: normals(&mut generator) * SWAY_RAD,
                carry_m: next_place_m - place_m,
            }
        });
        let poses = poses.collect();
        let tremor = [(); 3].map(|()| TREMOR.map(|band| sine(band, moves.tremor_rad, &mut generator)));
        Ok(Self { moves: *moves, poses, tremor })
    }

    /// How long it takes, s.
    pub fn duration_s(&self) -> f64 {
        self.rest_end_s(self.poses.len() - 1)
    }

    /// Start and end of each rest, s.
    pub fn rests(&self) -> Vec<(f64, f64)> {
        (0..self.poses.len()).map(|k| (self.rest_start_s(k), self.rest_end_s(k))).collect()
    }

    pub(super) fn moment(&self, time_s: f64) -> Moment {
        let (mut attitude, acceleration) = self.carried(time_s);
        if self.moves.tremor_rad > 0.0 {
            attitude = attitude.then(&Attitude::small(&self.tremor(time_s)));
        }
        Moment {
            rotation_world_from_body: attitude.rotation,
            angular_rate: attitude.rate,
            angular_acceleration: attitude.acceleration,
            acceleration,
            stand: None,
        }
    }

    pub(super) fn still_until(&self, time_s: f64) -> Option<f64> {
        let (k, move_share) = self.place_in_time(time_s);
        if move_share.is_some() || self.moves.tremor_rad > 0.0 {
            return None;
        }
        Some(if k + 1 < self.poses.len() { self.rest_end_s(k) } else { f64::INFINITY })
    }

    /// Attitude and acceleration without the tremor.
    fn carried(&self, time_s: f64) -> (Attitude, Vector3<f64>) {
        let (k, move_share) = self.place_in_time(time_s);
        let pose = &self.poses[k];
        let start = Attitude::fixed(pose.rotation);
        let Some(share) = move_share else {
            return (start, Vector3::zeros());
        };
        let step = Course::smooth_step(share).in_time(self.moves.move_s);
        let swell = Course::swell(share).in_time(self.moves.move_s);
        let turned = start.then(&Attitude::along(&pose.turn_rad, step)).then(&Attitude::along(&pose.sway_rad, swell));
        (turned, pose.carry_m * step.acceleration)
    }

    /// The number of the last pose, and the share of the move away from it unless it is held.
    fn place_in_time(&self, time_s: f64) -> (usize, Option<f64>) {
        let last = self.poses.len() - 1;
        let k = ((time_s / (self.moves.hold_s + self.moves.move_s)).max(0.0) as usize).min(last);
        let share = (time_s - self.rest_end_s(k)) / self.moves.move_s;
        (k, (k < last && share > 0.0).then_some(share.min(1.0)))
    }

    fn rest_start_s(&self, k: usize) -> f64 {
        k as f64 * (self.moves.hold_s + self.moves.move_s)
    }

    fn rest_end_s(&self, k: usize) -> f64 {
        self.rest_start_s(k) + self.moves.hold_s
    }

    fn tremor(&self, time_s: f64) -> [Course; 3] {
        self.tremor.map(|sines| {
            let parts =
                sines.map(|sine| Course::sine(sine.frequency_radps, sine.phase_rad, time_s) * sine.amplitude_rad);
            parts.into_iter().sum()
        })
    }
}

/// Uniform over all attitudes: four normal numbers point in any direction of quaternions alike.
fn attitude(generator: &mut ChaCha8Rng) -> UnitQuaternion<f64> {
    let [w, x, y, z] = [(); 4].map(|()| generator.sample::<f64, _>(StandardNormal));
    UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z))
}

/// In a cube of edge 1.
fn place(generator: &mut ChaCha8Rng) -> Vector3<f64> {
    [(); 3].map(|()| generator.random_range(-0.5..0.5)).into()
}

fn normals(generator: &mut ChaCha8Rng) -> Vector3<f64> {
    [(); 3].map(|()| generator.sample::<f64, _>(StandardNormal)).into()
}

/// A sine of the band whose variance is the band's share of the tremor's.
fn sine((low_hz, high_hz, share): (f64, f64, f64), tremor_rad: f64, generator: &mut ChaCha8Rng) -> Sine {
    Sine {
        amplitude_rad: tremor_rad * (2.0 * share).sqrt(),
        frequency_radps: TAU * generator.random_range(low_hz..high_hz),
        phase_rad: generator.random_range(0.0..TAU),
    }
}

fn check(moves: &HandMoves) -> Result<(), Error> {
    let input = |message: String| Err(Error::Input(format!("run by hand: {message}")));
    if moves.poses == 0 {
        return input("poses is 0: one or more is needed".to_owned());
    }
    for (name, value) in [("hold_s", moves.hold_s), ("move_s", moves.move_s)] {
        if !(value.is_finite() && value > 0.0) {
            return input(format!("{name} is {value}: a positive time is needed"));
        }
    }
    for (name, value) in [("tremor_rad", moves.tremor_rad), ("translation_m", moves.translation_m)] {
        if !(value.is_finite() && value >= 0.0) {
            return input(format!("{name} is {value}: zero or more is needed"));
        }
    }
    Ok(())
}
