//! Limits of the motors of a stand, or of a person who moves the unit by hand.

use std::f64::consts::{PI, TAU};

use nalgebra::Vector3;

use crate::error::Error;
use crate::simulate::profile::PEAK_ACCELERATION;

/// Minimum number of poses in a program: one more than the number of accelerometer parameters, which is nine.
pub(super) const FEWEST_POSES: usize = 10;
/// Shortest move that rest detection can distinguish from the adjacent rests, s.
const SHORTEST_MOVE_S: f64 = 0.3;
/// Resolution of the times in a program, s. All durations are multiples of this time.
pub(super) const TICK_S: f64 = 0.01;

/// Limits of one motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axis {
    /// Maximum mean rate during a turn, rad/s. The peak rate is 4/3 of the mean rate.
    pub max_rate_radps: f64,
    /// Maximum acceleration, rad/s^2.
    pub max_acceleration_radps2: f64,
    /// Minimum and maximum angle of the motor relative to its angle at the start of a program, rad. The angles may
    /// exceed a revolution. End stops or the length of the cable cause these limits. `None` if there is no limit.
    pub range_rad: Option<[f64; 2]>,
}

/// A forbidden zone of motor angles. The stand is in the zone if the angle of each motor, reduced by whole revolutions,
/// is between the lower and the upper angle for this motor. A motor with `None` is ignored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Zone {
    /// Lower and upper angle of each motor, rad; `None` if the zone does not depend on this motor.
    pub angle_rad: [Option<[f64; 2]>; 3],
}

/// Limits that every program obeys. They describe a stand, or a person who moves the unit by hand.
#[derive(Clone, Debug, PartialEq)]
pub struct Limits {
    /// Limits of each motor, outermost motor first; `None` for a missing motor, whose angle stays at zero.
    pub axes: [Option<Axis>; 3],
    /// Time after a turn during which the stand still vibrates, s. Samples within this time are not used.
    pub settle_s: f64,
    /// Minimum duration of a rest that rest detection requires, s.
    pub min_rest_s: f64,
    /// Minimum duration of a turn, s.
    pub min_move_s: f64,
    /// Forbidden zones.
    pub forbidden: Vec<Zone>,
    /// The motor angles of a pose are multiples of this angle, rad.
    pub pose_step_rad: f64,
    /// Maximum number of turns of a program. It limits the effort of a person who moves the unit by hand.
    pub most_moves: usize,
    /// Whether a person holds the unit. If so, the unit trembles at rest.
    pub in_hand: bool,
}

impl Limits {
    /// Limits of the stand of the paper cited in docs/model.md: three motors without end stops, each with a mean rate
    /// of at most 120 deg/s during a turn. The paper does not state the maximum acceleration of the motors. It is
    /// assumed to be the peak acceleration of a turn of 240 deg in 2 s, the largest turn in the random program of the
    /// paper.
    pub fn paper() -> Self {
        let axis = Axis {
            max_rate_radps: 120_f64.to_radians(),
            max_acceleration_radps2: PEAK_ACCELERATION * 240_f64.to_radians() / 4.0,
            range_rad: None,
        };
        Self {
            axes: [Some(axis); 3],
            settle_s: 0.0,
            min_rest_s: crate::rests::MIN_REST_S,
            min_move_s: SHORTEST_MOVE_S,
            forbidden: Vec::new(),
            pose_step_rad: 0.1_f64.to_radians(),
            most_moves: 1000,
            in_hand: false,
        }
    }

    /// Returns an error if a limit is out of range, or if the start pose is in a forbidden zone.
    pub(super) fn check(&self) -> Result<(), Error> {
        let input = |message: String| Err(Error::Input(format!("limits of the stand: {message}")));
        if self.axes.iter().all(Option::is_none) {
            return input("no axis can turn: give at least one axis".into());
        }
        for (number, axis) in self.axes.iter().enumerate().filter_map(|(k, axis)| Some((k + 1, axis.as_ref()?))) {
            for (name, value) in
                [("max_rate_radps", axis.max_rate_radps), ("max_acceleration_radps2", axis.max_acceleration_radps2)]
            {
                if !(value > 0.0 && value.is_finite()) {
                    return input(format!("{name} of axis {number} is {value}: give a positive number"));
                }
            }
            if let Some([low, high]) = axis.range_rad
                && !(low <= 0.0 && high >= 0.0 && high > low && (high - low).is_finite())
            {
                return input(format!(
                    "the range of axis {number} is {:.1} deg to {:.1} deg: it must contain zero, where a program starts",
                    low.to_degrees(),
                    high.to_degrees()
                ));
            }
        }
        for (name, value) in
            [("settle_s", self.settle_s), ("min_rest_s", self.min_rest_s), ("min_move_s", self.min_move_s)]
        {
            if !(0.0..=3600.0).contains(&value) {
                return input(format!("{name} is {value}: give a time from 0 s to 3600 s"));
            }
        }
        if self.most_moves < FEWEST_POSES - 1 {
            return input(format!("most_moves is {}: give {} or more", self.most_moves, FEWEST_POSES - 1));
        }
        if !(self.pose_step_rad > 0.0 && self.pose_step_rad <= PI) {
            return input(format!(
                "pose_step_rad is {}: give a positive angle of at most half a revolution",
                self.pose_step_rad
            ));
        }
        for zone in &self.forbidden {
            for [low, high] in zone.angle_rad.iter().flatten() {
                if !(low < high && high - low <= TAU) {
                    return input(format!(
                        "a forbidden zone is {:.1} deg to {:.1} deg: give the lower angle first, and at most a full \
                         revolution",
                        low.to_degrees(),
                        high.to_degrees()
                    ));
                }
            }
        }
        let start = Vector3::zeros();
        if self.forbidden.iter().any(|zone| zone.is_crossed(&start, &start)) {
            return input("the start of a program, all motors at zero, is in a forbidden zone".into());
        }
        Ok(())
    }

    /// The allowed angle of a motor that is nearest to a given angle, rad.
    pub(super) fn nearest(&self, motor: usize, angle_rad: f64) -> f64 {
        let Some(axis) = &self.axes[motor] else { return 0.0 };
        let step = self.pose_step_rad;
        match axis.range_rad {
            None => (angle_rad / step).round() * step,
            // Rounds to a multiple of the pose step that is within the end stops.
            Some([low, high]) => ((angle_rad.clamp(low, high) / step).round() * step)
                .clamp((low / step - 1e-9).ceil() * step, (high / step + 1e-9).floor() * step),
        }
    }

    /// Whether the motors may turn directly from one pose to another.
    pub(super) fn allow(&self, from: &Vector3<f64>, to: &Vector3<f64>) -> bool {
        !self.forbidden.iter().any(|zone| zone.is_crossed(from, to))
    }

    /// Minimum duration, s, of a turn of the motors by the angles `turn`, rad.
    pub(super) fn fastest_s(&self, turn: &Vector3<f64>) -> f64 {
        let of_axis = |(turn, axis): (&f64, &Option<Axis>)| {
            axis.as_ref().map_or(0.0, |axis| {
                let ramp = (PEAK_ACCELERATION * turn.abs() / axis.max_acceleration_radps2).sqrt();
                (turn.abs() / axis.max_rate_radps).max(ramp)
            })
        };
        turn.iter().zip(&self.axes).map(of_axis).fold(self.min_move_s.max(SHORTEST_MOVE_S), f64::max)
    }
}

/// Rounds a time up to a multiple of [`TICK_S`].
pub(super) fn whole_ticks(time_s: f64) -> f64 {
    (time_s / TICK_S - 1e-6).ceil() * TICK_S
}

impl Zone {
    /// Whether the straight path between two sets of motor angles touches the zone.
    fn is_crossed(&self, from: &Vector3<f64>, to: &Vector3<f64>) -> bool {
        // Intervals of the path in which the angles of all motors processed so far are inside the zone. The position on
        // the path is a number from 0 (start) to 1 (end). The angle of a motor that makes several revolutions is inside
        // the zone several times.
        let mut inside = vec![[0.0, 1.0]];
        for motor in 0..3 {
            let Some([low, high]) = self.angle_rad[motor] else { continue };
            let (start, turn) = (from[motor], to[motor] - from[motor]);
            let (least, most) = (start.min(start + turn), start.max(start + turn));
            let (first, last) = (((least - high) / TAU).ceil() as i64, ((most - low) / TAU).floor() as i64);
            let share = |angle: f64| if turn == 0.0 { f64::NAN } else { (angle - start) / turn };
            let visits: Vec<[f64; 2]> = (first..=last)
                .map(|turns| {
                    let (a, b) = (share(low + TAU * turns as f64), share(high + TAU * turns as f64));
                    if turn == 0.0 { [0.0, 1.0] } else { [a.min(b).max(0.0), a.max(b).min(1.0)] }
                })
                .collect();
            let common = |a: &[f64; 2], b: &[f64; 2]| [a[0].max(b[0]), a[1].min(b[1])];
            inside =
                inside.iter().flat_map(|a| visits.iter().map(move |b| common(a, b))).filter(|s| s[0] <= s[1]).collect();
        }
        !inside.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn deg(values: [f64; 3]) -> Vector3<f64> {
        Vector3::from(values.map(f64::to_radians))
    }

    #[test]
    fn a_way_through_a_zone_is_seen_however_thin_it_is_and_after_full_turns() {
        let zone = Zone {
            angle_rad: [
                Some([89.99_f64, 90.01].map(f64::to_radians)),
                None,
                Some([-10_f64, 10.0].map(f64::to_radians)),
            ],
        };
        assert!(zone.is_crossed(&deg([0.0, 0.0, 0.0]), &deg([180.0, 50.0, 0.0])));
        assert!(zone.is_crossed(&deg([0.0, 0.0, 360.0]), &deg([-360.0, 50.0, 365.0])));
        assert!(zone.is_crossed(&deg([90.0, 0.0, 5.0]), &deg([90.0, 0.0, 5.0])));
        assert!(!zone.is_crossed(&deg([0.0, 0.0, 0.0]), &deg([89.0, 0.0, 0.0])));
        assert!(!zone.is_crossed(&deg([0.0, 0.0, 20.0]), &deg([180.0, 0.0, 20.0])));
        // When the first motor is in the zone, at 90 deg, the third motor is at 45 deg and therefore outside the zone.
        assert!(!zone.is_crossed(&deg([0.0, 0.0, 0.0]), &deg([180.0, 0.0, 90.0])));
    }

    #[test]
    fn fewer_moves_than_a_program_has_at_least_are_refused() {
        let with = |most_moves| Limits { most_moves, ..Limits::paper() }.check();
        assert!(with(8).unwrap_err().to_string().contains("most_moves is 8: give 9 or more"));
        assert!(with(9).is_ok() && with(usize::MAX).is_ok());
    }

    #[test]
    fn the_paper_s_motors_run_the_paper_s_program() {
        let limits = Limits::paper();
        assert!((limits.fastest_s(&deg([240.0, -30.0, 10.0])) - 2.0).abs() < 1e-12);
        assert!((limits.fastest_s(&deg([0.0, 0.0, 60.0])) - 1.0).abs() < 1e-12);
        assert_eq!(limits.fastest_s(&deg([1.0, 0.0, 0.0])), SHORTEST_MOVE_S);
    }
}
