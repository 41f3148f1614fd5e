//! Computes the attitude after each of many consecutive rotations.
//!
//! The sequence of rotations is divided into consecutive parts. Each lane of a SIMD register processes one part. A
//! first pass computes the product of the rotations in each part. These products give the attitude at the start of each
//! part. A second pass computes all attitudes.

use nalgebra::{UnitQuaternion, Vector3};
use pulp::{Simd, WithSimd};

use super::lanes::{Lanes, MOST_LANES, Quaternions, lane_start, three};
use super::rotate_by;
use super::step::{half_turn, is_within_range, times_quaternion};
use crate::numerics::instructions::Instructions;

/// Number of rotations that are processed as one block. The data of a block fit into the L1 cache. Within a block, the
/// product of the quaternions is not normalised. Its norm grows with every rotation, but stays below 14.
const AT_ONCE: usize = 512;

/// Computes the attitude after each of the rotations `turns`, which are rotation vectors in the body frame, rad. The
/// first entry of the result is `begin`, the attitude before all rotations. An attitude maps vectors from the body
/// frame to the reference frame: `v_reference = attitude v_body`.
pub(crate) fn attitudes(begin: UnitQuaternion<f64>, turns: &[Vector3<f64>]) -> Vec<UnitQuaternion<f64>> {
    let mut all = Vec::with_capacity(turns.len() + 1);
    all.push(begin);
    for turns in turns.chunks(AT_ONCE) {
        let before = all[all.len() - 1];
        if turns.iter().all(is_within_range) {
            Instructions::Best.run(InLanes { before, turns, to: &mut all });
        } else {
            scalar_steps(before, turns, &mut all);
        }
    }
    all
}

fn scalar_steps(before: UnitQuaternion<f64>, turns: &[Vector3<f64>], to: &mut Vec<UnitQuaternion<f64>>) {
    to.extend(turns.iter().scan(before, |here, turn| {
        rotate_by(here, turn);
        Some(*here)
    }));
}

struct InLanes<'a> {
    before: UnitQuaternion<f64>,
    turns: &'a [Vector3<f64>],
    to: &'a mut Vec<UnitQuaternion<f64>>,
}

impl WithSimd for InLanes<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { before, turns, to } = self;
        let steps = turns.len() / S::F64_LANES;
        let (in_lanes, rest) = turns.split_at(steps * S::F64_LANES);
        let own: [&[Vector3<f64>]; MOST_LANES] =
            std::array::from_fn(|l| &in_lanes[lane_start::<S>(l, steps)..][..steps]);
        let (zero, one) = (Lanes::splat(simd, 0.0), Lanes::splat(simd, 1.0));
        let mut halves = Vec::with_capacity(steps);
        let mut product = [one, zero, zero, zero];
        for k in 0..steps {
            let half = half_turn(simd, three(|c| Lanes::from_fn(simd, |l| own[l][k][c])));
            product = times_quaternion(&product, half);
            halves.push(half);
        }
        let of_lanes = Quaternions::new(&product);
        let mut begins = [before; MOST_LANES];
        for l in 1..S::F64_LANES {
            begins[l] = begins[l - 1] * of_lanes.unit(l - 1);
        }
        let mut here = [3, 0, 1, 2].map(|part: usize| Lanes::from_fn(simd, |l| begins[l].coords[part]));
        let first = to.len();
        to.resize(first + in_lanes.len(), before);
        let to_lanes = &mut to[first..];
        for (k, half) in halves.into_iter().enumerate() {
            here = times_quaternion(&here, half);
            let in_lanes = Quaternions::new(&here);
            for l in 0..S::F64_LANES {
                to_lanes[l * steps + k] = in_lanes.unit(l);
            }
        }
        scalar_steps(to.last().copied().unwrap_or(before), rest, to);
    }
}

#[cfg(test)]
mod tests {
    use imucal_core::so3;

    use super::*;

    #[test]
    fn any_number_of_lanes_takes_the_same_turns() {
        let turns: Vec<Vector3<f64>> =
            (0..83).map(|k| Vector3::from_fn(|c, _| 0.1 * ((3 * k + c) as f64).sin())).collect();
        let (before, mut to) = (UnitQuaternion::identity(), Vec::new());
        InLanes { before, turns: &turns, to: &mut to }.with_simd(pulp::Scalar);
        let many = attitudes(before, &turns);
        assert_eq!((to.len(), many.len()), (turns.len(), turns.len() + 1));
        assert!(to.iter().zip(&many[1..]).all(|(one, many)| (one.coords - many.coords).norm() < 1e-14));
    }

    #[test]
    fn attitudes_are_the_products_of_all_turns_before() {
        let begin = so3::exp(&Vector3::new(0.3, -1.0, 2.0));
        for count in [0, 1, 7, 8, 41, 600, 1500] {
            // The third of these angles, rad, exceeds the range of the vectorised steps (0.2 rad).
            for most in [0.01, 0.19, 2.0] {
                let part = |k: usize, c: usize| ((3 * k + c) as f64 * 1.7).sin() * most / 3.0_f64.sqrt();
                let turns: Vec<Vector3<f64>> = (0..count).map(|k| Vector3::from_fn(|c, _| part(k, c))).collect();
                let mut here = begin;
                let all = attitudes(begin, &turns);
                assert_eq!((all.len(), all[0]), (count + 1, begin));
                for (turn, found) in turns.iter().zip(&all[1..]) {
                    here *= so3::exp(turn);
                    here.renormalize();
                    assert!((found.coords - here.coords).norm() < 1e-13, "{count} {most}");
                }
            }
        }
    }
}
