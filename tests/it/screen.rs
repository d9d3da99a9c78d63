//! The operator's screen on a fixed status, as text; and that no status and no size breaks it. One
//! file, because all tests share the status.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use gripcast::daemon::{
    CameraState, CameraStatus, EngineStatus, MarkerStatus, PredictionStatus, Preview, StartFinding,
    StartSubject,
};
use gripcast::tui::{ColourDepth, LinePrinter, Overlay, Palette, Reaction, ScreenState, draw};
use gripcast_base::files::{Label, ObjectName};
use gripcast_capture::camera::CameraCounters;
use gripcast_dataset::{GraspId, Outcome, PredictionRecord};
use gripcast_imaging::Role;
use gripcast_session::{
    Command, Counts, LastGrasp, Message, MessageLevel, Refusal, SessionView, Step,
};
use image::{Rgb, RgbImage};
use proptest::prelude::*;
use ratatui::Terminal;
use ratatui::backend::TestBackend;

fn predicted(p_stable: f64, ood_score: Option<f64>) -> PredictionRecord {
    PredictionRecord {
        p_stable,
        ood_score,
        unsure_reason: None,
        adapted: None,
        set: None,
        threshold: 0.5,
        inputs: None,
        geometry: None,
        model_sha256: String::new(),
        model: "baseline-contact".to_owned(),
        latency_ms: 12.4,
        engine_ms: 3.1,
    }
}

fn camera(role: Role, serial: &str, port: &str, nominal_fps: f64) -> CameraStatus {
    let product = if role.is_tactile() {
        format!("GelSight Mini R0B {serial}")
    } else {
        "Intel RealSense D435".to_owned()
    };
    CameraStatus {
        role,
        product,
        serial: serial.to_owned(),
        port: port.to_owned(),
        state: CameraState::Live,
        measured_fps: nominal_fps - 0.1,
        nominal_fps,
        frame_age_ms: Some(18.0),
        counters: CameraCounters {
            received: 1500,
            ..CameraCounters::default()
        },
        markers: None,
    }
}

/// Preview with a bright spot: top left for an image, centre for a difference.
fn preview(is_difference: bool) -> Preview {
    let image = RgbImage::from_fn(64, 48, |x, y| {
        let (cx, cy) = if is_difference {
            (32.0, 24.0)
        } else {
            (0.0, 0.0)
        };
        let distance = (f64::from(x) - cx).hypot(f64::from(y) - cy);
        let rise = (120.0 - 5.0 * distance).max(0.0) as u8;
        Rgb([if is_difference { 128 } else { 20 } + rise; 3])
    });
    let image = Arc::new(image);
    Preview {
        difference: is_difference.then(|| Arc::clone(&image)),
        levels: None,
        driver_time_ns: 0,
        image,
    }
}

fn waiting_for_grasp() -> EngineStatus {
    EngineStatus {
        monotonic_ms: 0,
        dataset: "kitchen-02".to_owned(),
        rig: "bench-a".to_owned(),
        clock: "17:42:10".to_owned(),
        disk_free_bytes: Some(212_000_000_000),
        grasps_left: None,
        target_per_object: 0,
        objects: Arc::default(),
        start_report: Vec::new(),
        black_box: None,
        session: SessionView {
            revision: 0,
            step: Step::Grasp,
            object: "mug-blue".parse().unwrap(),
            scene: "sink".parse().unwrap(),
            operator: "Ada".parse().unwrap(),
            initial_at: Some("2026-11-20T17:41:58Z".to_owned()),
            initial_age_s: Some(12.0),
            counts: Counts {
                stable: 88,
                slip: 71,
                unlabelled: 2,
                object_stable: 4,
                object_slip: 2,
            },
            last: Some(LastGrasp {
                id: GraspId::parse("2026-11-20T17-40-51Z-7f3a").unwrap(),
                object: "mug-blue".parse().unwrap(),
                outcome: Outcome::Stable,
                predicted: Some(predicted(0.74, None)),
            }),
            undo: Some("initial frame".to_owned()),
            redo: None,
            message: Some(Message {
                level: MessageLevel::Info,
                text: "initial frame saved".to_owned(),
            }),
            refusal: None,
            saving: false,
        },
        cameras: vec![
            camera(Role::Left, "2BNN4ZE7", "3-2.1", 25.0),
            CameraStatus {
                counters: CameraCounters {
                    received: 1500,
                    sequence_gaps: 3,
                    reconnects: 1,
                    ..CameraCounters::default()
                },
                ..camera(Role::Right, "2BKR9QX1", "3-2.2", 25.0)
            },
            camera(Role::Rgb, "842512070215", "4-1", 30.0),
            camera(Role::Depth, "842512070215", "4-1", 30.0),
        ],
        prediction: Some(PredictionStatus {
            frame_age_ms: 18.0,
            ..PredictionStatus::new(predicted(0.81, None), true)
        }),
        lift: None,
        no_prediction_reason: None,
        adaptation: None,
        contact: BTreeMap::from([(Role::Left, 8.4), (Role::Right, 8.4)]),
        gels: BTreeMap::new(),
        shear: BTreeMap::new(),
        force: BTreeMap::new(),
        marker_fields: BTreeMap::new(),
        previews: BTreeMap::from([
            (Role::Left, preview(true)),
            (Role::Right, preview(true)),
            (Role::Rgb, preview(false)),
        ]),
    }
}

fn waiting_for_initial() -> EngineStatus {
    let mut status = waiting_for_grasp();
    status.session.step = Step::Initial;
    status.session.initial_at = None;
    status.session.initial_age_s = None;
    status.prediction = None;
    status.no_prediction_reason = Some("take the initial frame first".to_owned());
    status.contact.clear();
    for (role, preview) in &mut status.previews {
        if role.is_tactile() {
            *preview = self::preview(false);
        }
    }
    status
}

fn labelling() -> EngineStatus {
    let mut status = waiting_for_grasp();
    status.session.step = Step::Label;
    let said = PredictionRecord {
        model: "gripnet-3".to_owned(),
        ..predicted(0.12, None)
    };
    status.prediction = Some(PredictionStatus {
        frame_age_ms: 18.0,
        ..PredictionStatus::new(said, false)
    });
    if let Some(last) = &mut status.session.last {
        last.outcome = Outcome::Unlabelled;
        last.predicted = Some(predicted(0.12, Some(0.4)));
    }
    status.session.undo = Some("grasp 7f3a".to_owned());
    status
}

fn refused() -> EngineStatus {
    let mut status = waiting_for_grasp();
    status.session.refusal = Some(Refusal {
        stage: "grasp".to_owned(),
        reasons: vec![
            "left and right look like the initial frame (contact 0.4, at least 1.5 expected)"
                .to_owned(),
            "rgb is 140 ms behind the tactile frames (at most 40 ms)".to_owned(),
        ],
        can_override: true,
    });
    status
}

fn faulty() -> EngineStatus {
    let mut status = waiting_for_grasp();
    status.cameras[0].state = CameraState::Silent { for_s: 1.4 };
    status
}

fn state() -> ScreenState {
    ScreenState::new(Palette {
        depth: ColourDepth::Mono,
    })
}

fn image(width: u16, height: u16, status: &EngineStatus, state: &ScreenState) -> String {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    terminal.draw(|frame| draw(frame, status, state)).unwrap();
    terminal.backend().to_string()
}

fn press(state: &mut ScreenState, code: KeyCode, status: &EngineStatus) -> Reaction {
    state.press(&KeyEvent::new(code, KeyModifiers::NONE), status)
}

#[test]
fn screen_at_80_by_24() {
    insta::assert_snapshot!("initial", image(80, 24, &waiting_for_initial(), &state()));
    insta::assert_snapshot!("grasp", image(80, 24, &waiting_for_grasp(), &state()));
    insta::assert_snapshot!("label", image(80, 24, &labelling(), &state()));
    insta::assert_snapshot!("refusal", image(80, 24, &refused(), &state()));
    insta::assert_snapshot!("fault", image(80, 24, &faulty(), &state()));
}

#[test]
fn overlays_at_80_by_24() {
    let status = waiting_for_grasp();
    let mut help = state();
    press(&mut help, KeyCode::Char('?'), &status);
    insta::assert_snapshot!("help", image(80, 24, &status, &help));
    let mut sensors = state();
    press(&mut sensors, KeyCode::Char('h'), &status);
    insta::assert_snapshot!("sensors", image(80, 24, &status, &sensors));
}

#[test]
fn screen_without_model() {
    let mut status = waiting_for_grasp();
    status.prediction = None;
    status.no_prediction_reason = Some("no model is loaded (--model FILE)".to_owned());
    insta::assert_snapshot!("no_model", image(80, 24, &status, &state()));
}

#[test]
fn other_sizes() {
    let status = waiting_for_grasp();
    let mut typing = state();
    press(&mut typing, KeyCode::Char('o'), &status);
    for c in "Tasse für 茶".chars() {
        press(&mut typing, KeyCode::Char(c), &status);
    }
    insta::assert_snapshot!("narrow", image(60, 18, &status, &typing));
    insta::assert_snapshot!("wide", image(160, 50, &status, &state()));
    insta::assert_snapshot!("compact", image(48, 14, &status, &state()));
    insta::assert_snapshot!("tiny", image(39, 5, &status, &state()));
}

#[test]
fn old_prediction_has_no_verdict() {
    let mut status = waiting_for_grasp();
    if let Some(prediction) = &mut status.prediction {
        prediction.frame_age_ms = 1_400.0;
    }
    let tiny = image(39, 5, &status, &state());
    assert!(tiny.contains("OLD") && !tiny.contains("STABLE"), "{tiny}");
    let full = image(80, 24, &status, &state());
    assert!(full.contains("frame 1.4 s old"), "{full}");
}

#[test]
fn dismissed_fault_stays_one_line_until_another_camera_fails() {
    let mut status = faulty();
    let mut state = state();
    press(&mut state, KeyCode::Esc, &status);
    let aside = image(80, 24, &status, &state);
    assert!(aside.contains("CLOSE THE GRIPPER"), "{aside}");
    assert!(aside.contains("LEFT GELSIGHT SILENT 1.4 s"), "{aside}");
    status.cameras[2].state = CameraState::Unplugged {
        reason: "no device with serial 842512070215".to_owned(),
    };
    let both = image(80, 24, &status, &state);
    assert!(!both.contains("CLOSE THE GRIPPER"), "{both}");
    assert!(both.contains("also: COLOUR CAMERA UNPLUGGED"), "{both}");
}

#[test]
fn damaged_and_unavailable_cameras_are_not_told_to_be_plugged_in() {
    let with = |state: CameraState| {
        let mut status = faulty();
        status.cameras[0].state = state;
        image(80, 24, &status, &crate::screen::state())
    };
    let reason = || "the JPEG is truncated".to_owned();
    let damaged = with(CameraState::Damaged {
        fraction: 0.87,
        reason: reason(),
    });
    for words in ["DAMAGED", "87 %", "the JPEG is truncated", "whole"] {
        assert!(damaged.contains(words), "{words}: {damaged}");
    }
    let unavailable = with(CameraState::Unavailable { reason: reason() });
    assert!(unavailable.contains("FREE IT"), "{unavailable}");
    for screen in [damaged, unavailable] {
        assert!(!screen.contains("PLUG IT IN"), "{screen}");
    }
    let blind = with(CameraState::NoValidDepth { for_s: 3.0 });
    assert!(
        blind.contains("sees nothing") && blind.contains("CLOSE THE GRIPPER"),
        "{blind}"
    );
}

#[test]
fn recovered_camera_shows_its_next_fault() {
    let mut state = state();
    press(&mut state, KeyCode::Esc, &faulty());
    state.update(&waiting_for_grasp());
    let again = image(80, 24, &faulty(), &state);
    assert!(!again.contains("CLOSE THE GRIPPER"), "{again}");
}

#[test]
fn marker_detection_of_external_camera_is_shown() {
    let with = |markers: Result<&str, &str>| {
        let mut status = waiting_for_initial();
        status.cameras.push(CameraStatus {
            markers: Some(MarkerStatus {
                ok: markers.is_ok(),
                text: markers.unwrap_or_else(|why| why).to_owned(),
            }),
            ..camera(Role::External, "9F2C", "3-3", 30.0)
        });
        status
    };
    let seen = with(Ok("sheet 13, tags 6, 0.06 px"));
    let shown = image(120, 40, &seen, &state());
    assert!(shown.contains("sheet 13, tags 6"), "{shown}");
    let lost = with(Err("the sheet is not in the image"));
    let shown = image(120, 40, &lost, &state());
    assert!(shown.contains("no pose: the sheet"), "{shown}");

    let mut printer = LinePrinter::default();
    let begin = Instant::now();
    let after = |seconds| begin + Duration::from_secs(seconds);
    let told = |lines: Vec<String>| lines.join("\n");
    assert!(told(printer.lines(&seen, begin)).contains("external: pose can be measured"));
    assert!(!told(printer.lines(&seen, after(5))).contains("external"));
    assert!(told(printer.lines(&lost, after(10))).contains("external: no pose: the sheet"));
}

#[test]
fn q_asks_for_confirmation_if_work_is_unfinished() {
    let quit = |status: &EngineStatus, keys: &[char]| {
        let mut state = state();
        let reactions = keys
            .iter()
            .map(|&c| press(&mut state, KeyCode::Char(c), status));
        reactions.last()
    };
    let mut saving = waiting_for_grasp();
    saving.session.saving = true;
    assert_eq!(quit(&waiting_for_grasp(), &['q']), Some(Reaction::Leave));
    for unfinished in [&labelling(), &saving] {
        assert_eq!(quit(unfinished, &['q']), Some(Reaction::None));
        assert_eq!(quit(unfinished, &['q', 'q']), Some(Reaction::Leave));
        assert_eq!(quit(unfinished, &['q', '?', 'q']), Some(Reaction::None));
    }
    let stable = Reaction::Send(Command::Label(Outcome::Stable));
    assert_eq!(quit(&labelling(), &['q', 's']), Some(stable));
    let interrupt = KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL);
    assert_eq!(state().press(&interrupt, &labelling()), Reaction::Leave);
}

#[test]
fn keys_in_a_prompt_are_not_commands() {
    let status = waiting_for_grasp();
    let mut state = state();
    press(&mut state, KeyCode::Char('n'), &status);
    for c in "sofa q".chars() {
        assert_eq!(press(&mut state, KeyCode::Char(c), &status), Reaction::None);
    }
    let scene = Reaction::Send(Command::Scene("sofa q".parse().unwrap()));
    assert_eq!(press(&mut state, KeyCode::Enter, &status), scene);
    assert_eq!(state.prompt, None);
    press(&mut state, KeyCode::Char('o'), &status);
    press(&mut state, KeyCode::Char('x'), &status);
    assert_eq!(press(&mut state, KeyCode::Esc, &status), Reaction::None);
    let trigger = Reaction::Send(Command::Trigger);
    assert_eq!(press(&mut state, KeyCode::Char(' '), &status), trigger);
}

#[test]
fn plain_lines_report_each_change_once() {
    let mut printer = LinePrinter::default();
    let start = Instant::now();
    let mut at_s = 0;
    let mut lines = |status: &EngineStatus| {
        at_s += 3;
        printer.lines(status, start + Duration::from_secs(at_s))
    };
    insta::assert_snapshot!("lines_start", lines(&waiting_for_initial()).join("\n"));
    assert_eq!(lines(&waiting_for_initial()), [""; 0]);

    let predicting = ["predicting 0.81 STABLE (baseline-contact, heuristic)"];
    assert_eq!(lines(&waiting_for_grasp()), predicting);
    assert_eq!(lines(&waiting_for_grasp()), [""; 0]);

    let mut saved = labelling();
    let id = GraspId::parse("2026-11-20T17-42-10Z-52c1").unwrap();
    saved.session.last.as_mut().unwrap().id = id;
    assert_eq!(
        lines(&saved),
        [
            "predicting 0.12 SLIP (gripnet-3)",
            "saved 2026-11-20T17-42-10Z-52c1 mug-blue: predicted 0.12 SLIP"
        ]
    );
    let mut odd = labelling();
    let last = odd.session.last.as_mut().unwrap();
    last.id = GraspId::parse("2026-11-20T17-43-00Z-0b77").unwrap();
    last.predicted = Some(predicted(0.97, Some(1.3)));
    assert_eq!(
        lines(&odd),
        ["saved 2026-11-20T17-43-00Z-0b77 mug-blue: predicted 0.97 UNSURE"]
    );
    assert_eq!(lines(&saved).len(), 1);
    saved.session.last.as_mut().unwrap().outcome = Outcome::Slip;
    assert_eq!(lines(&saved), ["labelled 2026-11-20T17-42-10Z-52c1 slip"]);

    saved.cameras[0].state = CameraState::Frozen { for_s: 2.0 };
    let fault = lines(&saved);
    assert_eq!(fault.len(), 1);
    assert!(
        fault[0].starts_with("FAULT LEFT GELSIGHT FROZEN 2.0 s"),
        "{fault:?}"
    );
    saved.cameras[0].state = CameraState::Frozen { for_s: 9.0 };
    assert_eq!(lines(&saved), [""; 0]);
}

#[test]
fn plain_lines_of_flapping_camera_are_rate_limited() {
    let mut printer = LinePrinter::default();
    let start = Instant::now();
    printer.lines(&waiting_for_grasp(), start);
    let mut count = 0;
    for step in 0..100_u64 {
        let status = if step % 2 == 0 {
            faulty()
        } else {
            waiting_for_grasp()
        };
        let now = start + Duration::from_millis(100 * step);
        count += printer.lines(&status, now).len();
    }
    assert!((1..=6).contains(&count), "{count} lines in 10 s");
}

fn any_number() -> impl Strategy<Value = f64> {
    prop_oneof![
        Just(f64::NAN),
        Just(f64::INFINITY),
        Just(f64::NEG_INFINITY),
        Just(-1e300),
        0.0..1.0,
        0.0..1e9,
    ]
}

fn any_text() -> impl Strategy<Value = String> {
    prop_oneof![".{0,60}", "[茶ß☕e\u{301}\u{200b}\u{7}\n ]{0,20}"]
}

fn any_state() -> impl Strategy<Value = CameraState> {
    prop_oneof![
        Just(CameraState::Opening),
        Just(CameraState::Live),
        Just(CameraState::Ended),
        any_number().prop_map(|for_s| CameraState::Silent { for_s }),
        any_number().prop_map(|for_s| CameraState::Frozen { for_s }),
        any_number().prop_map(|for_s| CameraState::NoValidDepth { for_s }),
        any_text().prop_map(|reason| CameraState::Unplugged { reason }),
        any_text().prop_map(|reason| CameraState::Unavailable { reason }),
        (any_number(), any_text())
            .prop_map(|(fraction, reason)| CameraState::Damaged { fraction, reason }),
    ]
}

prop_compose! {
    fn any_camera()(
        role in proptest::sample::select(Role::ALL.to_vec()),
        state in any_state(),
        numbers in (any_number(), any_number(), proptest::option::of(any_number())),
        text in (any_text(), any_text(), any_text()),
        count in any::<u64>(),
    ) -> CameraStatus {
        CameraStatus {
            role, state,
            product: text.0, serial: text.1, port: text.2,
            measured_fps: numbers.0, nominal_fps: numbers.1, frame_age_ms: numbers.2,
            counters: CameraCounters {
                received: count, sequence_gaps: count / 3, damaged: count / 5, late: count,
                duplicates: 0, reconnects: count % 2,
            },
            markers: None,
        }
    }
}

prop_compose! {
    fn any_prediction()(n in (any_number(), any_number(), any_number()), model in any_text())
        -> PredictionStatus
    {
        let said = PredictionRecord {
            threshold: n.1, model, latency_ms: n.0, engine_ms: n.1,
            ..predicted(n.0, None)
        };
        PredictionStatus { frame_age_ms: n.2, ..PredictionStatus::new(said, n.2 > 0.5) }
    }
}

prop_compose! {
    fn any_session()(
        step in proptest::sample::select(vec![Step::Initial, Step::Grasp, Step::Label]),
        names in (any_text(), any_text(), any_text()),
        age in proptest::option::of(any_number()),
        counts in (any::<u32>(), any::<u32>(), any::<u32>()),
        said in proptest::option::of((any_number(), proptest::option::of(any_number()))),
        undo in proptest::option::of(any_text()),
        reasons in proptest::option::of(proptest::collection::vec(any_text(), 0..9)),
        saving in any::<bool>(),
    ) -> SessionView {
        let [a, b, c] = [counts.0, counts.1, counts.2].map(|n| n as usize);
        SessionView {
            revision: 0,
            step,
            initial_at: None,
            initial_age_s: age,
            counts: Counts { stable: a, slip: b, unlabelled: c, object_stable: c, object_slip: a },
            last: Some(LastGrasp {
                id: GraspId::parse("2026-11-20T10-15-03Z-7f3a").unwrap(),
                object: ObjectName::nearest(&names.1),
                outcome: Outcome::Slip,
                predicted: said.map(|(p_stable, ood_score)| predicted(p_stable, ood_score)),
            }),
            redo: undo.clone(),
            message: Some(Message { level: MessageLevel::Error, text: names.2.clone() }),
            refusal: reasons.map(|reasons| Refusal {
                stage: names.0.clone(), reasons, can_override: saving,
            }),
            object: ObjectName::nearest(&names.0), scene: Label::nearest(&names.1), operator: Label::nearest(&names.2),
            undo, saving,
        }
    }
}

prop_compose! {
    fn any_status()(
        session in any_session(),
        cameras in proptest::collection::vec(any_camera(), 0..7),
        prediction in proptest::option::of(any_prediction()),
        absent in proptest::option::of(any_text()),
        text in any_text(),
        disk in proptest::option::of(any::<u64>()),
        image in (0..70_u32, 0..70_u32, any::<bool>()),
    ) -> EngineStatus {
        let preview = Preview {
            image: Arc::new(RgbImage::new(image.0, image.1)),
            difference: image.2.then(|| Arc::new(RgbImage::new(image.0, image.1))),
            levels: None,
            driver_time_ns: 0,
        };
        let contact = prediction.as_ref().map(|p| (Role::Left, p.record.p_stable));
        let subject = StartSubject::Clock;
        let level = MessageLevel::Warning;
        let report = vec![StartFinding { subject, level, text: text.clone() }];
        EngineStatus {
            monotonic_ms: 0,
            black_box: None,
            dataset: text.clone(), rig: text.clone(), clock: text,
            disk_free_bytes: disk,
            grasps_left: disk.map(|free| free / 1_300_000),
            target_per_object: 20, objects: Arc::default(), start_report: report,
            contact: contact.into_iter().collect(),
            adaptation: None, gels: BTreeMap::new(), shear: BTreeMap::new(), force: BTreeMap::new(), marker_fields: BTreeMap::new(),
            session, cameras, prediction,
            lift: None,
            no_prediction_reason: absent,
            previews: BTreeMap::from([(Role::Left, preview.clone()), (Role::External, preview)]),
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(192))]

    #[test]
    fn screen_draws_any_status_at_any_size(
        width in 1..=300_u16,
        height in 1..=100_u16,
        status in any_status(),
        depth in proptest::sample::select(
            vec![ColourDepth::True, ColourDepth::Indexed, ColourDepth::Mono]
        ),
        overlay in proptest::sample::select(
            vec![Overlay::None, Overlay::Help, Overlay::Sensors]
        ),
        typed in proptest::option::of(any_text()),
    ) {
        let mut state = ScreenState::new(Palette { depth });
        state.overlay = overlay;
        if width % 2 == 0 {
            press(&mut state, KeyCode::Esc, &status);
        }
        if let Some(typed) = typed {
            press(&mut state, KeyCode::Char('p'), &status);
            for c in typed.chars() {
                press(&mut state, KeyCode::Char(c), &status);
            }
        }
        image(width, height, &status, &state);
        LinePrinter::default().lines(&status, Instant::now());
    }
}
