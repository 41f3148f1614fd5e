//! Fast reader for columns of numbers in a text table.
//!
//! The text is passed in blocks, so a long file is never in memory as a whole. Only plain tables are read. In a plain
//! table, each field in use is a decimal number, and all lines have equal numbers of fields. Any other text (quotes,
//! empty fields, dates) gives the error [`NotPlain`]. A more general reader must then read the file.
//!
//! Numbers are rounded correctly, as by [`str::parse`].

mod cursor;

use cursor::{Cursor, Number};

use crate::numerics::workers::{in_order, processors};

/// Several threads read the lines of a block if the block has at least this number of bytes.
const WORTH_THREADS: usize = 1 << 20;
/// A text is treated as long if its first block has at least this number of bytes, because many more blocks may follow.
/// For a long text, each column reserves memory for [`RESERVED`] values.
const LONG: usize = 1 << 22;
/// Number of values for which a column of a long text reserves memory. These values need more than 32 MB, so the
/// allocator of Linux maps the memory directly from the system. Only pages that are written then occupy memory. The
/// column can grow into the reserved memory without being copied, which avoids fragmentation.
const RESERVED: usize = (1 << 22) + (1 << 10);

/// Format of a text table.
#[derive(Clone, Debug)]
pub struct Form {
    /// Separator between two fields. A space means any number of spaces and tabs.
    pub separator: u8,
    /// Character of the decimal point.
    pub decimal: u8,
    /// For each field of a line: whether it is a column of the result.
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
    /// Whether memory must still be reserved for the columns.
    is_new: bool,
    /// Start of a line whose end is in the next block.
    rest: Vec<u8>,
}

impl NumberColumns {
    /// Creates a reader for a text with the format `form`. It has read no line yet.
    #[must_use]
    pub fn new(form: Form) -> Self {
        let columns = form.columns(0);
        Self { form, columns, is_new: true, rest: Vec::new() }
    }

    /// Adds the lines of a block.
    ///
    /// # Errors
    ///
    /// [`NotPlain`] if the block contains anything other than lines of decimal numbers. The reader must not be used
    /// afterwards.
    pub fn add(&mut self, block: &[u8]) -> Result<(), NotPlain> {
        let Some(first) = block.iter().position(|&byte| byte == b'\n') else {
            self.rest.extend_from_slice(block);
            return Ok(());
        };
        if std::mem::take(&mut self.is_new) {
            // A short text is read so fast that mapping memory for `RESERVED` values per column would take a noticeable
            // part of the reading time.
            let rows = if block.len() < LONG { self.form.rows(block) } else { RESERVED };
            self.columns = self.form.columns(rows);
        }
        let last = block.iter().rposition(|&byte| byte == b'\n').unwrap_or(first);
        self.rest.extend_from_slice(&block[..=first]);
        let rest = std::mem::take(&mut self.rest);
        self.add_lines(&rest)?;
        self.add_lines(&block[first + 1..=last.max(first)])?;
        self.rest.extend_from_slice(&block[last + 1..]);
        Ok(())
    }

    /// Reads the last line and returns the columns.
    ///
    /// # Errors
    ///
    /// [`NotPlain`] if the last line contains anything other than decimal numbers. The last line may lack a line end.
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
            let mut columns = form.columns(form.rows(pieces[index]));
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
    /// Indices of the rows in which an integer column has the text `-0`. If the column is converted to f64, the values
    /// in these rows become -0.0.
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

    /// The numbers of the column as reals. A column of integers is converted first.
    fn reals(&mut self) -> &mut Vec<f64> {
        if let Column::Whole(values) = &self.numbers {
            let mut reals: Vec<f64> = Vec::with_capacity(values.capacity());
            #[allow(clippy::cast_precision_loss)] // Rounds to the nearest f64, as parsing the text would.
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

impl Form {
    /// Number of rows for which memory is reserved. It is a quarter more than the number of rows that `lines` would
    /// have if all lines were as long as the first line.
    fn rows(&self, lines: &[u8]) -> usize {
        let first = lines.iter().position(|&byte| byte == b'\n').map_or(lines.len(), |end| end + 1);
        lines.len() / first.max(self.used.len()).max(1) * 5 / 4
    }

    fn columns(&self, reserved: usize) -> Vec<Growing> {
        let column = || Growing { numbers: Column::Whole(Vec::with_capacity(reserved)), negative_zeros: Vec::new() };
        self.used.iter().filter(|&&is_used| is_used).map(|_| column()).collect()
    }

    /// Reads the numbers of all lines and appends them to the columns.
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

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str, separator: u8, used: &[bool]) -> Result<Vec<Column>, NotPlain> {
        let mut results = Vec::new();
        // The border between two blocks may be at any position. The result must always be the same.
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
