//! Evaluates the field Phi of an effect: the derivatives of the error that the effect adds with respect to its
//! parameters theta. The formula of a field is written once. The formula passes the columns of Phi to a receiver
//! (`Terms`). The receiver either stores the columns or computes the error `Phi theta` that the effect adds.

#[cfg(feature = "catalogue")]
use super::Columns;
use super::MAX_PARAMETERS;
use nalgebra::{RealField, Vector3};

/// Receiver of the columns of the field Phi, in the order of the parameters theta.
pub(super) trait Terms<F: RealField + Copy> {
    /// Receives the column of the next parameter.
    fn column(&mut self, column: Vector3<F>);

    /// Receives the column `(cause, 0, 0)` of the next parameter, which acts only on the x axis.
    fn x(&mut self, cause: F);

    /// Receives the column `(0, cause, 0)` of the next parameter, which acts only on the y axis.
    fn y(&mut self, cause: F);

    /// Receives the column `(0, 0, cause)` of the next parameter, which acts only on the z axis.
    fn z(&mut self, cause: F);

    /// Receives the columns of the next three parameters k_x, k_y and k_z, one for each axis: component i of the error
    /// is k_i times component i of `cause`.
    #[inline(always)]
    fn axes(&mut self, cause: Vector3<F>) {
        self.x(cause.x);
        self.y(cause.y);
        self.z(cause.z);
    }

    /// Receives the columns of the next nine parameters, which add the error `Theta cause`. Theta is the 3x3 matrix of
    /// these parameters, row by row.
    #[inline(always)]
    fn entries(&mut self, cause: Vector3<F>) {
        self.x(cause.x);
        self.x(cause.y);
        self.x(cause.z);
        self.y(cause.x);
        self.y(cause.y);
        self.y(cause.z);
        self.z(cause.x);
        self.z(cause.y);
        self.z(cause.z);
    }
}

/// Stores the columns of Phi in an array.
#[cfg(feature = "catalogue")]
pub(super) struct ToColumns<'a, F: RealField + Copy>(core::slice::IterMut<'a, Vector3<F>>);

#[cfg(feature = "catalogue")]
impl<'a, F: RealField + Copy> ToColumns<'a, F> {
    #[inline]
    pub(super) fn new(columns: &'a mut Columns<F>) -> Self {
        Self(columns.iter_mut())
    }
}

#[cfg(feature = "catalogue")]
impl<F: RealField + Copy> Terms<F> for ToColumns<'_, F> {
    #[inline]
    fn column(&mut self, column: Vector3<F>) {
        if let Some(place) = self.0.next() {
            *place = column;
        }
    }

    #[inline]
    fn x(&mut self, cause: F) {
        self.column(Vector3::new(cause, F::zero(), F::zero()));
    }

    #[inline]
    fn y(&mut self, cause: F) {
        self.column(Vector3::new(F::zero(), cause, F::zero()));
    }

    #[inline]
    fn z(&mut self, cause: F) {
        self.column(Vector3::new(F::zero(), F::zero(), cause));
    }
}

/// Computes `Phi theta`: the sum of all columns of Phi, each multiplied by its parameter. All methods are inlined at
/// any optimisation level, so the indices of the parameters are known at compile time. Without inlining, function calls
/// would take most of the computing time of a correction on a device.
pub(super) struct Sum<'a, F: RealField + Copy> {
    values: &'a [F; MAX_PARAMETERS],
    next: usize,
    pub(super) sum: Vector3<F>,
}

impl<'a, F: RealField + Copy> Sum<'a, F> {
    #[inline(always)]
    pub(super) fn new(values: &'a [F; MAX_PARAMETERS]) -> Self {
        Self { values, next: 0, sum: same(F::zero()) }
    }

    /// Value of the next parameter. An effect in its plain form has fewer parameters than in its full form; the missing
    /// parameters are zero.
    #[inline(always)]
    fn value(&mut self) -> F {
        let value = self.values.get(self.next).copied().unwrap_or(F::zero());
        self.next += 1;
        value
    }
}

impl<F: RealField + Copy> Terms<F> for Sum<'_, F> {
    #[inline(always)]
    fn column(&mut self, column: Vector3<F>) {
        let value = self.value();
        self.sum.x += column.x * value;
        self.sum.y += column.y * value;
        self.sum.z += column.z * value;
    }

    #[inline(always)]
    fn x(&mut self, cause: F) {
        let value = self.value();
        self.sum.x += cause * value;
    }

    #[inline(always)]
    fn y(&mut self, cause: F) {
        let value = self.value();
        self.sum.y += cause * value;
    }

    #[inline(always)]
    fn z(&mut self, cause: F) {
        let value = self.value();
        self.sum.z += cause * value;
    }
}

/// The vector with three equal components.
#[inline(always)]
pub(super) fn same<F: RealField + Copy>(x: F) -> Vector3<F> {
    Vector3::new(x, x, x)
}

/// Defines one effect of the catalogue. Without the feature `catalogue`, the macro omits the texts and the columns.
macro_rules! effect {
    (
        number: $number:expr,
        name: $name:expr,
        sensor: $sensor:expr,
        parameters: $parameters:expr,
        plain: $plain:expr,
        shape: $shape:expr,
        reads: $reads:expr,
        needs: $needs:expr,
        formula: $formula:expr,
        observable: $observable:expr,
        aliases: $aliases:expr,
        field: |$state:ident, $shape_value:tt, $terms:ident| $field:expr,
    ) => {{
        const PARAMETERS: &[$crate::effects::Parameter] = $parameters;
        const SHAPE: Option<$crate::effects::Parameter> = $shape;
        #[allow(dead_code)] // Kept without `catalogue`, so that its texts are not reported as unused.
        const ALIASES: &[$crate::effects::Alias] = $aliases;
        $crate::effects::Effect {
            number: $number,
            sensor: $sensor,
            plain: $plain,
            count: PARAMETERS.len(),
            is_shaped: SHAPE.is_some(),
            reads: $reads,
            needs: $needs,
            sum: |$state, $shape_value, values| {
                let mut sum = $crate::effects::terms::Sum::new(values);
                let $terms = &mut sum;
                $field;
                sum.sum
            },
            #[cfg(feature = "catalogue")]
            columns: |$state, $shape_value, columns| {
                let $terms = &mut $crate::effects::terms::ToColumns::new(columns);
                $field
            },
            #[cfg(feature = "catalogue")]
            name: $name,
            #[cfg(feature = "catalogue")]
            parameters: PARAMETERS,
            #[cfg(feature = "catalogue")]
            shape: SHAPE,
            #[cfg(feature = "catalogue")]
            formula: $formula,
            #[cfg(feature = "catalogue")]
            observable: $observable,
            #[cfg(feature = "catalogue")]
            aliases: ALIASES,
        }
    }};
}
pub(super) use effect;
