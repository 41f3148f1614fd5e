//! A trial program: a program whose cost the search computes. The information from each rest and from each move is
//! stored separately. After a change of the program, only the information from the affected rests and moves is computed
//! again.

use std::rc::Rc;

use nalgebra::Vector3;

use super::goal::Goal;
use super::information_filter::InformationFilter;
use super::limits::{Limits, TICK_S, whole_ticks};
use super::propagation::{EDGE_S, MoveInformation, RestInformation};
use super::sensors::Sensors;
use crate::error::Error;
use crate::simulate::profile::MotorState;
use crate::simulate::{Moment, Program, Step};

/// Between two consecutive poses, at least one motor must turn by at least this angle, rad. Two poses that are closer
/// together would give nearly equal measurements.
const LEAST_TURN_RAD: f64 = 0.17;
/// A planned rest is longer than the minimum duration of a rest by this margin, s. The margin is needed because rest
/// detection tests short blocks of samples and finds the ends of a rest only with a resolution of one block.
const SPARE_S: f64 = 0.2;
/// Number of instants during a move at which the rate is compared with the range of the gyroscope.
const RATE_INSTANTS: usize = 24;

/// Inputs of a search, which are the same for all trial programs.
pub(super) struct Scene<'a> {
    pub(super) sensors: &'a Sensors,
    pub(super) limits: &'a Limits,
    pub(super) goal: &'a Goal,
    /// Prior precision (inverse variance) of each parameter.
    pub(super) prior: Vec<f64>,
}

/// A program: the poses, the duration of the hold in each pose, and the information from each rest and from each move.
#[derive(Clone)]
pub(super) struct Trial {
    pub(super) poses: Vec<Vector3<f64>>,
    pub(super) holds_s: Vec<f64>,
    moves_s: Vec<f64>,
    stills: Vec<Rc<RestInformation>>,
    legs: Vec<Rc<MoveInformation>>,
    pub(super) cost: f64,
}

impl Scene<'_> {
    /// Minimum duration of a hold, s.
    pub(super) fn shortest_hold_s(&self) -> f64 {
        whole_ticks(self.limits.settle_s + self.limits.min_rest_s + 2.0 * EDGE_S + SPARE_S)
    }

    /// A program with these poses and hold durations; `None` if the limits forbid a move, if the program is too long,
    /// or if its information matrix is singular.
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
        self.with_cost(trial)
    }

    /// A copy of the program in which `pose` replaces pose `k`; `None` if the limits forbid a move, if the changed
    /// program is too long, or if its information matrix is singular.
    pub(super) fn with_pose(&self, trial: &Trial, k: usize, pose: Vector3<f64>) -> Option<Trial> {
        let mut changed = trial.clone();
        changed.poses[k] = pose;
        changed.stills[k] = self.still(&pose, 0.0);
        for leg in k.saturating_sub(1)..(k + 1).min(changed.legs.len()) {
            (changed.moves_s[leg], changed.legs[leg]) = self.leg(&changed.poses[leg], &changed.poses[leg + 1], 0.0)?;
        }
        self.with_cost(changed)
    }

    /// A copy of the program with the hold durations `holds_s`; `None` if the changed program is too long or its
    /// information matrix is singular.
    pub(super) fn with_holds(&self, trial: &Trial, holds_s: Vec<f64>) -> Option<Trial> {
        self.with_cost(Trial { holds_s, ..trial.clone() })
    }

    fn still(&self, pose: &Vector3<f64>, time_s: f64) -> Rc<RestInformation> {
        let moment = Moment::on_perfect_stand(&MotorState::still(*pose));
        Rc::new(RestInformation::new(self.sensors, &moment, time_s, self.limits.in_hand))
    }

    /// Duration, s, of the fastest move between two poses, and the information from this move; `None` if the limits
    /// forbid the move, or if no motor turns by [`LEAST_TURN_RAD`] or more.
    fn leg(&self, from: &Vector3<f64>, to: &Vector3<f64>, start_s: f64) -> Option<(f64, Rc<MoveInformation>)> {
        let turn = to - from;
        if turn.amax() < LEAST_TURN_RAD || !self.limits.allow(from, to) {
            return None;
        }
        let mut move_s = self.limits.fastest_s(&turn);
        let look = |k: usize| {
            let share = (k as f64 + 0.5) / RATE_INSTANTS as f64;
            self.sensors.too_fast(&moment(from, &turn, move_s, share * move_s).angular_rate)
        };
        // All rates are inversely proportional to the duration of the move. If a rate exceeds the usable range of the
        // gyroscope, the duration is therefore multiplied by largest rate / usable range.
        move_s = whole_ticks(move_s * (0..RATE_INSTANTS).map(look).fold(1.0, f64::max));
        let at = |time_s: f64| moment(from, &turn, move_s, time_s - start_s);
        Some((move_s, Rc::new(MoveInformation::new(self.sensors, start_s, move_s, self.limits.settle_s, at))))
    }

    /// Computes the cost of the program; `None` if the program is too long or its information matrix is singular.
    fn with_cost(&self, mut trial: Trial) -> Option<Trial> {
        if let Goal::MostIn { duration_s } = self.goal {
            trial.fill(*duration_s, self.shortest_hold_s())?;
        }
        if self.sensors.depend_on_time() {
            self.in_time(&mut trial)?;
        }
        let information = trial.information(self);
        trial.cost = self.goal.cost(&information, &self.prior, trial.duration_s())?;
        trial.cost.is_finite().then_some(trial)
    }

    /// Computes the information of all rests and moves again, at the times at which they occur in the program. This
    /// repetition is needed for effects that depend on time.
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

    /// Changes the holds so that the program takes `duration_s`. Each hold takes `shortest_s` plus a share of the
    /// remaining time. The ratios between the shares of the holds do not change. `None` if the time is too short for
    /// the moves and for holds of `shortest_s`.
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
        let mut filter = InformationFilter::new(scene.sensors.parameters());
        let last = self.poses.len() - 1;
        for (k, (still, hold_s)) in self.stills.iter().zip(&self.holds_s).enumerate() {
            let edges =
                if k == 0 { 0.0 } else { EDGE_S + scene.limits.settle_s } + if k == last { 0.0 } else { EDGE_S };
            still.add_to(&mut filter, hold_s - edges, self.poses.len());
            if let Some(leg) = self.legs.get(k) {
                leg.propagate(&mut filter);
            }
        }
        filter.information()
    }

    /// The program with hold durations that are multiples of [`TICK_S`]. The durations are rounded up if `up` is set,
    /// and down otherwise.
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
