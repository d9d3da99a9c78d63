//! The verdict in the lift on the eight grasps of the virtual rig, image by image.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use gripcast_capture::calibration::RigFile;
use gripcast_capture::camera::{CameraOpener as _, Clock as _, FrameSource, ManualClock};
use gripcast_imaging::{
    CropProfile, Decoder, Depth, DepthView, Frame, ObjectMotion, ObjectTracker, Role,
};
use gripcast_nn::predict::contract::InputName;
use gripcast_nn::predict::{InputImages, LiftVerdict, Model};
use gripcast_shear::ExpectedMarkers;
use gripcast_tactile::SensorProfile;
use gripcast_virtual_rig::{ClipLibrary, HandTarget, VirtualHand, VirtualRig};
use image::RgbImage;

const MS: u64 = 1_000_000;
const GELS: [Role; 2] = [Role::Left, Role::Right];

/// The cameras of the virtual rig on a clock that only the test moves.
struct Bench {
    clock: Arc<ManualClock>,
    hand: Arc<VirtualHand>,
    cameras: BTreeMap<Role, Box<dyn FrameSource>>,
    crop: CropProfile,
    decoder: Decoder,
}

impl Bench {
    fn new() -> Self {
        let clock = Arc::new(ManualClock::new(1_000 * MS));
        let rig = VirtualRig::new(ClipLibrary::built_in().unwrap(), 1, clock.clone());
        let file = RigFile::virtual_rig();
        let crop = file.cameras[&Role::Left].crop_profile.as_deref().unwrap();
        let cameras = [Role::Left, Role::Right, Role::Rgb, Role::Depth];
        let open = |role| {
            let mut camera = rig.camera(role, &file.cameras[&role]).unwrap();
            (role, camera.open().unwrap())
        };
        Self {
            hand: rig.hand(),
            cameras: cameras.map(open).into(),
            crop: CropProfile::by_name(crop).unwrap(),
            decoder: Decoder::new().unwrap(),
            clock,
        }
    }

    /// The next frame of a camera, for which the clock advances.
    fn frame(&mut self, role: Role) -> Frame {
        let camera = self.cameras.get_mut(&role).unwrap();
        loop {
            let now_ns = self.clock.now_ns();
            let frame = camera.next_frame(Duration::from_secs(1)).unwrap();
            if frame.driver_time_ns >= now_ns {
                return frame;
            }
        }
    }

    fn image(&mut self, role: Role) -> RgbImage {
        let frame = self.frame(role);
        let crop = role.is_tactile().then_some(&self.crop);
        self.decoder.decode(&frame, crop, 320, 240).unwrap()
    }

    fn depth(&mut self) -> Depth {
        let frame = self.frame(Role::Depth);
        Depth {
            image: self.decoder.depth(&frame).unwrap(),
            unit_m: 1e-3,
        }
    }

    fn gels(&mut self) -> [RgbImage; 2] {
        GELS.map(|role| self.image(role))
    }
}

/// Verdicts by shown step of a lift: 1, 2, 3, 4, 5, 10, 15, … mm.
type Verdicts = BTreeMap<usize, LiftVerdict>;

struct Lift {
    held: bool,
    before: bool,
    /// From the gels alone, and with the motion of the object.
    verdicts: [Verdicts; 2],
}

fn follow(bench: &mut Bench, model: &Model, m_per_px: f64) -> Lift {
    let held = bench.hand.clip().outcome().name() == "success";
    let initial = bench.gels();
    bench.hand.move_to(HandTarget::Closed);
    bench.clock.advance(1_000 * MS);
    let closed = bench.hand.scene_at(bench.clock.now_ns()).step;
    let grasp = bench.gels();
    let rgb = bench.image(Role::Rgb);
    let depth = bench.depth();
    let tactile = |side: usize| InputImages::Tactile {
        initial: initial[side].clone(),
        grasp: grasp[side].clone(),
    };
    let predicted = model.predict_grasp(|name| {
        Ok(Some(match name {
            InputName::TactileLeft => tactile(0),
            InputName::TactileRight => tactile(1),
            InputName::Rgb => InputImages::Rgb(rgb.clone()),
            InputName::Depth => InputImages::Depth(depth.clone(), DepthView::Colour),
        }))
    });
    let prediction = predicted.unwrap().prediction;

    bench.hand.move_to(HandTarget::Lifted);
    // None where only walls along the approach direction are seen.
    let tracker = ObjectTracker::new(&depth, DepthView::Colour);
    let frames: Vec<(usize, [RgbImage; 2], Option<ObjectMotion>)> = (0..30)
        .map(|_| {
            let images = bench.gels();
            let depth = bench.depth();
            let object = tracker.as_ref();
            let object = object.and_then(|tracker| tracker.motion(&depth, DepthView::Colour));
            let step = bench.hand.scene_at(bench.clock.now_ns()).step;
            (step, images, object)
        })
        .collect();
    let verdicts = [false, true].map(|with_object| {
        let images = frames.iter().map(|(_, images, object)| {
            let object = object.filter(|_| with_object);
            (images.each_ref(), object)
        });
        let found = model.lift_head().unwrap().follow(
            prediction.p_stable,
            initial.each_ref(),
            grasp.each_ref(),
            images,
            m_per_px,
            ExpectedMarkers::None,
        );
        let steps = frames
            .iter()
            .map(|(step, _, _)| step.saturating_sub(closed));
        steps.zip(found.unwrap()).collect()
    });
    Lift {
        held,
        before: prediction.p_stable >= prediction.threshold,
        verdicts,
    }
}

#[test]
fn verdict_in_the_lift_follows_held_and_lost_grasps() {
    let model = Model::by_name("gripcast-vt").unwrap();
    let m_per_px = SensorProfile::gelsight_mini().unwrap().geometry.pixel_m;
    let mut bench = Bench::new();
    // Clips with a right verdict by inputs and rise, mm.
    let mut right: [BTreeMap<u32, Vec<String>>; 2] = Default::default();
    for _ in 0..8 {
        let clip = bench.hand.truth(bench.clock.now_ns()).clip;
        let lift = follow(&mut bench, &model, m_per_px);
        println!(
            "{clip}: held {}, before the lift {}",
            lift.held, lift.before
        );
        for (verdicts, right) in lift.verdicts.iter().zip(&mut right) {
            for (step, verdict) in verdicts {
                println!("{step:4} {verdict:?}");
                assert!(!(lift.held && verdict.is_slipping), "{clip}: {step}");
            }
            for (rise_mm, step) in [(2, 2), (5, 5), (10, 6)] {
                let (_, verdict) = verdicts.range(..=step).next_back().unwrap();
                if verdict.is_stable == lift.held {
                    right.entry(rise_mm).or_default().push(clip.clone());
                }
            }
            let (_, last) = verdicts.last_key_value().unwrap();
            assert_eq!(last.is_stable, lift.held, "{clip}");
            let is_alarmed = verdicts.values().any(|verdict| verdict.is_slipping);
            assert_eq!(is_alarmed, !lift.held, "{clip}");
        }
        bench.hand.next_object();
    }
    println!("{right:?}");
    let [gels, with_object] = right;
    for right in [gels, with_object] {
        assert!(right[&2].len() >= 6 && right[&5].len() >= 6, "{right:?}");
        assert!(right[&10].len() >= 7, "{right:?}");
    }
}
