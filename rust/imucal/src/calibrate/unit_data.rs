//! Checked recordings of one unit, the rests in them, and the two fits.

use std::ops::Range;

use imucal_core::sensor::Triad;

use super::{Options, check_options};
use crate::check;
use crate::error::Error;
use crate::evaluate::{RestReport, rest_report};
use crate::finding::{Finding, Severity};
use crate::joint::is_blind_by_hand;
use crate::recording::{RawUnit, Recording};
use crate::rests::moves::{Directions, Unusable, saturated_stretches};
use crate::rests::noise_density::NoiseDensity;
use crate::rests::segment::Segments;
use crate::rests::tremor::{self, Hand, Sensors};
use crate::rests::unit_rest::{UnitRest, rests_of};
use crate::two_stage::gyroscope::{self, GyroscopeBias};

/// Moves that the gyroscope's nine entries need at least, two numbers each.
pub(super) const FEWEST_MOVES: usize = 5;
/// Why a move takes no part that all others speak against.
pub(super) const CONTRADICTS_MOVES: &str = "contradicts_other_moves";
/// Why a rest takes no part whose mean rate is far from that of all others.
pub(super) const NOT_STILL: &str = "rest_not_still";

/// Checked recordings of one unit and the rests in them.
#[derive(Clone)]
pub(super) struct UnitData<'a> {
    pub(super) recordings: &'a [Recording<'a>],
    pub(super) segments: Vec<Segments>,
    pub(super) rests: Vec<UnitRest>,
    /// Why a rest takes no part; `None` if it does.
    pub(super) excluded: Vec<Option<&'static str>>,
    pub(super) bias: GyroscopeBias,
    /// White noise of each recording, raw units.
    noise: Vec<NoiseDensity>,
    /// The hand that holds the unit, if one does, for each recording.
    hands: Vec<Option<Hand>>,
    pub(super) saturated: Vec<Vec<Range<usize>>>,
    pub(super) findings: Vec<Finding>,
}

impl<'a> UnitData<'a> {
    pub(super) fn try_new(recordings: &'a [Recording<'a>], options: &Options<'_>) -> Result<Self, Error> {
        check_options(recordings, options)?;
        let mut findings = Vec::new();
        for recording in recordings {
            findings.extend(check::check_columns(recording));
        }
        findings.extend(check::check_shared(recordings));
        if options.exclude_saturated {
            for finding in findings.iter_mut().filter(|finding| finding.is_saturation()) {
                finding.severity = Severity::Warning;
            }
        }
        refuse_errors(&findings)?;
        let segments: Vec<Segments> = recordings
            .iter()
            .map(|recording| Segments::find(recording, options.min_rest_s))
            .collect::<Result<_, _>>()?;
        for (recording, segments) in recordings.iter().zip(&segments) {
            let ranges: Vec<_> = segments.rests.iter().map(|rest| rest.first..rest.end).collect();
            findings.extend(check::check_rests(recording, &ranges, options.gravity_mps2));
        }
        refuse_errors(&findings)?;
        let rests = rests_of(&segments);
        let saturated = saturated_stretches(recordings, &findings);
        let bias = gyroscope::bias_from_rests(&rests.iter().map(|rest| &rest.rest).collect::<Vec<_>>());
        let excluded: Vec<_> = rests
            .iter()
            .zip(&bias.weights)
            .map(|(rest, weight)| {
                if rest.is_saturated(&saturated) {
                    Some("saturation")
                } else if weight.min() == 0.0 {
                    // Its mean rate is far from all others': a slow, even turn looks like a rest.
                    Some(NOT_STILL)
                } else {
                    None
                }
            })
            .collect();
        refuse_no_rest(&excluded)?;
        let noise = segments.iter().map(|segments| segments.noise_density).collect();
        let hands = vec![None; recordings.len()];
        Ok(Self { recordings, segments, rests, excluded, bias, noise, hands, saturated, findings })
    }

    /// The same of these recordings, which must have the same samples.
    pub(super) fn of<'b>(self, recordings: &'b [Recording<'b>]) -> UnitData<'b> {
        let Self { segments, rests, excluded, bias, noise, hands, saturated, findings, .. } = self;
        UnitData { recordings, segments, rests, excluded, bias, noise, hands, saturated, findings }
    }

    /// Frees rests and noise of the tremor of a hand, now that the sensors are known; `used` rests say how it holds the unit.
    pub(super) fn free_of_tremor(&mut self, accelerometer: &Triad<f64>, gyroscope: &Triad<f64>, used: &[bool]) {
        let sensors = Sensors { accelerometer, gyroscope };
        self.hands = tremor::hands(self.recordings, &mut self.rests, used, &mut self.noise, sensors);
    }

    /// Which rests are no faults of the data.
    pub(super) fn sound(&self) -> Vec<bool> {
        self.excluded.iter().map(Option::is_none).collect()
    }

    pub(super) fn raw_is_si(&self, unit: impl Fn(&Recording<'_>) -> RawUnit) -> bool {
        self.recordings.first().is_some_and(|recording| unit(recording) == RawUnit::Si)
    }

    /// Stretches that are a little too short to be rests are worth a word where rests are missing.
    pub(super) fn short_rests(&self, options: &Options<'_>) -> Option<String> {
        self.recordings.iter().zip(&self.segments).find_map(|(recording, segments)| {
            let range = segments.too_short.iter().max_by_key(|range| range.len())?;
            let (start_s, end_s) = (recording.time_s[range.start], recording.time_s[range.end - 1]);
            Some(format!(
                "{} still stretches are too short to be rests, the longest ({start_s:.2} s to {end_s:.2} s) \
                 has {} samples: hold each pose for {} s, or pass min_rest_s={:.2}",
                segments.too_short.len(),
                range.len(),
                options.min_rest_s,
                0.9 * (end_s - start_s)
            ))
        })
    }

    /// Tremor of the hand that holds the unit, if one does, for each recording, rad.
    pub(super) fn tremor_rad(&self) -> Vec<Option<f64>> {
        self.hands.iter().map(|hand| hand.as_ref().map(Hand::tremor_rad)).collect()
    }

    /// Whether a hand holds the unit in some recording.
    pub(super) fn is_held(&self) -> bool {
        self.hands.iter().any(Option::is_some)
    }

    /// Refuses effects that the force inside the moves shows where a hand carried the unit along.
    pub(super) fn require_turns_in_place(&self, options: &Options<'_>) -> Result<(), Error> {
        let blind = options.effects.iter().find(|choice| is_blind_by_hand(choice.effect.name));
        match blind.filter(|_| self.is_held()) {
            None => Ok(()),
            Some(choice) => Err(Error::NotEnoughMotion(format!(
                "a hand held the unit and carried it along inside the moves, where {} would show: turn it on a stand, or \
                 leave the effect out",
                choice.effect.name
            ))),
        }
    }

    pub(super) fn noise(&self) -> &[NoiseDensity] {
        &self.noise
    }

    pub(super) fn directions<'b>(&'b self, accelerometer: &'b Triad<f64>, gyroscope: &'b Triad<f64>) -> Directions<'b> {
        let Self { recordings, rests, noise, hands, .. } = self;
        Directions { recordings, rests, noise, hands, accelerometer, gyroscope }
    }
}

impl UnitData<'_> {
    /// `used` says which rests take part.
    pub(super) fn rest_reports(&self, accelerometer: &Triad<f64>, used: &[bool], gravity_mps2: f64) -> Vec<RestReport> {
        let report = |k: usize| {
            let contradicts = (!used[k]).then_some("contradicts_other_rests");
            let excluded = self.excluded[k].or(contradicts);
            rest_report(&self.rests[k], accelerometer, gravity_mps2, excluded)
        };
        (0..self.rests.len()).map(report).collect()
    }
}

/// What to do about too few moves, and why others cannot be used.
pub(super) fn too_few_moves(usable: usize, unusable: &[Unusable]) -> String {
    let needed = format!("at least {FEWEST_MOVES} between different poses are needed, better 12");
    let Some(first) = unusable.first() else {
        return format!("{needed}; move the unit about all three axes, resting in between");
    };
    let count = |reason: &str| unusable.iter().filter(|u| u.reason == reason).count();
    let reasons: Vec<String> = [("samples_missing", "gaps in time"), ("saturation", "saturated samples")]
        .into_iter()
        .filter(|(reason, _)| count(reason) > 0)
        .map(|(reason, words)| format!("{} for {words} [{reason}]", count(reason)))
        .collect();
    format!(
        "{usable} of {} moves are usable and {needed}; left out: {} (the first between rests {} and {}): record again \
         without them",
        usable + unusable.len(),
        reasons.join(", "),
        first.span.from,
        first.span.to
    )
}

/// Nothing can be said of a unit without a rest that takes part.
fn refuse_no_rest(excluded: &[Option<&'static str>]) -> Result<(), Error> {
    if excluded.iter().any(Option::is_none) {
        return Ok(());
    }
    let saturated = excluded.iter().filter(|reason| **reason == Some("saturation")).count();
    let moving = excluded.len() - saturated;
    let left_out = [(saturated, "for saturated samples [saturation]"), (moving, "as slow turns [rest_not_still]")]
        .into_iter()
        .filter(|(count, _)| *count > 0)
        .map(|(count, words)| format!("{count} {words}"))
        .collect::<Vec<_>>();
    let way_out = if saturated > 0 {
        "a unit at rest is far from the ends of its range, so look at how the columns were read; else use a larger range"
    } else {
        "hold the unit still in each pose for 2 s or longer"
    };
    Err(Error::NotEnoughMotion(format!(
        "0 of {} rests are usable; left out: {}: {way_out}",
        excluded.len(),
        left_out.join(", ")
    )))
}

/// The findings that refuse a calibration, as an error.
pub(super) fn refuse_errors(findings: &[Finding]) -> Result<(), Error> {
    let errors: Vec<Finding> = findings.iter().filter(|f| f.severity == Severity::Error).cloned().collect();
    if errors.is_empty() { Ok(()) } else { Err(Error::Data(errors)) }
}
