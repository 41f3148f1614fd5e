//! Effects of specific force on a gyroscope.
//!
//! ```text
//! gyro_g_sensitivity         G f
//! gyro_g2_sensitivity        G2 (fx^2, fy^2, fz^2)     full form: + H (fy fz, fx fz, fx fy)
//! gyro_scale_g_sensitivity   k_i w_i f_i
//! ```
//!
//! f is the specific force and w the angular rate. The parameters are the 3x3 matrices G, G2 and H, and k_i for each
//! axis i. The full form of an effect has all its parameters. The form with the fewest parameters is called the plain
//! form.

use super::{AXES, Alias, DEGREE, ENTRIES, Effect, Sensor, Terms, cross_products, effect, parameters, squares};
use crate::{STANDARD_GRAVITY_MPS2, vector::each};
use nalgebra::RealField;

/// Names of the parameters of `gyro_g2_sensitivity`. The first nine are the coefficients of the squares of force
/// components, and the plain form has only these nine. The other nine are the coefficients of products of two different
/// force components.
const PRODUCTS: [&str; 18] = [
    "x_xx", "x_yy", "x_zz", "y_xx", "y_yy", "y_zz", "z_xx", "z_yy", "z_zz", "x_yz", "x_xz", "x_xy", "y_yz", "y_xz",
    "y_xy", "z_yz", "z_xz", "z_xy",
];

impl<F: RealField + Copy> Effect<F> {
    #[cfg(feature = "catalogue")]
    pub(super) const G_SENSITIVITY: &'static [&'static Self] =
        &[Self::GYRO_G_SENSITIVITY, Self::GYRO_G2_SENSITIVITY, Self::GYRO_SCALE_G_SENSITIVITY];

    /// `gyro_g_sensitivity`: error `G f` of the rate, with the specific force f and the matrix G of the parameters.
    pub const GYRO_G_SENSITIVITY: &'static Self = &effect! {
        number: 1,
        name: "gyro_g_sensitivity",
        sensor: Sensor::Gyroscope,
        // Typical value: 0.1 deg/s per g.
        parameters: &parameters(ENTRIES, "rad/s/(m/s^2)", 0.1 * DEGREE / STANDARD_GRAVITY_MPS2),
        plain: 9,
        shape: None,
        reads: &[Sensor::Accelerometer],
        needs: &[],
        formula: "G f",
        observable: "the gyroscope's mean in rests of many orientations, and moves between them",
        aliases: &[
            Alias { with: "earth_rate", told_apart_by: "turns of the heading, or the latitude" },
            Alias { with: "gyro_bias_drift", told_apart_by: "orientations that are repeated later in the run" },
        ],
        field: |state, _, terms| terms.entries(state.specific_force),
    };

    /// `gyro_g2_sensitivity`: error `G2 (fx^2, fy^2, fz^2) + H (fy fz, fx fz, fx fy)` of the rate, with the specific
    /// force f. The plain form has only the parameters G2, and the full form also the parameters H.
    pub const GYRO_G2_SENSITIVITY: &'static Self = &effect! {
        number: 2,
        name: "gyro_g2_sensitivity",
        sensor: Sensor::Gyroscope,
        // Typical value: 0.0004 deg/s per g^2.
        parameters: &parameters(
            PRODUCTS,
            "rad/s/(m/s^2)^2",
            0.0004 * DEGREE / (STANDARD_GRAVITY_MPS2 * STANDARD_GRAVITY_MPS2),
        ),
        plain: 9,
        shape: None,
        reads: &[Sensor::Accelerometer],
        needs: &[],
        formula: "G2 (fx^2, fy^2, fz^2) + H (fy fz, fx fz, fx fy)",
        observable: "rests of many orientations, for six of the nine directions of G2; forces far from g for all",
        aliases: &[Alias {
            with: "gyro_bias",
            told_apart_by: "forces far from g: at rest fx^2 + fy^2 + fz^2 does not change",
        }],
        field: |state, _, terms| {
            terms.entries(squares(&state.specific_force));
            terms.entries(cross_products(&state.specific_force));
        },
    };

    /// `gyro_scale_g_sensitivity`: error `k_i w_i f_i` of axis i, with the parameter k_i, the angular rate w and the
    /// specific force f.
    pub const GYRO_SCALE_G_SENSITIVITY: &'static Self = &effect! {
        number: 3,
        name: "gyro_scale_g_sensitivity",
        sensor: Sensor::Gyroscope,
        // Typical value: a scale change of 0.1 % per g.
        parameters: &parameters(AXES, "1/(m/s^2)", 0.001 / STANDARD_GRAVITY_MPS2),
        plain: 3,
        shape: None,
        reads: &[Sensor::Gyroscope, Sensor::Accelerometer],
        needs: &[],
        formula: "k_i w_i f_i",
        observable: "turns about an axis that points up, down and across",
        aliases: &[Alias {
            with: "gyro_scale",
            told_apart_by: "turns about an axis that points down as well as up",
        }],
        field: |state, _, terms| terms.axes(each(&state.angular_rate, &state.specific_force)),
    };
}
