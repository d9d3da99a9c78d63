//! Kills the collection at random times: no acknowledged grasp is lost, no partial one is visible.

use std::collections::BTreeMap;
use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;
use serde_json::Value;

use crate::program::{collect_on, grasps, script, verify};

/// Number of kills.
const KILLS: u64 = 200;

/// Kills per dataset, so that runs also start from the state left by the previous kill.
const KILLS_PER_DATASET: u64 = 20;

/// Small fast cameras, because the test is about the dataset.
pub(crate) const RIG: &str = r#"
schema = 1
id = "crash"
[cameras.left]
source = "virtual"
format = "MJPG"
width = 160
height = 120
fps = 100.0
crop_profile = "gsmini-seventh-v1"
[cameras.right]
source = "virtual"
format = "MJPG"
width = 160
height = 120
fps = 100.0
crop_profile = "gsmini-seventh-v1"
"#;

/// State of the dataset according to the acknowledged lines of `--events`.
#[derive(Clone, Debug, Default)]
struct Acknowledged {
    /// Object and outcome per grasp id.
    grasps: BTreeMap<String, String>,
    /// The initial frame without a grasp.
    pending: Option<String>,
}

impl Acknowledged {
    fn apply(&mut self, event: &Value) {
        let (request, reply) = (&event["request"], &event["reply"]);
        assert!(reply.get("failed").is_none(), "a request failed: {event}");
        let (kind, body) = request.as_object().unwrap().iter().next().unwrap();
        let id = |value: &Value| value.as_str().unwrap().to_owned();
        let reply_id = || {
            let answer = reply.get("initial").or_else(|| reply.get("grasp")).unwrap();
            id(&answer["id"])
        };
        match kind.as_str() {
            "save_initial" | "restore_initial" => self.pending = Some(reply_id()),
            "discard_initial" => {
                if self.pending == Some(id(&body["id"])) {
                    self.pending = None;
                }
            }
            "save_grasp" | "redo_grasp" => {
                self.pending = None;
                self.grasps.insert(reply_id(), labelled(&reply["grasp"]));
            }
            "undo_grasp" => {
                self.grasps.remove(&id(&body["id"]));
                self.pending = Some(reply_id());
            }
            "set_outcome" => {
                let object = id(&reply["labelled"]["object"]);
                let outcome = id(&body["outcome"]);
                self.grasps
                    .insert(id(&body["id"]), format!("{object} {outcome}"));
            }
            "set_names" => {
                let grasp = &reply["renamed"]["grasp"];
                self.grasps.insert(id(&grasp["id"]), labelled(grasp));
            }
            other => panic!("unknown request {other}"),
        }
    }
}

/// Object and outcome of a record or a reply.
fn labelled(grasp: &Value) -> String {
    let text = |key: &str| grasp[key].as_str().unwrap().to_owned();
    format!("{} {}", text("object"), text("outcome"))
}

fn on_disk(dataset: &Path) -> BTreeMap<String, String> {
    grasps(dataset)
        .into_iter()
        .map(|(id, grasp)| (id, labelled(&grasp)))
        .collect()
}

/// Counts entries that differ between two maps.
fn differences(a: &BTreeMap<String, String>, b: &BTreeMap<String, String>) -> usize {
    let changed = a
        .iter()
        .filter(|(id, outcome)| b.get(*id) != Some(outcome))
        .count();
    changed + b.keys().filter(|id| !a.contains_key(*id)).count()
}

#[test]
fn acknowledged_changes_survive_200_random_kills() {
    let dir = tempfile::tempdir().unwrap();
    let rig = dir.path().join("crash.toml");
    std::fs::write(&rig, RIG).unwrap();
    let cycle = "wait fresh\ninitial\nexpect saved\nwait contact\ngrasp\nexpect saved\nstable\nexpect saved\nundo\n\
                 expect saved\nslip\nexpect saved\nundo\nexpect saved\nundo\nexpect saved\n\
                 redo\nexpect saved\nwait fresh\ninitial\nexpect saved\nwait fresh\ninitial\nexpect saved\n\
                 undo\nexpect saved\nwait contact\ngrasp\nexpect saved\nslip\nexpect saved\n\
                 edit last object cup\nexpect saved\nundo\nexpect saved\nredo\nexpect saved\n";
    let steps = format!("wait live\n{}quit\n", cycle.repeat(50));
    let script = script(dir.path(), &steps);
    let stderr_file = dir.path().join("stderr");
    let mut rng = Pcg64::seed_from_u64(20);
    let (mut acknowledged, mut in_flight) = (0, 0);
    let mut state = Acknowledged::default();
    for kill in 0..KILLS {
        let dataset = dir.path().join(format!("d{}", kill / KILLS_PER_DATASET));
        if kill % KILLS_PER_DATASET == 0 {
            state = Acknowledged::default();
        }
        let mut child = collect_on(&rig, &script, &dataset)
            .args(["--events", "--quiet"])
            // A seed per run: identical images in two grasps would be a problem.
            .args(["--seed", &kill.to_string()])
            // No contact required, so the script need not wait for the virtual hand.
            .env("GRIPCAST__GUARDS__MIN_CONTACT_FRACTION", "0")
            .stdout(Stdio::piped())
            .stderr(std::fs::File::create(&stderr_file).unwrap())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let events = rng.random_range(0..40);
        for _ in 0..events {
            let line = lines.next().unwrap_or_else(|| {
                let stderr = std::fs::read_to_string(&stderr_file).unwrap();
                panic!(
                    "the collection exited too early: {:?}\n{stderr}",
                    child.wait()
                )
            });
            let line = line.unwrap();
            state.apply(&serde_json::from_str(&line).unwrap());
        }
        // During one of the next two requests.
        let kill_at = Instant::now() + Duration::from_micros(rng.random_range(0..12_000));
        while Instant::now() < kill_at {
            std::hint::spin_loop();
        }
        child.kill().unwrap();
        child.wait().unwrap();
        // Lines written to the pipe before the kill are acknowledged too.
        for line in lines {
            let Ok(event) = serde_json::from_str(&line.unwrap()) else {
                break;
            };
            state.apply(&event);
        }

        let found = on_disk(&dataset);
        let unacknowledged = differences(&state.grasps, &found);
        assert!(
            unacknowledged <= 1,
            "kill {kill}: more than the one request in flight differs\n{state:?}\n{found:?}"
        );
        in_flight += unacknowledged;
        acknowledged += state.grasps.len();
        if dataset.join("dataset.toml").exists() {
            let verified = verify(&dataset);
            let torn: Vec<&Value> = verified["problems"]
                .as_array()
                .unwrap()
                .iter()
                .filter(|problem| !matches!(problem["kind"].as_str(), Some("torn" | "index")))
                .collect();
            assert!(torn.is_empty(), "kill {kill}: {torn:?}");
        }
        state.grasps = found;
    }
    println!("{KILLS} kills, {acknowledged} acknowledged grasps checked, {in_flight} in flight");
    assert!(
        acknowledged > KILLS as usize,
        "the run collected too few grasps"
    );
}
