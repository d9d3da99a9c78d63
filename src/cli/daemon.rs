//! `gripcast daemon`: the collection as a service, controlled by web pages, programs and pedals.
//!
//! It runs the engine of `collect` without a screen: it waits for missing cameras, serves the page
//! and the API, notifies systemd and reloads guards and token on SIGHUP. `gripcast collect
//! --attach` shows a screen for it.
//!
//! Exit codes: 0 ended by SIGTERM · 1 address, rig or dataset in use · 2 invalid configuration ·
//! 3 a save failed · 130 interrupted.

use std::net::{IpAddr, SocketAddr};
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::closing_report::conclude;
use super::collection_flags::CollectionFlags;
use super::flags::{given, path_text};
use super::{ConfigFlag, Context, load_settings};
use crate::collection::{Start, chosen_rig, prepare, usual_socket};
use crate::config::{DaemonConfig, FlagValue, Layered};
use crate::rig_lock::RigLock;
use crate::service::{self, Reloaded, ServiceSettings};
use crate::web::Token;
use gripcast_base::error::{Error, Result};

/// Maximum time for open responses at the end.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_millis(500);
/// Added to the niceness of the threads that serve the API.
const SERVER_NICE: i32 = 10;

/// Arguments of `daemon`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    collection: CollectionFlags,
    /// Address of the page and the API, or none [default: 127.0.0.1:7471]; non-loopback addresses
    /// need --token-file
    #[arg(long, value_name = "ADDRESS:PORT")]
    listen: Option<String>,
    /// Unix socket for local programs, or none [default: gripcast.sock in $XDG_RUNTIME_DIR or
    /// /run/gripcast]
    #[arg(long, value_name = "FILE")]
    socket: Option<String>,
    /// File with the token that TCP clients must present; readable by its owner only
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
    /// Random seed of the virtual rig
    #[arg(long, value_name = "SEED", default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    config: ConfigFlag,
    /// Print the closing report as JSON
    #[arg(long)]
    json: bool,
}

impl Args {
    fn flags(&self) -> Vec<FlagValue> {
        let token_file = path_text(self.token_file.as_ref());
        let own = given([
            ("--listen", "daemon.listen", self.listen.clone()),
            ("--socket", "daemon.socket", self.socket.clone()),
            ("--token-file", "daemon.token_file", token_file),
        ]);
        self.collection.given().into_iter().chain(own).collect()
    }
}

/// Runs the command.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    let file = args.config.file();
    let flags = args.flags();
    let load = move || load_settings(file.as_ref(), &flags);
    let started = load()?;
    let settings = service_settings(&started.config.daemon, context.quiet)?;
    let rig = chosen_rig(&started.config.collect)?;
    let _lock = RigLock::acquire(&rig)?;
    let pedals = rig.pedals.clone();
    let start = Start {
        seed: args.seed,
        all_present: false,
        quiet: context.quiet,
    };
    let setup = prepare(started.config.clone(), rig, None, start)?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        // API load must not delay camera frames; a failure is harmless.
        .on_thread_start(|| {
            let _ = rustix::process::nice(SERVER_NICE);
        })
        .enable_all()
        .build()
        .map_err(|e| Error::io("cannot start the event loop", e))?;
    let reload = || reloaded(&started, load()?);
    let report = runtime.block_on(service::run(setup, pedals, settings, reload));
    runtime.shutdown_timeout(SHUTDOWN_TIMEOUT);
    conclude(&report?, args.json, true)
}

fn service_settings(config: &DaemonConfig, quiet: bool) -> Result<ServiceSettings> {
    let listen = match config.listen.as_str() {
        "none" => None,
        text => Some(address(text)?),
    };
    let token = token(config)?;
    if let Some(address) = listen
        && !address.ip().is_loopback()
        && token.is_none()
    {
        return Err(Error::usage(format!(
            "{address} is reachable from other machines, but there is no token"
        ))
        .remedy(
            "head -c 24 /dev/urandom | base64 > FILE; chmod 600 FILE; then --token-file FILE; or \
             keep 127.0.0.1 and use `ssh -L 7471:127.0.0.1:7471`",
        ));
    }
    let socket = match config.socket.as_str() {
        "none" => None,
        "" => usual_socket(),
        path => Some(PathBuf::from(path)),
    };
    if listen.is_none() && socket.is_none() {
        return Err(
            Error::usage("no source of triggers: neither an address nor a socket")
                .remedy("give --listen 127.0.0.1:7471 or --socket FILE"),
        );
    }
    Ok(ServiceSettings {
        listen,
        socket,
        token,
        quiet,
    })
}

fn address(text: &str) -> Result<SocketAddr> {
    text.parse().map_err(|_| {
        let is_address = text.parse::<IpAddr>().is_ok();
        let remedy = match is_address {
            true => format!("add the port: {text}:7471"),
            false => "give an address and a port, as in 127.0.0.1:7471 or [::1]:7471".to_owned(),
        };
        Error::usage(format!("invalid listen address `{text}`")).remedy(remedy)
    })
}

fn token(config: &DaemonConfig) -> Result<Option<Token>> {
    let file = Some(&config.token_file).filter(|file| !file.is_empty());
    file.map(|file| Token::read(Path::new(file))).transpose()
}

/// Returns the reloadable settings and the changed keys that need a restart.
fn reloaded(started: &Layered, now: Layered) -> Result<Reloaded> {
    let is_reloadable = |key: &str| key.starts_with("guards.") || key == "daemon.token_file";
    let need_restart = now
        .values
        .iter()
        .filter(|(key, (value, _))| !is_reloadable(key) && started.values[*key].0 != *value)
        .map(|(key, _)| key.clone())
        .collect();
    let token = token(&now.config.daemon)?;
    let is_reachable = address(&now.config.daemon.listen).is_ok_and(|a| !a.ip().is_loopback());
    if token.is_none() && is_reachable {
        return Err(Error::config(
            "the token cannot be removed: the daemon is reachable from other machines",
        ));
    }
    Ok(Reloaded {
        guards: now.config.guards,
        token,
        need_restart,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config;

    fn settings(listen: &str, socket: &str) -> Result<ServiceSettings> {
        let config = DaemonConfig {
            listen: listen.into(),
            socket: socket.into(),
            token_file: String::new(),
        };
        service_settings(&config, true)
    }

    #[test]
    fn non_loopback_address_needs_token() {
        for listen in ["0.0.0.0:7471", "192.168.0.2:7471", "[::]:7471"] {
            let error = settings(listen, "none").err().unwrap();
            assert!(error.to_string().contains("no token"), "{error}");
            assert_eq!(error.kind().exit_code(), 2);
        }
        for listen in ["127.0.0.1:0", "[::1]:7471"] {
            assert!(settings(listen, "none").is_ok());
        }
    }

    #[test]
    fn invalid_listen_addresses_are_explained() {
        let text = |listen: &str| settings(listen, "none").err().unwrap().to_string();
        assert!(text("127.0.0.1").contains("127.0.0.1:7471"));
        assert!(text("lab").contains("invalid listen address"));
        assert!(text("none").contains("no source of triggers"));
    }

    #[test]
    fn reload_applies_guards_and_lists_keys_that_need_restart() {
        let load = |pairs: &[(&str, &str)]| {
            let env = pairs
                .iter()
                .map(|(k, v)| ((*k).to_owned(), (*v).to_owned()));
            config::load(None, env, &[]).unwrap()
        };
        let started = load(&[]);
        let now = load(&[
            ("GRIPCAST__GUARDS__MAX_SKEW_MS", "77"),
            ("GRIPCAST__COLLECT__MODEL", "none"),
        ]);
        let reloaded = reloaded(&started, now).unwrap();
        assert!((reloaded.guards.max_skew_ms - 77.0).abs() < 1e-12);
        assert_eq!(reloaded.need_restart, ["collect.model"]);
    }
}
