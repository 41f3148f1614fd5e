//! A move at given parameters: its pass, and gravity at its ends.

use std::sync::Arc;

use nalgebra::{Vector2, Vector3};

use super::pass::Pass;
use crate::rests::moves::rows_across;

/// Direction of gravity at one end of a move and its derivative by every parameter.
#[derive(Clone)]
pub(crate) struct EndDirection {
    pub(crate) up: Vector3<f64>,
    pub(crate) jacobian: Vec<Vector3<f64>>,
}

/// One move at given parameters.
pub(crate) struct AtMove {
    pub(crate) pass: Pass,
    pub(crate) before: Arc<EndDirection>,
    pub(crate) after: Arc<EndDirection>,
}

/// Two components of the carried minus the measured direction, and their derivatives by every parameter.
pub(super) fn move_direction(at_move: &AtMove) -> (Vector2<f64>, Vec<Vector2<f64>>) {
    let AtMove { pass, before, after } = at_move;
    let across = rows_across(&after.up);
    let to_end = across * pass.rotation.transpose();
    let by_turn = to_end * before.up.cross_matrix();
    let columns = pass.turn.iter().zip(&before.jacobian).zip(&after.jacobian);
    let columns = columns.map(|((turn, before), after)| by_turn * turn + to_end * before - across * after);
    (to_end * before.up - across * after.up, columns.collect())
}
