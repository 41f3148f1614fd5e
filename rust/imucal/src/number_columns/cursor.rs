//! Reads the fields of a text table one after the other, and rounds their numbers correctly.

use super::NotPlain;

/// Largest integer up to which float64 represents every integer exactly.
const LARGEST_EXACT: u64 = 1 << 53;
/// Powers of ten that a float64 represents exactly.
const POWERS: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20,
    1e21, 1e22,
];
/// Number of decimal digits that always fit into an unsigned 64-bit integer.
const DIGITS: usize = 19;
/// Largest exponent e for which [`rounded`] divides by 10^e; 10^19 is the largest power of ten below 2^64.
const LARGEST_DIVISOR: usize = 19;

/// A number of a text table.
#[derive(Clone, Copy)]
pub(super) enum Number {
    Whole { value: i64, negative: bool },
    Real(f64),
}

impl Number {
    #[allow(clippy::cast_precision_loss)] // Rounds to the nearest f64, as parsing the text would.
    pub(super) fn real(self) -> f64 {
        match self {
            Self::Whole { value: 0, negative: true } => -0.0,
            Self::Whole { value, .. } => value as f64,
            Self::Real(value) => value,
        }
    }
}

/// A position in the text of a table.
pub(super) struct Cursor<'a> {
    pub(super) text: &'a [u8],
    pub(super) at: usize,
}

impl Cursor<'_> {
    fn peek(&self) -> u8 {
        // The end of the text is read as a zero byte, which no line of a plain table contains.
        self.text.get(self.at).copied().unwrap_or(0)
    }

    /// Skips a line end at the cursor, if there is one. Returns whether there was a line end.
    pub(super) fn line_end(&mut self) -> bool {
        let length = match self.peek() {
            b'\n' => 1,
            b'\r' if self.text.get(self.at + 1) == Some(&b'\n') => 2,
            _ => return false,
        };
        self.at += length;
        true
    }

    pub(super) fn expect(&mut self, byte: u8) -> Result<(), NotPlain> {
        if self.peek() != byte {
            return Err(NotPlain);
        }
        self.at += 1;
        Ok(())
    }

    pub(super) fn skip_spaces(&mut self, separator: u8) {
        while self.peek() == b' ' || (separator != b'\t' && self.peek() == b'\t') {
            self.at += 1;
        }
    }

    pub(super) fn skip_field(&mut self, separator: u8) -> Result<(), NotPlain> {
        let start = self.at;
        loop {
            match self.text.get(self.at) {
                None | Some(b'\n' | b'\r') => break,
                Some(b'"') => return Err(NotPlain),
                Some(&byte) if byte == separator || (separator == b' ' && byte == b'\t') => break,
                Some(_) => self.at += 1,
            }
        }
        if separator == b' ' && self.at == start { Err(NotPlain) } else { Ok(()) }
    }

    /// Reads the digits at the cursor and appends them to `mantissa`. Returns the number of digits.
    fn digits(&mut self, mantissa: &mut u64) -> usize {
        let start = self.at;
        while let Some(eight) =
            self.text.get(self.at..).and_then(<[u8]>::first_chunk).and_then(|chunk| eight_digits(*chunk))
        {
            *mantissa = mantissa.wrapping_mul(100_000_000).wrapping_add(eight);
            self.at += 8;
        }
        while let Some(&byte) = self.text.get(self.at) {
            let digit = byte.wrapping_sub(b'0');
            if digit > 9 {
                break;
            }
            *mantissa = mantissa.wrapping_mul(10).wrapping_add(u64::from(digit));
            self.at += 1;
        }
        self.at - start
    }

    pub(super) fn number(&mut self, decimal: u8) -> Result<Number, NotPlain> {
        let start = self.at;
        let negative = self.peek() == b'-';
        self.at += usize::from(negative);
        let mut mantissa = 0;
        let mut count = self.digits(&mut mantissa);
        let mut exponent = 0_i64;
        let mut is_whole = true;
        if self.peek() == decimal {
            is_whole = false;
            self.at += 1;
            let decimals = self.digits(&mut mantissa);
            count += decimals;
            exponent -= i64::try_from(decimals).map_err(|_| NotPlain)?;
        }
        if count == 0 {
            return Err(NotPlain);
        }
        if self.peek() | 0x20 == b'e' {
            is_whole = false;
            exponent += self.exponent()?;
        }
        if count <= DIGITS {
            if is_whole && let Ok(value) = i64::try_from(mantissa) {
                return Ok(Number::Whole { value: if negative { -value } else { value }, negative });
            }
            if let Some(value) = rounded(mantissa, exponent) {
                return Ok(Number::Real(if negative { -value } else { value }));
            }
        }
        let text = std::str::from_utf8(&self.text[start..self.at]).map_err(|_| NotPlain)?;
        let parsed = if decimal == b'.' { text.parse() } else { text.replace(char::from(decimal), ".").parse() };
        parsed.ok().filter(|value: &f64| value.is_finite()).map(Number::Real).ok_or(NotPlain)
    }

    /// Reads an exponent, for example `e-12`.
    fn exponent(&mut self) -> Result<i64, NotPlain> {
        self.at += 1;
        let negative = self.peek() == b'-';
        self.at += usize::from(negative || self.peek() == b'+');
        let mut value = 0;
        if !(1..=3).contains(&self.digits(&mut value)) {
            return Err(NotPlain);
        }
        let value = i64::try_from(value).map_err(|_| NotPlain)?;
        Ok(if negative { -value } else { value })
    }
}

/// The number that eight decimal digits represent; `None` if not all eight bytes are digits. The arithmetic processes
/// all eight bytes at once.
fn eight_digits(bytes: [u8; 8]) -> Option<u64> {
    const HIGH: u64 = 0xf0f0_f0f0_f0f0_f0f0;
    const ZEROS: u64 = 0x3030_3030_3030_3030;
    let chunk = u64::from_le_bytes(bytes);
    let is_digits = chunk & HIGH == ZEROS && chunk.wrapping_add(0x0606_0606_0606_0606) & HIGH == ZEROS;
    // Neighbouring digits are combined to four two-digit numbers. These numbers are multiplied by their powers of ten
    // and added. The first digit of the text is in the lowest byte of `chunk`.
    let pairs = chunk.wrapping_sub(ZEROS);
    let pairs = pairs.wrapping_mul(10).wrapping_add(pairs >> 8);
    let first_and_third = (pairs & 0x0000_00ff_0000_00ff).wrapping_mul(1_000_000 << 32 | 100);
    let second_and_fourth = (pairs >> 16 & 0x0000_00ff_0000_00ff).wrapping_mul(10_000 << 32 | 1);
    is_digits.then_some(first_and_third.wrapping_add(second_and_fourth) >> 32)
}

/// mantissa * 10^exponent, correctly rounded; `None` if a more general algorithm is needed.
#[allow(clippy::cast_precision_loss, clippy::cast_possible_truncation)] // Each cast is exact, see below.
fn rounded(mantissa: u64, exponent: i64) -> Option<f64> {
    let index = usize::try_from(exponent.unsigned_abs()).ok()?;
    if mantissa <= LARGEST_EXACT {
        // Both operands are exact, so there is only one rounding.
        let power = POWERS.get(index)?;
        return Some(if exponent < 0 { mantissa as f64 / power } else { mantissa as f64 * power });
    }
    if exponent >= 0 || index > LARGEST_DIVISOR {
        return None;
    }
    // The quotient has at least 54 bits. Its first 53 bits are the significand before rounding. The other bits and the
    // remainder determine whether the significand is rounded up.
    let divisor = 10_u128.pow(index as u32);
    let dividend = u128::from(mantissa) << 64;
    let (quotient, remainder) = (dividend / divisor, dividend % divisor);
    let excess = (128 - quotient.leading_zeros()).checked_sub(53).filter(|&excess| excess > 1)?;
    let (kept, half) = (quotient >> excess, 1 << (excess - 1));
    let cut = quotient & ((1 << excess) - 1);
    let is_up = cut > half || (cut == half && (remainder > 0 || kept & 1 == 1));
    // The significand is at most 2^53 and therefore exact. The power of two is also exact.
    let significand = (kept + u128::from(is_up)) as f64;
    Some(significand * f64::from_bits((1023 + u64::from(excess) - 64) << 52))
}
