//! Searches for the best program by simulated annealing. A proposal is a copy of the current program with one change: a
//! pose is changed, added or removed, a full revolution is added to a turn of one motor or subtracted from it, or holds
//! get other durations.
//!
//! A better program is always accepted. A slightly worse program is accepted with a probability that decreases during
//! the search. The search can thus reach better programs that differ from the current program in several poses.

use std::f64::consts::{PI, TAU};

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::goal::Goal;
use super::limits::Limits;
use super::sensors::Sensors;
use super::trial::{Scene, Trial};
use crate::cancellation::checkpoint;
use crate::error::Error;
use crate::plan::limits::FEWEST_POSES;
use crate::simulate::Program;

/// Numbers of poses of the four random programs from which the search starts. A number below [`FEWEST_POSES`] is
/// replaced by [`FEWEST_POSES`]. The search can add and remove poses.
const STARTS: [usize; 4] = [8, 16, 32, 64];
/// The search first starts from each of the four random programs, each time with 1 / `SHARE_OF_START` of all proposals.
/// It then continues from the best of the four results with the remaining proposals.
const SHARE_OF_START: usize = 16;
/// Annealing temperature at the start of the search. The cost of a program is a logarithm, so the temperature has no
/// unit. An increase of the cost by this temperature is accepted with a probability of about one third.
const WARM: f64 = 0.006;
/// Annealing temperature at the end of the search. At this temperature, an increase of the cost by 0.001 is practically
/// never accepted.
const COLD: f64 = 0.00006;
/// Maximum number of random poses that are tried to find a pose that the stand can reach.
const ATTEMPTS: usize = 200;
/// Number of bisection steps in the search for the shortest holds with which a program reaches the goal.
const HALVINGS: usize = 30;

/// Goal, random seed and length of a search.
#[derive(Clone, Debug, PartialEq)]
pub struct Search {
    /// Goal for which the program is optimised.
    pub goal: Goal,
    /// Seed of the random numbers. The same seed gives the same program.
    pub seed: u64,
    /// Number of proposals (changed programs that are tried) in the whole search.
    pub proposals: usize,
}

/// Result of a search.
#[derive(Clone, Debug, PartialEq)]
pub struct Found {
    /// The best program found. It starts with all motors at the angle zero.
    pub program: Program,
    /// Whether the program reaches the target standard deviations of the goal. It is always true for a goal without
    /// targets.
    pub reached: bool,
}

/// Finds the best program for these sensors on this stand.
///
/// # Errors
/// [`Error::Input`] for invalid limits or an invalid goal; [`Error::NotEnoughMotion`] if no program was found that the
/// stand can run in the given time.
pub fn optimal(sensors: &Sensors, limits: &Limits, search: &Search) -> Result<Found, Error> {
    limits.check()?;
    check(&search.goal, sensors)?;
    let scene = Scene { sensors, limits, goal: &search.goal, prior: sensors.prior_precision() };
    let mut annealing = Annealing { scene: &scene, random: ChaCha8Rng::seed_from_u64(search.seed) };
    let each = search.proposals / SHARE_OF_START;
    let mut starts: Vec<Trial> = Vec::new();
    for poses in STARTS {
        if let Some(start) = annealing.start(poses.min(limits.most_moves.saturating_add(1))) {
            starts.push(annealing.anneal(start, each, (WARM, WARM / 4.0)));
        }
    }
    let Some(best) = starts.into_iter().min_by(|a, b| a.cost.total_cmp(&b.cost)) else {
        return Err(Error::NotEnoughMotion(format!(
            "no program was found that the stand can run: a program needs {FEWEST_POSES} rests of {:.2} s with turns between them: \
             give more time, wider ranges or smaller forbidden zones",
            scene.shortest_hold_s()
        )));
    };
    let best = annealing.anneal(best, search.proposals.saturating_sub(STARTS.len() * each), (WARM / 2.0, COLD));
    match search.goal {
        Goal::MostIn { .. } => Ok(Found { program: best.program(false)?, reached: true }),
        Goal::ShortestTo { .. } => {
            let (best, reached) = annealing.just_enough(best);
            Ok(Found { program: best.program(true)?, reached })
        }
    }
}

fn check(goal: &Goal, sensors: &Sensors) -> Result<(), Error> {
    match goal {
        Goal::MostIn { duration_s } if *duration_s > 0.0 && duration_s.is_finite() => Ok(()),
        Goal::MostIn { duration_s } => {
            Err(Error::Input(format!("the duration of the program is {duration_s} s: give a positive time")))
        }
        Goal::ShortestTo { sigma } if sigma.len() != sensors.parameters() => Err(Error::Input(format!(
            "sigma has {} numbers for {} parameters: give one number per parameter",
            sigma.len(),
            sensors.parameters()
        ))),
        Goal::ShortestTo { sigma } if sigma.iter().any(|sigma| sigma.is_nan() || *sigma <= 0.0) => Err(Error::Input(
            "sigma has a number that is not positive: give infinity for parameters without a target".into(),
        )),
        Goal::ShortestTo { sigma } if sigma.iter().all(|sigma| sigma.is_infinite()) => {
            Err(Error::Input("sigma has no target: give a finite number for at least one parameter".into()))
        }
        Goal::ShortestTo { .. } => Ok(()),
    }
}

struct Annealing<'a> {
    scene: &'a Scene<'a>,
    random: ChaCha8Rng,
}

impl Annealing<'_> {
    /// Creates a program with `poses` random poses, but at least [`FEWEST_POSES`]. If the given time is too short for
    /// so many poses, the program has fewer poses. `None` if the stand cannot run a program with [`FEWEST_POSES`].
    fn start(&mut self, poses: usize) -> Option<Trial> {
        let mut count = poses.max(FEWEST_POSES);
        loop {
            checkpoint();
            let mut all = vec![Vector3::zeros()];
            while all.len() < count {
                let next = self.next_pose(&all[all.len() - 1])?;
                all.push(next);
            }
            let holds = vec![1.5 * self.scene.shortest_hold_s(); count];
            if let Some(trial) = self.scene.trial(all, holds) {
                return Some(trial);
            }
            if count == FEWEST_POSES {
                return None;
            }
            count = (count - 1).max(FEWEST_POSES);
        }
    }

    /// A random pose that the stand can reach from a given pose.
    fn next_pose(&mut self, from: &Vector3<f64>) -> Option<Vector3<f64>> {
        let limits = self.scene.limits;
        (0..ATTEMPTS).find_map(|_| {
            let to = Vector3::from_fn(|motor, _| {
                let angle = match limits.axes[motor].and_then(|axis| axis.range_rad) {
                    Some([low, high]) if high - low < TAU => self.random.random_range(low..high),
                    _ => from[motor] + self.random.random_range(-TAU..TAU) * 0.8,
                };
                limits.nearest(motor, angle)
            });
            ((to - from).amax() > 0.2 && limits.allow(from, &to)).then_some(to)
        })
    }

    fn anneal(&mut self, start: Trial, proposals: usize, (warm, cold): (f64, f64)) -> Trial {
        let (mut here, mut best) = (start.clone(), start);
        for k in 0..proposals {
            checkpoint();
            let temperature = warm * (cold / warm).powf(k as f64 / proposals as f64);
            let Some(there) = self.propose(&here) else { continue };
            let worse = there.cost - here.cost;
            if worse <= 0.0 || self.random.random_range(0.0..1.0) < (-worse / temperature).exp() {
                here = there;
                if here.cost < best.cost {
                    best = here.clone();
                }
            }
        }
        best
    }

    /// A copy of `trial` with one random change; `None` if the stand cannot run the changed program.
    fn propose(&mut self, trial: &Trial) -> Option<Trial> {
        let count = trial.poses.len();
        // The first pose is the start position of the motors, so it is not changed.
        let k = self.random.random_range(1..count);
        match self.random.random_range(0..100) {
            0..40 => {
                let size = [3_f64, 12.0, 45.0][self.random.random_range(0..3)].to_radians();
                let moved = Vector3::from_fn(|motor, _| trial.poses[k][motor] + size * self.normal());
                self.scene.with_pose(trial, k, self.snapped(&moved))
            }
            40..47 => {
                let pose = self.next_pose(&trial.poses[k - 1])?;
                self.scene.with_pose(trial, k, pose)
            }
            47..55 => {
                // The turn of one motor to pose k changes by a full revolution. The motor can then, for example, turn
                // in the other direction. The angle of this motor in pose k and in all following poses changes by the
                // full revolution, so the attitudes of the unit in the poses stay the same.
                let (motor, turn) =
                    (self.random.random_range(0..3), if self.random.random::<bool>() { TAU } else { -TAU });
                let mut poses = trial.poses.clone();
                for pose in &mut poses[k..] {
                    pose[motor] += turn;
                    if (self.scene.limits.nearest(motor, pose[motor]) - pose[motor]).abs() > 1e-9 {
                        return None;
                    }
                }
                self.scene.trial(poses, trial.holds_s.clone())
            }
            55..80 => {
                let mut holds = trial.holds_s.clone();
                let j = self.random.random_range(0..count);
                holds[j] = (holds[j] * (0.4 * self.normal()).exp()).max(self.scene.shortest_hold_s());
                self.scene.with_holds(trial, holds)
            }
            80..86 => {
                let factor = (0.1 * self.normal()).exp();
                let shortest = self.scene.shortest_hold_s();
                let holds = trial.holds_s.iter().map(|hold| (hold * factor).max(shortest)).collect();
                self.scene.with_holds(trial, holds)
            }
            86..93 if count <= self.scene.limits.most_moves => {
                let pose = self.next_pose(&trial.poses[k - 1])?;
                let (mut poses, mut holds) = (trial.poses.clone(), trial.holds_s.clone());
                poses.insert(k, pose);
                holds.insert(k, self.scene.shortest_hold_s());
                self.scene.trial(poses, holds)
            }
            _ if count > FEWEST_POSES => {
                let (mut poses, mut holds) = (trial.poses.clone(), trial.holds_s.clone());
                poses.remove(k);
                holds.remove(k);
                self.scene.trial(poses, holds)
            }
            _ => None,
        }
    }

    /// Multiplies the durations of all holds by the smallest common factor with which the program reaches the goal. A
    /// hold does not become shorter than its minimum duration. Returns the program and whether it reaches the goal.
    fn just_enough(&self, trial: Trial) -> (Trial, bool) {
        let scene = self.scene;
        let shortest = scene.shortest_hold_s();
        let with = |factor: f64| {
            let holds = trial.holds_s.iter().map(|hold| (hold * factor).max(shortest)).collect();
            let scaled = scene.with_holds(&trial, holds)?;
            let worst = scene.goal.worst(&scaled.information(scene), &scene.prior)?;
            Some((scaled, worst))
        };
        // Holds are extended by at most a factor of ten. If a program would need longer holds, additional poses are
        // more efficient than longer holds.
        let (mut low, mut high) = (0.1_f64, 10.0_f64);
        match with(high) {
            Some((_, worst)) if worst <= 1.0 => {}
            _ => return (trial, false),
        }
        for _ in 0..HALVINGS {
            checkpoint();
            let middle = (low * high).sqrt();
            if with(middle).is_some_and(|(_, worst)| worst <= 1.0) { high = middle } else { low = middle }
        }
        with(high).map_or((trial.clone(), false), |(found, _)| (found, true))
    }

    fn snapped(&self, pose: &Vector3<f64>) -> Vector3<f64> {
        Vector3::from_fn(|motor, _| self.scene.limits.nearest(motor, pose[motor]))
    }

    fn normal(&mut self) -> f64 {
        // The random number is limited to at most pi in magnitude, so that no change of the program is very large.
        self.random.sample::<f64, _>(StandardNormal).clamp(-PI, PI)
    }
}
