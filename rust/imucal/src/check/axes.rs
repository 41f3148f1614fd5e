//! Signed permutations of axes, and the recommendations for a gyroscope whose axes do not match the axes of the
//! accelerometer.
//!
//! Let G and A be the signed permutations from the axes of one right-handed body to the reported gyroscope and
//! accelerometer axes. The motion of gravity determines only P = det(A) A G^T (see [`super::kinematics`]). For each of
//! the 48 possible P, there are 48 pairs (A, G), which form two classes. Pairs within a class differ only in the choice
//! of the body axes. The two classes differ in det A:
//!
//! ```text
//! det A = +1   A = I,   G = P^T     the accelerometer is right, the gyroscope columns need P
//! det A = -1   A = -I,  G = P^T     the accelerometer is mirrored: its axes are left-handed
//! ```
//!
//! Gravity cannot distinguish the two classes. A rotation about the vertical distinguishes them, because the rate about
//! the axis that points up has opposite signs in the two classes. The recommendation therefore describes both classes
//! and this rotation.

use nalgebra::Matrix3;

const NAMES: [&str; 3] = ["x", "y", "z"];

/// Assignment of columns to axes: true component k = sign_of\[k\] * raw component column_of\[k\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SignedPermutation {
    pub(super) column_of: [usize; 3],
    pub(super) sign_of: [f64; 3],
}

/// The signed permutation that keeps the order of the axes and multiplies them by the given signs.
const fn signs(sign_of: [f64; 3]) -> SignedPermutation {
    SignedPermutation { column_of: [0, 1, 2], sign_of }
}

const IDENTITY: SignedPermutation = signs([1.0; 3]);
const REVERSED: SignedPermutation = signs([-1.0; 3]);

impl SignedPermutation {
    /// All 48 signed permutations.
    fn all() -> impl Iterator<Item = Self> {
        const ORDERS: [[usize; 3]; 6] = [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]];
        ORDERS.into_iter().flat_map(|column_of| {
            (0..8).map(move |bits| Self {
                column_of,
                sign_of: [0, 1, 2].map(|k| if (bits >> k) & 1 == 1 { -1.0 } else { 1.0 }),
            })
        })
    }

    /// Returns the signed permutation that has the largest correlation with the matrix P (`p`), and this correlation.
    /// Only permutations with the handedness of P are considered. The correlation is the sum over k of
    /// `sign_of[k] P[k, column_of[k]]`, divided by sqrt(3) |P|, where |P| is the Frobenius norm. It is 1 if P is a
    /// positive multiple of the permutation.
    pub(super) fn closest(p: &Matrix3<f64>) -> (Self, f64) {
        let handedness = p.determinant().signum();
        let norm = 3.0f64.sqrt() * p.norm();
        let correlation = |one: &Self| (0..3).map(|k| one.sign_of[k] * p[(k, one.column_of[k])]).sum::<f64>() / norm;
        Self::all()
            .filter(|one| one.determinant() == handedness)
            .map(|one| (one, correlation(&one)))
            .fold((IDENTITY, f64::NEG_INFINITY), |best, next| if next.1 > best.1 { next } else { best })
    }

    pub(super) fn determinant(&self) -> f64 {
        let cyclic = (self.column_of[0] + 1) % 3 == self.column_of[1];
        self.sign_of.iter().product::<f64>() * if cyclic { 1.0 } else { -1.0 }
    }

    pub(super) fn is_identity(&self) -> bool {
        *self == IDENTITY
    }

    pub(super) fn in_order(&self) -> bool {
        self.column_of == [0, 1, 2]
    }

    fn negated(&self) -> Self {
        Self { sign_of: self.sign_of.map(|sign| -sign), ..*self }
    }

    /// The rotation axis, if the permutation is a half turn about a coordinate axis. Such a half turn keeps the sign of
    /// this axis and reverses the other two. `None` for any other permutation.
    pub(super) fn half_turn(&self) -> Option<usize> {
        (0..3).find(|&axis| self.in_order() && (0..3).all(|k| (self.sign_of[k] > 0.0) == (k == axis)))
    }

    /// The axis with the reversed sign, if the permutation reverses exactly one axis and keeps the order of the axes.
    pub(super) fn reversed_axis(&self) -> Option<usize> {
        self.negated().half_turn()
    }

    /// The two exchanged axes, if exactly two are exchanged and all three signs equal `sign`.
    fn exchanged_with(&self, sign: f64) -> Option<[usize; 2]> {
        let mut moved = (0..3).filter(|&k| self.column_of[k] != k);
        let pair = [moved.next()?, moved.next()?];
        (moved.next().is_none() && self.sign_of == [sign; 3]).then_some(pair)
    }

    /// The two exchanged axes, if the permutation is a half turn about a diagonal. Such a half turn exchanges two axes
    /// and reverses all three.
    pub(super) fn exchanged_and_reversed(&self) -> Option<[usize; 2]> {
        self.exchanged_with(-1.0)
    }

    /// The two exchanged axes, if the permutation exchanges two axes and makes no other change.
    pub(super) fn exchanged(&self) -> Option<[usize; 2]> {
        self.exchanged_with(1.0)
    }

    /// Returns a text such as "gyro x follows accelerometer -y", for each gyroscope axis that does not agree with the
    /// accelerometer axis of the same name.
    pub(super) fn mapping(&self) -> String {
        let parts: Vec<String> = (0..3)
            .filter(|&k| self.column_of[k] != k || self.sign_of[k] < 0.0)
            .map(|k| format!("gyro {} follows accelerometer {}{}", NAMES[self.column_of[k]], self.minus(k), NAMES[k]))
            .collect();
        parts.join(", ")
    }

    fn minus(&self, axis: usize) -> &'static str {
        if self.sign_of[axis] < 0.0 { "-" } else { "" }
    }

    /// The value of the option `axes` that applies this permutation. It names the signed columns that become x, y and
    /// z, for example "-y,x,z".
    fn option(&self) -> String {
        [0, 1, 2].map(|k| format!("{}{}", self.minus(k), NAMES[self.column_of[k]])).join(",")
    }
}

/// A possible cause of wrong axes, as text, with the value of the option `axes` that corrects it.
pub(super) struct Cause {
    words: String,
    option: Option<String>,
}

impl Cause {
    fn text(&self) -> String {
        match &self.option {
            Some(option) => format!("{}: pass axes='{option}'", self.words),
            None => self.words.clone(),
        }
    }
}

/// Returns the recommendation for a gyroscope whose axes differ from the axes of the accelerometer by the signed
/// permutation `p`. It contains the two possible causes (right-handed or left-handed accelerometer axes) and the test
/// that distinguishes them.
pub(super) fn recommendation(p: &SignedPermutation) -> String {
    let sign = |is_right: bool| if (p.sign_of[2] > 0.0) == is_right { "positive" } else { "negative" };
    let rate = format!("gyro_{}", NAMES[p.column_of[2]]);
    format!(
        "two causes fit, which gravity alone cannot tell apart. Rest the unit so that accel_z reads +1 g, and turn it \
         counter-clockwise as seen from above. If {rate} reads a {} rate, {}. If {rate} reads a {} rate, {}",
        sign(true),
        right_accelerometer(p).text(),
        sign(false),
        mirrored_accelerometer(p).text()
    )
}

/// Returns the cause with det A = +1, where A is the signed permutation of the accelerometer: its axes are right-handed
/// and need no correction, and the gyroscope columns need the permutation `p`.
fn right_accelerometer(p: &SignedPermutation) -> Cause {
    let option = Some(format!("gyro={}", p.option()));
    if *p == REVERSED {
        return Cause { words: "the sign of the gyroscope is reversed".into(), option };
    }
    if let Some(axis) = p.reversed_axis() {
        return Cause { words: format!("gyro_{} is reversed", NAMES[axis]), option };
    }
    if let Some([one, other]) = p.exchanged() {
        return Cause { words: format!("gyro_{} and gyro_{} are exchanged", NAMES[one], NAMES[other]), option };
    }
    if p.determinant() < 0.0 {
        return Cause { words: "the gyroscope columns are out of order or reversed".into(), option };
    }
    Cause {
        words: format!(
            "the gyroscope is mounted like this, or its columns are out of order: pass axes='gyro={}' for rates along \
             the accelerometer's axes",
            p.option()
        ),
        option: None,
    }
}

/// Returns the cause with det A = -1, where A is the signed permutation of the accelerometer: its axes are left-handed,
/// or its sign is reversed.
fn mirrored_accelerometer(p: &SignedPermutation) -> Cause {
    if *p == REVERSED {
        return Cause {
            words:
                "the columns of both sensors are mirrored in the same way. Rest the unit with each axis of its drawing \
                    up: the column of this axis must read +1 g. If two axes are exchanged, pass axes='y,x,z', \
                    axes='z,y,x' or axes='x,z,y'; if one is reversed, pass axes='-x,y,z', axes='x,-y,z' or \
                    axes='x,y,-z'; these options change both sensors"
                    .into(),
            option: None,
        };
    }
    // P (`p`) is det(A) A G^T. A and G are the signed permutations from the body axes to the reported accelerometer
    // axes and to the reported gyroscope axes. If only the accelerometer is wrong, G = I and det(A) = -1, and therefore
    // P = -A. The accelerometer columns need A^T, which is -P, because P is symmetric in both cases below.
    let alone = p.negated();
    if let Some(axis) = p.half_turn() {
        return Cause {
            words: format!("accel_{} is reversed", NAMES[axis]),
            option: Some(format!("accel={}", alone.option())),
        };
    }
    if let Some([one, other]) = p.exchanged_and_reversed() {
        return Cause {
            words: format!("accel_{} and accel_{} are exchanged", NAMES[one], NAMES[other]),
            option: Some(format!("accel={}", alone.option())),
        };
    }
    Cause {
        words: "the accelerometer is mirrored as well: it reads -g on the axis that points up, or an odd number of its axes is \
                reversed or exchanged. Rest the unit with each axis of its drawing up: the accel column of this axis \
                must read +1 g. If all three read -1 g"
            .into(),
        option: Some(format!("accel={} gyro={}", REVERSED.option(), p.option())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn matrix(s: &SignedPermutation) -> Matrix3<f64> {
        Matrix3::from_fn(|k, column| if s.column_of[k] == column { s.sign_of[k] } else { 0.0 })
    }

    /// The matrices by which a value of the option `axes` multiplies the raw accelerometer and gyroscope vectors.
    fn applied(option: &str) -> [Matrix3<f64>; 2] {
        let of = |words: &str| {
            let rows = words.split(',').map(|word| {
                let axis = NAMES.iter().position(|name| word.trim_start_matches('-') == *name).unwrap();
                nalgebra::Vector3::ith(axis, if word.starts_with('-') { -1.0 } else { 1.0 }).transpose()
            });
            Matrix3::from_rows(&rows.collect::<Vec<_>>())
        };
        let mut both = [Matrix3::identity(); 2];
        for part in option.split(' ') {
            match part.split_once('=') {
                Some(("accel", words)) => both[0] = of(words),
                Some(("gyro", words)) => both[1] = of(words),
                _ => both = [of(part); 2],
            }
        }
        both
    }

    #[test]
    fn there_are_48_and_each_is_its_own_closest() {
        let all: Vec<_> = SignedPermutation::all().collect();
        assert_eq!(all.len(), 48);
        for one in &all {
            assert_eq!(matrix(one).determinant().round(), one.determinant());
            let (closest, correlation) = SignedPermutation::closest(&(2.0 * matrix(one)));
            assert_eq!((closest, (correlation - 1.0).abs() < 1e-12), (*one, true));
        }
    }

    /// For every signed permutation P and both possible causes (right-handed or left-handed accelerometer axes), each
    /// recommended option must align both sensors with one right-handed body.
    #[test]
    fn every_recommended_option_gives_a_consistent_unit() {
        for p in SignedPermutation::all().filter(|p| !p.is_identity()) {
            for (cause, handedness) in [(right_accelerometer(&p), 1.0), (mirrored_accelerometer(&p), -1.0)] {
                let text = cause.text();
                for option in text.split("axes='").skip(1).map(|rest| rest.split('\'').next().unwrap()) {
                    let [accel, gyro] = applied(option);
                    // The option multiplies the accelerometer columns by a = `accel` and the gyroscope columns by
                    // g = `gyro`. It thereby changes P to det(a) a P g^T.
                    let corrected = accel.determinant() * accel * matrix(&p) * gyro.transpose();
                    assert_eq!(corrected, Matrix3::identity(), "{p:?}: {option}");
                    assert_eq!(accel.determinant().round(), handedness, "{p:?}: {option}");
                }
                assert!(text.contains("axes='"), "{text}");
            }
        }
    }

    #[test]
    fn mirrored_columns_have_two_ways_out_and_a_test() {
        let text = recommendation(&REVERSED);
        for part in [
            "two causes fit",
            "counter-clockwise",
            "If gyro_z reads a negative rate, the sign of the gyroscope is reversed: pass axes='gyro=-x,-y,-z'",
            "If gyro_z reads a positive rate, the columns of both sensors are mirrored",
        ] {
            assert!(text.contains(part), "{text}");
        }
    }
}
