//! `gripcast collect`: the collection program.
//!
//! Shows the cameras of a rig live with the predicted stability and saves grasps: trigger with the
//! gripper open (initial frame), close it, trigger again (grasp frame), read the prediction, lift,
//! label. Everything acknowledged by a sound or on the screen is on disk.
//!
//! On a terminal it shows the operator's screen; with `--script` or `--headless` it prints lines on
//! stderr. The closing report goes to stdout. Exit codes: 0 ok · 3 a save failed · 69 a camera is
//! missing at the start · 75 ended by SIGTERM · 130 interrupted.

use std::io::IsTerminal as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::RecvTimeoutError;
use std::time::Duration;

use clap::ValueEnum;
use tokio::sync::{mpsc, watch};

use super::closing_report::conclude;
use super::collection_flags::CollectionFlags;
use super::flags::read_text;
use super::{ConfigFlag, Context, print};
use crate::collection::{
    COMMAND_QUEUE, Start, chosen_dataset, chosen_rig, prepare, start_pedals, stop_signals,
    usual_socket,
};
use crate::config::{CollectConfig, FlagValue, Layered};
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

/// Maximum time for the screen to end after the engine.
const SCREEN_TIMEOUT: Duration = Duration::from_secs(2);

/// Arguments of `collect`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    collection: CollectionFlags,
    /// Attach a screen to a running daemon: its address or socket [default: the default socket]
    #[arg(
        long,
        value_name = "http://HOST:PORT|SOCKET",
        num_args = 0..=1,
        default_missing_value = "",
        conflicts_with_all = ["rig", "dataset", "object", "scene", "operator", "model", "script",
            "headless", "json", "events", "black_box", "error_rate", "adapt", "adapt_strength"]
    )]
    attach: Option<String>,
    /// File with the daemon's token, for --attach
    #[arg(long, value_name = "FILE", requires = "attach")]
    token_file: Option<PathBuf>,
    /// Run a script of timed commands
    #[arg(long, value_name = "FILE")]
    script: Option<PathBuf>,
    /// Disable the screen; commands come from a pedal or a script
    #[arg(long)]
    headless: bool,
    /// Sounds: auto, bell, off
    #[arg(long, value_name = "MODE")]
    sound: Option<String>,
    /// Images of the screen: auto, kitty, iterm2, sixel, blocks
    #[arg(long, value_name = "MODE")]
    graphics: Option<String>,
    /// Random seed of the virtual rig
    #[arg(long, value_name = "SEED", default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    config: ConfigFlag,
    /// Print every durable change of the dataset as a JSON line
    #[arg(long)]
    events: bool,
    /// Print the closing report as JSON
    #[arg(long)]
    json: bool,
}

impl Args {
    fn flags(&self) -> Vec<FlagValue> {
        let sound = self.sound.clone();
        let sound = sound.map(|sound| ("--sound", "collect.sound", sound));
        let graphics = self.graphics.clone();
        let graphics = graphics.map(|mode| ("--graphics", "collect.graphics", mode));
        let own = sound.into_iter().chain(graphics);
        self.collection.given().into_iter().chain(own).collect()
    }
}

/// Runs the command.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    let Layered { config, .. } = args.config.load(&args.flags())?;
    if let Some(target) = &args.attach {
        let token = args.token_file.as_deref().map(Token::read).transpose()?;
        return attach(target, token.as_ref(), screen_output(&config.collect)?);
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
            "no source of triggers: no terminal, no --script and no pedal in the rig",
        )
        .remedy("run it in a terminal, give --script FILE, or add a [[pedals]] entry to the rig"));
    }
    let output = screen_output(&config.collect)?;
    let _lock = RigLock::acquire(&rig)?;
    let pedals = rig.pedals.clone();
    let start = Start {
        seed: args.seed,
        all_present: true,
        quiet: context.quiet,
    };
    let setup = prepare(config, rig, script, start)?;
    let report = event_loop()?.block_on(collect(
        setup,
        pedals,
        screen.then_some(output),
        args.events,
        context.quiet,
    ))?;
    conclude(&report, args.json, false)
}

fn event_loop() -> Result<tokio::runtime::Runtime> {
    let mut runtime = tokio::runtime::Builder::new_current_thread();
    let runtime = runtime.enable_all().build();
    runtime.map_err(|e| Error::io("cannot start the event loop", e))
}

/// Runs the engine with its screen or lines and its pedals until it ends.
async fn collect(
    setup: EngineSetup,
    pedals: Vec<PedalConfig>,
    screen: Option<tui::Output>,
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
    let screen = screen.map(|output| {
        Screen::start(tui::Wiring {
            status: newest.clone(),
            commands: command_sender.clone(),
            tones,
            output,
        })
    });
    let lines = async {
        if screen.is_none() && !quiet {
            tui::print_lines(newest).await;
        }
    };
    drop(command_sender);

    let prints_failures = screen.is_none();
    // The guards of a collection at a terminal never change.
    let (_, limits) = mpsc::channel(1);
    let links = EngineLinks {
        commands,
        limits,
        tasks: Tasks::default(),
        status,
        tones: tone_sender,
        on_stored: Box::new(move |stored| {
            if let (true, StoreReply::Failed { message }) = (prints_failures, &stored.reply) {
                note!("NOT SAVED: {message}");
            }
            if events {
                // A closed stdout does not stop the collection.
                let _ = serde_json::to_string(stored).map(|line| print(&escaped_json(&line)));
            }
        }),
    };
    let (report, ()) = tokio::join!(daemon::run(setup, links, stop), lines);
    ended.store(true, Ordering::Relaxed);
    // The engine has closed its channels, so screen and pedals end.
    let screen = screen.map_or(Ok(()), Screen::end);
    for pedal in pedals {
        // A panicked pedal thread has printed its message.
        let _ = pedal.join();
    }
    let report = report?;
    screen.map(|()| report)
}

/// Shows the screen of a running daemon; the daemon continues when the operator leaves.
fn attach(target: &str, token: Option<&Token>, output: tui::Output) -> Result<()> {
    if !(std::io::stdin().is_terminal() && std::io::stdout().is_terminal()) {
        return Err(Error::usage("`--attach` needs a terminal")
            .remedy("run it in a terminal; programs use the API (docs/reference/api.md)"));
    }
    let target = match (target, usual_socket()) {
        ("", Some(socket)) => Target::parse(&socket.display().to_string())?,
        ("", None) => {
            return Err(Error::usage(
                "no default socket: neither $XDG_RUNTIME_DIR nor /run/gripcast exists",
            )
            .remedy("give --attach http://127.0.0.1:7471 or --attach SOCKET"));
        }
        (target, _) => Target::parse(target)?,
    };
    let (command_sender, commands) = mpsc::channel(COMMAND_QUEUE);
    let (tone_sender, tones) = mpsc::unbounded_channel();
    let (status, newest) =
        watch::channel(Arc::new(EngineStatus::starting("", "", Labels::default())));
    let screen = Screen::start(tui::Wiring {
        status: newest,
        commands: command_sender,
        tones,
        output,
    });
    let wiring = web::Screen {
        status,
        tones: tone_sender,
        commands,
    };
    let attached = event_loop()?.block_on(web::attach(&target, token, wiring));
    screen.end()?;
    match attached? {
        Attached::Left => Ok(()),
        Attached::Ended => Err(Error::new(ErrorKind::Stopped, "the daemon has ended")
            .at(target)
            .remedy("all acknowledged data is on disk")),
    }
}

/// The thread of the screen.
struct Screen {
    ended: std::sync::mpsc::Receiver<Result<()>>,
}

impl Screen {
    /// Starts the screen; it makes the engine quit when it ends.
    fn start(wiring: tui::Wiring) -> Self {
        let (sender, ended) = std::sync::mpsc::channel();
        std::thread::spawn(move || {
            let commands = wiring.commands.clone();
            let result = tui::run(wiring);
            // The engine may have ended before.
            let _ =
                commands.blocking_send(CommandRequest::new(Command::Quit, CommandSource::Keyboard));
            // The process may end without waiting for the screen.
            let _ = sender.send(result);
        });
        Self { ended }
    }

    /// Waits for the end of the thread. On a closed terminal it never ends; then the process ends
    /// it.
    fn end(self) -> Result<()> {
        match self.ended.recv_timeout(SCREEN_TIMEOUT) {
            Ok(result) => result,
            Err(RecvTimeoutError::Timeout) => Ok(()),
            Err(RecvTimeoutError::Disconnected) => Err(Error::internal("the screen panicked")),
        }
    }
}

fn screen_output(config: &CollectConfig) -> Result<tui::Output> {
    let sound = <tui::Sound as ValueEnum>::from_str(&config.sound, true).map_err(|_| {
        Error::config(format!("unknown sound `{}`", config.sound)).remedy("use auto, bell or off")
    })?;
    let name = &config.graphics;
    let graphics = <tui::Graphics as ValueEnum>::from_str(name, true).map_err(|_| {
        Error::config(format!("unknown graphics `{name}`"))
            .remedy("use auto, kitty, iterm2, sixel or blocks")
    })?;
    Ok(tui::Output { sound, graphics })
}

fn read_script(path: &Path) -> Result<Script> {
    let text = read_text(path, "script")?;
    Script::parse(&text, path.display(), &|command| {
        command
            .parse::<Command>()
            .map(drop)
            .map_err(|e| e.to_string())
    })
}
