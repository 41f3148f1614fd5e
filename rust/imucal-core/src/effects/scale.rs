//! Effects of nonlinearity: the reading is not a linear function of the measured quantity.
//!
//! ```text
//! *_scale_quadratic        k_i v_i^2        v = w of the gyroscope, v = f of the accelerometer
//! *_scale_cubic            k_i v_i^3
//! *_scale_asymmetry        k_i |v_i|
//! *_cross_axis_quadratic   sum of k_i,jl v_j v_l
//! ```
//!
//! The gyroscope's cross-axis effect has the products of two different axes, nine in all. The accelerometer's
//! cross-axis effect has fifteen: for each axis all products except the square of that axis, which is the quadratic
//! scale effect.

use super::{
    AXES, Alias, Columns, DEGREE, Effect, Sensor, State, cross_products, parameters, set_axes, set_entries, squares,
};
use crate::STANDARD_GRAVITY_MPS2;
use nalgebra::{RealField, Vector3};

const GYROSCOPE_PRODUCTS: [&str; 9] = ["x_yz", "x_xz", "x_xy", "y_yz", "y_xz", "y_xy", "z_yz", "z_xz", "z_xy"];
const ACCELEROMETER_PRODUCTS: [&str; 15] = [
    "x_yy", "x_zz", "x_yz", "x_xz", "x_xy", "y_xx", "y_zz", "y_yz", "y_xz", "y_xy", "z_xx", "z_yy", "z_yz", "z_xz",
    "z_xy",
];

/// Rate at which datasheets specify the nonlinearity of a gyroscope, rad/s.
const FULL_RATE: f64 = 250.0 * DEGREE;

impl<F: RealField + Copy> Effect<F> {
    pub(super) const SCALE: &'static [Self] = &[
        Self {
            name: "gyro_scale_quadratic",
            sensor: Sensor::Gyroscope,
            // Typical value: 0.2 % at 250 deg/s.
            parameters: &parameters(AXES, "s/rad", 0.002 / FULL_RATE),
            plain: 3,
            shape: None,
            reads: &[Sensor::Gyroscope],
            needs: &[],
            formula: "k_i w_i^2",
            observable: "turns of both signs",
            aliases: &[Alias { with: "gyro_scale_asymmetry", told_apart_by: "turns at several rates" }],
            columns: |state, _, columns| quadratic(&state.angular_rate, columns),
        },
        Self {
            name: "gyro_scale_cubic",
            sensor: Sensor::Gyroscope,
            // Typical value: 0.5 % at 250 deg/s.
            parameters: &parameters(AXES, "s^2/rad^2", 0.005 / (FULL_RATE * FULL_RATE)),
            plain: 3,
            shape: None,
            reads: &[Sensor::Gyroscope],
            needs: &[],
            formula: "k_i w_i^3",
            observable: "turns at several rates",
            aliases: &[Alias { with: "gyro_scale", told_apart_by: "turns at several rates" }],
            columns: |state, _, columns| cubic(&state.angular_rate, columns),
        },
        Self {
            name: "gyro_scale_asymmetry",
            sensor: Sensor::Gyroscope,
            // Typical value: 0.2 %.
            parameters: &parameters(AXES, "1", 0.002),
            plain: 3,
            shape: None,
            reads: &[Sensor::Gyroscope],
            needs: &[],
            formula: "k_i |w_i|",
            observable: "turns of both signs",
            aliases: &[Alias { with: "gyro_scale_quadratic", told_apart_by: "turns at several rates" }],
            columns: |state, _, columns| asymmetry(&state.angular_rate, columns),
        },
        Self {
            name: "gyro_cross_axis_quadratic",
            sensor: Sensor::Gyroscope,
            parameters: &parameters(GYROSCOPE_PRODUCTS, "s/rad", 1e-4),
            plain: 9,
            shape: None,
            reads: &[Sensor::Gyroscope],
            needs: &[],
            formula: "k_i,yz wy wz + k_i,xz wx wz + k_i,xy wx wy",
            observable: "turns about axes between the sensor axes",
            aliases: &[],
            columns: |state, _, columns| set_entries(cross_products(&state.angular_rate), columns),
        },
        Self {
            name: "accel_scale_quadratic",
            sensor: Sensor::Accelerometer,
            // Typical value: 2e-3 per g.
            parameters: &parameters(AXES, "1/(m/s^2)", 2e-3 / STANDARD_GRAVITY_MPS2),
            plain: 3,
            shape: None,
            reads: &[Sensor::Accelerometer],
            needs: &[],
            formula: "k_i f_i^2",
            observable: "rests with each axis up, down and between",
            aliases: &[
                Alias { with: "accel_scale_asymmetry", told_apart_by: "rests every 15 deg" },
                Alias {
                    with: "accel_cross_axis_quadratic",
                    told_apart_by: "a stand whose angles are known: |f| alone cannot tell",
                },
            ],
            columns: |state, _, columns| quadratic(&state.specific_force, columns),
        },
        Self {
            name: "accel_scale_cubic",
            sensor: Sensor::Accelerometer,
            // Typical value: 2e-3 per g^2.
            parameters: &parameters(AXES, "1/(m/s^2)^2", 2e-3 / (STANDARD_GRAVITY_MPS2 * STANDARD_GRAVITY_MPS2)),
            plain: 3,
            shape: None,
            reads: &[Sensor::Accelerometer],
            needs: &[],
            formula: "k_i f_i^3",
            observable: "rests every 15 deg, weakly",
            aliases: &[Alias { with: "accel_scale", told_apart_by: "rests every 15 deg, or forces above g" }],
            columns: |state, _, columns| cubic(&state.specific_force, columns),
        },
        Self {
            name: "accel_scale_asymmetry",
            sensor: Sensor::Accelerometer,
            // Typical value: 0.1 %.
            parameters: &parameters(AXES, "1", 0.001),
            plain: 3,
            shape: None,
            reads: &[Sensor::Accelerometer],
            needs: &[],
            formula: "k_i |f_i|",
            observable: "rests with each axis up, down and between",
            aliases: &[Alias { with: "accel_scale_quadratic", told_apart_by: "rests every 15 deg" }],
            columns: |state, _, columns| asymmetry(&state.specific_force, columns),
        },
        Self {
            name: "accel_cross_axis_quadratic",
            sensor: Sensor::Accelerometer,
            // Typical value: 1e-3 per g.
            parameters: &parameters(ACCELEROMETER_PRODUCTS, "1/(m/s^2)", 1e-3 / STANDARD_GRAVITY_MPS2),
            plain: 15,
            shape: None,
            reads: &[Sensor::Accelerometer],
            needs: &[],
            formula: "sum of k_i,jl f_j f_l over all products but f_i^2",
            observable: "rests on a stand whose angles are known",
            aliases: &[Alias {
                with: "accel_scale_quadratic",
                told_apart_by: "a stand whose angles are known: |f| alone cannot tell",
            }],
            columns: accelerometer_cross_axis,
        },
    ];
}

fn quadratic<F: RealField + Copy>(v: &Vector3<F>, columns: &mut Columns<F>) {
    set_axes(squares(v), columns);
}

fn cubic<F: RealField + Copy>(v: &Vector3<F>, columns: &mut Columns<F>) {
    set_axes(squares(v).component_mul(v), columns);
}

fn asymmetry<F: RealField + Copy>(v: &Vector3<F>, columns: &mut Columns<F>) {
    set_axes(v.abs(), columns);
}

fn accelerometer_cross_axis<F: RealField + Copy>(state: &State<F>, _: F, columns: &mut Columns<F>) {
    let own = squares(&state.specific_force);
    let mixed = cross_products(&state.specific_force);
    for (i, columns) in columns.chunks_exact_mut(5).enumerate() {
        let others = if i == 0 {
            [own.y, own.z]
        } else if i == 1 {
            [own.x, own.z]
        } else {
            [own.x, own.y]
        };
        let products = [others[0], others[1], mixed.x, mixed.y, mixed.z];
        for (column, product) in columns.iter_mut().zip(products) {
            *column = Vector3::ith(i, product);
        }
    }
}
