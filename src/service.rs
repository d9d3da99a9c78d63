//! The engine as a service with API and page, systemd notifications and reloadable settings.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use sd_notify::NotifyState;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::{mpsc, watch};

use super::collection::{COMMAND_QUEUE, start_pedals, stop_signals};
use super::daemon::{
    self, CollectReport, EngineLinks, EngineSetup, EngineStatus, ModelInfo, StoreEvent, Tasks,
};
use super::tui;
use super::web::{self, Access, Backend, Listeners, News, Token};
use crate::note;
use gripcast_base::error::{Error, Result};
use gripcast_capture::calibration::PedalConfig;
use gripcast_session::{GuardLimits, StoreReply};

/// Time for open connections to receive the end message.
const FAREWELL: Duration = Duration::from_millis(100);
/// Watchdog interval if systemd does not set one.
const DEFAULT_WATCHDOG_INTERVAL: Duration = Duration::from_secs(5);

/// Where the service listens.
pub(crate) struct ServiceSettings {
    /// TCP address.
    pub(crate) listen: Option<SocketAddr>,
    /// Unix socket.
    pub(crate) socket: Option<PathBuf>,
    /// Without it only this machine is heard.
    pub(crate) token: Option<Token>,
    /// Whether lines on stderr are left out.
    pub(crate) quiet: bool,
}

/// Settings that a running service takes.
pub(crate) struct Reloaded {
    /// Limits of the guards.
    pub(crate) guards: GuardLimits,
    /// The token.
    pub(crate) token: Option<Token>,
    /// Changed keys that need a restart.
    pub(crate) need_restart: Vec<String>,
}

/// Runs engine, API and page until the process is asked to end.
///
/// # Errors
/// `Busy` where something listens already; as [`daemon::run`].
pub(crate) async fn run(
    setup: EngineSetup,
    pedals: Vec<PedalConfig>,
    settings: ServiceSettings,
    reload: impl FnMut() -> Result<Reloaded>,
) -> Result<CollectReport> {
    let stop = stop_signals(false)?;
    // Before the address is announced: until then SIGHUP would end the process.
    let hangup =
        signal(SignalKind::hangup()).map_err(|e| Error::io("cannot listen for SIGHUP", e))?;
    let listeners = Listeners::open(settings.listen, settings.socket.as_deref()).await?;
    announce(&listeners, &settings);
    let (command_sender, commands) = mpsc::channel(COMMAND_QUEUE);
    let (limit_sender, limits) = mpsc::channel(1);
    let (tone_sender, mut tones) = mpsc::unbounded_channel();
    let starting =
        EngineStatus::starting(&setup.new_dataset.name, &setup.rig.id, setup.labels.clone());
    let (status, newest) = watch::channel(Arc::new(starting));
    let tasks = Tasks::default();
    let access = Arc::new(Access::new(settings.token));
    let backend = Arc::new(Backend::new(
        newest.clone(),
        command_sender.clone(),
        tasks.clone(),
        Arc::clone(&access),
        setup.model.as_ref().map(ModelInfo::new),
        setup.index.clone(),
    ));
    let ended = Arc::new(AtomicBool::new(false));
    let pedals = start_pedals(pedals, &command_sender, &ended);
    let (close, closed) = watch::channel(false);

    let store_backend = Arc::clone(&backend);
    let links = EngineLinks {
        commands,
        limits,
        tasks: tasks.clone(),
        status,
        tones: tone_sender,
        on_stored: Box::new(move |stored| on_stored(&store_backend, stored)),
    };
    let engine = daemon::run(setup, links, stop);
    let beside = async {
        let serving = web::serve(
            listeners,
            web::router(Arc::clone(&backend)),
            tasks.clone(),
            closed,
        );
        let sounds = async {
            while let Some(tone) = tones.recv().await {
                // Without an open page there is no receiver.
                let _ = backend.news.send(News::Tone(tone));
            }
        };
        let lines = async {
            if !settings.quiet {
                tui::print_lines(newest.clone()).await;
            }
        };
        let watchdog = notify_systemd(newest.clone(), &tasks);
        let reloads = reload_on_hangup(hangup, reload, &limit_sender, &access);
        tokio::join!(serving, sounds, lines, watchdog, reloads);
    };
    tokio::pin!(engine, beside);
    let report = tokio::select! {
        report = &mut engine => report,
        // It only ends with the channels of the engine.
        () = &mut beside => engine.await,
    };
    let _ = sd_notify::notify(&[NotifyState::Stopping]);
    ended.store(true, Ordering::Relaxed);
    // Without receivers there is no need to wait.
    if backend.news.send(News::Shutdown).is_ok() {
        tokio::time::sleep(FAREWELL).await;
    }
    let _ = close.send(true);
    for pedal in pedals {
        // A panicked pedal thread has printed its message.
        let _ = pedal.join();
    }
    report
}

fn announce(listeners: &Listeners, settings: &ServiceSettings) {
    if settings.quiet {
        return;
    }
    if let Some(address) = listeners.address() {
        note!("page and API: http://{address}/");
    }
    if let Some(socket) = &settings.socket {
        note!("socket: {}", socket.display());
    }
}

/// Publishes a change of the dataset.
fn on_stored(backend: &Backend, event: &StoreEvent) {
    if let StoreReply::Failed { message } = &event.reply {
        note!("NOT SAVED: {message}");
    }
    // Without an open page there is no receiver.
    let _ = backend.news.send(News::Stored(Arc::new(event.clone())));
}

/// Notifies systemd that the service is ready, then feeds its watchdog. Does nothing without
/// systemd.
async fn notify_systemd(mut status: watch::Receiver<Arc<EngineStatus>>, tasks: &Tasks) {
    // The engine sends the first status when it has started.
    if status.changed().await.is_err() {
        return;
    }
    let _ = sd_notify::notify(&[NotifyState::Ready]);
    let interval =
        sd_notify::watchdog_enabled().map_or(DEFAULT_WATCHDOG_INTERVAL, |limit| limit / 3);
    loop {
        tokio::time::sleep(interval).await;
        match status.has_changed() {
            Err(_) => return,
            // The engine has made no progress.
            Ok(false) => continue,
            Ok(true) => drop(status.borrow_and_update()),
        }
        if web::is_healthy(&tasks.report()) {
            let _ = sd_notify::notify(&[NotifyState::Watchdog]);
        }
    }
}

/// Reloads the settings on SIGHUP.
async fn reload_on_hangup(
    mut hangup: Signal,
    mut reload: impl FnMut() -> Result<Reloaded>,
    limits: &mpsc::Sender<GuardLimits>,
    access: &Access,
) {
    while hangup.recv().await.is_some() {
        if let Ok(now) = NotifyState::monotonic_usec_now() {
            let _ = sd_notify::notify(&[NotifyState::Reloading, now]);
        }
        match reload() {
            Ok(settings) => {
                access.replace(settings.token);
                if limits.send(settings.guards).await.is_err() {
                    return;
                }
                note!("settings reloaded");
                if !settings.need_restart.is_empty() {
                    let keys = settings.need_restart.join(", ");
                    note!("changed settings that need a restart: {keys}");
                }
            }
            Err(error) => note!("settings NOT reloaded: {error}"),
        }
        let _ = sd_notify::notify(&[NotifyState::Ready]);
    }
}
