//! Rigid transforms between named frames.
//!
//! A value is named `dst_from_src`; it maps a point in `src` to the same point in `dst`, so that
//! products compose by matching neighbours: `a_from_b * b_from_c = a_from_c`.

use std::ops::Mul;

use nalgebra::{Matrix3, Point3, Quaternion, Rotation3, Translation3, UnitQuaternion, Vector3};

/// Why a pose was refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FrameError {
    /// A component is NaN or infinite.
    #[error(
        "pose has a component that is not finite: rotation {rotation:?}, translation {translation:?}"
    )]
    NotFinite {
        /// Rotation as given (quaternion x, y, z, w, or the diagonal of a matrix).
        rotation: [f64; 4],
        /// Translation as given, metres.
        translation: [f64; 3],
    },
    /// So far away that millimetres are lost in the number.
    #[error("translation {translation:?} is beyond {MAX_TRANSLATION_M:e} m")]
    TooFar {
        /// Translation as given, metres.
        translation: [f64; 3],
    },
    /// The quaternion's norm is not 1.
    #[error("rotation quaternion {quaternion_xyzw:?} has norm {norm}, not 1")]
    NotUnit {
        /// The quaternion as given.
        quaternion_xyzw: [f64; 4],
        /// Its norm.
        norm: f64,
    },
    /// The 3×3 part is not a rotation.
    #[error(
        "matrix is not a rotation: determinant {determinant}, largest deviation from orthonormal {deviation}"
    )]
    NotRotation {
        /// Determinant of the 3×3 part.
        determinant: f64,
        /// max |RᵀR − I|.
        deviation: f64,
    },
}

/// A rotation followed by a translation, in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigidTransform {
    isometry: nalgebra::Isometry3<f64>,
}

/// Quaternions published as float32 or rounded to a few decimals are off by less than this.
const UNIT_TOLERANCE: f64 = 1e-2;

/// Largest component of a translation: beyond the Moon, and a double still resolves a micrometre.
const MAX_TRANSLATION_M: f64 = 1e9;

fn check_translation(translation: [f64; 3]) -> Result<(), FrameError> {
    if translation.iter().any(|m| m.abs() > MAX_TRANSLATION_M) {
        return Err(FrameError::TooFar { translation });
    }
    Ok(())
}

impl RigidTransform {
    /// The transform that changes nothing.
    pub fn identity() -> Self {
        Self {
            isometry: nalgebra::Isometry3::identity(),
        }
    }

    /// From a quaternion (x, y, z, w), as ROS orders it, and a translation in metres.
    ///
    /// # Errors
    /// [`FrameError`] when a component is not finite, the translation beyond a million kilometres,
    /// or the quaternion's norm more than 1 % off 1 (an all-zero quaternion, the usual sign of an unset field, among them).
    pub fn try_from_quaternion(
        quaternion_xyzw: [f64; 4],
        translation_m: [f64; 3],
    ) -> Result<Self, FrameError> {
        let all_finite = quaternion_xyzw
            .iter()
            .chain(&translation_m)
            .all(|v| v.is_finite());
        if !all_finite {
            return Err(FrameError::NotFinite {
                rotation: quaternion_xyzw,
                translation: translation_m,
            });
        }
        check_translation(translation_m)?;
        let [x, y, z, w] = quaternion_xyzw;
        let quaternion = Quaternion::new(w, x, y, z);
        let norm = quaternion.norm();
        if (norm - 1.0).abs() > UNIT_TOLERANCE {
            return Err(FrameError::NotUnit {
                quaternion_xyzw,
                norm,
            });
        }
        Ok(Self::from_parts(
            UnitQuaternion::from_quaternion(quaternion),
            Vector3::from(translation_m),
        ))
    }

    /// From a row-major homogeneous 4×4 matrix, metres.
    ///
    /// # Errors
    /// [`FrameError`] when a component is not finite, the translation beyond a million kilometres,
    /// or the 3×3 part not a rotation within 1 %.
    pub fn try_from_matrix(rows: &[[f64; 4]; 4]) -> Result<Self, FrameError> {
        let translation = [rows[0][3], rows[1][3], rows[2][3]];
        if !rows.iter().flatten().all(|v| v.is_finite()) {
            return Err(FrameError::NotFinite {
                rotation: [rows[0][0], rows[1][1], rows[2][2], rows[3][3]],
                translation,
            });
        }
        check_translation(translation)?;
        let rotation = Matrix3::from_fn(|r, c| rows[r][c]);
        let deviation = (rotation.transpose() * rotation - Matrix3::identity()).amax();
        let determinant = rotation.determinant();
        if deviation > UNIT_TOLERANCE || determinant < 0.0 {
            return Err(FrameError::NotRotation {
                determinant,
                deviation,
            });
        }
        // A few sweeps of the polar iteration remove the rounding of the file.
        let rotation = Rotation3::from_matrix_eps(&rotation, 1e-14, 32, Rotation3::identity());
        Ok(Self::from_parts(
            UnitQuaternion::from_rotation_matrix(&rotation),
            Vector3::from(translation),
        ))
    }

    /// From parts that are valid by their types.
    pub fn from_parts(rotation: UnitQuaternion<f64>, translation_m: Vector3<f64>) -> Self {
        Self {
            isometry: nalgebra::Isometry3::from_parts(Translation3::from(translation_m), rotation),
        }
    }

    /// `src_from_dst`.
    pub fn inverse(&self) -> Self {
        Self {
            isometry: self.isometry.inverse(),
        }
    }

    /// The point in `dst`.
    pub fn transform_point(&self, point_in_src: &Point3<f64>) -> Point3<f64> {
        self.isometry.transform_point(point_in_src)
    }

    /// All points in `dst`: one rotation matrix serves them all.
    pub fn transform_points(&self, points_in_src: &[Point3<f64>]) -> Vec<Point3<f64>> {
        let rotation = self.rotation().to_rotation_matrix();
        points_in_src
            .iter()
            .map(|point| Point3::from(rotation * point.coords + self.translation()))
            .collect()
    }

    /// The direction in `dst`.
    pub fn transform_vector(&self, vector_in_src: &Vector3<f64>) -> Vector3<f64> {
        self.isometry.transform_vector(vector_in_src)
    }

    /// The rotation part.
    pub fn rotation(&self) -> &UnitQuaternion<f64> {
        &self.isometry.rotation
    }

    /// The translation part in metres: the origin of `src` in `dst`.
    pub fn translation(&self) -> &Vector3<f64> {
        &self.isometry.translation.vector
    }

    /// Quaternion as ROS orders it: x, y, z, w.
    pub fn quaternion_xyzw(&self) -> [f64; 4] {
        let q = &self.isometry.rotation;
        [q.i, q.j, q.k, q.w]
    }

    /// Between `self` (`t` = 0) and `other` (`t` = 1): slerp of the rotation along the shorter
    /// arc, linear in translation.
    pub fn interpolate(&self, other: &Self, t: f64) -> Self {
        let rotation = self
            .isometry
            .rotation
            .try_slerp(&other.isometry.rotation, t, 1e-12)
            .unwrap_or(self.isometry.rotation);
        Self::from_parts(rotation, self.translation().lerp(other.translation(), t))
    }

    /// Angle in radians and distance in metres between two poses of the same frames.
    pub fn distance_to(&self, other: &Self) -> (f64, f64) {
        (
            self.rotation().angle_to(other.rotation()),
            (self.translation() - other.translation()).norm(),
        )
    }
}

impl Mul for RigidTransform {
    type Output = Self;
    fn mul(self, rhs: Self) -> Self {
        Self {
            isometry: self.isometry * rhs.isometry,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn translations_in_which_millimetres_are_lost_are_refused() {
        let unit = [0.0, 0.0, 0.0, 1.0];
        for far in [-1.1e9, 1e300] {
            let refused = RigidTransform::try_from_quaternion(unit, [0.0, far, 0.0]);
            assert!(matches!(refused, Err(FrameError::TooFar { .. })));
            let mut rows = [[0.0; 4]; 4];
            (0..4).for_each(|i| rows[i][i] = 1.0);
            rows[2][3] = far;
            let refused = RigidTransform::try_from_matrix(&rows);
            assert!(matches!(refused, Err(FrameError::TooFar { .. })));
        }
        assert!(RigidTransform::try_from_quaternion(unit, [6.4e6; 3]).is_ok());
    }

    #[test]
    fn refuses_what_is_not_a_rotation() {
        assert!(matches!(
            RigidTransform::try_from_quaternion([0.0; 4], [0.0; 3]),
            Err(FrameError::NotUnit { .. })
        ));
        assert!(matches!(
            RigidTransform::try_from_quaternion([f64::NAN, 0.0, 0.0, 1.0], [0.0; 3]),
            Err(FrameError::NotFinite { .. })
        ));
        let mut mirror = [[0.0; 4]; 4];
        for (i, row) in mirror.iter_mut().enumerate() {
            row[i] = 1.0;
        }
        mirror[0][0] = -1.0;
        assert!(matches!(
            RigidTransform::try_from_matrix(&mirror),
            Err(FrameError::NotRotation { .. })
        ));
    }

    #[test]
    fn composes_and_inverts() {
        let a_from_b =
            RigidTransform::try_from_quaternion([0.0, 0.0, 0.6, 0.8], [1.0, 2.0, 3.0]).unwrap();
        let point_in_b = Point3::new(0.3, -0.2, 0.9);
        let back = (a_from_b.inverse() * a_from_b).transform_point(&point_in_b);
        assert!((back - point_in_b).norm() < 1e-12);
        let half = RigidTransform::identity().interpolate(&a_from_b, 0.5);
        let (angle_rad, distance_m) = half.distance_to(&a_from_b);
        assert!((angle_rad - a_from_b.rotation().angle() / 2.0).abs() < 1e-12);
        assert!((distance_m - 14f64.sqrt() / 2.0).abs() < 1e-12);
    }
}
