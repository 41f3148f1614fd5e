//! Recordings from arbitrary bytes, and what is done with them. A function that returns has passed: no input may cause
//! a panic or an endless loop.

#![allow(dead_code, clippy::expect_used, reason = "a test, of which each target of cargo-fuzz uses one function")]

use std::sync::OnceLock;

use imucal::calibrate::{Options, calibrate as fit};
use imucal::check::{check_columns, check_rests};
use imucal::recording::{RawUnit, Recording};
use imucal::rests::Segments;
use imucal::simulate::{Program, RandomMoves, Simulation, Unit, simulate};

const GRAVITY_MPS2: f64 = 9.80665;
/// Bytes of one change of the recording.
const CHANGE: usize = 14;
/// Maximum number of samples of a recording that consists of arbitrary numbers only.
const MOST_SAMPLES: usize = 4096;
/// Values at the ends of number ranges, and values that damaged files contain.
const VALUES: [f64; 16] = [
    0.0,
    -0.0,
    f64::NAN,
    f64::INFINITY,
    f64::NEG_INFINITY,
    f64::MAX,
    f64::MIN_POSITIVE,
    5e-324,
    1.7e153,
    -3.4e38,
    9.8,
    -9.8,
    32767.0,
    -32768.0,
    1e-9,
    99_999.0,
];

struct Columns {
    time_s: Vec<f64>,
    force: Vec<[f64; 3]>,
    rate: Vec<[f64; 3]>,
    units: [RawUnit; 2],
}

/// All checks that need no rests.
pub(crate) fn check(bytes: &[u8]) {
    let columns = Columns::of(bytes);
    check_columns(&columns.recording());
}

/// The checks, the rests, and the checks of rests.
pub(crate) fn inspect(bytes: &[u8]) {
    let columns = Columns::of(bytes);
    let recording = columns.recording();
    check_columns(&recording);
    if let Ok(segments) = Segments::find(&recording, 1.0) {
        let rests: Vec<_> = segments.rests.iter().map(|rest| rest.first..rest.end).collect();
        check_rests(&recording, &rests, GRAVITY_MPS2);
    }
}

/// The complete calibration.
pub(crate) fn calibrate(bytes: &[u8]) {
    let columns = Columns::of(bytes);
    let _ = fit(&[columns.recording()], &Options::default());
}

impl Columns {
    /// The first byte selects the units, and whether a simulated run is changed or all numbers are arbitrary.
    fn of(bytes: &[u8]) -> Self {
        let (&kind, rest) = bytes.split_first().unwrap_or((&0, &[]));
        let unit = |bit: u8| if kind & bit == 0 { RawUnit::Si } else { RawUnit::Lsb };
        let mut columns = if kind & 4 == 0 { Self::simulated() } else { Self::arbitrary(rest) };
        columns.units = [unit(1), unit(2)];
        if kind & 4 == 0 {
            rest.chunks_exact(CHANGE).for_each(|change| columns.change(change));
        }
        columns
    }

    fn simulated() -> Self {
        static RUN: OnceLock<Simulation> = OnceLock::new();
        let run = RUN.get_or_init(|| {
            let moves = RandomMoves { moves: 12, hold_s: 2.0, ..RandomMoves::default() };
            let program = Program::random(&moves, 1).expect("the program is valid");
            simulate(&program, &Unit::paper(), 20.0, GRAVITY_MPS2, 1).expect("the unit is valid")
        });
        Self {
            time_s: run.time_s.clone(),
            force: run.specific_force.clone(),
            rate: run.angular_rate.clone(),
            units: [RawUnit::Si; 2],
        }
    }

    fn arbitrary(bytes: &[u8]) -> Self {
        let numbers: Vec<f64> = bytes.chunks_exact(8).map(number).take(7 * MOST_SAMPLES).collect();
        let rows = numbers.chunks_exact(7);
        Self {
            time_s: rows.clone().map(|row| row[0]).collect(),
            force: rows.clone().map(|row| [row[1], row[2], row[3]]).collect(),
            rate: rows.map(|row| [row[4], row[5], row[6]]).collect(),
            units: [RawUnit::Si; 2],
        }
    }

    /// Changes a range of samples: byte 0 is the kind of change, 1 the channel, 2 to 3 the first sample, 4 to 5 the
    /// number of samples, and 6 to 13 a value.
    fn change(&mut self, bytes: &[u8]) {
        let short = |at: usize| usize::from(u16::from_le_bytes([bytes[at], bytes[at + 1]]));
        let len = self.time_s.len().max(1);
        let first = short(2) % len;
        let end = (first + 1 + short(4) % 400).min(self.time_s.len());
        let channel = usize::from(bytes[1]) % 7;
        let exact = number(&bytes[6..]);
        let value = if bytes[0] & 128 == 0 { exact } else { VALUES[usize::from(bytes[6]) % VALUES.len()] };
        match bytes[0] % 8 {
            0 => self.each(channel, first..end, |_, _| value),
            1 => self.each(channel, first..first + 1, |_, _| value),
            2 => self.each(channel, first..end, |_, old| old * value),
            3 => self.each(channel, 0..usize::MAX, |_, old| old * value),
            4 => self.each(channel, first..end, |_, old| old + value),
            5 => self.each(channel, first..usize::MAX, |k, old| old + k as f64 * value),
            6 => self.rows(|rows| drop(rows.splice(first..end.min(rows.len()), []))),
            _ => self.rows(|rows| {
                let part: Vec<_> = rows[first.min(rows.len())..end.min(rows.len())].to_vec();
                rows.splice(first.min(rows.len())..first.min(rows.len()), part);
            }),
        }
    }

    fn each(&mut self, channel: usize, samples: std::ops::Range<usize>, new: impl Fn(usize, f64) -> f64) {
        let end = samples.end.min(self.time_s.len());
        for (k, i) in (samples.start..end).enumerate() {
            let old = match channel {
                0 => &mut self.time_s[i],
                1..4 => &mut self.force[i][channel - 1],
                _ => &mut self.rate[i][channel - 4],
            };
            *old = new(k, *old);
        }
    }

    fn rows(&mut self, edit: impl Fn(&mut Vec<[f64; 7]>)) {
        let columns = self.time_s.iter().zip(&self.force).zip(&self.rate);
        let mut rows: Vec<[f64; 7]> = columns.map(|((t, f), w)| [*t, f[0], f[1], f[2], w[0], w[1], w[2]]).collect();
        edit(&mut rows);
        rows.truncate(4 * MOST_SAMPLES);
        self.time_s = rows.iter().map(|row| row[0]).collect();
        self.force = rows.iter().map(|row| [row[1], row[2], row[3]]).collect();
        self.rate = rows.iter().map(|row| [row[4], row[5], row[6]]).collect();
    }

    fn recording(&self) -> Recording<'_> {
        let recording = Recording::try_new("arbitrary", &self.time_s, &self.force, &self.rate);
        let [accel_unit, gyro_unit] = self.units;
        Recording { accel_unit, gyro_unit, ..recording.expect("the columns have one length") }
    }
}

fn number(bytes: &[u8]) -> f64 {
    bytes.first_chunk::<8>().map_or(0.0, |bytes| f64::from_le_bytes(*bytes))
}
