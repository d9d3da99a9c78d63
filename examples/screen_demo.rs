//! Shows the operator's screen on a made-up engine, to look at it without cameras.
//!
//! `cargo run --example screen_demo [-- grasp|initial|label|fault|refused|no-model]`: without an
//! argument the cycle runs by itself, with one the screen stays at that moment.

use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::sync::Arc;
use std::time::{Duration, Instant};

use gripcast::daemon::{Asked, CameraState, CameraStatus, EngineStatus, PredictionStatus, Preview};
use gripcast::tui::{Sound, Wiring, run};
use gripcast_base::error::Result;
use gripcast_base::files::{Label, ObjectName};
use gripcast_capture::camera::CameraCounters;
use gripcast_dataset::{GraspId, Outcome, PredictionRecord};
use gripcast_imaging::Role;
use gripcast_session::{
    Command, Counts, LastGrasp, Message, MessageLevel, Refusal, SessionView, Step, Tone,
};
use image::{Rgb, RgbImage};
use tokio::sync::{mpsc, watch};

/// Seconds of one cycle: open, close, lift, and a fault.
const CYCLE_S: f64 = 24.0;

fn main() -> Result<()> {
    let moment = std::env::args().nth(1);
    let start = Instant::now();
    let (sender, status) = watch::channel(Arc::new(status_at(0.0, moment.as_deref())));
    let (commands, mut received) = mpsc::channel::<Asked>(16);
    let (tone_sender, tones) = mpsc::unbounded_channel();
    std::thread::spawn(move || {
        while !sender.is_closed() {
            std::thread::sleep(Duration::from_millis(100));
            while let Ok(asked) = received.try_recv() {
                let tone = match asked.command {
                    Command::Trigger | Command::Grasp => Tone::GraspSaved,
                    Command::Initial => Tone::InitialSaved,
                    Command::Label(Outcome::Stable) => Tone::Stable,
                    Command::Label(_) => Tone::Slip,
                    Command::Undo | Command::Redo => Tone::Undone,
                    _ => Tone::Refused,
                };
                // The screen may be gone already.
                let _ = tone_sender.send(tone);
            }
            let now = status_at(start.elapsed().as_secs_f64(), moment.as_deref());
            sender.send_replace(Arc::new(now));
        }
    });
    run(Wiring {
        status,
        commands,
        tones,
        sound: Sound::Auto,
    })
}

fn status_at(time_s: f64, moment: Option<&str>) -> EngineStatus {
    let cycle_s = time_s % CYCLE_S;
    let moment = moment.unwrap_or(match cycle_s {
        ..5.0 => "initial",
        ..12.0 => "grasp",
        ..18.0 => "label",
        ..21.0 => "refused",
        _ => "fault",
    });
    let squeeze = match moment {
        "initial" => 0.0,
        _ => 0.75 + 0.25 * (TAU * time_s / 9.0).sin(),
    };
    let step = match moment {
        "initial" => Step::Initial,
        "label" => Step::Label,
        _ => Step::Grasp,
    };
    let predicts = !matches!(moment, "initial" | "no-model");
    EngineStatus {
        dataset: "kitchen-02".to_owned(),
        rig: "bench-a".to_owned(),
        clock: format!("17:42:{:02}", time_s as u64 % 60),
        disk_free_bytes: Some(212_000_000_000),
        session: session(step, moment, time_s),
        cameras: Role::ALL[..4]
            .iter()
            .map(|&role| camera(role, moment, time_s))
            .collect(),
        prediction: predicts.then(|| PredictionStatus {
            frame_age_ms: 18.0 + 6.0 * (3.0 * time_s).sin(),
            ..PredictionStatus::new(predicted((1.3 * squeeze - 0.35).clamp(0.0, 1.0)), true)
        }),
        prediction_absent: Some(match moment {
            "no-model" => "no model is loaded (--model FILE)".to_owned(),
            _ => "take the initial frame first".to_owned(),
        }),
        contact: match step {
            Step::Initial => BTreeMap::new(),
            _ => [Role::Left, Role::Right]
                .map(|role| (role, 9.0 * squeeze))
                .into(),
        },
        previews: previews(squeeze, step, time_s),
        black_box: None,
    }
}

fn predicted(p_stable: f64) -> PredictionRecord {
    PredictionRecord {
        p_stable,
        novelty: None,
        threshold: 0.5,
        model_sha256: String::new(),
        model: "baseline-contact".to_owned(),
        latency_ms: 12.4,
        engine_ms: 3.1,
    }
}

fn session(step: Step, moment: &str, time_s: f64) -> SessionView {
    SessionView {
        step,
        object: ObjectName::nearest("mug-blue"),
        scene: Label::nearest("sink"),
        operator: Label::nearest("Ada"),
        initial_at: Some("2026-11-20T17:41:58Z".to_owned()),
        initial_age_s: Some(12.0 + time_s % CYCLE_S),
        counts: Counts {
            stable: 88,
            slip: 71,
            unlabelled: 2,
            object_stable: 4,
            object_slip: 2,
        },
        last: GraspId::parse("2026-11-20T17-40-51Z-7f3a")
            .ok()
            .map(|id| LastGrasp {
                id,
                object: ObjectName::nearest("mug-blue"),
                outcome: match step {
                    Step::Label => Outcome::Unlabelled,
                    _ => Outcome::Stable,
                },
                predicted: Some(predicted(0.74)),
            }),
        undo: Some("label of 7f3a".to_owned()),
        redo: None,
        message: Some(Message {
            level: MessageLevel::Warning,
            text: "right gel: the initial frame is 6 min old, take it again with i".to_owned(),
        }),
        refusal: (moment == "refused").then(|| Refusal {
            stage: "grasp".to_owned(),
            reasons: vec![
                "left and right look like the initial frame (contact 0.4, at least 1.5 expected): \
                 close the gripper"
                    .to_owned(),
                "rgb is 140 ms behind the tactile frames (at most 40 ms)".to_owned(),
            ],
            can_override: true,
        }),
        saving: false,
    }
}

fn camera(role: Role, moment: &str, time_s: f64) -> CameraStatus {
    let (product, serial, port, nominal_fps) = match role {
        Role::Left => ("GelSight Mini R0B 2BNN-4ZE7", "2BNN4ZE7", "3-2.1", 25.0),
        Role::Right => ("GelSight Mini R0B 2BKR-9QX1", "2BKR9QX1", "3-2.2", 25.0),
        _ => ("Intel RealSense D435", "842512070215", "4-1", 30.0),
    };
    let failed = moment == "fault" && role == Role::Left;
    CameraStatus {
        role,
        product: product.to_owned(),
        serial: serial.to_owned(),
        port: port.to_owned(),
        state: if failed {
            CameraState::Silent {
                for_s: 1.4 + time_s % 3.0,
            }
        } else {
            CameraState::Live
        },
        measured_fps: nominal_fps - 0.1,
        nominal_fps,
        frame_age_ms: Some(18.0 + 3.0 * f64::from(role as u8)),
        counters: CameraCounters {
            received: (time_s * nominal_fps) as u64,
            sequence_gaps: if role == Role::Right { 3 } else { 0 },
            late: 2,
            ..CameraCounters::default()
        },
        markers: None,
    }
}

fn previews(squeeze: f64, step: Step, time_s: f64) -> BTreeMap<Role, Preview> {
    let touched = step != Step::Initial;
    let tactile = |mirror: f64| Preview {
        image: Arc::new(tactile_picture(squeeze, mirror, touched)),
        is_difference: touched,
    };
    let plain = |image| Preview {
        image: Arc::new(image),
        is_difference: false,
    };
    BTreeMap::from([
        (Role::Left, tactile(1.0)),
        (Role::Right, tactile(-1.0)),
        (Role::Rgb, plain(colour_picture(time_s))),
        (Role::Depth, plain(depth_picture())),
    ])
}

/// A pressed edge lit from three sides; as a difference, around grey.
fn tactile_picture(squeeze: f64, mirror: f64, is_difference: bool) -> RgbImage {
    RgbImage::from_fn(320, 240, |x, y| {
        let u = mirror * (f64::from(x) / 160.0 - 1.0);
        let v = f64::from(y) / 120.0 - 1.0;
        let (along, across) = (u * 0.9 + v * 0.4, v * 0.9 - u * 0.4);
        let depth = (-(along / 0.75).powi(4) - (across / 0.3).powi(2)).exp() * squeeze;
        let slope_x = -4.0 * along.powi(3) * depth;
        let slope_y = -8.0 * across * depth;
        let lights = [0.0, TAU / 3.0, 2.0 * TAU / 3.0];
        let base = if is_difference {
            [128.0; 3]
        } else {
            [95.0 + 30.0 * u, 110.0 - 20.0 * v, 120.0 - 25.0 * u]
        };
        let value = |i: usize| {
            let light: f64 = lights[i];
            base[i] + 75.0 * (slope_x * light.cos() + slope_y * light.sin()) + 25.0 * depth
        };
        Rgb([0, 1, 2].map(|i| value(i).clamp(0.0, 255.0) as u8))
    })
}

/// A blue mug between two fingers.
fn colour_picture(time_s: f64) -> RgbImage {
    let sway = 0.03 * (TAU * time_s / 5.0).sin();
    RgbImage::from_fn(320, 180, |x, y| {
        let u = f64::from(x) / 160.0 - 1.0 - sway;
        let v = f64::from(y) / 90.0 - 1.0;
        let shade = 1.0 - 0.5 * u.abs();
        let finger = u.abs() > 0.42 && u.abs() < 0.62 && v < 0.25;
        let mug = u.abs() < 0.42 && (-0.5..0.7).contains(&v);
        let rgb = match (finger, mug) {
            (true, _) => [60.0, 60.0, 66.0],
            (_, true) => [50.0, 110.0, 215.0].map(|c| c * (1.0 - 1.6 * u * u)),
            _ if v > 0.4 => [170.0, 130.0, 85.0].map(|c| c * shade),
            _ => [205.0, 205.0, 195.0].map(|c| c * shade),
        };
        Rgb(rgb.map(|c| c.clamp(0.0, 255.0) as u8))
    })
}

fn depth_picture() -> RgbImage {
    RgbImage::from_fn(320, 180, |x, y| {
        let u = f64::from(x) / 160.0 - 1.0;
        let v = f64::from(y) / 90.0 - 1.0;
        let near = u.abs() < 0.42 && (-0.5..0.7).contains(&v);
        let level = if near {
            190.0 - 90.0 * u * u
        } else {
            70.0 + 30.0 * v
        };
        Rgb([level, level * 0.8, 255.0 - level].map(|c| c as u8))
    })
}
