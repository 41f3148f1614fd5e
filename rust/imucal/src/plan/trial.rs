//! A program on trial, in pieces: a change costs what it changes.

use std::rc::Rc;

use nalgebra::Vector3;

use super::chain::Chain;
use super::goal::Goal;
use super::leg::{EDGE_S, Leg, Still};
use super::limits::{Limits, TICK_S, whole_ticks};
use super::sensors::Sensors;
use crate::error::Error;
use crate::simulate::profile::MotorState;
use crate::simulate::{Moment, Program, Step};

/// No motor turns less between two poses than this, rad: they would show the same.
const LEAST_TURN_RAD: f64 = 0.17;
/// A planned rest is longer than the shortest that is found by this: detection works in blocks.
const SPARE_S: f64 = 0.2;
/// Moments at which the rate of a move is looked at.
const LOOKS: usize = 24;

/// What all trials have in common.
pub(super) struct Scene<'a> {
    pub(super) sensors: &'a Sensors,
    pub(super) limits: &'a Limits,
    pub(super) goal: &'a Goal,
    pub(super) before: Vec<f64>,
}

/// Poses, how long each is held, and what lies between.
#[derive(Clone)]
pub(super) struct Trial {
    pub(super) poses: Vec<Vector3<f64>>,
    pub(super) holds_s: Vec<f64>,
    moves_s: Vec<f64>,
    stills: Vec<Rc<Still>>,
    legs: Vec<Rc<Leg>>,
    pub(super) cost: f64,
}

impl Scene<'_> {
    /// Shortest hold, s.
    pub(super) fn shortest_hold_s(&self) -> f64 {
        whole_ticks(self.limits.settle_s + self.limits.min_rest_s + 2.0 * EDGE_S + SPARE_S)
    }

    /// A program of these poses; `None` if the stand cannot run it.
    pub(super) fn trial(&self, poses: Vec<Vector3<f64>>, holds_s: Vec<f64>) -> Option<Trial> {
        let mut trial =
            Trial { moves_s: Vec::new(), stills: Vec::new(), legs: Vec::new(), poses, holds_s, cost: f64::INFINITY };
        for k in 0..trial.poses.len() {
            trial.stills.push(self.still(&trial.poses[k], 0.0));
            if k > 0 {
                let (move_s, leg) = self.leg(&trial.poses[k - 1], &trial.poses[k], 0.0)?;
                trial.moves_s.push(move_s);
                trial.legs.push(leg);
            }
        }
        self.judged(trial)
    }

    /// The same with pose `k` elsewhere; `None` if the stand cannot go there.
    pub(super) fn with_pose(&self, trial: &Trial, k: usize, pose: Vector3<f64>) -> Option<Trial> {
        let mut changed = trial.clone();
        changed.poses[k] = pose;
        changed.stills[k] = self.still(&pose, 0.0);
        for leg in k.saturating_sub(1)..(k + 1).min(changed.legs.len()) {
            (changed.moves_s[leg], changed.legs[leg]) = self.leg(&changed.poses[leg], &changed.poses[leg + 1], 0.0)?;
        }
        self.judged(changed)
    }

    /// The same with other holds.
    pub(super) fn with_holds(&self, trial: &Trial, holds_s: Vec<f64>) -> Option<Trial> {
        self.judged(Trial { holds_s, ..trial.clone() })
    }

    fn still(&self, pose: &Vector3<f64>, time_s: f64) -> Rc<Still> {
        let moment = Moment::on_perfect_stand(&MotorState::still(*pose));
        Rc::new(Still::new(self.sensors, &moment, time_s, self.limits.in_hand))
    }

    /// The fastest way from pose to pose, `None` if there is none.
    fn leg(&self, from: &Vector3<f64>, to: &Vector3<f64>, start_s: f64) -> Option<(f64, Rc<Leg>)> {
        let turn = to - from;
        if turn.amax() < LEAST_TURN_RAD || !self.limits.allow(from, to) {
            return None;
        }
        let mut move_s = self.limits.fastest_s(&turn);
        let look = |k: usize| {
            let share = (k as f64 + 0.5) / LOOKS as f64;
            self.sensors.too_fast(&moment(from, &turn, move_s, share * move_s).angular_rate)
        };
        // All rates are in proportion to one over the time.
        move_s = whole_ticks(move_s * (0..LOOKS).map(look).fold(1.0, f64::max));
        let at = |time_s: f64| moment(from, &turn, move_s, time_s - start_s);
        Some((move_s, Rc::new(Leg::new(self.sensors, start_s, move_s, self.limits.settle_s, at))))
    }

    /// The trial with its cost; `None` if it takes too long or shows nothing.
    fn judged(&self, mut trial: Trial) -> Option<Trial> {
        if let Goal::MostIn { duration_s } = self.goal {
            trial.fill(*duration_s, self.shortest_hold_s())?;
        }
        if self.sensors.depend_on_time() {
            self.in_time(&mut trial)?;
        }
        let information = trial.information(self);
        trial.cost = self.goal.cost(&information, &self.before, trial.duration_s())?;
        trial.cost.is_finite().then_some(trial)
    }

    /// All pieces anew, at the times at which they are.
    fn in_time(&self, trial: &mut Trial) -> Option<()> {
        let mut time_s = 0.0;
        for k in 0..trial.poses.len() {
            trial.stills[k] = self.still(&trial.poses[k], time_s + trial.holds_s[k] / 2.0);
            time_s += trial.holds_s[k];
            if k + 1 < trial.poses.len() {
                (trial.moves_s[k], trial.legs[k]) = self.leg(&trial.poses[k], &trial.poses[k + 1], time_s)?;
                time_s += trial.moves_s[k];
            }
        }
        Some(())
    }
}

fn moment(from: &Vector3<f64>, turn: &Vector3<f64>, move_s: f64, time_s: f64) -> Moment {
    Moment::on_perfect_stand(&MotorState::turning(*from, *turn, move_s, time_s))
}

impl Trial {
    pub(super) fn duration_s(&self) -> f64 {
        self.holds_s.iter().chain(&self.moves_s).sum()
    }

    /// Shares out what the moves leave of a time among the holds; `None` if it is too little.
    fn fill(&mut self, duration_s: f64, shortest_s: f64) -> Option<()> {
        let count = self.holds_s.len() as f64;
        let spare_s = duration_s - self.moves_s.iter().sum::<f64>() - shortest_s * count;
        if spare_s < 0.0 {
            return None;
        }
        let wished: Vec<f64> = self.holds_s.iter().map(|hold| (hold - shortest_s).max(1e-3)).collect();
        let sum: f64 = wished.iter().sum();
        self.holds_s = wished.iter().map(|hold| shortest_s + hold * spare_s / sum).collect();
        Some(())
    }

    pub(super) fn information(&self, scene: &Scene<'_>) -> faer::Mat<f64> {
        let mut chain = Chain::new(scene.sensors.parameters());
        let last = self.poses.len() - 1;
        for (k, (still, hold_s)) in self.stills.iter().zip(&self.holds_s).enumerate() {
            let edges =
                if k == 0 { 0.0 } else { EDGE_S + scene.limits.settle_s } + if k == last { 0.0 } else { EDGE_S };
            still.see(&mut chain, hold_s - edges);
            if let Some(leg) = self.legs.get(k) {
                leg.go(&mut chain);
            }
        }
        chain.information()
    }

    /// The program, its times in whole ticks: `up` or down.
    pub(super) fn program(&self, up: bool) -> Result<Program, Error> {
        let ticks = |hold_s: f64| if up { whole_ticks(hold_s) } else { (hold_s / TICK_S + 1e-6).floor() * TICK_S };
        let mut steps = vec![Step::hold(ticks(self.holds_s[0]))];
        for (k, move_s) in self.moves_s.iter().enumerate() {
            let turn_rad = (self.poses[k + 1] - self.poses[k]).into();
            steps.push(Step { turn_rad, move_s: *move_s, hold_s: ticks(self.holds_s[k + 1]) });
        }
        Program::try_new(steps)
    }
}
