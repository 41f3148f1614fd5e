//! Temperature of the sensors over a run.
//!
//! ```text
//! T(t) = linear between the knots (t_k, T_k), constant before the first and after the last knot
//! ```

use crate::error::Error;

/// A temperature profile, defined by its knots.
#[derive(Clone, Debug, PartialEq)]
pub struct Temperature {
    time_s: Vec<f64>,
    temperature_degc: Vec<f64>,
}

impl Temperature {
    /// The profile with a constant temperature, degC.
    pub fn constant(temperature_degc: f64) -> Self {
        Self { time_s: vec![0.0], temperature_degc: vec![temperature_degc] }
    }

    /// A profile with knots at the given times, s, and the given temperatures, degC.
    ///
    /// # Errors
    /// [`Error::Input`] if there is no knot, the columns have different lengths, a value is not finite, or a time is
    /// not later than the previous time.
    pub fn try_new(time_s: Vec<f64>, temperature_degc: Vec<f64>) -> Result<Self, Error> {
        let input = |message: String| Err(Error::Input(format!("temperature profile: {message}")));
        if time_s.is_empty() || time_s.len() != temperature_degc.len() {
            let (times, values) = (time_s.len(), temperature_degc.len());
            return input(format!(
                "{times} times and {values} temperatures: give the same number of times and temperatures, at least one of \
                 each"
            ));
        }
        if let Some(k) = (0..time_s.len()).find(|&k| !(time_s[k].is_finite() && temperature_degc[k].is_finite())) {
            return input(format!(
                "knot {k} is ({} s, {} degC): finite values are needed",
                time_s[k], temperature_degc[k]
            ));
        }
        if let Some(k) = (1..time_s.len()).find(|&k| time_s[k] <= time_s[k - 1]) {
            return input(format!("knot {k} is at {} s, after {} s: times have to increase", time_s[k], time_s[k - 1]));
        }
        Ok(Self { time_s, temperature_degc })
    }

    /// Whether all knots have the same temperature.
    pub fn is_constant(&self) -> bool {
        self.temperature_degc.iter().all(|value| *value == self.temperature_degc[0])
    }

    /// Temperature at a time, degC.
    pub fn at(&self, time_s: f64) -> f64 {
        let (times, values) = (&self.time_s, &self.temperature_degc);
        let later = times.partition_point(|knot| *knot <= time_s);
        if later == 0 {
            return values[0];
        }
        if later == times.len() {
            return values[later - 1];
        }
        let share = (time_s - times[later - 1]) / (times[later] - times[later - 1]);
        values[later - 1] + share * (values[later] - values[later - 1])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_between_knots_and_constant_outside() {
        let profile = Temperature::try_new(vec![10.0, 20.0, 40.0], vec![25.0, 35.0, 31.0]).unwrap();
        for (time_s, expected) in [(-5.0, 25.0), (10.0, 25.0), (15.0, 30.0), (20.0, 35.0), (30.0, 33.0), (99.0, 31.0)] {
            assert_eq!(profile.at(time_s), expected, "at {time_s} s");
        }
        assert!(!profile.is_constant());
        assert!(Temperature::constant(25.0).is_constant());
        assert_eq!(Temperature::constant(25.0).at(1e3), 25.0);
    }

    #[test]
    fn knots_that_are_no_profile_are_refused() {
        for (time_s, temperature_degc) in [
            (vec![], vec![]),
            (vec![0.0, 1.0], vec![25.0]),
            (vec![0.0, 0.0], vec![25.0, 26.0]),
            (vec![1.0, 0.0], vec![25.0, 26.0]),
            (vec![0.0, 1.0], vec![25.0, f64::NAN]),
        ] {
            let message = Temperature::try_new(time_s, temperature_degc).unwrap_err().to_string();
            assert!(message.starts_with("temperature profile"), "{message}");
        }
    }
}
