//! A move evaluated at given parameters of the model: its integrated rotation, the gravity directions at its ends, and
//! the attitude after it.
//!
//! Gravity determines roll and pitch at every rest, and the gyroscope determines the change of heading over every move.
//! The heading at the first rest is unknown and is fixed by definition: the attitude of the first rest is the smallest
//! rotation that makes its gravity direction vertical.

use std::sync::Arc;

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector2, Vector3};

use super::pass::Pass;
use crate::rests::moves::rows_across;

/// Gravity direction (unit vector, pointing up) at one end of a move, and its derivative with respect to every
/// parameter.
#[derive(Clone)]
pub(crate) struct EndDirection {
    pub(crate) up: Vector3<f64>,
    pub(crate) jacobian: Vec<Vector3<f64>>,
}

/// One move at given parameters, with the gravity directions before and after it.
pub(crate) struct AtMove {
    pub(crate) pass: Pass,
    pub(crate) before: Arc<EndDirection>,
    pub(crate) after: Arc<EndDirection>,
}

/// Computes the propagated minus the measured gravity direction after the move, as two components perpendicular to the
/// measured direction. Also returns their derivatives with respect to every parameter.
pub(super) fn move_direction(at_move: &AtMove) -> (Vector2<f64>, Vec<Vector2<f64>>) {
    let AtMove { pass, before, after } = at_move;
    let across = rows_across(&after.up);
    let end_from_start = across * pass.rotation.transpose();
    let by_turn = end_from_start * before.up.cross_matrix();
    let columns = pass.turn.iter().zip(&before.jacobian).zip(&after.jacobian);
    let columns = columns.map(|((turn, before), after)| by_turn * turn + end_from_start * before - across * after);
    (end_from_start * before.up - across * after.up, columns.collect())
}

/// Attitude of the first rest: the smallest rotation that makes its gravity direction vertical.
pub(crate) fn first_attitude(up: &Vector3<f64>) -> UnitQuaternion<f64> {
    upright(up)
}

/// Computes the attitude after a move from the attitude `start` before it and the integrated `rotation`. The gravity
/// direction `up` measured at the rest after the move corrects roll and pitch.
pub(crate) fn attitude_after(
    start: &UnitQuaternion<f64>,
    rotation: &Matrix3<f64>,
    up: &Vector3<f64>,
) -> UnitQuaternion<f64> {
    let propagated = start * UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*rotation));
    upright(&(propagated * up)) * propagated
}

/// Smallest rotation that takes `up` to the z axis.
fn upright(up: &Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::rotation_between(up, &Vector3::z())
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI))
}
