//! Check that recordings are independent: no recording is a copy or a part of another recording, even if the copy was
//! altered.
//!
//! A control recording must not be an altered copy of a calibration recording. The copy contains the noise to which the
//! model was fitted, so the residuals on it are too small. The check compares the noise at rest, because this noise
//! differs between any two independent recordings. All correlations are divided by the standard deviation that the
//! correlation of independent noise has. The largest correlation over all lags is below 10 for independent recordings
//! without periodic vibration, and above 20 for altered copies, unless rounding has removed most of their noise
//! (docs/results/copies.md).

use std::ops::Range;

use super::Place;
use super::noise_search::{Peak, TEMPLATE, Template, Transform, samples_of};
pub use super::noise_tape::{AtRest, at_rest};
use super::noise_tape::{Tape, is_same_rate};
use crate::finding::Finding;

/// Two recordings contain the same noise if (correlation of their noise) / (standard deviation of this correlation for
/// independent noise) is at least this value. It is between the values of independent recordings (up to 10) and of
/// altered copies (from 20).
const COPY_SIGMAS: f32 = 14.0;
/// For two recordings to be copies, their largest correlation must also be at least this multiple of the largest
/// correlation at lags far from its own lag. Periodic vibration in two independent recordings gives large correlations
/// at many lags, so it does not reach this limit.
const UNIQUE: f32 = 2.0;
/// For two recordings to be copies, their correlation without the contributions of short pulses
/// ([`Transform::sigmas_without_pulses`]) must also be at least this value. The correlation is divided by the standard
/// deviation that it has for independent noise. The quotient was at most 4.4 for independent recordings with coinciding
/// pulses, and at least 9 for altered copies.
const WITHOUT_PULSES_SIGMAS: f32 = 5.0;
/// Number of templates of a recording, one in each third. A template is an excerpt that is searched for in the other
/// recordings. If another recording contains at least half of this recording, it usually contains at least one of the
/// templates.
const TEMPLATES: usize = 3;

/// Reports `recordings_overlap` for each pair of recordings that contain the same noise.
pub fn check_independent(recordings: &[AtRest<'_>]) -> Vec<Finding> {
    if recordings.len() < 2 {
        return Vec::new();
    }
    let found = copies(recordings, |_, _| true, COPY_SIGMAS);
    let finding = |copy: &Copy| Finding {
        way_out: "give every recording once: repeated data add no information, and the stated accuracy would be wrong"
            .into(),
        ..copy.finding("recordings_overlap", recordings)
    };
    found.iter().map(finding).collect()
}

/// Reports `control_not_independent` for each pair of a control recording and a calibration recording that contain the
/// same noise.
pub fn check_control(calibration: &[AtRest<'_>], control: &[AtRest<'_>]) -> Vec<Finding> {
    let all: Vec<AtRest<'_>> = calibration.iter().chain(control).copied().collect();
    let is_control = |index: usize| index >= calibration.len();
    let found = copies(&all, |first, second| is_control(first) != is_control(second), COPY_SIGMAS);
    let finding = |copy: &Copy| {
        let copy = if is_control(copy.recording) { *copy } else { copy.reversed() };
        Finding {
            way_out: "make the control recording anew: a part or an altered copy of a calibration recording contains \
                      the noise that the calibration was fitted to"
                .into(),
            ..copy.finding("control_not_independent", &all)
        }
    };
    found.iter().map(finding).collect()
}

/// A pair of recordings that contain the same noise.
#[derive(Clone, Copy)]
struct Copy {
    /// Index of the recording in which the common part is reported.
    recording: usize,
    /// Index of the other recording.
    of: usize,
    /// Index of the first sample of the common part, in the recording `recording`.
    first: usize,
    /// Index of the first sample of the common part, in the recording `of`.
    first_of: usize,
    /// Numbers of samples of the common part in the recordings `recording` and `of`.
    samples: [usize; 2],
    /// Correlation of the common part, divided by the standard deviation of this correlation for independent noise.
    sigmas: f32,
}

impl Copy {
    fn reversed(&self) -> Self {
        let Self { recording, of, first, first_of, samples: [own, others], .. } = *self;
        Self { recording: of, of: recording, first: first_of, first_of: first, samples: [others, own], ..*self }
    }

    fn finding(&self, code: &'static str, recordings: &[AtRest<'_>]) -> Finding {
        let (recording, of) = (recordings[self.recording].recording, recordings[self.of].recording);
        let end = (self.first + self.samples[0]).min(recording.len());
        let place = Place::new(recording, self.first, end - 1);
        Finding {
            place: Some(place),
            count: end - self.first,
            value: f64::from(self.sigmas),
            unit: "sigma",
            message: format!(
                "the noise {place} is that of {} from {:.2} s: their correlation is {:.0} times its standard deviation \
                 for independent recordings",
                of.name, of.time_s[self.first_of], self.sigmas
            ),
            ..Finding::error(code, recording.name)
        }
    }
}

/// Finds copies among the recordings: at most one for each pair for which `is_compared` is true. Two recordings are
/// copies if their correlation is at least `copy_sigmas` times its standard deviation for independent noise. Each
/// recording is searched for in all recordings with at least as many samples.
fn copies(recordings: &[AtRest<'_>], is_compared: impl Fn(usize, usize) -> bool, copy_sigmas: f32) -> Vec<Copy> {
    let mut order: Vec<usize> = (0..recordings.len()).collect();
    order.sort_by_key(|&index| std::cmp::Reverse(recordings[index].recording.len()));
    let (tapes, places) = Tape::of(recordings, &order);
    let mut transform = Transform::new();
    let mut templates = Vec::new();
    for &index in &order {
        let own = &tapes[places[index].tape];
        for (k, tape) in tapes.iter().enumerate() {
            let until = searched_until(tape, &order, index, &is_compared);
            if until == 0 {
                continue;
            }
            let ratio = tape.rate_hz / own.rate_hz;
            // If the sampling rates differ, the samples are also compared one to one. A copy with changed time stamps
            // has the same samples at a different rate.
            let ratios = if is_same_rate(tape.rate_hz, own.rate_hz) { vec![1.0] } else { vec![ratio, 1.0] };
            for ratio in ratios.into_iter().filter(|ratio| *ratio > 0.0 && ratio.is_finite()) {
                for first in starts(&recordings[index], samples_of(ratio)) {
                    let range = &places[index].range;
                    templates.push(transform.template(own, (index, range), first, ratio, (k, until)));
                }
            }
        }
    }
    let peaks = transform.search(&tapes, &templates);
    let mut found: Vec<Copy> = Vec::new();
    for (template, peaks) in templates.iter().zip(&peaks) {
        let tape = &tapes[template.tape];
        for (kind, peak) in peaks.iter().enumerate() {
            let is_high = peak.sigmas >= copy_sigmas && peak.sigmas >= UNIQUE * peak.elsewhere;
            if !is_high || transform.sigmas_without_pulses(tape, template, kind, peak) < WITHOUT_PULSES_SIGMAS {
                continue;
            }
            let copy = copy_at(template, peak, tape);
            let Some(copy) = copy.filter(|copy| is_compared(copy.recording, copy.of)) else { continue };
            match found.iter_mut().find(|known| (known.recording, known.of) == (copy.recording, copy.of)) {
                Some(known) if known.sigmas < copy.sigmas => *known = copy,
                Some(_) => {}
                None => found.push(copy),
            }
        }
    }
    found
}

/// Returns the end of the part of the tape (concatenated recordings) in which the recording `index` is searched for, as
/// a sample index. Only recordings that precede `index` in `order`, and with which it is compared, are searched. The
/// result is the end of the last of these recordings, or 0 if there are none.
fn searched_until(tape: &Tape, order: &[usize], index: usize, is_compared: impl Fn(usize, usize) -> bool) -> usize {
    let before: Vec<usize> = order.iter().copied().take_while(|&other| other != index).collect();
    let is_searched = |part: &&(usize, Range<usize>)| before.contains(&part.0) && is_compared(part.0, index);
    tape.parts.iter().filter(is_searched).map(|(_, range)| range.end).max().unwrap_or(0)
}

/// Returns the start indices of the templates of a recording. A template is an excerpt that is searched for in other
/// recordings. There is one template per third of the recording, at the start of the longest rest of this third.
fn starts(at_rest: &AtRest<'_>, samples: usize) -> Vec<usize> {
    let length = at_rest.recording.len();
    let latest = length.saturating_sub(samples);
    if latest == 0 {
        return vec![0];
    }
    let third = |rest: &Range<usize>| (rest.start + rest.end) * TEMPLATES / (2 * length).max(1);
    let longest = |k: usize| at_rest.rests.iter().filter(|rest| third(rest) == k).max_by_key(|rest| rest.len());
    let mut starts: Vec<usize> = (0..TEMPLATES).filter_map(longest).map(|rest| rest.start.min(latest)).collect();
    starts.dedup();
    starts
}

/// Returns the two recordings that have the noise of the template in common: the recording from which the template is
/// taken, and the recording on the tape at the position of `peak`, the largest correlation with the template. The tape
/// contains recordings one after another. `None` if there is no recording at this position.
fn copy_at(template: &Template, peak: &Peak, tape: &Tape) -> Option<Copy> {
    let middle = (peak.at + (TEMPLATE / 2) as isize).clamp(0, template.until as isize - 1) as usize;
    let (of, range) = tape.parts.iter().find(|(_, range)| range.contains(&middle))?;
    let first_of = (peak.at.max(0) as usize).clamp(range.start, range.end - 1) - range.start;
    Some(Copy {
        recording: template.recording,
        of: *of,
        first: template.first,
        first_of,
        samples: [template.samples, TEMPLATE.min(range.len() - first_of)],
        sigmas: peak.sigmas,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::Recording;
    use crate::rests::segment::Segments;
    use crate::simulate::{Program, RandomMoves, Simulation, Unit, simulate};

    type Columns = (Vec<f64>, Vec<[f64; 3]>, Vec<[f64; 3]>);

    fn run(program: &Program, seed: u64) -> Simulation {
        simulate(program, &Unit::paper(), 100.0, 9.80665, seed).unwrap()
    }

    fn program(seed: u64) -> Program {
        Program::random(&RandomMoves { moves: 12, ..RandomMoves::default() }, seed).unwrap()
    }

    fn columns(recording: &Recording<'_>) -> Columns {
        (recording.time_s.to_vec(), recording.specific_force.iter().collect(), recording.angular_rate.iter().collect())
    }

    fn correlation(first: &Recording<'_>, second: &Recording<'_>, copy_sigmas: f32) -> Option<f32> {
        let rests = [first, second].map(|recording| Segments::find(recording, 1.0).unwrap().ranges());
        let pair = [first, second].map(|recording| *recording);
        let found = copies(&at_rest(&pair, &rests), |_, _| true, copy_sigmas);
        found.iter().map(|copy| copy.sigmas).max_by(f32::total_cmp)
    }

    /// Two simulated runs of the same motor program on one stand differ only in their noise, so they must count as
    /// independent. The benchmark benches/copies.py confirms this for hundreds of seeds.
    #[test]
    fn runs_of_one_program_are_independent() {
        let program = program(3);
        for seed in 1..6 {
            let (first, second) = (run(&program, seed), run(&program, 100 + seed));
            let most = correlation(&first.recording("first"), &second.recording("second"), 0.0);
            assert!(most.is_none_or(|sigmas| sigmas < 0.7 * COPY_SIGMAS), "seed {seed}: {most:?}");
        }
    }

    #[test]
    fn every_second_sample_and_a_part_at_another_gain_are_copies() {
        let run = run(&program(4), 4);
        let recording = run.recording("whole");
        let (time_s, force, rate) = columns(&recording);
        let second = |rows: &[[f64; 3]]| rows.iter().step_by(2).copied().collect::<Vec<_>>();
        let times: Vec<f64> = time_s.iter().step_by(2).copied().collect();
        let (half_force, half_rate) = (second(&force), second(&rate));
        let thinned = Recording::try_new("thinned", &times, &half_force, &half_rate).unwrap();
        assert!(correlation(&recording, &thinned, COPY_SIGMAS).is_some());
        let part = 1000..4000;
        let scaled: Vec<[f64; 3]> = force[part.clone()].iter().map(|row| row.map(|v| 1.001 * v)).collect();
        let part = Recording::try_new("part", &time_s[..3000], &scaled, &rate[part]).unwrap();
        assert!(correlation(&part, &recording, COPY_SIGMAS).is_some());
    }

    #[test]
    fn axes_without_noise_and_few_samples_have_no_common_noise() {
        let still = vec![[0.0, 0.0, 9.80665]; 1000];
        let (time, zero) = ((0..1000).map(f64::from).collect::<Vec<_>>(), vec![[0.0; 3]; 1000]);
        let recording = Recording::try_new("still", &time, &still, &zero).unwrap();
        for rests in [vec![vec![0..1000]; 2], vec![vec![]; 2], vec![vec![0..2, 999..1000]; 2]] {
            assert!(check_independent(&at_rest(&[recording, recording], &rests)).is_empty());
        }
    }
}
