//! Fast reader for columns of numbers in a text table.
//!
//! The text is passed in blocks, so that a long file is never in memory as a whole. Only plain tables are read, in
//! which each used field is a decimal number and all lines have equal numbers of fields. Anything else (quotes, empty
//! fields, dates, text) is the error [`NotPlain`], after which a more general reader must read the file.
//!
//! Numbers are rounded correctly, like those of [`str::parse`].

use crate::numerics::workers::{in_order, processors};

/// Minimum size of a block, in bytes, for its lines to be distributed among threads.
const WORTH_THREADS: usize = 1 << 20;
/// Up to this integer, float64 represents every integer exactly.
const LARGEST_EXACT: u64 = 1 << 53;
/// Number of values for which a column reserves memory. The size is more than 32 MB, so that the allocator of Linux
/// maps the memory directly from the system. Only pages in use then count as memory, and the column can grow without
/// being copied, which avoids fragmentation.
const RESERVED: usize = (1 << 22) + (1 << 10);
/// Powers of ten that a float64 represents exactly.
const POWERS: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20,
    1e21, 1e22,
];
/// Number of decimal digits that always fit into an unsigned 64-bit integer.
const DIGITS: usize = 19;
/// Exponent of the largest power of ten below 2^64.
const LARGEST_DIVISOR: usize = 19;

/// Format of a text table.
#[derive(Clone, Debug)]
pub struct Form {
    /// Separator between two fields. A space means any number of spaces and tabs.
    pub separator: u8,
    /// Character of the decimal point.
    pub decimal: u8,
    /// For each field of a line, whether it is a column of the result.
    pub used: Vec<bool>,
}

/// A column of numbers. It contains integers if all numbers are written without decimal point and exponent.
#[derive(Clone, Debug, PartialEq)]
pub enum Column {
    /// Integers that fit into 64 bits.
    Whole(Vec<i64>),
    /// All other numbers.
    Real(Vec<f64>),
}

/// Error for a text that contains anything other than lines of plain numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotPlain;

/// Reader of the columns of a text that is passed in blocks.
#[derive(Debug)]
pub struct NumberColumns {
    form: Form,
    columns: Vec<Growing>,
    /// Start of a line whose end is in the next block.
    rest: Vec<u8>,
}

impl NumberColumns {
    /// An empty table.
    #[must_use]
    pub fn new(form: Form) -> Self {
        let columns = form.columns(RESERVED);
        Self { form, columns, rest: Vec::new() }
    }

    /// Adds the lines of a block.
    ///
    /// # Errors
    ///
    /// [`NotPlain`] if the block is not plain. The table must not be used afterwards.
    pub fn add(&mut self, block: &[u8]) -> Result<(), NotPlain> {
        let Some(first) = block.iter().position(|&byte| byte == b'\n') else {
            self.rest.extend_from_slice(block);
            return Ok(());
        };
        let last = block.iter().rposition(|&byte| byte == b'\n').unwrap_or(first);
        self.rest.extend_from_slice(&block[..=first]);
        let rest = std::mem::take(&mut self.rest);
        self.add_lines(&rest)?;
        self.add_lines(&block[first + 1..=last.max(first)])?;
        self.rest.extend_from_slice(&block[last + 1..]);
        Ok(())
    }

    /// The columns.
    ///
    /// # Errors
    ///
    /// [`NotPlain`] if the last line, which may lack a line end, is not plain.
    pub fn finish(mut self) -> Result<Vec<Column>, NotPlain> {
        let rest = std::mem::take(&mut self.rest);
        self.add_lines(&rest)?;
        Ok(self.columns.into_iter().map(|column| column.numbers).collect())
    }

    fn add_lines(&mut self, lines: &[u8]) -> Result<(), NotPlain> {
        let threads = if lines.len() < WORTH_THREADS { 1 } else { processors() };
        if threads == 1 {
            return self.form.read(lines, &mut self.columns);
        }
        let pieces = split(lines, threads);
        let form = &self.form;
        let read = in_order(threads, pieces.len(), |index| {
            let mut columns = form.columns(0);
            form.read(pieces[index], &mut columns).map(|()| columns)
        });
        for piece in read {
            for (column, more) in self.columns.iter_mut().zip(piece?) {
                column.append(more);
            }
        }
        Ok(())
    }
}

/// Divides lines into `count` pieces of about equal size.
fn split(lines: &[u8], count: usize) -> Vec<&[u8]> {
    let mut pieces = Vec::with_capacity(count);
    let mut rest = lines;
    for left in (1..=count).rev() {
        let about = rest.len() / left;
        let end = rest[about..].iter().position(|&byte| byte == b'\n').map_or(rest.len(), |at| about + at + 1);
        let (piece, after) = rest.split_at(end);
        pieces.push(piece);
        rest = after;
    }
    pieces
}

/// A column to which numbers are added.
#[derive(Debug)]
struct Growing {
    numbers: Column,
    /// Rows with `-0` in a column of integers. They are stored because -0 differs from 0 if the column is later
    /// converted to reals.
    negative_zeros: Vec<usize>,
}

impl Growing {
    fn push(&mut self, number: Number) {
        match (&mut self.numbers, number) {
            (Column::Whole(values), Number::Whole { value, negative }) => {
                if negative && value == 0 {
                    self.negative_zeros.push(values.len());
                }
                values.push(value);
            }
            (Column::Real(values), number) => values.push(number.real()),
            (Column::Whole(_), number) => self.reals().push(number.real()),
        }
    }

    fn append(&mut self, more: Self) {
        match (&mut self.numbers, more.numbers) {
            (Column::Whole(values), Column::Whole(others)) => {
                self.negative_zeros.extend(more.negative_zeros.iter().map(|row| row + values.len()));
                values.extend(others);
            }
            (_, Column::Real(others)) => self.reals().extend(others),
            (Column::Real(_), whole @ Column::Whole(_)) => {
                let mut others = Self { numbers: whole, negative_zeros: more.negative_zeros };
                let others = std::mem::take(others.reals());
                self.reals().extend(others);
            }
        }
    }

    /// The column, converted to reals if necessary.
    fn reals(&mut self) -> &mut Vec<f64> {
        if let Column::Whole(values) = &self.numbers {
            let mut reals: Vec<f64> = Vec::with_capacity(values.capacity());
            #[allow(clippy::cast_precision_loss)] // The integer is rounded like the text of the number.
            reals.extend(values.iter().map(|&value| value as f64));
            for row in self.negative_zeros.drain(..) {
                reals[row] = -0.0;
            }
            self.numbers = Column::Real(reals);
        }
        match &mut self.numbers {
            Column::Real(values) => values,
            Column::Whole(_) => unreachable!("it was converted above"),
        }
    }
}

#[derive(Clone, Copy)]
enum Number {
    Whole { value: i64, negative: bool },
    Real(f64),
}

impl Number {
    #[allow(clippy::cast_precision_loss)] // The integer is rounded like the text of the number.
    fn real(self) -> f64 {
        match self {
            Self::Whole { value: 0, negative: true } => -0.0,
            Self::Whole { value, .. } => value as f64,
            Self::Real(value) => value,
        }
    }
}

impl Form {
    fn columns(&self, reserved: usize) -> Vec<Growing> {
        let column = || Growing { numbers: Column::Whole(Vec::with_capacity(reserved)), negative_zeros: Vec::new() };
        self.used.iter().filter(|&&is_used| is_used).map(|_| column()).collect()
    }

    /// Adds all lines to the columns.
    fn read(&self, lines: &[u8], columns: &mut [Growing]) -> Result<(), NotPlain> {
        let mut cursor = Cursor { text: lines, at: 0 };
        let is_spaced = self.separator == b' ';
        while cursor.at < lines.len() {
            if cursor.line_end() {
                continue;
            }
            let mut slots = columns.iter_mut();
            for (field, &is_used) in self.used.iter().enumerate() {
                if field > 0 && !is_spaced {
                    cursor.expect(self.separator)?;
                }
                cursor.skip_spaces(self.separator);
                if is_used {
                    let number = cursor.number(self.decimal)?;
                    if let Some(slot) = slots.next() {
                        slot.push(number);
                    }
                } else {
                    cursor.skip_field(self.separator)?;
                }
                let end = cursor.at;
                cursor.skip_spaces(self.separator);
                let is_last = field + 1 == self.used.len();
                // Two numbers must be separated by a space.
                if is_spaced && !is_last && cursor.at == end {
                    return Err(NotPlain);
                }
            }
            if cursor.at < lines.len() && !cursor.line_end() {
                return Err(NotPlain);
            }
        }
        Ok(())
    }
}

struct Cursor<'a> {
    text: &'a [u8],
    at: usize,
}

impl Cursor<'_> {
    fn peek(&self) -> u8 {
        // The end of the text is reported as a zero byte, which occurs in no line.
        self.text.get(self.at).copied().unwrap_or(0)
    }

    /// Skips a line end, if there is one at the cursor, and returns whether there was.
    fn line_end(&mut self) -> bool {
        let length = match self.peek() {
            b'\n' => 1,
            b'\r' if self.text.get(self.at + 1) == Some(&b'\n') => 2,
            _ => return false,
        };
        self.at += length;
        true
    }

    fn expect(&mut self, byte: u8) -> Result<(), NotPlain> {
        if self.peek() != byte {
            return Err(NotPlain);
        }
        self.at += 1;
        Ok(())
    }

    fn skip_spaces(&mut self, separator: u8) {
        while self.peek() == b' ' || (separator != b'\t' && self.peek() == b'\t') {
            self.at += 1;
        }
    }

    fn skip_field(&mut self, separator: u8) -> Result<(), NotPlain> {
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

    /// Reads the digits at the cursor, appends them to `mantissa` and returns their number.
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

    fn number(&mut self, decimal: u8) -> Result<Number, NotPlain> {
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

    /// Reads an exponent such as `e-12`.
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

/// The number that eight bytes represent, if all of them are digits. All eight are processed together.
fn eight_digits(bytes: [u8; 8]) -> Option<u64> {
    const HIGH: u64 = 0xf0f0_f0f0_f0f0_f0f0;
    const ZEROS: u64 = 0x3030_3030_3030_3030;
    let chunk = u64::from_le_bytes(bytes);
    let is_digits = chunk & HIGH == ZEROS && chunk.wrapping_add(0x0606_0606_0606_0606) & HIGH == ZEROS;
    // Digits are combined to pairs, and the four pairs are then added with their weights. The first digit is in the
    // lowest byte.
    let pairs = chunk.wrapping_sub(ZEROS);
    let pairs = pairs.wrapping_mul(10).wrapping_add(pairs >> 8);
    let first_and_third = (pairs & 0x0000_00ff_0000_00ff).wrapping_mul(1_000_000 << 32 | 100);
    let second_and_fourth = (pairs >> 16 & 0x0000_00ff_0000_00ff).wrapping_mul(10_000 << 32 | 1);
    is_digits.then_some(first_and_third.wrapping_add(second_and_fourth) >> 32)
}

/// mantissa * 10^exponent, correctly rounded; `None` for exponents that need a more general algorithm.
#[allow(clippy::cast_precision_loss, clippy::cast_possible_truncation)] // Each cast is exact, as said there.
fn rounded(mantissa: u64, exponent: i64) -> Option<f64> {
    let index = usize::try_from(exponent.unsigned_abs()).ok()?;
    if mantissa <= LARGEST_EXACT {
        // Both operands are exact, so the result is rounded only once.
        let power = POWERS.get(index)?;
        return Some(if exponent < 0 { mantissa as f64 / power } else { mantissa as f64 * power });
    }
    if exponent >= 0 || index > LARGEST_DIVISOR {
        return None;
    }
    // The quotient has at least 64 bits, of which 53 are kept. The dropped bits and the remainder determine the
    // rounding.
    let divisor = 10_u128.pow(index as u32);
    let dividend = u128::from(mantissa) << 64;
    let (quotient, remainder) = (dividend / divisor, dividend % divisor);
    let excess = (128 - quotient.leading_zeros()).checked_sub(53).filter(|&excess| excess > 1)?;
    let (kept, half) = (quotient >> excess, 1 << (excess - 1));
    let cut = quotient & ((1 << excess) - 1);
    let is_up = cut > half || (cut == half && (remainder > 0 || kept & 1 == 1));
    // The significand is at most 2^53 and therefore exact, and so is the power of two.
    let significand = (kept + u128::from(is_up)) as f64;
    Some(significand * f64::from_bits((1023 + u64::from(excess) - 64) << 52))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str, separator: u8, used: &[bool]) -> Result<Vec<Column>, NotPlain> {
        let mut results = Vec::new();
        // The result must be the same for all positions of the border between two blocks.
        for border in 0..=text.len() {
            let decimal = if separator == b';' { b',' } else { b'.' };
            let mut table = NumberColumns::new(Form { separator, decimal, used: used.to_vec() });
            let (first, second) = text.as_bytes().split_at(border);
            let result = table.add(first).and_then(|()| table.add(second)).and_then(|()| table.finish());
            results.push(result);
        }
        assert!(results.windows(2).all(|two| two[0] == two[1]));
        results.swap_remove(0)
    }

    #[test]
    fn numbers_are_rounded_like_the_standard_library_does() {
        for text in [
            "0.1",
            "-9.80665",
            "1e22",
            "1.7976931348623157e308",
            "5e-324",
            "12345678901234567890",
            "9007199254740993.0",
            "3.141592653589793238",
            "0.000000000000000000000001",
            "-0.0",
            "1.",
            ".5",
            "1E+2",
            "123456789.01234567",
            "12345678901234567890123",
            "4.35",
            "2.2250738585072011e-308",
        ] {
            let Ok(columns) = read(&format!("{text}\n0.5\n"), b',', &[true]) else { panic!("{text}") };
            let Column::Real(values) = &columns[0] else { panic!("{text}") };
            assert_eq!(values[0].to_bits(), text.parse::<f64>().unwrap().to_bits(), "{text}");
        }
    }

    #[test]
    fn random_numbers_are_rounded_like_the_standard_library_does() {
        let mut state = 1_u64;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            state >> 1
        };
        for digits in 0..20_000 {
            let (mantissa, decimals) = (next() % 10_u64.pow(1 + digits % 19), next() % 21);
            let padded = format!("{mantissa:021}");
            let (whole, fraction) = padded.split_at(21 - usize::try_from(decimals).unwrap());
            let text = format!("{}.{fraction}0", whole.trim_start_matches('0'));
            let Ok(columns) = read_at_once(&format!("{text}\n")) else { panic!("{text}") };
            assert_eq!(columns, [Column::Real(vec![text.parse().unwrap()])], "{text}");
        }
    }

    fn read_at_once(text: &str) -> Result<Vec<Column>, NotPlain> {
        let mut table = NumberColumns::new(Form { separator: b',', decimal: b'.', used: vec![true] });
        table.add(text.as_bytes())?;
        table.finish()
    }

    #[test]
    fn integers_stay_integers_until_a_real_follows() {
        let whole = read("1700000000123456789,-0\n-5,7\r\n\n007,1\n", b',', &[true, true]);
        let expected = vec![Column::Whole(vec![1_700_000_000_123_456_789, -5, 7]), Column::Whole(vec![0, 7, 1])];
        assert_eq!(whole, Ok(expected));
        let large = read("9223372036854775807\n9223372036854775808", b',', &[true]);
        assert_eq!(large, Ok(vec![Column::Real(vec![9_223_372_036_854_775_807.0, 9_223_372_036_854_775_808.0])]));
        let mixed = read("-0\n3\n0.5\n4\n", b',', &[true]).unwrap();
        let Column::Real(values) = &mixed[0] else { panic!() };
        assert_eq!(values, &[0.0, 3.0, 0.5, 4.0]);
        assert!(values[0].is_sign_negative());
    }

    #[test]
    fn fields_are_separated_and_left_out() {
        let spaced = read("  1.5\t 2 x 3\n4 5  y  6  \n", b' ', &[true, true, false, true]);
        assert_eq!(
            spaced,
            Ok(vec![Column::Real(vec![1.5, 4.0]), Column::Whole(vec![2, 5]), Column::Whole(vec![3, 6])])
        );
        let comma = read("1,5; text ;2\n-2,25;;3\n", b';', &[true, false, true]);
        assert_eq!(comma, Ok(vec![Column::Real(vec![1.5, -2.25]), Column::Whole(vec![2, 3])]));
    }

    #[test]
    fn anything_else_is_not_plain() {
        for text in [
            "1,,3\n",
            "1,2\n",
            "1,2,3,4\n",
            "1,2,x\n",
            "1,\"2\",3\n",
            "1,nan,3\n",
            "+1,2,3\n",
            "1,2,3\rx\n",
            "1 2,2,3\n",
            "0x1,2,3\n",
            "1e,2,3\n",
            "1,2,1e999\n",
            "-,2,3\n",
            ".,2,3\n",
            "# 1,2,3\n",
            "1,2,3,\n",
        ] {
            assert_eq!(read(text, b',', &[true; 3]), Err(NotPlain), "{text}");
        }
        assert_eq!(read("1 2\n", b' ', &[true; 3]), Err(NotPlain));
    }

    #[test]
    fn a_large_block_is_read_by_threads_in_order() {
        let rows: Vec<i64> = (0..200_000).collect();
        let text: String = rows.iter().map(|row| format!("{row},{}\n", row / 150_000)).collect();
        let mut table = NumberColumns::new(Form { separator: b',', decimal: b'.', used: vec![true, false] });
        assert!(text.len() > WORTH_THREADS);
        table.add(text.as_bytes()).unwrap();
        assert_eq!(table.finish(), Ok(vec![Column::Whole(rows)]));
    }
}
