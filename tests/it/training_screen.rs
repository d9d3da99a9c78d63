//! The dashboard of a training on fixed news, as text; and that no news and no size breaks it.

use std::time::Duration;

use gripcast::tui::{ColourDepth, Palette, TrainingNews, TrainingStatus, draw_training};
use gripcast_nn::Architecture;
use gripcast_nn::predict::contract::Modality;
use gripcast_train::{EpochMetrics, RunStart, SplitCounts, TrainEvent, TrainSettings};
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::style::Color;

const STEPS: u64 = 40;
const EPOCHS: u64 = 30;
/// Duration of a step.
const STEP: Duration = Duration::from_millis(1200);

fn settings() -> TrainSettings {
    TrainSettings::new(Modality::Vt, Architecture::by_name("gripcast").unwrap(), 0)
}

fn fresh(seeds: u64) -> TrainingStatus {
    TrainingStatus::new("kitchen-fem", "vt", settings(), seeds)
}

fn figures(epoch: u32) -> EpochMetrics {
    let since = f64::from(epoch);
    EpochMetrics {
        epoch,
        train_loss: 0.7 * (-since / 5.0).exp(),
        validation_loss: 0.6 - 0.05 * since + 0.006 * since * since,
        validation_accuracy: 0.9 - 0.01 * (since - 5.0).powi(2),
        validation_auroc: Some(0.95 - 0.008 * (since - 6.0).powi(2)),
        validation_geometry_error_m: None,
        samples_per_s: 13.0,
    }
}

fn start(epochs: u32) -> RunStart {
    let split = |samples, stable, objects| SplitCounts {
        samples,
        stable,
        objects,
    };
    RunStart {
        train: split(640, 322, 38),
        validation: split(96, 48, 9),
        steps_per_epoch: STEPS,
        steps: [u64::from(epochs) * STEPS, EPOCHS * STEPS],
        epochs: (1..=epochs).map(figures).collect(),
        batch_size: 16,
        warnings: Vec::new(),
    }
}

/// Applies a range of steps.
fn steps(status: &mut TrainingStatus, steps: std::ops::Range<u64>) {
    let begun = steps.start;
    for step in steps {
        let event = TrainEvent::Step {
            steps: [step + 1, EPOCHS * STEPS],
            loss: 0.69 / (1.0 + step as f64 / 60.0),
            learning_rate: 3e-4 * (1.0 - step as f64 / (EPOCHS * STEPS) as f64),
        };
        let after = STEP * u32::try_from(step + 1 - begun).unwrap();
        status.apply(TrainingNews::Train(event), after);
    }
}

/// Status in the first epoch of the first of five seeds.
fn started() -> TrainingStatus {
    let mut status = fresh(5);
    status.apply(TrainingNews::Seed(0), Duration::ZERO);
    status.apply(
        TrainingNews::Train(TrainEvent::Started(start(0))),
        Duration::ZERO,
    );
    steps(&mut status, 0..17);
    status
}

/// Status of a run resumed after six epochs.
fn resumed() -> TrainingStatus {
    let mut status = fresh(1);
    status.apply(
        TrainingNews::Train(TrainEvent::Started(start(6))),
        Duration::ZERO,
    );
    steps(&mut status, 6 * STEPS..7 * STEPS);
    let event = TrainEvent::Epoch(figures(7));
    status.apply(TrainingNews::Train(event), 41 * STEP);
    steps(&mut status, 7 * STEPS..7 * STEPS + 12);
    status.set_elapsed(Duration::from_secs(3725));
    status
}

fn image(width: u16, height: u16, status: &TrainingStatus) -> String {
    drawn(width, height, status, ColourDepth::Mono).to_string()
}

fn drawn(width: u16, height: u16, status: &TrainingStatus, depth: ColourDepth) -> TestBackend {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    let palette = Palette { depth };
    let draw = |frame: &mut ratatui::Frame<'_>| draw_training(frame, status, palette);
    terminal.draw(draw).unwrap();
    terminal.backend().clone()
}

#[test]
fn dashboard_at_80_by_24() {
    insta::assert_snapshot!("waiting", image(80, 24, &fresh(1)));
    insta::assert_snapshot!("first_epoch", image(80, 24, &started()));
    insta::assert_snapshot!("resumed", image(80, 24, &resumed()));
}

#[test]
fn dashboard_at_other_sizes() {
    insta::assert_snapshot!("wide", image(120, 36, &resumed()));
    insta::assert_snapshot!("narrow", image(48, 20, &resumed()));
    insta::assert_snapshot!("low", image(80, 9, &resumed()));
    insta::assert_snapshot!("tiny", image(30, 3, &resumed()));
}

#[test]
fn other_stages_are_shown() {
    let mut status = resumed();
    let now = Duration::from_secs(70);
    let look = TrainEvent::Validate([64, 96]);
    status.apply(TrainingNews::Train(look), now);
    assert!(image(80, 24, &status).contains("validation, 64 of 96 samples"));
    status.apply(TrainingNews::Stage("calibrating"), now);
    assert!(image(80, 24, &status).contains("calibrating"));
}

#[test]
fn next_seed_resets_screen_and_keeps_last_as_line() {
    let mut status = fresh(2);
    let now = Duration::from_secs(9);
    status.apply(TrainingNews::Seed(0), now);
    status.apply(TrainingNews::Train(TrainEvent::Started(start(7))), now);
    status.apply(TrainingNews::Seed(1), now);
    let text = image(100, 24, &status);
    assert!(text.contains("seed 1, 2 of 2"), "{text}");
    let line = "seed 0: best epoch 6 of 7, validation AUROC 0.950, accuracy 0.890";
    assert!(text.contains(line), "{text}");
    assert!(text.contains("reading the dataset"), "{text}");
}

#[test]
fn colours_are_disabled_on_request() {
    let has_colour = |depth| {
        let screen = drawn(80, 24, &resumed(), depth);
        let cells = screen.buffer().content().iter();
        cells
            .map(|cell| (cell.fg, cell.bg))
            .any(|colours| colours != (Color::Reset, Color::Reset))
    };
    assert!(!has_colour(ColourDepth::Mono));
    assert!(has_colour(ColourDepth::Indexed));
    // The terminal's own background, light or dark, stays.
    let screen = drawn(80, 24, &resumed(), ColourDepth::True);
    assert!(
        screen
            .buffer()
            .content()
            .iter()
            .all(|cell| cell.bg == Color::Reset)
    );
}

#[test]
fn any_size_and_values_can_be_drawn() {
    let mut odd = TrainingStatus::new("茶 ☕\n\u{7}", "", settings(), 100);
    let broken = EpochMetrics {
        train_loss: f64::NAN,
        validation_loss: f64::INFINITY,
        validation_accuracy: -1e300,
        validation_auroc: None,
        ..figures(1)
    };
    let nothing = RunStart {
        steps_per_epoch: 0,
        steps: [7, 0],
        epochs: vec![broken; 40],
        ..start(0)
    };
    odd.apply(
        TrainingNews::Train(TrainEvent::Started(nothing)),
        Duration::MAX,
    );
    let step = TrainEvent::Step {
        steps: [8, 0],
        loss: f64::NAN,
        learning_rate: f64::INFINITY,
    };
    odd.apply(TrainingNews::Train(step), Duration::ZERO);
    for status in [fresh(1), started(), resumed(), odd] {
        for width in 1..=100 {
            for height in [1, 2, 5, 6, 7, 8, 9, 12, 14, 15, 16, 19, 24, 40, 60] {
                drawn(width, height, &status, ColourDepth::Indexed);
            }
        }
    }
}
