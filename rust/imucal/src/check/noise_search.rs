//! Searches other recordings for a part of the noise of one recording. The search computes the correlation at all lags.
//! The searched recordings are concatenated, and such a concatenation is called a tape (see `noise_tape`).
//!
//! The signals of the part and of the searched recording (second differences of the axes, see `noise_tape`) are
//! whitened: each spectrum is divided by its magnitude, so that all frequencies have equal weight (phase transform:
//! Knapp and Carter, The generalized correlation method for estimation of time delay, 1976). A strong periodic
//! vibration in two independent recordings contains only a few frequencies, so it contributes little to the
//! correlation. The correlation at a lag is a sum over m frequencies (positive and negative) and n signals, and each
//! term has the magnitude 1. For independent noise, the variance of the sum is m n at every lag.

use std::sync::Arc;

use realfft::num_complex::Complex;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};

use super::noise_tape::{SIGNALS, Tape};

/// Whitened Fourier transform of a block of one signal; empty if the signal is zero in the block.
type Spectrum = Vec<Complex<f32>>;

/// Number of samples of a block. The searched recordings are processed in overlapping blocks.
const BLOCK: usize = 4096;
/// Number of samples in a template after resampling to the rate of the searched recording. A template is so short that
/// the clocks of the two recordings differ by less than one sample at its end.
pub(super) const TEMPLATE: usize = 2048;
/// Number of lags at which a template is correlated with one block. These are the lags at which the template lies
/// completely within the block.
const LAGS: usize = BLOCK - TEMPLATE;
/// Share of a block or template that is tapered at each end. Without the taper, the edges would spread periodic
/// vibration over all frequencies.
const TAPER: f64 = 0.05;
/// Distance from the lag of the largest correlation, in samples. Other large correlations at lags within this distance
/// are ignored, because a copy with lost samples has large correlations at several neighbouring lags. Large
/// correlations at a greater distance indicate a periodic signal instead of a copy.
const NEAR: usize = 64;

/// Number of samples in each part into which [`Transform::sigmas_without_pulses`] divides a block.
const PART: usize = 64;
/// Number of parts that [`Transform::sigmas_without_pulses`] leaves out. A short pulse (knock or wrong sample) covers
/// at most this number of parts.
const PULSE_PARTS: usize = 2;

/// The two groups of signals, as ranges of their indices. Each group is correlated separately. The first group has the
/// three signals that depend on the order of the axes, and the second has the signal that does not.
const KINDS: [std::ops::Range<usize>; 2] = [0..3, 3..SIGNALS];

/// A template: part of the noise of one recording. Other recordings are searched for this part.
pub(super) struct Template {
    /// Index of the recording from which the template is taken.
    pub(super) recording: usize,
    /// Index of the first sample of the template in the recording.
    pub(super) first: usize,
    /// Number of samples of the recording that the template covers.
    pub(super) samples: usize,
    /// Index of the tape (concatenated recordings) in which the template is searched for.
    pub(super) tape: usize,
    /// The tape (concatenated recordings) is searched up to this sample. The search ends before the template's own
    /// recording, so the template is not compared with itself.
    pub(super) until: usize,
    /// Conjugate whitened spectrum of each signal; empty for a signal that is zero.
    spectra: [Spectrum; SIGNALS],
}

/// The largest correlation of a template with a tape. All correlations are divided by the standard deviation of the
/// correlation for independent noise.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Peak {
    /// The largest correlation.
    pub(super) sigmas: f32,
    /// Index of the tape's sample with which the first sample of the template coincides at this correlation. It is
    /// negative if the template begins before the start of the tape.
    pub(super) at: isize,
    /// Largest correlation among the lags that differ by more than [`NEAR`] samples from the lag of `sigmas`.
    pub(super) elsewhere: f32,
}

pub(super) struct Transform {
    forward: Arc<dyn RealToComplex<f32>>,
    inverse: Arc<dyn ComplexToReal<f32>>,
    block_taper: Vec<f32>,
    template_taper: Vec<f32>,
    buffer: Vec<f32>,
    product: Vec<Complex<f32>>,
    scratch: Vec<Complex<f32>>,
}

impl Transform {
    pub(super) fn new() -> Self {
        let mut planner = RealFftPlanner::new();
        let (forward, inverse) = (planner.plan_fft_forward(BLOCK), planner.plan_fft_inverse(BLOCK));
        let scratch = forward.get_scratch_len().max(inverse.get_scratch_len());
        Self {
            block_taper: taper(BLOCK),
            template_taper: taper(TEMPLATE),
            buffer: vec![0.0; BLOCK],
            product: vec![Complex::default(); BLOCK / 2 + 1],
            scratch: vec![Complex::default(); scratch],
            forward,
            inverse,
        }
    }

    /// Returns the template that begins `first` samples after the start of `range`. `range` contains the samples of the
    /// recording on the tape `from` (concatenated recordings). `ratio` is the sampling rate of the searched tape
    /// divided by the sampling rate of the recording.
    ///
    /// The signals on a tape are second differences of the samples. A second difference is the change of slope of the
    /// linear interpolation between samples. To resample a signal to another rate, the function distributes each change
    /// of slope over the two nearest samples of the new rate.
    pub(super) fn template(
        &mut self,
        from: &Tape,
        (recording, range): (usize, &std::ops::Range<usize>),
        first: usize,
        ratio: f64,
        (tape, until): (usize, usize),
    ) -> Template {
        let samples = samples_of(ratio).min(range.len() - first);
        let spectra = std::array::from_fn(|k| {
            let signal = &from.signals[k][range.start + first..][..samples];
            self.buffer.fill(0.0);
            for (i, value) in signal.iter().enumerate() {
                let position = i as f64 * ratio;
                let (at, share) = (position as usize, position.fract() as f32);
                self.buffer[at] += value * (1.0 - share);
                self.buffer[at + 1] += value * share;
            }
            for (value, taper) in self.buffer.iter_mut().zip(&self.template_taper) {
                *value *= taper;
            }
            let mut spectrum = self.whitened();
            spectrum.iter_mut().for_each(|value| value.im = -value.im);
            spectrum
        });
        Template { recording, first, samples, tape, until, spectra }
    }

    /// Finds the largest correlation of each template with the tape (concatenated recordings) in which it is searched
    /// for. The result has one value for each group of signals in [`KINDS`].
    pub(super) fn search(&mut self, tapes: &[Tape], templates: &[Template]) -> Vec<[Peak; 2]> {
        let mut tops: Vec<[Vec<Peak>; 2]> = templates.iter().map(|_| Default::default()).collect();
        for (index, tape) in tapes.iter().enumerate() {
            let here = |template: &&Template| template.tape == index;
            let until = templates.iter().filter(here).map(|template| template.until).max().unwrap_or(0);
            for first in (0..until + TEMPLATE).step_by(LAGS) {
                let first = first as isize - TEMPLATE as isize;
                let spectra: [Spectrum; SIGNALS] = std::array::from_fn(|k| self.block(&tape.signals[k], first));
                for (template, tops) in templates.iter().zip(&mut tops) {
                    if !here(&template) || first >= template.until as isize {
                        continue;
                    }
                    for (kind, tops) in KINDS.iter().zip(tops) {
                        let lags = LAGS.min((template.until as isize - first) as usize);
                        let pair = (&spectra[kind.clone()], &template.spectra[kind.clone()]);
                        tops.extend(self.correlate(pair, (first, lags)));
                    }
                }
            }
        }
        tops.iter().map(|kinds| kinds.each_ref().map(|tops| highest(tops))).collect()
    }

    /// Returns the correlation at `peak` without the contributions of the [`PULSE_PARTS`] parts of the block that
    /// contribute most. It is divided by the same standard deviation as `peak`. `tape` is the tape in which the
    /// template is searched for, and `kind` the index of the group of signals in [`KINDS`].
    ///
    /// Two independent recordings with short pulses (knocks or wrong samples) are correlated at a lag at which pulses
    /// coincide. Only the parts with the pulses contribute to this correlation, so the result is nearly zero for one
    /// pulse. Two pulses coincide at the same lag if the time between them is the same in both recordings. This is
    /// frequent if one sample in a thousand is wrong. If the coinciding pulses cover more than [`PULSE_PARTS`] parts,
    /// some correlation remains. In a copy, the noise in all parts contributes, so most of the correlation remains.
    pub(super) fn sigmas_without_pulses(&mut self, tape: &Tape, template: &Template, kind: usize, peak: &Peak) -> f32 {
        let from_start = (peak.at + TEMPLATE as isize).max(0) as usize;
        let (first, shift) = (from_start / LAGS * LAGS, from_start % LAGS);
        let mut parts = [0.0_f32; BLOCK / PART];
        for k in KINDS[kind].clone() {
            let block = self.block(&tape.signals[k], first as isize - TEMPLATE as isize);
            let own = template.spectra[k].iter().map(Complex::conj).collect();
            let (block, own) = (self.whitened_signal(block), self.whitened_signal(own));
            for (i, (block, own)) in block.iter().zip(own.iter().cycle().skip(BLOCK - shift)).enumerate() {
                parts[i / PART] += block * own;
            }
        }
        let sum: f32 = parts.iter().sum();
        let mut shares = parts.map(|part| part / sum);
        shares.sort_unstable_by(f32::total_cmp);
        peak.sigmas * shares[..shares.len() - PULSE_PARTS].iter().sum::<f32>()
    }

    /// Computes the signal whose whitened spectrum is `spectrum`, multiplied by a constant factor; empty if the signal
    /// is zero.
    fn whitened_signal(&mut self, mut spectrum: Spectrum) -> Vec<f32> {
        let mut signal = vec![0.0; BLOCK];
        let length = self.inverse.get_scratch_len();
        match self.inverse.process_with_scratch(&mut spectrum, &mut signal, &mut self.scratch[..length]) {
            Ok(()) => signal,
            Err(_) => Vec::new(),
        }
    }

    /// Computes the whitened spectrum of the block that begins at sample `first` of a signal. The block may begin
    /// before the signal and end after it; samples outside the signal are zero.
    fn block(&mut self, signal: &[f32], first: isize) -> Spectrum {
        let clipped = |at: isize| at.clamp(0, signal.len() as isize) as usize;
        let (start, end) = (clipped(first), clipped(first + BLOCK as isize));
        self.buffer.fill(0.0);
        if start < end {
            let offset = (start as isize - first) as usize;
            let place = offset..offset + end - start;
            let tapers = &self.block_taper[place.clone()];
            for ((value, sample), taper) in self.buffer[place].iter_mut().zip(&signal[start..end]).zip(tapers) {
                *value = sample * taper;
            }
        }
        self.whitened()
    }

    /// Computes the spectrum of the signal in `buffer`, divided by its magnitude at every frequency; empty if the
    /// signal is zero.
    fn whitened(&mut self) -> Spectrum {
        if self.buffer.iter().all(|value| *value == 0.0) {
            return Vec::new();
        }
        let mut spectrum = vec![Complex::default(); BLOCK / 2 + 1];
        let length = self.forward.get_scratch_len();
        let done = self.forward.process_with_scratch(&mut self.buffer, &mut spectrum, &mut self.scratch[..length]);
        if done.is_err() {
            return Vec::new();
        }
        for value in &mut spectrum {
            let squared = value.norm_sqr();
            let inverse = if squared > 0.0 { 1.0 / squared.sqrt() } else { 0.0 };
            *value = Complex::new(value.re * inverse, value.im * inverse);
        }
        spectrum
    }

    /// Finds the largest correlation of a block with a template at the first `lags` lags. `first` is the sample of the
    /// tape at which the block begins. `None` if, in each signal, the block or the template is zero.
    fn correlate(
        &mut self,
        (block, template): (&[Spectrum], &[Spectrum]),
        (first, lags): (isize, usize),
    ) -> Option<Peak> {
        self.product.fill(Complex::default());
        let mut signals = 0;
        for (block, template) in block.iter().zip(template) {
            signals += usize::from(!block.is_empty() && !template.is_empty());
            for ((sum, block), template) in self.product.iter_mut().zip(block).zip(template) {
                *sum += block * template;
            }
        }
        if signals == 0 {
            return None;
        }
        // The inverse transform requires real values at frequency 0 and at half of the sampling rate. The imaginary
        // parts there are only rounding errors and are set to zero.
        self.product[0].im = 0.0;
        self.product[BLOCK / 2].im = 0.0;
        let length = self.inverse.get_scratch_len();
        self.inverse.process_with_scratch(&mut self.product, &mut self.buffer, &mut self.scratch[..length]).ok()?;
        let lags = &self.buffer[..lags];
        let top = largest(lags);
        let at = lags.iter().position(|value| value.abs() == top)?;
        let elsewhere =
            largest(&lags[..at.saturating_sub(NEAR)]).max(largest(&lags[(at + NEAR + 1).min(lags.len())..]));
        let sigma = ((signals * BLOCK) as f32).sqrt();
        Some(Peak { sigmas: top / sigma, at: first + at as isize, elsewhere: elsewhere / sigma })
    }
}

/// Largest magnitude. Eight interleaved maxima are computed independently, so that the compiler can use vector
/// instructions.
fn largest(values: &[f32]) -> f32 {
    let larger = |most: f32, value: f32| if value.abs() > most { value.abs() } else { most };
    let (fulls, rest) = values.as_chunks::<8>();
    let mut most = [0.0_f32; 8];
    for full in fulls {
        (0..8).for_each(|k| most[k] = larger(most[k], full[k]));
    }
    most.iter().chain(rest).copied().fold(0.0, larger)
}

/// Number of samples of a recording that a template covers, if the sampling rate of the searched tape is `ratio` times
/// the sampling rate of the recording.
pub(super) fn samples_of(ratio: f64) -> usize {
    ((TEMPLATE - 2) as f64 / ratio) as usize + 1
}

/// Finds the largest correlation of a template with a tape. `tops` contains the largest correlation for each block of
/// the tape. The field `elsewhere` of the result is the largest correlation at the lags of the tape that differ by more
/// than [`NEAR`] samples from the lag of the result.
fn highest(tops: &[Peak]) -> Peak {
    let Some(&top) = tops.iter().max_by(|a, b| a.sigmas.total_cmp(&b.sigmas)) else { return Peak::default() };
    let others = tops.iter().filter(|other| other.at.abs_diff(top.at) > NEAR).map(|other| other.sigmas);
    Peak { elsewhere: others.fold(top.elsewhere, f32::max), ..top }
}

/// Weights of a Tukey window: the value 1 in the middle, and raised cosines at both ends.
fn taper(length: usize) -> Vec<f32> {
    let edge = (TAPER * length as f64) as usize;
    let weight = |i: usize| {
        let from_end = i.min(length - 1 - i);
        if from_end >= edge {
            return 1.0;
        }
        ((from_end as f32 + 0.5) / edge as f32 * std::f32::consts::FRAC_PI_2).sin().powi(2)
    };
    (0..length).map(weight).collect()
}
