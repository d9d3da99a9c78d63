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

use std::io::IsTerminal as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::RecvTimeoutError;
use std::time::Duration;

use tokio::sync::{mpsc, watch};

use super::closing_report::conclude;
use super::collection_flags::CollectionFlags;
use super::{ConfigFlag, Context, print};
use crate::collection::{
    COMMAND_QUEUE, Start, chosen_dataset, chosen_rig, prepare, start_pedals, stop_signals,
    usual_socket,
};
use crate::config::{FlagValue, Layered};
use crate::daemon::{
    self, CollectReport, CommandRequest, EngineLinks, EngineSetup, EngineStatus, Tasks,
};
use crate::note;
use crate::rig_lock::RigLock;
use crate::terminal_text::escaped_json;
use crate::tui;
use crate::web::{self, Attached, Target, Token};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_capture::calibration::PedalConfig;
use gripcast_capture::trigger::Script;
use gripcast_session::{Command, CommandSource, Labels, StoreReply};

/// How long the screen may take to come to its end after the engine.
const SCREEN_PATIENCE: Duration = Duration::from_secs(2);

/// Arguments of `collect`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    collection: CollectionFlags,
    /// Be a screen for a running daemon: its address, or its socket [default: the usual socket]
    #[arg(
        long,
        value_name = "http://HOST:PORT|SOCKET",
        num_args = 0..=1,
        default_missing_value = "",
        conflicts_with_all = ["rig", "dataset", "object", "scene", "operator", "model", "script",
            "headless", "json", "events", "black_box"]
    )]
    attach: Option<String>,
    /// Token of the daemon, for --attach
    #[arg(long, value_name = "FILE", requires = "attach")]
    token_file: Option<PathBuf>,
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
        let sound = self.sound.clone();
        let own = sound.map(|sound| ("--sound", "collect.sound", sound));
        self.collection.given().into_iter().chain(own).collect()
    }
}

/// Runs the verb.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    let Layered { config, .. } = args.config.load(&args.flags())?;
    if let Some(place) = &args.attach {
        let token = args.token_file.as_deref().map(Token::read).transpose()?;
        return attach(place, token.as_ref(), sound(&config.collect.sound)?);
    }
    let rig = chosen_rig(&config.collect)?;
    chosen_dataset(&config.collect)?;
    let script = args.script.as_deref().map(read_script).transpose()?;
    let screen = !args.headless
        && !args.events
        && script.is_none()
        && std::io::stdin().is_terminal()
        && std::io::stdout().is_terminal();
    if !screen && script.is_none() && rig.pedals.is_empty() {
        return Err(Error::usage(
            "there is no terminal, no --script and no pedal in the rig: nothing could trigger",
        )
        .remedy("run it in a terminal, give --script FILE, or add a [[pedals]] entry to the rig"));
    }
    let sound = sound(&config.collect.sound)?;
    let _lock = RigLock::acquire(&rig)?;
    let pedals = rig.pedals.clone();
    let start = Start {
        seed: args.seed,
        all_present: true,
        quiet: context.quiet,
    };
    let setup = prepare(config, rig, script, start)?;
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
    conclude(&report, args.json, false)
}

/// Runs the engine with its screen or lines and its pedals until it ends.
async fn collect(
    setup: EngineSetup,
    pedals: Vec<PedalConfig>,
    screen: Option<tui::Sound>,
    events: bool,
    quiet: bool,
) -> Result<CollectReport> {
    let stop = stop_signals(true)?;
    let (command_sender, commands) = mpsc::channel(COMMAND_QUEUE);
    let (tone_sender, tones) = mpsc::unbounded_channel();
    let (status, newest) = watch::channel(Arc::new(EngineStatus::starting(
        &setup.new_dataset.name,
        &setup.rig.id,
        setup.labels.clone(),
    )));
    let ended = Arc::new(AtomicBool::new(false));
    let pedals = start_pedals(pedals, &command_sender, &ended);
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
    // Nothing changes the guards of a collection at a terminal.
    let (_, limits) = mpsc::channel(1);
    let links = EngineLinks {
        commands,
        limits,
        tasks: Tasks::default(),
        status,
        tones: tone_sender,
        on_stored: Box::new(move |stored| {
            if let (true, StoreReply::Failed { message }) = (told, &stored.reply) {
                note!("NOT SAVED: {message}");
            }
            if events {
                // A reader that has gone does not stop the collection.
                let _ = serde_json::to_string(stored).map(|line| print(&escaped_json(&line)));
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

/// Is a screen for a running daemon, which goes on when the operator leaves.
fn attach(place: &str, token: Option<&Token>, sound: tui::Sound) -> Result<()> {
    if !(std::io::stdin().is_terminal() && std::io::stdout().is_terminal()) {
        return Err(Error::usage("a screen needs a terminal, and there is none")
            .remedy("run it in a terminal; programs use the API (docs/api.md)"));
    }
    let target = match (place, usual_socket()) {
        ("", Some(socket)) => Target::parse(&socket.display().to_string())?,
        ("", None) => {
            return Err(Error::usage(
                "where is the daemon? There is no $XDG_RUNTIME_DIR and no /run/gripcast",
            )
            .remedy("--attach http://127.0.0.1:7471, or --attach SOCKET"));
        }
        (place, _) => Target::parse(place)?,
    };
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(|e| Error::io("cannot start the event loop", e))?;
    let (command_sender, commands) = mpsc::channel(COMMAND_QUEUE);
    let (tone_sender, tones) = mpsc::unbounded_channel();
    let (status, newest) =
        watch::channel(Arc::new(EngineStatus::starting("", "", Labels::default())));
    let screen = Screen::start(tui::Wiring {
        status: newest,
        commands: command_sender,
        tones,
        sound,
    });
    let wiring = web::Screen {
        status,
        tones: tone_sender,
        commands,
    };
    let attached = runtime.block_on(web::attach(&target, token, wiring));
    screen.end()?;
    match attached? {
        Attached::Left => Ok(()),
        Attached::Ended => Err(Error::new(ErrorKind::Stopped, "the daemon has ended")
            .at(target)
            .remedy("everything that was acknowledged is on disk")),
    }
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
            let _ =
                commands.blocking_send(CommandRequest::new(Command::Quit, CommandSource::Keyboard));
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
            Err(RecvTimeoutError::Disconnected) => Err(Error::internal("the screen panicked")),
        }
    }
}

fn sound(name: &str) -> Result<tui::Sound> {
    <tui::Sound as clap::ValueEnum>::from_str(name, true).map_err(|_| {
        Error::config(format!("unknown sound `{name}`")).remedy("use auto, bell or off")
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
