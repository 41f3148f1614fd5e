//! A hand-held run: rests in random poses, and moves with rotation and translation between them.
//!
//! ```text
//! R_wb(t) = R_k exp(turn * s(u)) exp(sway * b(u)) R_tremor(t)       u = (t - end of rest k) / move_s
//! x(t)    = x_k + (x_(k+1) - x_k) s(u)
//! ```
//!
//! R_wb and x are the attitude and the position of the unit. R_k and x_k are the attitude and the position at rest k.
//! `turn` is the rotation vector from the attitude at rest k to the attitude at rest k + 1. `sway` is a random rotation
//! vector. u increases from 0 to 1 during the move after rest k.
//!
//! s increases from 0 to 1 during the move, and b increases from 0 to 1 and returns to 0. The first three derivatives
//! of s and b are zero at both ends of the move, so both are smooth at the start and end of rests. The sway varies the
//! axis of rotation during a move, because a hand does not rotate a unit about a fixed axis. R_tremor is the rotation
//! by the tremor, which is a sum of sines about each axis. During rests, the tremor is the only motion of the unit.

use imucal_core::so3;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::attitude::Attitude;
use super::moment::Moment;
use super::profile::Course;
use super::stream::Stream;
use super::tremor::Tremor;
use crate::error::Error;

/// Standard deviation of each component of the sway's rotation vector, rad. It is large enough to vary the axis of
/// rotation noticeably during a move.
const SWAY_RAD: f64 = 0.3;

/// Parameters of a hand-held run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandMoves {
    /// Number of poses.
    pub poses: usize,
    /// Duration of the rest in each pose, s.
    pub hold_s: f64,
    /// Duration of each move, s.
    pub move_s: f64,
    /// Standard deviation of the tremor about each axis, rad; 0 for no tremor.
    pub tremor_rad: f64,
    /// Edge length of the cube in which positions are uniformly distributed, m; 0 for motion without translation.
    pub translation_m: f64,
}

impl Default for HandMoves {
    fn default() -> Self {
        Self { poses: 40, hold_s: 4.0, move_s: 2.0, tremor_rad: 0.0, translation_m: 0.1 }
    }
}

/// A hand-held run. It starts and ends with a rest.
#[derive(Clone, Debug, PartialEq)]
pub struct Tumble {
    moves: HandMoves,
    poses: Vec<Pose>,
    tremor: Tremor,
}

/// Attitude of a pose, and the move from this pose to the next pose.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Pose {
    rotation: UnitQuaternion<f64>,
    turn_rad: Vector3<f64>,
    sway_rad: Vector3<f64>,
    carry_m: Vector3<f64>,
}

impl Tumble {
    /// Creates a run with random poses, uniformly distributed over all attitudes. The same seed always gives the same
    /// run.
    ///
    /// # Errors
    /// [`Error::Input`] if there is no pose, a time is not positive, or the tremor or the translation is negative.
    pub fn random(moves: &HandMoves, seed: u64) -> Result<Self, Error> {
        check(moves)?;
        let mut generator = Stream::Tumble.generator(seed);
        let places: Vec<(UnitQuaternion<f64>, Vector3<f64>)> =
            (0..moves.poses).map(|_| (attitude(&mut generator), place(&mut generator) * moves.translation_m)).collect();
        let poses = (0..moves.poses).map(|k| {
            let (rotation, place_m) = places[k];
            // No move follows the last pose. The move that is stored with it therefore leads from this pose to itself.
            let (next_rotation, next_place_m) = places[(k + 1).min(moves.poses - 1)];
            Pose {
                rotation,
                turn_rad: so3::log(&(rotation.inverse() * next_rotation)),
                sway_rad: normals(&mut generator) * SWAY_RAD,
                carry_m: next_place_m - place_m,
            }
        });
        let poses = poses.collect();
        let tremor = Tremor::drawn(moves.tremor_rad, &mut generator);
        Ok(Self { moves: *moves, poses, tremor })
    }

    /// Duration of the run, s.
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
            attitude = attitude.then(&self.tremor.attitude(time_s));
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

    /// Computes attitude and acceleration without the tremor.
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

    /// Index of the last pose that the unit has reached, and the elapsed share of the duration of the move to the next
    /// pose. The share is `None` during a rest.
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
}

/// Draws a random attitude, uniformly distributed over all attitudes. A normalised vector of four independent standard
/// normal numbers is a unit quaternion that is uniformly distributed on the unit sphere.
fn attitude(generator: &mut ChaCha8Rng) -> UnitQuaternion<f64> {
    let [w, x, y, z] = [(); 4].map(|()| generator.sample::<f64, _>(StandardNormal));
    UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z))
}

/// A random point in a cube of edge length 1.
fn place(generator: &mut ChaCha8Rng) -> Vector3<f64> {
    [(); 3].map(|()| generator.random_range(-0.5..0.5)).into()
}

fn normals(generator: &mut ChaCha8Rng) -> Vector3<f64> {
    [(); 3].map(|()| generator.sample::<f64, _>(StandardNormal)).into()
}

fn check(moves: &HandMoves) -> Result<(), Error> {
    let input = |message: String| Err(Error::Input(format!("run by hand: {message}")));
    if moves.poses == 0 {
        return input("poses is 0: give at least one".to_owned());
    }
    for (name, value) in [("hold_s", moves.hold_s), ("move_s", moves.move_s)] {
        if !(value.is_finite() && value > 0.0) {
            return input(format!("{name} is {value}: give a positive time"));
        }
    }
    for (name, value) in [("tremor_rad", moves.tremor_rad), ("translation_m", moves.translation_m)] {
        if !(value.is_finite() && value >= 0.0) {
            return input(format!("{name} is {value}: give zero or a positive value"));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tumble(moves: &HandMoves) -> Tumble {
        Tumble::random(moves, 5).unwrap()
    }

    #[test]
    fn a_run_is_rests_of_equal_length_with_moves_between_them() {
        let run = tumble(&HandMoves::default());
        assert_eq!(run.duration_s(), 40.0 * 4.0 + 39.0 * 2.0);
        let rests = run.rests();
        assert_eq!((rests.len(), rests[0], rests[1]), (40, (0.0, 4.0), (6.0, 10.0)));
        assert_eq!(run, tumble(&HandMoves::default()));
        assert_ne!(run, Tumble::random(&HandMoves::default(), 6).unwrap());
        assert_eq!(tumble(&HandMoves { poses: 1, ..HandMoves::default() }).rests(), vec![(0.0, 4.0)]);
    }

    #[test]
    fn poses_are_uniform_over_all_attitudes() {
        let run = tumble(&HandMoves { poses: 3000, ..HandMoves::default() });
        // The mean of a uniformly distributed unit vector v is zero, and the mean of v v^T is I / 3.
        let n = run.poses.len() as f64;
        for axis in [Vector3::x(), Vector3::y(), Vector3::z()] {
            let seen: Vec<Vector3<f64>> = run.poses.iter().map(|pose| pose.rotation * axis).collect();
            let mean = seen.iter().sum::<Vector3<f64>>() / n;
            assert!(mean.amax() < 5.0 / (3.0 * n).sqrt(), "{mean:?}");
            for i in 0..3 {
                let square = seen.iter().map(|v| v[i] * v[i]).sum::<f64>() / n;
                assert!((square - 1.0 / 3.0).abs() < 5.0 * (4.0 / 45.0 / n).sqrt(), "{square}");
            }
        }
    }

    #[test]
    fn a_move_ends_where_the_next_rest_begins() {
        let run = tumble(&HandMoves { poses: 8, ..HandMoves::default() });
        for (start, _) in run.rests().into_iter().skip(1) {
            let (before, after) = (run.moment(start - 1e-5), run.moment(start));
            let apart = before.rotation_world_from_body.angle_to(&after.rotation_world_from_body);
            assert!(apart < 1e-14, "{apart} rad");
            assert!(before.angular_rate.norm() < 1e-10 && before.acceleration.norm() < 1e-8);
        }
    }

    #[test]
    fn a_move_carries_the_unit_to_the_next_place_and_leaves_it_there() {
        let moves = HandMoves { poses: 2, translation_m: 0.2, ..HandMoves::default() };
        let run = tumble(&moves);
        let (count, step_s) = (20_000, 1e-4);
        let (mut velocity, mut place) = (Vector3::zeros(), Vector3::zeros());
        for i in 0..count {
            let acceleration = run.moment(moves.hold_s + (f64::from(i) + 0.5) * step_s).acceleration;
            place += velocity * step_s + acceleration * (step_s * step_s / 2.0);
            velocity += acceleration * step_s;
        }
        assert!(velocity.norm() < 1e-12, "{velocity:?}");
        assert!((place - run.poses[0].carry_m).norm() < 1e-8, "{place:?}");
        assert!(run.poses[0].carry_m.amax() < 0.2);
        let on_the_spot = tumble(&HandMoves { translation_m: 0.0, ..moves });
        assert_eq!(on_the_spot.moment(5.0).acceleration, Vector3::zeros());
    }

    /// The direction of the rate must vary during a move. With a fixed axis of rotation, it would be constant.
    #[test]
    fn the_axis_wanders_during_a_move() {
        let run = tumble(&HandMoves { poses: 10, ..HandMoves::default() });
        let wander = |(_, start): (f64, f64)| {
            let rate = |share: f64| run.moment(start + 2.0 * share).angular_rate;
            rate(0.15).angle(&rate(0.85))
        };
        let rests = run.rests();
        assert!(rests[..9].iter().all(|rest| wander(*rest) > 0.01));
    }

    #[test]
    fn tremor_has_the_stated_size() {
        let tremor_rad = 2e-3;
        let (trembling, calm) =
            (tumble(&HandMoves { tremor_rad, ..HandMoves::default() }), tumble(&HandMoves::default()));
        let times: Vec<f64> = (0..23_000).map(|i| f64::from(i) * 0.01).collect();
        let vectors = times.iter().map(|&t| {
            let (still, shaken) = (calm.moment(t), trembling.moment(t));
            so3::log(&(still.rotation_world_from_body.inverse() * shaken.rotation_world_from_body))
        });
        let squares: Vector3<f64> = vectors.map(|v| v.component_mul(&v)).sum::<Vector3<f64>>() / times.len() as f64;
        for square in &squares {
            assert!((square.sqrt() / tremor_rad - 1.0).abs() < 0.02, "{} rad", square.sqrt());
        }
    }

    #[test]
    fn runs_that_cannot_be_are_refused() {
        let good = HandMoves::default();
        let bad = [
            HandMoves { poses: 0, ..good },
            HandMoves { hold_s: 0.0, ..good },
            HandMoves { move_s: f64::NAN, ..good },
            HandMoves { tremor_rad: -1.0, ..good },
            HandMoves { translation_m: f64::INFINITY, ..good },
        ];
        for moves in bad {
            assert!(matches!(Tumble::random(&moves, 1), Err(Error::Input(_))), "{moves:?}");
        }
    }
}
