//! What the screens show of a grasp: the outline of the object, and the verdict in the lift.

use image::{Rgb, RgbImage};

use super::status::LiftStatus;
use gripcast_geometry::{GraspGeometry, WristCamera};
use gripcast_imaging::{Role, draw_line};
use gripcast_nn::predict::LiftHead;
use gripcast_shear::GelMotion;

/// Colour and width of the outline.
const OUTLINE: Rgb<u8> = Rgb([0, 230, 255]);
const OUTLINE_PX: f64 = 2.0;

/// Draws the near face of the object's box into an image of the wrist camera.
pub(super) fn draw_outline(image: &mut RgbImage, geometry: &GraspGeometry) {
    let (width, height) = (image.width() as usize, image.height() as usize);
    let corners = geometry
        .near_face()
        .map(|corner| WristCamera::project(corner, width, height));
    for (i, from) in corners.iter().enumerate() {
        if let (Some(from), Some(to)) = (from, corners[(i + 1) % corners.len()]) {
            draw_line(image, *from, to, OUTLINE_PX, OUTLINE);
        }
    }
}

/// The lift of a saved grasp.
#[derive(Clone, Debug)]
pub(super) struct LiveLift {
    p_before: f64,
    /// Both gels in the saved grasp, and in the last images with a verdict.
    before: [GelMotion; 2],
    previous: [GelMotion; 2],
    /// Newer images, left and right.
    newest: [Option<GelMotion>; 2],
    /// Driver time of the first alarm, ns.
    alarm_time_ns: Option<u64>,
}

impl LiveLift {
    /// The lift of a grasp with this probability of a stable lift and these gels.
    pub(super) fn new(p_before: f64, before: [GelMotion; 2]) -> Self {
        Self {
            p_before,
            before,
            previous: before,
            newest: [None; 2],
            alarm_time_ns: None,
        }
    }

    /// Adds what a gel shows; returns the verdict if the other gel also has a new image.
    pub(super) fn add(
        &mut self,
        head: &LiftHead,
        role: Role,
        motion: GelMotion,
        frame_time_ns: u64,
    ) -> Option<LiftStatus> {
        let side = match role {
            Role::Left => 0,
            Role::Right => 1,
            Role::Rgb | Role::Depth | Role::External => return None,
        };
        self.newest[side] = Some(motion);
        let [Some(left), Some(right)] = self.newest else {
            return None;
        };
        let now = [left, right];
        let verdict = head.verdict(self.p_before, &self.before, &self.previous, &now);
        self.previous = now;
        self.newest = [None; 2];
        if verdict.is_slipping {
            self.alarm_time_ns.get_or_insert(frame_time_ns);
        }
        Some(LiftStatus {
            p_stable: verdict.p_stable,
            p_before: self.p_before,
            threshold: head.threshold,
            is_stable: verdict.is_stable,
            is_slipping: verdict.is_slipping,
            alarm_time_ns: self.alarm_time_ns,
            frame_time_ns,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_nn::predict::lift::{FEATURES, MotionNetwork};

    fn gel(level: f64) -> GelMotion {
        GelMotion {
            level,
            contact_fraction: 0.2,
            confidence: 1.0,
            ..GelMotion::default()
        }
    }

    /// Reads the smaller ratio of the levels.
    fn head() -> LiftHead {
        let mut weights = vec![0.0; FEATURES + 1];
        weights[0] = 1.0;
        LiftHead {
            network: MotionNetwork {
                mean: vec![0.0; FEATURES],
                std: vec![1.0; FEATURES],
                hidden: vec![weights],
                output: vec![4.0, -2.0],
            },
            prior_weight: 1.0,
            motion_weight: 1.0,
            offset: 0.0,
            threshold: 0.5,
            alarm: 0.2,
        }
    }

    #[test]
    fn verdict_needs_new_images_of_both_gels() {
        let head = head();
        let mut lift = LiveLift::new(0.5, [gel(10.0); 2]);
        assert_eq!(lift.add(&head, Role::Left, gel(10.0), 1), None);
        assert_eq!(lift.add(&head, Role::Rgb, gel(10.0), 2), None);
        let held = lift.add(&head, Role::Right, gel(10.0), 3).unwrap();
        assert!(held.is_stable && !held.is_slipping && held.frame_time_ns == 3);
        assert_eq!(held.alarm_time_ns, None);
        assert_eq!(lift.add(&head, Role::Right, gel(1.0), 4), None);
        let lost = lift.add(&head, Role::Left, gel(1.0), 5).unwrap();
        assert!(lost.is_slipping && !lost.is_stable && lost.p_before == 0.5);
        assert_eq!(lost.alarm_time_ns, Some(5));
        lift.add(&head, Role::Left, gel(10.0), 6);
        let again = lift.add(&head, Role::Right, gel(10.0), 7).unwrap();
        assert!(!again.is_slipping && again.alarm_time_ns == Some(5));
    }

    #[test]
    fn outline_is_where_the_camera_sees_the_box() {
        let geometry = GraspGeometry::from_array([
            -0.02, 0.02, -0.03, 0.03, -0.01, 0.05, -0.03, 0.03, 0.0, 0.02,
        ]);
        let mut image = RgbImage::new(320, 240);
        draw_outline(&mut image, &geometry);
        let [x, y] = WristCamera::project(geometry.near_face()[2], 320, 240).unwrap();
        assert!(image.get_pixel(x as u32, y as u32)[2] > 100);
        assert_eq!(image.get_pixel(160, 239).0, [0; 3]);
    }
}
