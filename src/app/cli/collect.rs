//! `gripcast collect`: the collection program.
//!
//! Opens the cameras of a rig, shows them live with the predicted stability, and saves grasps:
//! trigger once with the gripper open (initial), close it, trigger again (grasp), read the
//! prediction, lift, label. Everything that was acknowledged by a sound or on the screen is on
//! disk, whatever happens next.
//!
//! With a terminal it shows the operator's screen; with `--script` or `--headless` it prints lines
//! on stderr. The closing report goes to stdout. Exit codes: 0 ok, 3 a save failed, 69 a camera is
//! missing at the start, 75 ended by SIGTERM, 130 by Ctrl-C.

use std::fmt::Write as _;
use std::io::IsTerminal as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::RecvTimeoutError;
use std::time::Duration;

use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::{mpsc, watch};

use super::{ConfigFlag, Context, print, print_json};
use crate::app::config::{self, CollectConfig, FlagValue, Layered};
use crate::app::daemon::{
    self, Boards, CollectReport, Ended, EngineLinks, EngineSetup, EngineStatus,
};
use crate::app::model_choice::chosen_model;
use crate::app::tui;
use crate::dataset::NewDataset;
use crate::error::{Error, ErrorKind, Result};
use crate::imaging::Role;
use crate::rig::calibration::{PedalConfig, RigFile};
use crate::rig::camera::{MonotonicClock, RigSources, SupervisionPolicy};
use crate::rig::device::SystemRoot;
use crate::rig::trigger::{PedalEvent, Script, run_pedal};
use crate::session::{Command, CommandSource, Labels, StoreReply};

/// Commands that wait for the engine; an operator cannot press faster than they are taken.
const COMMAND_QUEUE: usize = 64;
/// How long the screen may take to come to its end after the engine.
const SCREEN_PATIENCE: Duration = Duration::from_secs(2);

/// What "stable" means in a new dataset.
const LABEL_DEFINITION: &str = "stable: the object stayed in the gripper while it was lifted; \
                                slip: it moved in the gripper or fell";

/// Arguments of `collect`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Rig: `virtual`, the name of a rig file, or its path
    #[arg(long)]
    rig: Option<String>,
    /// Dataset directory; created when absent
    #[arg(short = 'C', long, value_name = "DIR")]
    dataset: Option<PathBuf>,
    /// Object at the start
    #[arg(long)]
    object: Option<String>,
    /// Scene at the start
    #[arg(long)]
    scene: Option<String>,
    /// Who holds the gripper
    #[arg(long)]
    operator: Option<String>,
    /// ONNX file, `gripcast-vt`, the built-in classifier, `baseline-contact`, a heuristic of touch
    /// alone, or `none` for no prediction [default: gripcast-vt; baseline-contact where the rig's
    /// cameras or crop profile are not those of the classifier]
    #[arg(long, value_name = "MODEL")]
    model: Option<String>,
    /// Timed commands instead of an operator
    #[arg(long, value_name = "FILE")]
    script: Option<PathBuf>,
    /// No screen, even on a terminal; commands come from a pedal or a script
    #[arg(long)]
    headless: bool,
    /// Sounds: auto, bell, off
    #[arg(long)]
    sound: Option<String>,
    /// Seed of the virtual rig
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Closing report as one JSON object on stdout
    #[arg(long)]
    json: bool,
    /// Every change of the dataset as a line of JSON on stdout, when it is durable
    #[arg(long)]
    events: bool,
    #[command(flatten)]
    config: ConfigFlag,
}

impl Args {
    fn flags(&self) -> Vec<FlagValue> {
        let path = |path: &PathBuf| path.display().to_string();
        [
            ("--rig", "collect.rig", self.rig.clone()),
            (
                "--dataset",
                "collect.dataset",
                self.dataset.as_ref().map(path),
            ),
            ("--object", "collect.object", self.object.clone()),
            ("--scene", "collect.scene", self.scene.clone()),
            ("--operator", "collect.operator", self.operator.clone()),
            ("--model", "collect.model", self.model.clone()),
            ("--sound", "collect.sound", self.sound.clone()),
        ]
        .into_iter()
        .filter_map(|(flag, key, value)| Some((flag, key, value?)))
        .collect()
    }
}

/// Runs the verb.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    let Layered { config, .. } = config::load(
        args.config.path().as_deref(),
        std::env::vars(),
        &args.flags(),
    )?;
    let settings = config.collect;
    let rig = chosen_rig(&settings)?;
    let dataset = chosen_dataset(&settings)?;
    let script = args.script.as_deref().map(read_script).transpose()?;
    let screen = !args.headless
        && !args.events
        && script.is_none()
        && std::io::stdin().is_terminal()
        && std::io::stdout().is_terminal();
    if !screen && script.is_none() && rig.pedals.is_empty() {
        return Err(Error::new(
            ErrorKind::Usage,
            "there is no terminal, no --script and no pedal in the rig: nothing could trigger",
        )
        .remedy("run it in a terminal, give --script FILE, or add a [[pedals]] entry to the rig"));
    }
    let sound = sound(&settings.sound)?;
    let model = chosen_model(&settings.model, &rig, context.quiet)?;
    let root = SystemRoot::default();
    let sources = RigSources::of(&rig, &root, args.seed)?;
    sources.check_present()?;
    let (intrinsics, notes) = sources.intrinsics(&rig, &root)?;
    if !context.quiet {
        for note in notes {
            eprintln!("{note}");
        }
    }

    let boards = match (&rig.boards, &sources.hand) {
        (Some(boards), _) => Some(Boards::read(boards)?),
        (None, Some(hand)) => Some(Boards::of_virtual_rig(Arc::clone(hand))?),
        (None, None) => None,
    };
    let is_bound = rig.cameras.contains_key(&Role::External);
    let is_calibrated = intrinsics.contains_key(&Role::External);
    if is_bound && boards.is_some() && !is_calibrated && !context.quiet {
        eprintln!(
            "external: no intrinsics, so that grasps get no pose; measure them with `gripcast \
             calibrate intrinsics` and name the file in [cameras.external]"
        );
    }

    let pedals = rig.pedals.clone();
    let setup = EngineSetup {
        new_dataset: NewDataset {
            name: dataset_name(&dataset),
            rig: rig.id.clone(),
            licence: settings.licence,
            label_definition: LABEL_DEFINITION.into(),
        },
        rig,
        intrinsics,
        openers: sources.openers,
        supervision: SupervisionPolicy::default(),
        dataset,
        labels: Labels {
            object: settings.object,
            scene: settings.scene,
            operator: settings.operator,
        },
        guards: config.guards,
        model,
        script,
        boards,
        hand: sources.hand,
    };
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(|e| Error::io("cannot start the event loop", e))?;
    let report = runtime.block_on(collect(
        setup,
        pedals,
        screen.then_some(sound),
        args.events,
        context.quiet,
    ))?;
    if args.json {
        print_json(&report)?;
    } else {
        print(summary(&report).trim_end())?;
    }
    match report.ended {
        Ended::Interrupted => Err(Error::new(
            ErrorKind::Interrupted,
            "interrupted; everything that was acknowledged is on disk",
        )),
        Ended::Terminated => Err(Error::new(
            ErrorKind::Stopped,
            "asked to end; everything that was acknowledged is on disk",
        )),
        Ended::Quit | Ended::ScriptDone if report.session.failed > 0 => Err(Error::new(
            ErrorKind::Partial,
            format!(
                "{} save(s) failed; see the messages above",
                report.session.failed
            ),
        )),
        Ended::Quit | Ended::ScriptDone => Ok(()),
    }
}

/// Runs the engine with its screen or lines and its pedals until it ends.
async fn collect(
    setup: EngineSetup,
    pedals: Vec<PedalConfig>,
    screen: Option<tui::Sound>,
    events: bool,
    quiet: bool,
) -> Result<CollectReport> {
    let stop = stop_signals()?;
    let (command_sender, commands) = mpsc::channel(COMMAND_QUEUE);
    let (tone_sender, tones) = mpsc::unbounded_channel();
    let (status, newest) = watch::channel(Arc::new(EngineStatus::starting(
        &setup.new_dataset.name,
        &setup.rig.id,
    )));
    let ended = Arc::new(AtomicBool::new(false));
    let pedals: Vec<_> = pedals
        .into_iter()
        .map(|pedal| {
            let (commands, ended) = (command_sender.clone(), Arc::clone(&ended));
            std::thread::spawn(move || listen_to_pedal(&pedal, &commands, &ended))
        })
        .collect();
    let screen = screen.map(|sound| {
        Screen::start(tui::Wiring {
            status: newest.clone(),
            commands: command_sender.clone(),
            tones,
            sound,
        })
    });
    let lines = async {
        if screen.is_none() && !quiet {
            tui::print_lines(newest).await;
        }
    };
    drop(command_sender);

    let told = screen.is_none();
    let links = EngineLinks {
        commands,
        status,
        tones: tone_sender,
        stored: Box::new(move |stored| {
            if let (true, StoreReply::Failed { message }) = (told, &stored.reply) {
                eprintln!("NOT SAVED: {message}");
            }
            if events {
                // A reader that has gone does not stop the collection.
                let _ = serde_json::to_string(stored).map(|line| print(&line));
            }
        }),
    };
    let (report, ()) = tokio::join!(daemon::run(setup, links, stop), lines);
    ended.store(true, Ordering::Relaxed);
    // The engine's ends of all channels are gone: screen and pedals come to their ends.
    let screen = screen.map_or(Ok(()), Screen::end);
    for pedal in pedals {
        // A pedal thread that panicked has printed why.
        let _ = pedal.join();
    }
    let report = report?;
    screen.map(|()| report)
}

/// The screen's thread, and whether it is at its end.
struct Screen {
    ended: std::sync::mpsc::Receiver<Result<()>>,
}

impl Screen {
    /// Starts it; it asks the engine to quit when it ends.
    fn start(wiring: tui::Wiring) -> Self {
        let (sender, ended) = std::sync::mpsc::channel();
        std::thread::spawn(move || {
            let commands = wiring.commands.clone();
            let result = tui::run(wiring);
            // Without a screen nobody can operate; the engine may have ended before.
            let _ = commands.blocking_send((Command::Quit, CommandSource::Keyboard));
            // Nobody asks any more where the process ends without the screen.
            let _ = sender.send(result);
        });
        Self { ended }
    }

    /// Waits for its end. It does not come on a terminal that has gone: the end of the process
    /// takes the thread with it.
    fn end(self) -> Result<()> {
        match self.ended.recv_timeout(SCREEN_PATIENCE) {
            Ok(result) => result,
            Err(RecvTimeoutError::Timeout) => Ok(()),
            Err(RecvTimeoutError::Disconnected) => {
                Err(Error::new(ErrorKind::Internal, "the screen panicked"))
            }
        }
    }
}

fn listen_to_pedal(
    pedal: &PedalConfig,
    commands: &mpsc::Sender<(Command, CommandSource)>,
    ended: &AtomicBool,
) {
    let result = run_pedal(pedal, &MonotonicClock, ended, &mut |event| match event {
        PedalEvent::Trigger(trigger) => {
            if let Ok(command) = trigger.text.parse() {
                // When the queue is full the operator presses faster than anything can be saved.
                let _ = commands.try_send((command, CommandSource::Pedal));
            }
        }
        PedalEvent::Ready { product } => eprintln!("pedal ready: {product}"),
        PedalEvent::Unmapped { key } => eprintln!("pedal key `{key}` has no command in the rig"),
        PedalEvent::Lost { reason } => eprintln!("pedal: {reason}"),
    });
    if let Err(error) = result {
        eprintln!("pedal: {error}");
    }
}

/// Resolves when the process is asked to end.
fn stop_signals() -> Result<impl Future<Output = Ended>> {
    let listen = |kind| signal(kind).map_err(|e| Error::io("cannot listen for signals", e));
    let mut interrupt = listen(SignalKind::interrupt())?;
    let mut terminate = listen(SignalKind::terminate())?;
    let mut hangup = listen(SignalKind::hangup())?;
    Ok(async move {
        tokio::select! {
            _ = interrupt.recv() => Ended::Interrupted,
            _ = terminate.recv() => Ended::Terminated,
            _ = hangup.recv() => Ended::Terminated,
        }
    })
}

fn chosen_rig(settings: &CollectConfig) -> Result<RigFile> {
    if settings.rig.is_empty() {
        return Err(Error::new(ErrorKind::Usage, "which rig?").remedy(
            "--rig virtual tries everything without cameras; `gripcast rig init` writes a rig \
             file for the cameras that are plugged in",
        ));
    }
    RigFile::find(&settings.rig)
}

fn chosen_dataset(settings: &CollectConfig) -> Result<PathBuf> {
    if settings.dataset.is_empty() {
        return Err(Error::new(ErrorKind::Usage, "which dataset?")
            .remedy("--dataset DIR; the directory is created when it is absent"));
    }
    Ok(PathBuf::from(&settings.dataset))
}

fn sound(name: &str) -> Result<tui::Sound> {
    <tui::Sound as clap::ValueEnum>::from_str(name, true).map_err(|_| {
        Error::new(ErrorKind::Config, format!("unknown sound `{name}`"))
            .remedy("use auto, bell or off")
    })
}

fn read_script(path: &Path) -> Result<Script> {
    let text = std::fs::read_to_string(path)
        .map_err(|e| Error::io("cannot read the script", e).at(path.display()))?;
    Script::parse(&text, path.display(), &|command| {
        command
            .parse::<Command>()
            .map(drop)
            .map_err(|e| e.to_string())
    })
}

fn dataset_name(path: &Path) -> String {
    path.file_name().map_or_else(
        || "dataset".into(),
        |name| name.to_string_lossy().into_owned(),
    )
}

fn summary(report: &CollectReport) -> String {
    let mut text = String::new();
    for grasp in &report.grasps {
        let predicted = grasp
            .p_stable
            .map_or_else(|| "no prediction".into(), |p| format!("predicted {p:.2}"));
        let _ = writeln!(
            text,
            "{}  {:<16} {:<10} {predicted}",
            grasp.id, grasp.object, grasp.outcome
        );
    }
    let session = &report.session;
    let _ = writeln!(
        text,
        "{} grasp(s) saved, {} label(s), {} trigger(s) refused, {} step(s) undone; dataset {}",
        session.saved, session.labelled, session.refused, session.undone, report.dataset
    );
    for (role, camera) in &report.cameras {
        let _ = writeln!(
            text,
            "{role:<9} {:>5.1} fps, {} frames, {} lost, {} damaged, {} late, {} reconnects",
            camera.measured_fps,
            camera.received,
            camera.sequence_gaps,
            camera.damaged,
            camera.late,
            camera.reconnects
        );
        for warning in &camera.warnings {
            let _ = writeln!(text, "          {warning}");
        }
    }
    let prediction = &report.prediction;
    if let (Some(model), Some(p50), Some(p99)) = (
        &prediction.model,
        prediction.latency_p50_ms,
        prediction.latency_p99_ms,
    ) {
        let _ = writeln!(
            text,
            "{} prediction(s) by {model}, frame to prediction {p50:.0} ms (median), {p99:.0} ms (p99)",
            prediction.predictions
        );
    }
    text
}
