//! Gravity and rotation of the Earth at a location, from WGS 84 (NIMA TR8350.2, third edition, 2000, chapter 4).
//!
//! ```text
//! g(latitude, 0) = g_e (1 + k s^2) / sqrt(1 - e^2 s^2)                               Somigliana's formula
//! g(latitude, h) = g(latitude, 0) (1 - 2 (1 + f + m - 2 f s^2) (h / a) + 3 (h / a)^2)
//! ```
//!
//! The second formula is the free-air correction to second order. g_e is the gravity on the equator, k the constant of
//! Somigliana's formula, and s the sine of the geodetic latitude. e, a and f are the eccentricity, the semi-major axis
//! and the flattening of the ellipsoid. m is the ratio of centrifugal acceleration to gravity on the equator, and h is
//! the height above the ellipsoid. Normal gravity is the gravity of the reference ellipsoid. Actual gravity usually
//! differs from normal gravity by less than 1e-3 m/s^2.

use imucal_core::EARTH_RATE_RADPS;
use nalgebra::Vector3;

/// Normal gravity on the equator, m/s^2.
const EQUATOR_MPS2: f64 = 9.780_325_335_9;
/// Constant k of Somigliana's formula.
const SOMIGLIANA: f64 = 0.001_931_852_652_41;
/// Square of the first eccentricity of the ellipsoid.
const ECCENTRICITY_SQUARED: f64 = 6.694_379_990_14e-3;
/// Semi-major axis of the ellipsoid, m.
const SEMI_MAJOR_AXIS_M: f64 = 6_378_137.0;
/// Flattening of the ellipsoid.
const FLATTENING: f64 = 1.0 / 298.257_223_563;
/// Ratio m of centrifugal acceleration to gravity on the equator: `rate^2 a^2 b / GM`, with the semi-axes a and b of
/// the ellipsoid and the gravitational constant GM of the Earth.
const CENTRIFUGAL: f64 = 0.003_449_786_506_84;

/// Computes normal gravity, m/s^2, at a geodetic latitude, rad, and a height above the ellipsoid, m.
pub fn gravity_mps2(latitude_rad: f64, height_m: f64) -> f64 {
    let sin_squared = latitude_rad.sin().powi(2);
    let at_zero = EQUATOR_MPS2 * (1.0 + SOMIGLIANA * sin_squared) / (1.0 - ECCENTRICITY_SQUARED * sin_squared).sqrt();
    let height = height_m / SEMI_MAJOR_AXIS_M;
    let first = 2.0 * (1.0 + FLATTENING + CENTRIFUGAL - 2.0 * FLATTENING * sin_squared);
    at_zero * (1.0 - height * (first - 3.0 * height))
}

/// Standard deviation of the difference between actual and normal gravity, m/s^2 (50 mGal). The rms of the gravity
/// anomalies in the model EGM2008 is about 35 mGal (Pavlis and others, J. Geophys. Res. 117, B04406, 2012). The
/// standard deviation is set to a larger value, because gravity anomalies are larger in mountains.
const ANOMALY_MPS2: f64 = 5e-4;
/// Assumed standard deviation of the height above the ellipsoid, m, for a location on land whose height is unknown.
const UNKNOWN_HEIGHT_M: f64 = 500.0;

/// Standard deviation of the difference between actual and normal gravity, m/s^2. If the height is known, normal
/// gravity is the value at this height. If the height is unknown, normal gravity is the value at height 0, and the
/// standard deviation includes the uncertainty of the height.
pub fn normal_gravity_sigma_mps2(height_is_known: bool) -> f64 {
    let by_height = gravity_mps2(0.0, 0.0) - gravity_mps2(0.0, UNKNOWN_HEIGHT_M);
    if height_is_known { ANOMALY_MPS2 } else { ANOMALY_MPS2.hypot(by_height) }
}

/// Rotation rate of the Earth relative to the stars, rad/s, in the world frame (x north, y west, z up).
pub fn rate_radps(latitude_rad: f64) -> Vector3<f64> {
    let (sine, cosine) = latitude_rad.sin_cos();
    Vector3::new(cosine, 0.0, sine) * EARTH_RATE_RADPS
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

    use super::*;

    #[test]
    fn gravity_is_that_of_the_published_tables() {
        // Gravity at the poles is from TR8350.2, table 3.4. Gravity at 45 deg is that of the ellipsoid GRS 80 (Moritz,
        // 2000). At this latitude, gravity of GRS 80 is larger than gravity of WGS 84 by 1.4e-6 m/s^2.
        assert!((gravity_mps2(FRAC_PI_2, 0.0) - 9.832_184_937_8).abs() < 1e-10);
        assert!((gravity_mps2(-FRAC_PI_2, 0.0) - 9.832_184_937_8).abs() < 1e-10);
        assert!((gravity_mps2(0.0, 0.0) - 9.780_325_335_9).abs() < 1e-12);
        assert!((gravity_mps2(FRAC_PI_4, 0.0) + 1.4e-6 - 9.806_199_2).abs() < 1e-7);
    }

    /// On the polar axis, gravity has a closed form: `GM / (z^2 + E^2)` plus a term for the flattening of the ellipsoid
    /// (`flattened`). z is the distance from the centre of the Earth, E the linear eccentricity of the ellipsoid, and
    /// GM the gravitational constant of the Earth.
    #[test]
    fn gravity_falls_with_height_as_on_the_axis_of_the_ellipsoid() {
        // TR8350.2, chapter 4, gives the exact gravity in ellipsoidal coordinates u and beta. On the polar axis, u is
        // the distance z from the centre of the Earth and beta is 90 deg. On the axis, there is no centrifugal
        // acceleration.
        const GM: f64 = 3.986_004_418e14;
        let semi_minor_m = SEMI_MAJOR_AXIS_M * (1.0 - FLATTENING);
        let eccentric_m = SEMI_MAJOR_AXIS_M * ECCENTRICITY_SQUARED.sqrt();
        let q = |u: f64| {
            let x = eccentric_m / u;
            ((1.0 + 3.0 / (x * x)) * x.atan() - 3.0 / x) / 2.0
        };
        let q_slope = |u: f64| {
            let x = eccentric_m / u;
            3.0 * (1.0 + 1.0 / (x * x)) * (1.0 - x.atan() / x) - 1.0
        };
        let exact = |u: f64| {
            let flattened =
                EARTH_RATE_RADPS.powi(2) * SEMI_MAJOR_AXIS_M.powi(2) * eccentric_m / q(semi_minor_m) * q_slope(u) / 3.0;
            (GM + flattened) / (u * u + eccentric_m * eccentric_m)
        };
        for height_m in [0.0, 1_000.0, 5_000.0] {
            let got = gravity_mps2(FRAC_PI_2, height_m);
            let expected = exact(semi_minor_m + height_m);
            assert!((got - expected).abs() < 3e-6, "{height_m} m: {got}, {expected}");
        }
    }

    #[test]
    fn the_earth_turns_once_in_a_sidereal_day_about_its_axis() {
        let day_s = std::f64::consts::TAU / rate_radps(0.3).norm();
        assert!((day_s - 86_164.1).abs() < 0.1);
        assert!((rate_radps(FRAC_PI_2) - Vector3::z() * EARTH_RATE_RADPS).norm() < 1e-19);
        assert_eq!(rate_radps(0.0), Vector3::x() * EARTH_RATE_RADPS);
        assert!(rate_radps(-0.5).z < 0.0);
    }
}
