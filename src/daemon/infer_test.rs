//! Tests of the inference thread.

use super::*;
use gripcast_imaging::{ChangeKind, Frame, MIN_CONTACT_FRACTION, PixelFormat, synthetic_gel};

const CAPTURED_NS: u64 = 100;

fn gel(contact: f32) -> RgbImage {
    synthetic_gel(160, 120, 1, contact)
}

#[test]
fn newest_image_per_camera_is_used_after_pending_requests() {
    let hub = Hub::new([Role::Left], Tap::default());
    let state = Arc::default();
    let mut worker = Worker::new(&hub, None, GelTrackers::default(), &state);
    let mut new_images = VecDeque::new();
    let (reply, answer) = std::sync::mpsc::channel();
    let images = BTreeMap::new();
    for request in [
        InferRequest::NewImage(Role::Left),
        InferRequest::NewImage(Role::Right),
        InferRequest::NewImage(Role::Left),
        InferRequest::Analyse {
            images,
            depth: None,
            reply,
        },
    ] {
        assert!(worker.handle(request, &mut new_images).is_continue());
    }
    assert_eq!(
        answer.try_recv(),
        Ok(SavedAnalysis::default()),
        "must be answered first"
    );
    assert_eq!(new_images, [Role::Left, Role::Right]);
    assert!(
        worker
            .handle(InferRequest::Stop, &mut new_images)
            .is_break()
    );
}

#[test]
fn contact_refers_to_the_newest_initial_frame_only() {
    let hub = Hub::new([Role::Left], Tap::default());
    let state = Arc::default();
    let mut worker = Worker::new(&hub, None, GelTrackers::default(), &state);
    let show = |worker: &mut Worker, contact: f32, at_ns: u64| {
        let frame = Frame {
            format: PixelFormat::Grey,
            width: 160,
            height: 120,
            data: vec![0; 160 * 120].into(),
            sequence: 1,
            driver_time_ns: at_ns,
            received_ns: at_ns,
        };
        hub.slot(Role::Left)
            .unwrap()
            .on_decoded(&frame, gel(contact), None);
        worker.on_new_image(Role::Left);
    };
    let contact = |revision: u64, since_ns: u64| {
        let change = lock(&state).change(Role::Left, Some(revision), since_ns);
        change.map(|change| change.kind(MIN_CONTACT_FRACTION))
    };
    let initial = Arc::new(gel(0.0));
    let set = |worker: &mut Worker, revision: u64| {
        worker.set_initial(revision, Arc::clone(&initial), Arc::clone(&initial));
    };

    set(&mut worker, 1);
    assert_eq!(contact(1, 0), None, "no frame yet");
    show(&mut worker, 0.8, CAPTURED_NS);
    assert_eq!(contact(1, 0), Some(ChangeKind::Contact));
    assert_eq!(
        contact(1, CAPTURED_NS),
        None,
        "the frame is older than the capture"
    );
    assert_eq!(contact(2, 0), None, "the revision is not set yet");
    // An undo restores the same initial frame.
    set(&mut worker, 2);
    assert_eq!(contact(2, 0), None, "the frame is older than the revision");
    assert_eq!(contact(1, 0), None);
    show(&mut worker, 0.0, CAPTURED_NS + 1);
    assert_eq!(contact(2, 0), Some(ChangeKind::Unchanged));
    assert!(lock(&state).gels[&Role::Left].problems.is_empty());
}
