//! What the screens show of a grasp: the outline of the object, and the verdict in the lift.

use image::{Rgb, RgbImage};

use super::status::LiftStatus;
use gripcast_geometry::{GraspGeometry, WristCamera};
use gripcast_imaging::{Depth, DepthView, ObjectMotion, ObjectTracker, Role, draw_line};
use gripcast_nn::predict::LiftHead;
use gripcast_shear::{GelMotion, LiftImage};

/// Colour and width of the outline.
const OUTLINE: Rgb<u8> = Rgb([0, 230, 255]);
const OUTLINE_PX: f64 = 2.0;
/// Maximum age of a depth image relative to the images of the gels, ns.
const MAX_DEPTH_AGE_NS: u64 = 150_000_000;

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
    /// The saved grasp, and the last images with a verdict.
    before: LiftImage,
    previous: LiftImage,
    /// Newer images of the gels, left and right.
    newest: [Option<GelMotion>; 2],
    /// Follows the object from the saved grasp on, if the depth camera sees it.
    tracker: Option<ObjectTracker>,
    /// Newest motion of the object, and the driver time of its image, ns.
    object: Option<(ObjectMotion, u64)>,
    /// Driver time of the first alarm, ns.
    alarm_time_ns: Option<u64>,
}

impl LiveLift {
    /// The lift of a grasp with this probability of a stable lift, these gels and what the depth
    /// camera sees of the object.
    pub(super) fn new(p_before: f64, gels: [GelMotion; 2], tracker: Option<ObjectTracker>) -> Self {
        let before = LiftImage {
            gels,
            object: tracker.as_ref().map(|_| ObjectMotion::NONE),
        };
        Self {
            p_before,
            before,
            previous: before,
            newest: [None; 2],
            tracker,
            object: None,
            alarm_time_ns: None,
        }
    }

    /// Adds an image of the depth camera.
    pub(super) fn add_depth(&mut self, depth: &Depth, view: DepthView, frame_time_ns: u64) {
        let tracker = self.tracker.as_ref();
        let motion = tracker.and_then(|tracker| tracker.motion(depth, view));
        self.object = motion.map(|motion| (motion, frame_time_ns));
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
        let is_new = |(_, time_ns): &(ObjectMotion, u64)| {
            frame_time_ns.abs_diff(*time_ns) <= MAX_DEPTH_AGE_NS
        };
        let now = LiftImage {
            gels: [left, right],
            object: self.object.filter(is_new).map(|(motion, _)| motion),
        };
        let verdict = head.verdict(self.p_before, &self.before, &self.previous, &now);
        self.previous = now;
        self.newest = [None; 2];
        if verdict.is_slipping {
            self.alarm_time_ns.get_or_insert(frame_time_ns);
        }
        Some(LiftStatus {
            p_stable: verdict.p_stable,
            p_before: self.p_before,
            threshold: verdict.threshold,
            is_stable: verdict.is_stable,
            is_slipping: verdict.is_slipping,
            object: now.object,
            alarm_time_ns: self.alarm_time_ns,
            frame_time_ns,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_imaging::DepthImage;
    use gripcast_nn::predict::lift::FEATURES;
    use gripcast_nn::predict::{BoostedTrees, LiftEstimator, TreeNode};

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
        LiftHead {
            gels: estimator(0, 0.5, [-2.0, 2.0]),
            with_object: None,
        }
    }

    /// Reads one feature: log-odds below a limit and from it on.
    fn estimator(feature: usize, limit: f32, values: [f32; 2]) -> LiftEstimator {
        let [below, above] = values.map(TreeNode::Leaf);
        let split = TreeNode::Split(feature as u16, limit, 1, 2);
        LiftEstimator {
            trees: BoostedTrees {
                bias: 0.0,
                trees: vec![vec![split, below, above]],
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
        let mut lift = LiveLift::new(0.5, [gel(10.0); 2], None);
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
    fn motion_of_the_object_counts_while_it_is_new() {
        let head = LiftHead {
            with_object: Some(estimator(FEATURES, 2.0, [1.0, -5.0])),
            ..head()
        };
        // A plate between the fingers, above a table.
        let plate = |code: u16| Depth {
            image: DepthImage::from_fn(320, 240, |x, y| {
                let is_plate = (130..190).contains(&x) && (60..180).contains(&y);
                image::Luma([if is_plate { code } else { 200 }])
            }),
            unit_m: 1e-3,
        };
        let tracker = ObjectTracker::new(&plate(180), DepthView::Colour).unwrap();
        let mut lift = LiveLift::new(0.5, [gel(10.0); 2], Some(tracker));
        let both = |lift: &mut LiveLift, ms: u64| {
            lift.add(&head, Role::Left, gel(10.0), ms * 1_000_000);
            let status = lift.add(&head, Role::Right, gel(10.0), ms * 1_000_000);
            status.unwrap()
        };
        assert_eq!(both(&mut lift, 0).object, None);
        lift.add_depth(&plate(180), DepthView::Colour, 40_000_000);
        let held = both(&mut lift, 40);
        assert!(
            held.object
                .is_some_and(|motion| motion.between_mm == Some(0.0))
                && held.is_stable
        );
        lift.add_depth(&plate(184), DepthView::Colour, 80_000_000);
        let lost = both(&mut lift, 100);
        assert!(
            lost.object
                .is_some_and(|motion| motion.between_mm.is_some_and(|mm| (3.0..5.0).contains(&mm)))
        );
        assert!(lost.is_slipping, "{lost:?}");
        // The camera has stopped.
        let unseen = both(&mut lift, 300);
        assert!(unseen.object.is_none() && unseen.is_stable);
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
