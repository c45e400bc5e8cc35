//! Wrong poses on purpose: how well a method bears them (ECCV 2022, supplement).

use nalgebra::{UnitQuaternion, Vector3};

use crate::geom::RigidTransform;
use crate::keyframe::Keyframe;

/// The keyframe with noise on its pose: each Euler angle and each component of the translation is
/// changed by a uniform share of itself in ±`share`. The same keyframe and seed give the same pose.
pub fn with_pose_noise(keyframe: &Keyframe, share: f64, seed: u64) -> Keyframe {
    let pose = &keyframe.world_from_camera;
    let (roll, pitch, yaw) = pose.rotation().euler_angles();
    let translation_m = pose.translation();
    let values = [
        roll,
        pitch,
        yaw,
        translation_m.x,
        translation_m.y,
        translation_m.z,
    ];
    let mut state = seed ^ (u64::from(keyframe.id.0) + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let [roll, pitch, yaw, x, y, z] = values.map(|value| {
        let uniform = 2.0 * unit_interval(&mut state) - 1.0;
        value * (1.0 + share * uniform)
    });
    Keyframe {
        world_from_camera: RigidTransform::from_parts(
            UnitQuaternion::from_euler_angles(roll, pitch, yaw),
            Vector3::new(x, y, z),
        ),
        ..keyframe.clone()
    }
}

/// SplitMix64 (Steele, Lea, Flood 2014), as a number in [0, 1).
fn unit_interval(state: &mut u64) -> f64 {
    *state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let mut z = *state;
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::geom::{CameraModel, ColorImage, EncodedColor, PinholeCamera, Stamp};
    use crate::keyframe::{FrameQuality, KeyframeId};

    fn keyframe(id: u32) -> Keyframe {
        let image = ColorImage::new(8, 8, vec![[9; 3]; 64]).unwrap();
        let pinhole = PinholeCamera::new([9.0, 9.0, 4.0, 4.0], 8, 8).unwrap();
        Keyframe {
            id: KeyframeId(id),
            stamp: Stamp::from_nanos(5),
            world_from_camera: RigidTransform::from_parts(
                UnitQuaternion::from_euler_angles(-1.5, 0.4, 2.0),
                Vector3::new(2.0, -3.0, 1.0),
            ),
            color: EncodedColor::png_from_image(&image).unwrap(),
            color_camera: CameraModel::ideal(pinhole),
            depth: None,
            quality: FrameQuality::default(),
        }
    }

    #[test]
    fn every_component_stays_within_its_share_and_moves() {
        let mut largest = [0.0f64; 6];
        for id in 0..400 {
            let noisy = with_pose_noise(&keyframe(id), 0.05, 7);
            let (roll, pitch, yaw) = noisy.world_from_camera.rotation().euler_angles();
            let t = noisy.world_from_camera.translation();
            let changes = [
                roll / -1.5,
                pitch / 0.4,
                yaw / 2.0,
                t.x / 2.0,
                t.y / -3.0,
                t.z,
            ];
            for (largest, change) in largest.iter_mut().zip(changes) {
                assert!((change - 1.0).abs() <= 0.05 + 1e-9, "{change}");
                *largest = largest.max((change - 1.0).abs());
            }
        }
        assert!(largest.iter().all(|&share| share > 0.045), "{largest:?}");
    }

    #[test]
    fn noise_depends_on_the_seed_and_the_keyframe_alone() {
        let pose = |id, seed| with_pose_noise(&keyframe(id), 0.05, seed).world_from_camera;
        assert_eq!(pose(3, 1), pose(3, 1));
        assert_ne!(pose(3, 1), pose(3, 2));
        assert_ne!(pose(3, 1), pose(4, 1));
        let still = Arc::new(with_pose_noise(&keyframe(3), 0.0, 1));
        let (turn, shift) = still
            .world_from_camera
            .distance_to(&keyframe(3).world_from_camera);
        assert!(turn < 1e-7 && shift < 1e-12);
    }
}
