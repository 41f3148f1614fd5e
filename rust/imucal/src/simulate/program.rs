//! A program of the stand: a sequence of turns and holds.
//!
//! In every step, each motor turns by an angle, and then all motors hold. All motors start and stop together (see
//! [`profile`](super::profile)). At the start of a program, the angles of all motors are zero. [`Program::grid`] and
//! [`Program::random`] are the accelerometer and gyroscope programs of the paper (`docs/model.md`). Any other program
//! is given as a list of steps.

use std::f64::consts::PI;

use nalgebra::Vector3;
use rand::RngExt;

use super::profile::MotorState;
use super::stream::Stream;
use crate::error::Error;

/// A step of a program: a turn, then a hold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Angle by which each motor turns, rad, outermost motor first.
    pub turn_rad: [f64; 3],
    /// Duration of the turn, s.
    pub move_s: f64,
    /// Duration of the hold after the turn, s.
    pub hold_s: f64,
}

impl Step {
    /// A step in which no motor turns, so that the unit rests for `hold_s`, s.
    pub fn hold(hold_s: f64) -> Self {
        Self { turn_rad: [0.0; 3], move_s: 0.0, hold_s }
    }

    fn turns(&self) -> bool {
        self.turn_rad != [0.0; 3]
    }

    /// Returns, for each motor, the sign of its last turn up to the end of this step; 0 if the motor has not turned
    /// yet. `before` contains the signs before this step. If a motor does not turn in this step, its sign is not
    /// changed.
    fn direction_after(&self, before: &Vector3<f64>) -> Vector3<f64> {
        before.zip_map(&self.turn_rad.into(), |before, turn: f64| if turn == 0.0 { before } else { turn.signum() })
    }

    fn check(&self, index: usize) -> Result<(), Error> {
        let input = |message: String| Err(Error::Input(format!("step {index} of the program: {message}")));
        if !self.turn_rad.iter().all(|angle| angle.is_finite()) {
            return input(format!("turn_rad is {:?}: give finite angles", self.turn_rad));
        }
        for (name, value) in [("move_s", self.move_s), ("hold_s", self.hold_s)] {
            if !(value.is_finite() && value >= 0.0) {
                return input(format!("{name} is {value}: give a time of zero or more"));
            }
        }
        if self.turns() && self.move_s == 0.0 {
            return input("the turn takes no time: give a positive move_s".to_owned());
        }
        Ok(())
    }
}

/// The accelerometer program of the paper cited in docs/model.md. Motor 3 makes a full revolution in equal steps, and
/// then motor 2 makes one step of the same size. This sequence is repeated until motor 2 has turned by half a
/// revolution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// Angle of each step of motors 2 and 3, rad. Half a revolution must be an integer multiple of this angle. The
    /// paper uses 20 deg.
    pub step_rad: f64,
    /// Duration of each turn, s. The paper does not state a duration; the default is 1 s.
    pub move_s: f64,
    /// Duration of each hold, s. The paper uses 5 s.
    pub hold_s: f64,
}

impl Default for Grid {
    fn default() -> Self {
        Self { step_rad: 20_f64.to_radians(), move_s: 1.0, hold_s: 5.0 }
    }
}

/// The gyroscope program of the paper cited in docs/model.md: random turns of all motors, with a hold before the first
/// turn and after each turn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RandomMoves {
    /// Number of turns. The paper uses 45.
    pub moves: usize,
    /// Maximum magnitude of each motor's mean rate during a turn, rad/s; the default is 120 deg/s. The angle of the
    /// turn is uniformly distributed between plus and minus `max_rate_radps * move_s`. The peak rate is 4/3 of the mean
    /// rate.
    pub max_rate_radps: f64,
    /// Duration of each turn, s. The paper uses 2 s.
    pub move_s: f64,
    /// Duration of each hold, s. The paper uses 5 s.
    pub hold_s: f64,
}

impl Default for RandomMoves {
    fn default() -> Self {
        Self { moves: 45, max_rate_radps: 120_f64.to_radians(), move_s: 2.0, hold_s: 5.0 }
    }
}

/// A checked list of steps, with the time and the motor angles at the start of each step.
#[derive(Clone, Debug, PartialEq)]
pub struct Program {
    steps: Vec<Step>,
    starts: Vec<Start>,
    end: Start,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Start {
    time_s: f64,
    angle_rad: Vector3<f64>,
    /// Sign of each motor's last turn before this step; 0 if the motor has not turned yet.
    direction: Vector3<f64>,
}

/// State of the motors at a time during the program.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Phase {
    pub(super) motors: MotorState,
    /// Sign of each motor's current or last turn; 0 if the motor has not turned yet.
    pub(super) direction: Vector3<f64>,
    /// Time since the start of the present turn, and duration of this turn, s; `None` if no motor turns.
    pub(super) turn: Option<(f64, f64)>,
}

impl Program {
    /// A program from a list of steps.
    ///
    /// # Errors
    /// [`Error::Input`] if the list is empty or has a total duration of zero, an angle or time is not finite, a time is
    /// negative, or a turn has a duration of zero.
    pub fn try_new(steps: Vec<Step>) -> Result<Self, Error> {
        let mut end = Start { time_s: 0.0, angle_rad: Vector3::zeros(), direction: Vector3::zeros() };
        let mut starts = Vec::with_capacity(steps.len());
        for (index, step) in steps.iter().enumerate() {
            step.check(index)?;
            starts.push(end);
            end.time_s += step.move_s + step.hold_s;
            end.angle_rad += Vector3::from(step.turn_rad);
            end.direction = step.direction_after(&end.direction);
        }
        let program = Self { steps, starts, end };
        if !(end.time_s > 0.0 && end.time_s.is_finite()) {
            return Err(Error::Input(format!(
                "the program has {} steps and lasts {} s: give steps with a positive total duration",
                program.steps.len(),
                end.time_s
            )));
        }
        Ok(program)
    }

    /// Creates the accelerometer program of the paper cited in docs/model.md. The default has 19 x 10 = 190 positions
    /// in 1139 s.
    ///
    /// # Errors
    /// [`Error::Input`] if half a revolution is not an integer multiple of the step, or if a time is invalid.
    pub fn grid(grid: &Grid) -> Result<Self, Error> {
        let half_turn = (PI / grid.step_rad).round();
        if !(1.0..=180.0).contains(&half_turn) || (half_turn * grid.step_rad - PI).abs() > 1e-6 {
            return Err(Error::Input(format!(
                "step_rad of the grid is {} ({} deg): give 180 deg divided by a whole number from 1 to 180",
                grid.step_rad,
                grid.step_rad.to_degrees()
            )));
        }
        let half_turn = half_turn as usize;
        let turn = |turn_rad| Step { turn_rad, move_s: grid.move_s, hold_s: grid.hold_s };
        let mut steps = vec![Step::hold(grid.hold_s)];
        for row in 0..=half_turn {
            if row > 0 {
                steps.push(turn([0.0, grid.step_rad, 0.0]));
            }
            steps.extend((0..2 * half_turn).map(|_| turn([0.0, 0.0, grid.step_rad])));
        }
        Self::try_new(steps)
    }

    /// Creates the gyroscope program of the paper cited in docs/model.md. The default has 46 rests and 45 moves in 320
    /// s. The same seed always gives the same turns.
    ///
    /// # Errors
    /// [`Error::Input`] if the maximum rate or a time is invalid.
    pub fn random(random: &RandomMoves, seed: u64) -> Result<Self, Error> {
        let bound_rad = random.max_rate_radps * random.move_s;
        if !(bound_rad.is_finite() && bound_rad > 0.0) {
            return Err(Error::Input(format!(
                "random moves of up to {} rad/s for {} s: both must be positive and finite",
                random.max_rate_radps, random.move_s
            )));
        }
        let mut generator = Stream::Program.generator(seed);
        let mut steps = vec![Step::hold(random.hold_s)];
        steps.extend((0..random.moves).map(|_| Step {
            turn_rad: [(); 3].map(|()| generator.random_range(-bound_rad..bound_rad)),
            move_s: random.move_s,
            hold_s: random.hold_s,
        }));
        Self::try_new(steps)
    }

    /// The steps of the program.
    pub fn steps(&self) -> &[Step] {
        &self.steps
    }

    /// Duration of the program, s.
    pub fn duration_s(&self) -> f64 {
        self.end.time_s
    }

    /// Exact angles, rates and accelerations of the motors at a time, s. Before the start and after the end, the motors
    /// are at rest.
    pub fn motors(&self, time_s: f64) -> MotorState {
        self.phase(time_s).motors
    }

    pub(super) fn phase(&self, time_s: f64) -> Phase {
        let Some(index) = self.started(time_s).checked_sub(1) else {
            return Phase { motors: MotorState::still(Vector3::zeros()), direction: Vector3::zeros(), turn: None };
        };
        let (step, start) = (&self.steps[index], &self.starts[index]);
        let elapsed_s = time_s - start.time_s;
        let direction = if elapsed_s > 0.0 { step.direction_after(&start.direction) } else { start.direction };
        let turns = step.turns() && elapsed_s > 0.0 && elapsed_s < step.move_s;
        Phase {
            motors: MotorState::turning(start.angle_rad, step.turn_rad.into(), step.move_s, elapsed_s),
            direction,
            turn: turns.then_some((elapsed_s, step.move_s)),
        }
    }

    /// Returns the time, s, until which all motors stay at rest. This is the start of the next turn; infinity after the
    /// last turn, and `None` during a turn.
    pub(super) fn still_until(&self, time_s: f64) -> Option<f64> {
        let started = self.started(time_s);
        if let Some(index) = started.checked_sub(1)
            && self.steps[index].turns()
            && time_s - self.starts[index].time_s < self.steps[index].move_s
        {
            return None;
        }
        let next_turn = self.steps[started..].iter().position(Step::turns);
        Some(next_turn.map_or(f64::INFINITY, |steps| self.starts[started + steps].time_s))
    }

    /// Number of steps of the program that start at or before `time_s`.
    fn started(&self, time_s: f64) -> usize {
        self.starts.partition_point(|start| start.time_s <= time_s)
    }

    /// Start and end of every interval without motion, s. Consecutive holds count as one rest.
    pub fn rests(&self) -> Vec<(f64, f64)> {
        let mut rests = Vec::new();
        let mut rest_start = 0.0;
        for (step, start) in self.steps.iter().zip(&self.starts) {
            if step.turns() {
                rests.push((rest_start, start.time_s));
                rest_start = start.time_s + step.move_s;
            }
        }
        rests.push((rest_start, self.end.time_s));
        rests.retain(|(start, end)| end > start);
        rests
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;
    use crate::simulate::gimbal::{inner_ring, rotation_world_from_body};

    fn ups(program: &Program) -> Vec<Vector3<f64>> {
        let rests = program.rests();
        let attitude = |time_s| rotation_world_from_body(&program.motors(time_s).angle_rad);
        rests.iter().map(|(start, end)| attitude((start + end) / 2.0).inverse() * Vector3::z()).collect()
    }

    #[test]
    fn grid_visits_190_positions_that_cover_the_sphere() {
        let program = Program::grid(&Grid::default()).unwrap();
        let ups = ups(&program);
        assert_eq!(ups.len(), 190);
        assert!((program.duration_s() - 1139.0).abs() < 1e-9);
        for (start, end) in program.rests() {
            assert!((end - start - 5.0).abs() < 1e-9);
        }
        // Adjacent rests are 20 deg apart. The angle between any direction and the up vector of the nearest rest is
        // therefore at most half the diagonal of a square of 20 deg x 20 deg, just below 14.2 deg.
        let mut furthest_deg = 0.0_f64;
        for i in 0..2000 {
            let z = 1.0 - (2.0 * f64::from(i) + 1.0) / 2000.0;
            let azimuth = f64::from(i) * 2.399_963_229_728_653; // golden angle, rad, for evenly spread directions
            let direction = Vector3::new(azimuth.cos(), azimuth.sin(), 0.0) * (1.0 - z * z).sqrt() + Vector3::z() * z;
            let nearest = ups.iter().map(|up| up.angle(&direction)).fold(f64::INFINITY, f64::min);
            furthest_deg = furthest_deg.max(nearest.to_degrees());
        }
        assert!(furthest_deg < 14.2, "{furthest_deg} deg");
    }

    #[test]
    fn random_program_is_the_papers() {
        let program = Program::random(&RandomMoves::default(), 3).unwrap();
        assert_eq!(program.rests().len(), 46);
        assert_eq!(program.steps().len(), 46);
        assert!((program.duration_s() - 320.0).abs() < 1e-9);
        assert_eq!(program, Program::random(&RandomMoves::default(), 3).unwrap());
        assert_ne!(program, Program::random(&RandomMoves::default(), 4).unwrap());
    }

    /// The mean rate of a motor is at most 120 deg/s, and its peak rate 160 deg/s. If outermost and innermost axis are
    /// parallel, their rates add to at most 320 deg/s, and the body rate is at most sqrt(320^2 + 160^2) = 358 deg/s.
    #[test]
    fn random_program_stays_within_the_gyroscopes_range() {
        let mut highest_dps = 0.0_f64;
        for seed in 1..=20 {
            let program = Program::random(&RandomMoves::default(), seed).unwrap();
            for i in 0..32_000 {
                let ring = inner_ring(&program.motors(f64::from(i) / 100.0), &[0.0; 2]);
                highest_dps = highest_dps.max(ring.rate.norm().to_degrees());
            }
        }
        println!("highest body rate of seeds 1 to 20: {highest_dps:.1} deg/s");
        assert!((250.0..360.0).contains(&highest_dps), "{highest_dps} deg/s");
    }

    #[test]
    fn steps_follow_each_other_without_a_jump() {
        let steps = vec![
            Step { turn_rad: [1.0, 0.0, -2.0], move_s: 1.0, hold_s: 0.0 },
            Step { turn_rad: [0.0, TAU, 0.5], move_s: 3.0, hold_s: 2.0 },
            Step { turn_rad: [0.0; 3], move_s: 1.0, hold_s: 1.0 },
        ];
        let program = Program::try_new(steps).unwrap();
        assert_eq!(program.rests(), vec![(4.0, 8.0)]);
        assert_eq!(program.motors(-1.0), MotorState::still(Vector3::zeros()));
        assert_eq!(program.motors(1.0), MotorState::still(Vector3::new(1.0, 0.0, -2.0)));
        assert_eq!(program.motors(99.0), MotorState::still(Vector3::new(1.0, TAU, -1.5)));
        for i in 0..8000 {
            let t = f64::from(i) * 1e-3;
            let change = program.motors(t + 1e-3).angle_rad - program.motors(t).angle_rad;
            assert!(change.norm() < 1e-3 * 4.0 / 3.0 * 7.0, "{t} s");
        }
    }

    #[test]
    fn stillness_and_the_direction_of_the_last_motion_are_known() {
        let steps = vec![
            Step::hold(1.0),
            Step { turn_rad: [1.0, 0.0, -2.0], move_s: 1.0, hold_s: 2.0 },
            Step::hold(0.5),
            Step { turn_rad: [-1.0, 0.5, 0.0], move_s: 1.0, hold_s: 0.0 },
        ];
        let program = Program::try_new(steps).unwrap();
        for (time_s, until_s, direction) in [
            (-1.0, Some(1.0), [0.0, 0.0, 0.0]),
            (0.5, Some(1.0), [0.0, 0.0, 0.0]),
            (1.0, None, [0.0, 0.0, 0.0]),
            (1.5, None, [1.0, 0.0, -1.0]),
            (2.0, Some(4.5), [1.0, 0.0, -1.0]),
            (4.2, Some(4.5), [1.0, 0.0, -1.0]),
            (5.0, None, [-1.0, 1.0, -1.0]),
            (5.5, Some(f64::INFINITY), [-1.0, 1.0, -1.0]),
        ] {
            let phase = program.phase(time_s);
            assert_eq!(program.still_until(time_s), until_s, "{time_s} s");
            assert_eq!(phase.direction, Vector3::from(direction), "{time_s} s");
            assert_eq!(phase.turn.is_some(), until_s.is_none() && time_s != 1.0, "{time_s} s");
            if let Some(until_s) = until_s.filter(|until_s| until_s.is_finite()) {
                assert_eq!(program.phase(until_s), phase, "{time_s} s");
            }
        }
    }

    #[test]
    fn programs_that_cannot_be_run_are_refused() {
        let step = Step { turn_rad: [1.0, 0.0, 0.0], move_s: 1.0, hold_s: 1.0 };
        let bad = [
            vec![],
            vec![Step::hold(0.0)],
            vec![Step::hold(1.0), Step { turn_rad: [f64::NAN, 0.0, 0.0], ..step }],
            vec![Step { move_s: 0.0, ..step }],
            vec![Step { move_s: -1.0, ..step }],
            vec![Step { hold_s: f64::INFINITY, ..step }],
        ];
        for steps in bad {
            assert!(matches!(Program::try_new(steps.clone()), Err(Error::Input(_))), "{steps:?}");
        }
        for step_deg in [0.0, -20.0, 50.0, 0.1, f64::NAN] {
            let step_rad = f64::to_radians(step_deg);
            assert!(Program::grid(&Grid { step_rad, ..Grid::default() }).is_err(), "{step_deg} deg");
        }
        for max_rate_radps in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let random = RandomMoves { max_rate_radps, ..RandomMoves::default() };
            assert!(Program::random(&random, 1).is_err(), "{max_rate_radps} rad/s");
        }
    }
}
