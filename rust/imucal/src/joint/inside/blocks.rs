//! Whitens the derivatives of the residuals inside a move with SIMD instructions. Each lane of a SIMD register
//! processes one parameter.

use faer::Mat;
use nalgebra::Vector3;
use pulp::{Simd, WithSimd};

use super::filter::Gain;
use super::{Inside, count};
use crate::joint::lanes::Lanes;
use crate::joint::pass::planes::Planes;

/// Derivatives of the residuals of one move with respect to some parameters, before whitening.
pub(super) struct Derivatives<'a> {
    pub(super) inside: &'a Inside<'a>,
    pub(super) planes: &'a Planes,
    /// For each block: one vector for each of the three directions. The dot product of this vector and a parameter's
    /// 3-vector of the block in `planes` is the derivative of the block's residual along the direction.
    pub(super) toward: &'a [[Vector3<f64>; 3]],
    /// Parts of the derivatives that are due to the gravity directions at both ends of the move: five rows with one
    /// value per parameter. Rows 0 to 2 are added to the derivatives of every block, along gravity and along the two
    /// directions perpendicular to gravity. Rows 3 and 4 are the derivatives of the last two residuals of the move,
    /// along the two perpendicular directions. These residuals compare the gravity direction at the start of the move
    /// with the direction at its end.
    pub(super) at_edges: &'a [f64],
}

/// Writes the whitened derivatives of a move's residuals to a matrix. The first residual is written to row `first`.
pub(super) struct IntoColumns<'a> {
    pub(super) seen: Derivatives<'a>,
    pub(super) matrix: &'a mut Mat<f64>,
    pub(super) first: usize,
}

/// Writes the whitened derivatives of a move's residuals to `lanes`, one row per residual. The values of the first
/// parameter are written at position `place` of each row.
pub(super) struct IntoLanes<'a> {
    pub(super) seen: Derivatives<'a>,
    pub(super) lanes: &'a mut Lanes,
    pub(super) place: usize,
}

impl WithSimd for IntoColumns<'_> {
    type Output = ();

    /// Processes the parameters that fit into one SIMD register, from the start of the move to its end, and then the
    /// next parameters. The results are transposed into columns of the matrix while they are in the L1 cache.
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { seen: Derivatives { inside, planes, toward, at_edges }, matrix, first } = self;
        let (registers, blocks) = (planes.width() / S::F64_LANES, toward.len());
        let edges = S::as_simd_f64s(at_edges).0;
        let mut tile = vec![0.0; count(inside.pass, false) * S::F64_LANES];
        for (group, parameters) in planes.parameters().chunks(S::F64_LANES).enumerate() {
            let (lanes, _) = S::as_mut_simd_f64s(&mut tile);
            let [along, one, other] = by_direction(lanes, blocks, 1);
            let mut states = [simd.splat_f64s(0.0); 3];
            for (k, (state, toward)) in planes.registers(simd).chunks_exact(3 * registers).zip(toward).enumerate() {
                let own = [state[group], state[registers + group], state[2 * registers + group]];
                let gains = [&inside.along[k], &inside.across[k], &inside.across[k]];
                for (c, to) in [&mut along[k], &mut one[k], &mut other[k]].into_iter().enumerate() {
                    let seen = along_direction(simd, &toward[c], own, edges[c * registers + group]);
                    *to = innovation(simd, seen, gains[c], &mut states[c]);
                }
            }
            for (c, to) in [(1, &mut one[blocks]), (2, &mut other[blocks])] {
                *to = innovation(simd, edges[(2 + c) * registers + group], &inside.end, &mut states[c]);
            }
            for (lane, parameter) in parameters.iter().enumerate() {
                let to = matrix.col_as_slice_mut(*parameter)[first..].iter_mut();
                to.zip(tile.chunks_exact(S::F64_LANES)).for_each(|(to, row)| *to = row[lane]);
            }
        }
    }
}

impl WithSimd for IntoLanes<'_> {
    type Output = ();

    /// Processes the blocks of the move in the order in which their values are stored in memory, each block for all
    /// parameters.
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { seen: Derivatives { inside, planes, toward, at_edges }, lanes, place } = self;
        let (registers, blocks) = (planes.width() / S::F64_LANES, toward.len());
        let edges = S::as_simd_f64s(at_edges).0;
        let mut states = vec![0.0; 3 * planes.width()];
        let (states, _) = S::as_mut_simd_f64s(&mut states);
        let (width, own) = (lanes.width(), place..place + planes.width());
        let [along, one, other] = by_direction(lanes.rows_mut(0..lanes.rows()), blocks, width);
        for (k, (state, toward)) in planes.registers(simd).chunks_exact(3 * registers).zip(toward).enumerate() {
            let gains = [&inside.along[k], &inside.across[k], &inside.across[k]];
            let (x, y, z) = (&state[..registers], &state[registers..][..registers], &state[2 * registers..]);
            for (c, rows) in [&mut *along, &mut *one, &mut *other].into_iter().enumerate() {
                let to = S::as_mut_simd_f64s(&mut rows[k * width..][own.clone()]).0;
                let (edges, states) = (&edges[c * registers..], &mut states[c * registers..]);
                let known = x.iter().zip(y).zip(z).zip(edges);
                for (((((x, y), z), edge), state), to) in known.zip(states).zip(to) {
                    let seen = along_direction(simd, &toward[c], [*x, *y, *z], *edge);
                    *to = innovation(simd, seen, gains[c], state);
                }
            }
        }
        for (c, rows) in [(1, one), (2, other)] {
            let to = S::as_mut_simd_f64s(&mut rows[blocks * width..][own.clone()]).0;
            let (edges, states) = (&edges[(2 + c) * registers..], &mut states[c * registers..]);
            for ((edge, state), to) in edges.iter().zip(states).zip(to) {
                *to = innovation(simd, *edge, &inside.end, state);
            }
        }
    }
}

/// Divides the rows of a move, each with `length` values, by direction. The first direction, along gravity, has one row
/// per block. Each of the two perpendicular directions has one additional row, for the rest after the move.
fn by_direction<T>(rows: &mut [T], blocks: usize, length: usize) -> [&mut [T]; 3] {
    let (along, across) = rows.split_at_mut(blocks * length);
    let (one, other) = across.split_at_mut((blocks + 1) * length);
    [along, one, other]
}

/// Computes `there` plus the dot product of `direction` and a vector, in each SIMD lane. Each lane contains the vector
/// of one parameter. `planes` contains the x, y and z components of these vectors.
#[inline(always)]
fn along_direction<S: Simd>(simd: S, direction: &Vector3<f64>, planes: [S::f64s; 3], there: S::f64s) -> S::f64s {
    let mut seen = simd.mul_add_e_f64s(simd.splat_f64s(direction.x), planes[0], there);
    seen = simd.mul_add_e_f64s(simd.splat_f64s(direction.y), planes[1], seen);
    simd.mul_add_e_f64s(simd.splat_f64s(direction.z), planes[2], seen)
}

/// Computes the innovation of the measurement `seen`, divided by its standard deviation, and updates the filter state.
#[inline(always)]
fn innovation<S: Simd>(simd: S, seen: S::f64s, gain: &Gain<1>, state: &mut S::f64s) -> S::f64s {
    let innovation = simd.sub_f64s(seen, *state);
    *state = simd.mul_add_e_f64s(simd.splat_f64s(gain.shares[0]), innovation, *state);
    simd.mul_f64s(simd.splat_f64s(gain.per_sigma), innovation)
}
