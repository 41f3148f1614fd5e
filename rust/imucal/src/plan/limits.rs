//! What the motors of a stand may do.

use std::f64::consts::{PI, TAU};

use nalgebra::Vector3;

use crate::error::Error;
use crate::simulate::profile::PEAK_ACCELERATION;

/// Fewest poses: ten rests for the accelerometer's nine numbers.
pub(super) const FEWEST_POSES: usize = 10;
/// Shorter moves cannot be told from the rests around them.
const SHORTEST_MOVE_S: f64 = 0.3;
/// Times of a program are whole multiples of this, s.
pub(super) const TICK_S: f64 = 0.01;

/// One motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axis {
    /// Highest rate, averaged over a turn, rad/s; the peak rate is 4/3 of it.
    pub max_rate_radps: f64,
    /// Highest acceleration, rad/s^2.
    pub max_acceleration_radps2: f64,
    /// Lowest and highest angle, counted through full turns from where the program starts, rad: end stops, or how far the cable may
    /// wind up.
    pub range_rad: Option<[f64; 2]>,
}

/// A part of the motors' angles where the unit must not be, whatever the full turns: a box. `None` is any angle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Zone {
    /// From where to where, rad.
    pub angle_rad: [Option<[f64; 2]>; 3],
}

/// What a stand, or a hand, can do.
#[derive(Clone, Debug, PartialEq)]
pub struct Limits {
    /// Outer motor first; one that is not there stays at zero.
    pub axes: [Option<Axis>; 3],
    /// How long the stand shakes after a turn, s.
    pub settle_s: f64,
    /// Shortest stretch of stillness that is found as a rest, s.
    pub min_rest_s: f64,
    /// Shortest turn, s.
    pub min_move_s: f64,
    /// Where the unit must not be.
    pub forbidden: Vec<Zone>,
    /// All poses are whole multiples of this, rad.
    pub pose_step_rad: f64,
    /// Most turns; a hand has no patience for more.
    pub most_moves: usize,
    /// A hand holds the unit: it trembles at rest.
    pub in_hand: bool,
}

impl Limits {
    /// The paper's motors: three axes without end stops at 120 deg/s. It does not say the acceleration: that which its random program
    /// asks for, 240 deg in 2 s.
    pub fn paper() -> Self {
        let axis = Axis {
            max_rate_radps: 120_f64.to_radians(),
            max_acceleration_radps2: PEAK_ACCELERATION * 240_f64.to_radians() / 4.0,
            range_rad: None,
        };
        Self {
            axes: [Some(axis); 3],
            settle_s: 0.0,
            min_rest_s: 1.0,
            min_move_s: SHORTEST_MOVE_S,
            forbidden: Vec::new(),
            pose_step_rad: 0.1_f64.to_radians(),
            most_moves: 1000,
            in_hand: false,
        }
    }

    /// Refuses what no stand has.
    pub(super) fn check(&self) -> Result<(), Error> {
        let input = |message: String| Err(Error::Input(format!("limits of the stand: {message}")));
        if self.axes.iter().all(Option::is_none) {
            return input("no axis can turn: at least one is needed".into());
        }
        for (number, axis) in self.axes.iter().enumerate().filter_map(|(k, axis)| Some((k + 1, axis.as_ref()?))) {
            for (name, value) in
                [("max_rate_radps", axis.max_rate_radps), ("max_acceleration_radps2", axis.max_acceleration_radps2)]
            {
                if !(value > 0.0 && value.is_finite()) {
                    return input(format!("{name} of axis {number} is {value}: a positive number is needed"));
                }
            }
            if let Some([low, high]) = axis.range_rad
                && !(low <= 0.0 && high >= 0.0 && high > low && (high - low).is_finite())
            {
                return input(format!(
                    "the range of axis {number} is {:.1} deg to {:.1} deg: the program starts at zero, which must be in it",
                    low.to_degrees(),
                    high.to_degrees()
                ));
            }
        }
        for (name, value) in
            [("settle_s", self.settle_s), ("min_rest_s", self.min_rest_s), ("min_move_s", self.min_move_s)]
        {
            if !(0.0..=3600.0).contains(&value) {
                return input(format!("{name} is {value}: a time from 0 s to 3600 s is needed"));
            }
        }
        if self.most_moves < FEWEST_POSES - 1 {
            return input(format!("most_moves is {}: {} or more are needed", self.most_moves, FEWEST_POSES - 1));
        }
        if !(self.pose_step_rad > 0.0 && self.pose_step_rad <= PI) {
            return input(format!("pose_step_rad is {}: more than 0 and at most half a turn", self.pose_step_rad));
        }
        for zone in &self.forbidden {
            for [low, high] in zone.angle_rad.iter().flatten() {
                if !(low < high && high - low <= TAU) {
                    return input(format!(
                        "a forbidden zone goes from {:.1} deg to {:.1} deg: from the lower to the higher angle, at most a \
                         full turn",
                        low.to_degrees(),
                        high.to_degrees()
                    ));
                }
            }
        }
        let start = Vector3::zeros();
        if self.forbidden.iter().any(|zone| zone.is_crossed(&start, &start)) {
            return input("all motors at zero, where a program starts, is in a forbidden zone".into());
        }
        Ok(())
    }

    /// The angle of a motor that is nearest to this one and may be.
    pub(super) fn nearest(&self, motor: usize, angle_rad: f64) -> f64 {
        let Some(axis) = &self.axes[motor] else { return 0.0 };
        let step = self.pose_step_rad;
        match axis.range_rad {
            None => (angle_rad / step).round() * step,
            // A step inside the end stops.
            Some([low, high]) => ((angle_rad.clamp(low, high) / step).round() * step)
                .clamp((low / step - 1e-9).ceil() * step, (high / step + 1e-9).floor() * step),
        }
    }

    /// Whether the motors may turn straight from here to there.
    pub(super) fn allow(&self, from: &Vector3<f64>, to: &Vector3<f64>) -> bool {
        !self.forbidden.iter().any(|zone| zone.is_crossed(from, to))
    }

    /// How long the motors need for a turn, s.
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

/// Up to the next whole tick.
pub(super) fn whole_ticks(time_s: f64) -> f64 {
    (time_s / TICK_S - 1e-6).ceil() * TICK_S
}

impl Zone {
    /// Whether the straight way from one set of angles to another one has a point in it.
    fn is_crossed(&self, from: &Vector3<f64>, to: &Vector3<f64>) -> bool {
        // Shares of the way on which each motor is inside; a motor that goes round comes there more than once.
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
        // At 90 deg of the first motor the third one is at 45 deg.
        assert!(!zone.is_crossed(&deg([0.0, 0.0, 0.0]), &deg([180.0, 0.0, 90.0])));
    }

    #[test]
    fn fewer_moves_than_a_program_has_at_least_are_refused() {
        let with = |most_moves| Limits { most_moves, ..Limits::paper() }.check();
        assert!(with(8).unwrap_err().to_string().contains("most_moves is 8: 9 or more"));
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
