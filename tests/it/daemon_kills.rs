//! Kills the daemon at random times under random commands through the API: no acknowledged change
//! is lost, at most the command in flight is done, and the restarted daemon's dataset verifies.
//!
//! `GRIPCAST_KILLS` sets the number of kills, for a long run:
//! `GRIPCAST_KILLS=1000 cargo test --test it -- acknowledged_changes_survive_kills_of_the_daemon`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::time::{Duration, Instant};

use rand::seq::IndexedRandom as _;
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;
use serde_json::{Value, json};

use crate::crash::RIG;
use crate::daemon::{Daemon, try_post};
use crate::program::{gripcast, poll, relax_guards, verify};

/// Number of kills without `GRIPCAST_KILLS`.
const KILLS: u64 = 10;
/// Kills per dataset, so that runs also start from the state left by the previous kill.
const KILLS_PER_DATASET: u64 = 20;
/// Maximum number of commands before a kill.
const MAX_COMMANDS: u32 = 30;

/// What the API says about the dataset.
#[derive(Clone, Debug, Default, PartialEq)]
struct Answered {
    /// Outcome and object by id.
    grasps: BTreeMap<String, (String, String)>,
    /// Whether an initial frame waits for its grasp.
    is_pending: bool,
    /// Grasps that were moved to the trash.
    trashed: BTreeSet<String>,
}

impl Answered {
    fn read(daemon: &Daemon, trashed: BTreeSet<String>) -> Self {
        let text = |value: &Value| value.as_str().unwrap().to_owned();
        let mut grasps = BTreeMap::new();
        let mut before = String::new();
        loop {
            let page = daemon.get(&format!("/api/grasps?limit=7{before}"));
            for grasp in page["grasps"].as_array().unwrap() {
                let facts = (text(&grasp["outcome"]), text(&grasp["object"]));
                grasps.insert(text(&grasp["id"]), facts);
            }
            match page["next"].as_str() {
                Some(next) => before = format!("&before={next}"),
                None => break,
            }
        }
        let state = daemon.get("/api/state");
        Self {
            trashed: trashed
                .into_iter()
                .filter(|id| !grasps.contains_key(id))
                .collect(),
            grasps,
            is_pending: state["session"]["step"] == "grasp",
        }
    }

    /// Ids whose grasps differ.
    fn differences(&self, other: &Self) -> Vec<String> {
        let ids: BTreeSet<&String> = self.grasps.keys().chain(other.grasps.keys()).collect();
        let differs = |id: &&String| self.grasps.get(*id) != other.grasps.get(*id);
        ids.into_iter().filter(differs).cloned().collect()
    }
}

/// The request in flight at a kill.
#[derive(Clone, Debug, Default)]
struct Request {
    path: String,
    body: Value,
    /// Status of the answer, if it came before the kill.
    status: Option<u16>,
}

impl Request {
    /// Whether a change that the daemon acknowledged just before the kill is there.
    fn is_kept(&self, found: &Answered) -> bool {
        let (Some(200), Some(id)) = (self.status, self.path.split('/').nth(3)) else {
            return true;
        };
        let outcome = found.grasps.get(id).map(|(outcome, _)| outcome.as_str());
        match self.path.rsplit('/').next() {
            Some("label") => outcome == self.body["outcome"].as_str(),
            Some("trash") => outcome.is_none(),
            _ => outcome.is_some(),
        }
    }

    /// Whether it may take or discard an initial frame.
    fn moves_frames(&self) -> bool {
        let command = self.body["command"].as_str().unwrap_or_default();
        ["trigger", "override", "undo", "redo"].contains(&command)
    }
}

/// A random request: path and body.
fn random_request(rng: &mut Pcg64, known: &Answered) -> (String, Value) {
    let command = |text: String| ("/api/commands".to_owned(), json!({ "command": text }));
    let ids: Vec<&String> = known.grasps.keys().collect();
    let trashed: Vec<&String> = known.trashed.iter().collect();
    match rng.random_range(0..20) {
        0..8 => command("trigger".to_owned()),
        8 => command("override".to_owned()),
        9 => command("stable".to_owned()),
        10 => command("slip".to_owned()),
        11 => command("unlabel".to_owned()),
        12 | 13 => command("undo".to_owned()),
        14 => command("redo".to_owned()),
        15 => command(format!("object mug {}", rng.random_range(0..3))),
        16 | 17 if !ids.is_empty() => {
            let outcome = ["stable", "slip", "unlabelled"].choose(rng).unwrap();
            let path = format!("/api/grasps/{}/label", ids.choose(rng).unwrap());
            (path, json!({ "outcome": outcome }))
        }
        18 if !ids.is_empty() => {
            let path = format!("/api/grasps/{}/trash", ids.choose(rng).unwrap());
            (path, json!({}))
        }
        19 if !trashed.is_empty() => {
            let path = format!("/api/grasps/{}/restore", trashed.choose(rng).unwrap());
            (path, json!({}))
        }
        _ => command("trigger".to_owned()),
    }
}

fn is_live(state: &Value) -> bool {
    let cameras = state["cameras"].as_array();
    cameras.is_some_and(|all| !all.is_empty() && all.iter().all(|camera| camera["state"] == "live"))
}

fn start(rig: &Path, dataset: &Path, seed: u64) -> Daemon {
    let mut command = gripcast();
    command
        .args(["daemon", "--listen", "127.0.0.1:0", "--rig"])
        .arg(rig)
        .arg("--dataset")
        .arg(dataset)
        // A seed per run: identical images in two grasps would be a problem.
        .args(["--seed", &seed.to_string()])
        .env("GRIPCAST__DAEMON__SOCKET", rig.with_file_name("socket"))
        // No contact required, so the test need not wait for the virtual hand.
        .env("GRIPCAST__GUARDS__MIN_CONTACT_FRACTION", "0");
    relax_guards(&mut command);
    let daemon = Daemon::start(&mut command);
    // Earlier triggers would be refused.
    poll(|| match daemon.get("/api/state") {
        state if is_live(&state) => Ok(()),
        state => Err(state.to_string()),
    });
    daemon
}

/// Sends random requests; the last one is in flight at the kill. Returns the acknowledged state and
/// the request in flight.
fn run_and_kill(daemon: &Daemon, rng: &mut Pcg64, mut known: Answered) -> (Answered, Request) {
    for _ in 0..rng.random_range(0..MAX_COMMANDS) {
        let (path, body) = random_request(rng, &known);
        let (status, answer) = daemon.post(&path, &body);
        assert!(
            matches!(status, 200 | 409),
            "{path} {body}: {status} {answer}"
        );
        let mut trashed = known.trashed.clone();
        if status == 200 && path.ends_with("/trash") {
            trashed.extend(path.split('/').nth(3).map(str::to_owned));
        }
        known = Answered::read(daemon, trashed);
    }
    let (path, body) = random_request(rng, &known);
    let delay = Duration::from_micros(rng.random_range(0..20_000));
    let address = daemon.address().to_owned();
    let status = std::thread::scope(|scope| {
        let request = scope.spawn(|| try_post(&address, &path, &body));
        let kill_at = Instant::now() + delay;
        while Instant::now() < kill_at {
            std::hint::spin_loop();
        }
        daemon.kill();
        request.join().unwrap()
    });
    let request = Request { path, body, status };
    (known, request)
}

#[test]
fn acknowledged_changes_survive_kills_of_the_daemon() {
    let kills = std::env::var("GRIPCAST_KILLS").ok();
    let kills: u64 = kills.map_or(KILLS, |text| text.parse().expect("a number of kills"));
    let dir = tempfile::tempdir().unwrap();
    let rig = dir.path().join("crash.toml");
    std::fs::write(&rig, RIG).unwrap();
    let mut rng = Pcg64::seed_from_u64(34);
    let (mut checked, mut in_flight) = (0, 0);
    let mut known = Answered::default();
    let mut request = Request::default();
    for kill in 0..=kills {
        let dataset = dir.path().join(format!("d{}", kill / KILLS_PER_DATASET));
        if kill % KILLS_PER_DATASET == 0 {
            (known, request) = (Answered::default(), Request::default());
        }
        let daemon = start(&rig, &dataset, kill);
        let found = Answered::read(&daemon, known.trashed.clone());
        let differences = known.differences(&found);
        let report = || format!("kill {kill}, in flight {request:?}:\n{known:?}\n{found:?}");
        assert!(differences.len() <= 1, "{}", report());
        let is_other_step = known.is_pending != found.is_pending;
        in_flight += usize::from(!differences.is_empty() || is_other_step);
        checked += known.grasps.len();
        // A changed step without a changed grasp is a frame that was taken or discarded.
        assert!(!is_other_step || request.moves_frames(), "{}", report());
        assert!(request.is_kept(&found), "{}", report());
        for id in &found.trashed {
            assert!(
                dataset.join(format!("trash/{id}/grasp.json")).is_file(),
                "{}",
                report()
            );
        }
        let verified = verify(&dataset);
        assert_eq!(verified["problems"], json!([]), "{}", report());
        if kill < kills {
            (known, request) = run_and_kill(&daemon, &mut rng, found);
        }
    }
    println!("{kills} kills, {checked} acknowledged grasps checked, {in_flight} in flight");
}
