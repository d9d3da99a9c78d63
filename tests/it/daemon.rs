//! `gripcast daemon` on the virtual rig: API, access rules and shutdown. One file for the shared
//! fixture.

use std::fs;
use std::io::{BufRead as _, BufReader, Read, Write};
use std::net::TcpStream;
use std::os::unix::fs::PermissionsExt as _;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};

use rustix::process::{Pid, Signal, kill_process};
use serde_json::{Value, json};

use crate::program::{
    STUCK, end_of, grasps, gripcast, json as json_of, poll, stderr, succeed, verify,
};

/// A running daemon, killed on drop.
pub(crate) struct Daemon {
    child: Child,
    address: String,
    said: Receiver<String>,
}

/// Temporary directory with paths for a dataset and a socket.
pub(crate) struct Place(tempfile::TempDir, Option<PathBuf>);

impl Place {
    pub(crate) fn new() -> Self {
        Self(tempfile::tempdir().unwrap(), None)
    }

    /// With a dataset that is there already.
    pub(crate) fn at(dataset: PathBuf) -> Self {
        Self(tempfile::tempdir().unwrap(), Some(dataset))
    }

    pub(crate) fn dataset(&self) -> PathBuf {
        self.1.clone().unwrap_or_else(|| self.0.path().join("d"))
    }

    pub(crate) fn socket(&self) -> PathBuf {
        self.0.path().join("s")
    }

    fn command(&self) -> Command {
        let mut command = gripcast();
        command
            .args(["daemon", "--rig", "virtual"])
            .env("GRIPCAST__DAEMON__LISTEN", "127.0.0.1:0")
            .env("GRIPCAST__DAEMON__SOCKET", self.socket())
            .env("GRIPCAST__COLLECT__DATASET", self.dataset())
            .env("GRIPCAST__GUARDS__MAX_FRAME_AGE_MS", "60000")
            .env("GRIPCAST__GUARDS__MAX_SKEW_MS", "60000")
            .env("GRIPCAST__GUARDS__MAX_COMMAND_AGE_MS", "60000")
            .env("GRIPCAST__GUARDS__MIN_FREE_BYTES", "0");
        command
    }

    pub(crate) fn daemon(&self) -> Daemon {
        Daemon::start(&mut self.command())
    }
}

impl Daemon {
    pub(crate) fn start(command: &mut Command) -> Self {
        let mut child = command
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let lines = BufReader::new(child.stderr.take().unwrap()).lines();
        let (sender, said) = channel();
        std::thread::spawn(move || {
            for line in lines.map_while(Result::ok) {
                if sender.send(line).is_err() {
                    return;
                }
            }
        });
        let mut before = Vec::new();
        let address = loop {
            let line = said
                .recv_timeout(STUCK)
                .unwrap_or_else(|e| panic!("it ended early or is stuck ({e}): {before:#?}"));
            if let Some(address) = line.strip_prefix("page and API: http://") {
                break address.trim_end_matches('/').to_owned();
            }
            before.push(line);
        };
        Self {
            child,
            address,
            said,
        }
    }

    fn connect(&self) -> TcpStream {
        TcpStream::connect(&self.address).unwrap()
    }

    /// Status and body.
    pub(crate) fn ask(&self, method: &str, path: &str, body: Option<&Value>) -> (u16, Vec<u8>) {
        let body = body.map(Value::to_string);
        let headers = body
            .as_ref()
            .map_or("", |_| "Content-Type: application/json\r\n");
        let (status, _, answer) = exchange(
            self.connect(),
            method,
            path,
            &format!("Host: {}\r\n{headers}", self.address),
            body.unwrap_or_default().as_bytes(),
        );
        (status, answer)
    }

    pub(crate) fn get(&self, path: &str) -> Value {
        let (status, body) = self.ask("GET", path, None);
        assert_eq!(status, 200, "{path}: {}", String::from_utf8_lossy(&body));
        serde_json::from_slice(&body).unwrap()
    }

    pub(crate) fn post(&self, path: &str, body: &Value) -> (u16, Value) {
        let (status, answer) = self.ask("POST", path, Some(body));
        (
            status,
            serde_json::from_slice(&answer).unwrap_or(Value::Null),
        )
    }

    pub(crate) fn address(&self) -> &str {
        &self.address
    }

    /// Kills the daemon; it is waited for when this is dropped.
    pub(crate) fn kill(&self) {
        self.signal(Signal::KILL);
    }

    pub(crate) fn command(&self, command: &str) -> (u16, Value) {
        self.post("/api/commands", &json!({"command": command}))
    }

    /// Triggers until no guard refuses: the gripper may not have closed yet.
    pub(crate) fn trigger(&self) -> Value {
        self.wait_for_open_gripper();
        poll(|| {
            let (status, answer) = self.command("trigger");
            match status {
                200 => return Ok(answer),
                409 => assert_ne!(answer["reasons"], json!([]), "{answer}"),
                _ => panic!("{status}: {answer}"),
            }
            Err(answer.to_string())
        })
    }

    /// Before an initial frame: waits until the virtual hand has let go of the last object.
    fn wait_for_open_gripper(&self) {
        poll(|| {
            let state = self.get("/api/state");
            let mut gels = state["gels"].as_object().unwrap().values();
            if state["session"]["step"] != "initial" || gels.all(|gel| gel["change"] != "contact") {
                return Ok(());
            }
            Err(state.to_string())
        });
    }

    /// One whole grasp; returns its id.
    pub(crate) fn grasp(&self, outcome: &str) -> String {
        assert_eq!(self.trigger()["state"]["session"]["step"], "grasp");
        let answer = self.trigger();
        let id = answer["state"]["session"]["last"]["id"]
            .as_str()
            .unwrap()
            .to_owned();
        let (status, answer) = self.command(outcome);
        assert_eq!(
            (status, &answer["result"]),
            (200, &json!("accepted")),
            "{answer}"
        );
        id
    }

    fn signal(&self, signal: Signal) {
        let pid = Pid::from_raw(i32::try_from(self.child.id()).unwrap()).unwrap();
        kill_process(pid, signal).unwrap();
    }

    /// Waits for a line.
    fn hear(&self, text: &str) {
        loop {
            let line = self.said.recv_timeout(STUCK).expect("a line of the daemon");
            if line.contains(text) {
                return;
            }
        }
    }

    pub(crate) fn stop(mut self) -> Option<i32> {
        self.signal(Signal::TERM);
        end_of(&mut self.child).code()
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Posts to a daemon that may be killed meanwhile; returns the status, if it answers.
pub(crate) fn try_post(address: &str, path: &str, body: &Value) -> Option<u16> {
    let body = body.to_string();
    let request = format!(
        "POST {path} HTTP/1.1\r\nHost: {address}\r\nContent-Type: application/json\r\n\
         Content-Length: {}\r\nConnection: close\r\n\r\n{body}",
        body.len()
    );
    let mut stream = TcpStream::connect(address).ok()?;
    stream.write_all(request.as_bytes()).ok()?;
    let mut answer = String::new();
    // What arrived before the kill counts.
    let _ = stream.read_to_string(&mut answer);
    answer.split(' ').nth(1)?.parse().ok()
}

/// Sends a raw request; returns status, head and body.
fn exchange(
    mut stream: impl Read + Write,
    method: &str,
    path: &str,
    headers: &str,
    body: &[u8],
) -> (u16, String, Vec<u8>) {
    let head = format!(
        "{method} {path} HTTP/1.1\r\n{headers}Content-Length: {}\r\nConnection: close\r\n\r\n",
        body.len()
    );
    // A server that refuses may close before it has read all.
    let _ = stream.write_all(&[head.as_bytes(), body].concat());
    let mut answer = Vec::new();
    let _ = stream.read_to_end(&mut answer);
    let end = answer
        .windows(4)
        .position(|four| four == b"\r\n\r\n")
        .unwrap_or_else(|| panic!("no answer to {method} {path}"));
    let head = String::from_utf8_lossy(&answer[..end]).into_owned();
    let status = head.split(' ').nth(1).unwrap().parse().unwrap();
    (status, head, answer.split_off(end + 4))
}

fn sha256(bytes: &[u8]) -> String {
    gripcast_base::files::sha256_hex(bytes)
}

#[test]
fn api_collects_reads_and_changes_grasps() {
    let place = Place::new();
    let daemon = place.daemon();
    let (status, named) = {
        let (status, body) = daemon.ask("PUT", "/api/object", Some(&json!({"name": "blue mug"})));
        (status, serde_json::from_slice::<Value>(&body).unwrap())
    };
    assert_eq!(
        (status, &named["state"]["session"]["object"]),
        (200, &json!("blue mug"))
    );
    let (first, second) = (daemon.grasp("slip"), daemon.grasp("stable"));

    let page = daemon.get("/api/grasps?limit=1");
    assert_eq!(page["grasps"][0]["id"], second);
    let rest = daemon.get(&format!(
        "/api/grasps?before={}",
        page["next"].as_str().unwrap()
    ));
    assert_eq!(rest["grasps"][0]["id"], first);
    assert_eq!(rest["next"], Value::Null);
    let record = daemon.get(&format!("/api/grasps/{first}"));
    assert_eq!(
        (&record["object"], &record["outcome"]),
        (&json!("blue mug"), &json!("slip"))
    );
    assert_eq!(record["grasp"]["trigger"], "remote");
    for (name, digest) in record["files"].as_object().unwrap() {
        let (status, bytes) = daemon.ask("GET", &format!("/api/grasps/{first}/files/{name}"), None);
        assert_eq!(
            (status, json!(sha256(&bytes))),
            (200, digest["sha256"].clone()),
            "{name}"
        );
    }
    for (kind, file) in [
        ("initial", "left.jpg"),
        ("difference", "right.jpg"),
        ("grasp", "depth.jpg"),
    ] {
        let path = format!("/api/grasps/{first}/preview/{kind}/{file}");
        let (status, bytes) = daemon.ask("GET", &path, None);
        assert_eq!((status, &bytes[..2]), (200, &[0xff, 0xd8][..]), "{path}");
    }

    let label = json!({"outcome": "stable"});
    let (status, answer) = daemon.post(&format!("/api/grasps/{first}/label"), &label);
    assert_eq!(
        (status, &answer["state"]["session"]["counts"]["stable"]),
        (200, &json!(2))
    );
    let stable = daemon.get("/api/grasps?outcome=stable");
    assert_eq!(stable["grasps"].as_array().unwrap().len(), 2);
    let (status, answer) = daemon.post(&format!("/api/grasps/{second}/trash"), &json!({}));
    assert_eq!(
        (status, &answer["state"]["session"]["counts"]["stable"]),
        (200, &json!(1))
    );
    assert_eq!(
        daemon.ask("GET", &format!("/api/grasps/{second}"), None).0,
        404
    );
    let (status, _) = daemon.post(&format!("/api/grasps/{second}/restore"), &json!({}));
    assert_eq!(status, 200);
    let (status, answer) = daemon.command("undo");
    assert_eq!(
        (status, &answer["state"]["session"]["counts"]["stable"]),
        (200, &json!(1))
    );
    let (status, answer) = daemon.command("undo");
    assert_eq!(
        (status, &answer["state"]["session"]["counts"]["stable"]),
        (200, &json!(2))
    );

    let (status, text) = daemon.ask("GET", "/metrics", None);
    let text = String::from_utf8(text).unwrap();
    assert_eq!(status, 200);
    assert!(
        text.contains("gripcast_grasps{outcome=\"stable\"} 2"),
        "{text}"
    );
    assert!(text.contains("gripcast_healthy 1"), "{text}");
    let health = daemon.get("/api/health");
    let names: Vec<&str> = health["tasks"]
        .as_array()
        .unwrap()
        .iter()
        .map(|t| t["name"].as_str().unwrap())
        .collect();
    for task in [
        "capture-left",
        "decode-right",
        "inference",
        "store",
        "serve-tcp",
        "serve-unix",
    ] {
        assert!(names.contains(&task), "{names:?}");
    }
    assert_eq!(daemon.get("/api/model")["name"], "gripcast-vt");

    assert_eq!(daemon.stop(), Some(0));
    assert_eq!(verify(&place.dataset())["problems"], json!([]));
    assert_eq!(grasps(&place.dataset()).len(), 2);
    assert!(!place.socket().exists());
}

/// A tap on a dead line arrives late, twice, or after somebody else's.
#[test]
fn late_repeated_and_outdated_commands_change_nothing() {
    let place = Place::new();
    let mut command = place.command();
    let daemon = Daemon::start(command.env("GRIPCAST__GUARDS__MAX_COMMAND_AGE_MS", "20000"));
    let send = |command: &str, sender: Value| {
        daemon.post(
            "/api/commands",
            &json!({"command": command, "sender": sender}),
        )
    };
    // Taken once a tap is accepted: the cameras may still be starting.
    let initial = daemon.trigger();
    let state = &initial["state"];
    let now_ms = state["monotonic_ms"].as_f64().unwrap();
    let revision = state["session"]["revision"].as_u64().unwrap();
    assert_eq!(state["session"]["undo"], "initial frame");

    for (sender, reason) in [
        (
            json!({"sent_at_ms": now_ms - 25_000.0}),
            "s old; the limit is 20 s",
        ),
        (
            json!({"age_ms": 25_000}),
            "this command is 25 s old; the limit is 20 s",
        ),
        (
            json!({"seen": {"revision": revision - 1}}),
            "the initial frame was saved",
        ),
        (
            json!({"seen": {"step": "initial"}}),
            "ago; look at the step",
        ),
        (
            json!({"seen": {"undo": "grasp 7f3a"}}),
            "undo would now change initial frame, not grasp 7f3a",
        ),
    ] {
        let (status, answer) = send("undo", sender.clone());
        assert_eq!(
            (status, &answer["stale"]),
            (409, &json!(true)),
            "{sender}: {answer}"
        );
        let reasons = answer["reasons"].to_string();
        assert!(reasons.contains(reason), "{sender}: {reasons}");
        assert_eq!(answer["state"]["session"]["revision"], json!(revision));
    }
    let (status, _) = send("undo", json!({"sent_at_ms": now_ms + 1e6}));
    assert_eq!(status, 422);

    let tap = json!({"request_id": "tap", "seen": {"revision": revision, "undo": "initial frame"}});
    let (status, first) = send("undo", tap.clone());
    assert_eq!(
        (status, &first["state"]["session"]["step"]),
        (200, &json!("initial"))
    );
    let now = &first["state"]["session"]["revision"];
    assert_eq!(now, &json!(revision + 1));
    let (status, again) = send("undo", tap);
    assert_eq!((status, &again["state"]["session"]["revision"]), (200, now));
    assert_eq!(daemon.get("/api/commands/tap")["result"], "accepted");
    assert_eq!(daemon.ask("GET", "/api/commands/other", None).0, 404);

    // A name means the same for longer.
    let body = json!({"name": "cup", "sender": {"age_ms": 25_000}});
    assert_eq!(daemon.ask("PUT", "/api/object", Some(&body)).0, 200);
    let mut socket = listen(&daemon);
    let message = json!({"command": "redo", "id": 3, "sender": {"age_ms": 25_000}});
    socket
        .send(tungstenite::Message::text(message.to_string()))
        .unwrap();
    let [answer] = wait_for_events(&mut socket, [&|event| event["type"] == "response"]);
    assert_eq!(
        (&answer["id"], &answer["response"]["stale"]),
        (&json!(3), &json!(true))
    );
    drop(daemon);

    // Revisions increase across restarts, so that an old tap cannot fit again.
    let daemon = place.daemon();
    let restarted = daemon.get("/api/state")["session"]["revision"]
        .as_u64()
        .unwrap();
    assert!(
        restarted == 0 || restarted > revision,
        "{restarted} after {revision}"
    );
}

#[test]
fn programs_get_each_image_of_a_gel_once_without_loss() {
    let place = Place::new();
    let daemon = place.daemon();
    let own = format!("Host: {}\r\n", daemon.address);
    let ask = |path: &str| exchange(daemon.connect(), "GET", path, &own, b"");
    let driver_time = |head: &str| -> u64 {
        let head = head.to_lowercase();
        let (_, rest) = head.split_once("gripcast-driver-time-ns: ").unwrap();
        rest.lines().next().unwrap().trim().parse().unwrap()
    };
    // Until the first image there is none.
    let image = |path: &str| {
        poll(|| {
            let (status, head, body) = ask(path);
            match status {
                200 => Ok((driver_time(&head), image::load_from_memory(&body).unwrap())),
                204 | 503 => Err(head),
                _ => panic!("{path}: {head}"),
            }
        })
    };
    let (first_ns, first) = image("/api/cameras/left/image.png");
    assert_eq!((first.width(), first.height()), (320, 240));
    let (second_ns, _) = image(&format!("/api/cameras/left/image.png?after={first_ns}"));
    assert!(second_ns > first_ns);
    assert_eq!(ask("/api/cameras/left/image.png?image=difference").0, 503);
    assert_eq!(ask("/api/cameras/rgb/image.png?image=difference").0, 400);
    assert_eq!(ask("/api/cameras/external/image.png").0, 404);
    daemon.trigger();
    let (_, difference) = image("/api/cameras/left/image.png?image=difference");
    assert_eq!((difference.width(), difference.height()), (320, 240));
}

#[test]
fn invalid_requests_are_rejected() {
    let place = Place::new();
    let daemon = place.daemon();
    let own = format!("Host: {}\r\n", daemon.address);
    let status = |method: &str, path: &str, headers: &str, body: &[u8]| {
        let (status, head, body) = exchange(daemon.connect(), method, path, headers, body);
        if status >= 400 {
            let complaint: Value =
                serde_json::from_slice(&body).unwrap_or_else(|_| panic!("{method} {path}: {head}"));
            assert!(complaint["error"]["what"].is_string(), "{complaint}");
        }
        assert!(
            head.to_lowercase().contains("content-security-policy"),
            "{head}"
        );
        status
    };
    let typed = format!("{own}Content-Type: application/json\r\n");
    let trigger = br#"{"command": "trigger"}"#;
    for origin in ["http://evil.example", "null"] {
        let foreign = format!("{typed}Origin: {origin}\r\n");
        assert_eq!(status("POST", "/api/commands", &foreign, trigger), 403);
    }
    assert_eq!(
        status("GET", "/api/state", "Host: rebound.example\r\n", b""),
        403
    );
    for path in [
        "/api/grasps/../../../etc/passwd",
        "/api/grasps/%2e%2e%2f%2e%2e%2fetc",
        "/../Cargo.toml",
        "/api/grasps/2026-11-20T10-15-03Z-7f3a/files/%2e%2e%2fgrasp.json",
        "/api/cameras/left/preview.exe",
    ] {
        let found = status("GET", path, &own, b"");
        assert!(found == 404 || found == 422, "{path}: {found}");
    }
    assert_eq!(
        status("GET", "/api/cameras/tail/preview.jpg", &own, b""),
        400
    );
    let large = format!("{{\"command\": \"object {}\"}}", "x".repeat(20_000));
    assert_eq!(
        status("POST", "/api/commands", &typed, large.as_bytes()),
        413
    );
    assert_eq!(status("POST", "/api/commands", &own, trigger), 415);
    assert_eq!(status("POST", "/api/commands", &typed, b"{"), 400);
    assert_eq!(
        status("POST", "/api/commands", &typed, br#"{"comand": "trigger"}"#),
        422
    );
    assert_eq!(
        status("POST", "/api/commands", &typed, br#"{"command": "jump"}"#),
        422
    );
    assert_eq!(
        status("POST", "/api/commands", &typed, br#"{"command": "quit"}"#),
        403
    );
    assert_eq!(
        status("PUT", "/api/object", &typed, br#"{"name": "a\nb"}"#),
        422
    );
    assert_eq!(status("GET", "/api/grasps?limit=many", &own, b""), 400);
    assert_eq!(status("DELETE", "/api/state", &own, b""), 405);
    assert_eq!(status("GET", "/nothing", &own, b""), 404);
    assert_eq!(status("GET", "/", &own, b""), 200);
    assert_eq!(daemon.get("/api/state")["session"]["step"], "initial");
}

#[test]
fn token_is_required_over_tcp_but_not_on_the_socket() {
    const SECRET: &str = "correct-horse-battery";
    let place = Place::new();
    let file = place.0.path().join("token");
    fs::write(&file, SECRET).unwrap();
    fs::set_permissions(&file, fs::Permissions::from_mode(0o600)).unwrap();
    let daemon = Daemon::start(place.command().arg("--token-file").arg(&file));
    let status = |headers: &str| exchange(daemon.connect(), "GET", "/api/state", headers, b"").0;
    assert_eq!(status("Host: lab.example\r\n"), 401);
    assert_eq!(
        status("Host: lab.example\r\nAuthorization: Bearer no\r\n"),
        401
    );
    let bearer = format!("Host: lab.example\r\nAuthorization: Bearer {SECRET}\r\n");
    assert_eq!(status(&bearer), 200);
    let login = format!("{{\"token\": \"{SECRET}\"}}");
    let typed = "Host: lab.example\r\nContent-Type: application/json\r\n";
    let (code, head, _) = exchange(
        daemon.connect(),
        "POST",
        "/api/login",
        typed,
        login.as_bytes(),
    );
    assert_eq!(code, 204, "{head}");
    let cookie = head
        .lines()
        .find_map(|line| line.strip_prefix("set-cookie: "))
        .and_then(|cookie| cookie.split(';').next())
        .unwrap();
    assert_eq!(
        status(&format!("Host: lab.example\r\nCookie: {cookie}\r\n")),
        200
    );
    let local = UnixStream::connect(place.socket()).unwrap();
    assert_eq!(
        exchange(local, "GET", "/api/state", "Host: localhost\r\n", b"").0,
        200
    );
    daemon.signal(Signal::HUP);
    daemon.hear("settings reloaded");
    let with_cookie = format!("Host: lab.example\r\nCookie: {cookie}\r\n");
    assert_eq!(status(&with_cookie), 200, "the token is unchanged");
    fs::write(&file, "another-token-altogether").unwrap();
    daemon.signal(Signal::HUP);
    daemon.hear("settings reloaded");
    assert_eq!(status(&with_cookie), 401, "sessions end with their token");

    let open = place
        .command()
        .args(["--listen", "0.0.0.0:0"])
        .output()
        .unwrap();
    assert_eq!(open.status.code(), Some(2));
    assert!(stderr(&open).contains("no token"), "{}", stderr(&open));
}

#[test]
fn second_daemon_reports_what_is_in_use() {
    let place = Place::new();
    let daemon = place.daemon();
    let refused = |command: &mut Command| {
        let output = command.output().unwrap();
        assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
        stderr(&output)
    };
    let other = Place::new();
    let text = refused(other.command().arg("--listen").arg(&daemon.address));
    assert!(text.contains("in use"), "{text}");
    let text = refused(other.command().arg("--socket").arg(place.socket()));
    assert!(text.contains("another daemon"), "{text}");
    let text = refused(other.command().arg("--dataset").arg(place.dataset()));
    assert!(text.contains(&daemon.child.id().to_string()), "{text}");
    drop(daemon);
    // Killed, it left its socket behind, which the next one replaces.
    assert!(place.socket().exists());
    place.daemon().get("/api/health");
}

/// Opens an event WebSocket.
fn listen(daemon: &Daemon) -> tungstenite::WebSocket<TcpStream> {
    let url = format!("ws://{}/api/events", daemon.address);
    tungstenite::client(url, daemon.connect()).unwrap().0
}

/// Waits for one event per predicate, in any order; returns them in the order of the predicates.
fn wait_for_events<const N: usize>(
    socket: &mut tungstenite::WebSocket<TcpStream>,
    wanted: [&dyn Fn(&Value) -> bool; N],
) -> [Value; N] {
    // Images come all the time.
    const PATIENCE: usize = 20_000;
    let mut heard = [const { Value::Null }; N];
    let mut others = Vec::new();
    for _ in 0..PATIENCE {
        if let tungstenite::Message::Text(text) = socket.read().unwrap() {
            let event: Value = serde_json::from_str(&text).unwrap();
            let mut slots = heard.iter_mut().zip(&wanted);
            match slots.find(|(slot, is)| slot.is_null() && is(&event)) {
                Some((slot, _)) => *slot = event,
                None => others.push(event["type"].to_string() + &event["tone"].to_string()),
            }
        }
        if heard.iter().all(|slot| !slot.is_null()) {
            return heard;
        }
    }
    panic!("heard {heard:#?} besides {others:?}");
}

fn tone(event: &Value, name: &str) -> bool {
    event["type"] == "tone" && event["tone"] == name
}

fn step(event: &Value, name: &str) -> bool {
    event["type"] == "state" && event["state"]["session"]["step"] == name
}

#[test]
fn slow_event_client_does_not_delay_the_others() {
    let place = Place::new();
    let daemon = place.daemon();
    let (mut one, mut two) = (listen(&daemon), listen(&daemon));
    // The first states may be those of the start, without cameras.
    wait_for_events(
        &mut one,
        [&|event| {
            event["state"]["cameras"]
                .as_array()
                .is_some_and(|all| all.len() == 4)
        }],
    );
    let mut deaf = Vec::new();
    for role in ["left", "right", "rgb", "depth"] {
        let mut stream = daemon.connect();
        write!(
            stream,
            "GET /api/cameras/{role}/preview.mjpg HTTP/1.1\r\nHost: {}\r\n\r\n",
            daemon.address
        )
        .unwrap();
        deaf.push(stream);
    }
    let mut first = [0; 4096];
    deaf[0].read_exact(&mut first).unwrap();
    let text = String::from_utf8_lossy(&first);
    assert!(text.starts_with("HTTP/1.1 200") && text.contains("multipart/x-mixed-replace"));
    assert!(text.contains("--gripcast-frame"), "{text}");

    daemon.trigger();
    for socket in [&mut one, &mut two] {
        let is_stored = |event: &Value| event["type"] == "stored";
        let [_, stored] =
            wait_for_events(socket, [&|event| tone(event, "initial_saved"), &is_stored]);
        assert!(
            stored["stored"]["request"]["save_initial"].is_object(),
            "{stored}"
        );
    }
    let message = json!({"command": "undo", "id": 7}).to_string();
    one.send(tungstenite::Message::text(message)).unwrap();
    let [answer] = wait_for_events(&mut one, [&|event| event["type"] == "response"]);
    assert_eq!(
        (&answer["id"], &answer["response"]["result"]),
        (&json!(7), &json!("accepted"))
    );
    wait_for_events(
        &mut two,
        [&|event| tone(event, "undone"), &|event| {
            step(event, "initial")
        }],
    );
    daemon.signal(Signal::TERM);
    wait_for_events(&mut two, [&|event| event["type"] == "shutdown"]);
    assert_eq!(daemon.stop(), Some(0));
}

#[test]
fn removed_dataset_is_reported_and_no_grasp_is_lost() {
    let place = Place::new();
    let daemon = place.daemon();
    let id = daemon.grasp("stable");
    let away = place.0.path().join("away");
    fs::rename(place.dataset(), &away).unwrap();
    let (status, answer) = poll(|| match daemon.command("trigger") {
        (409, answer) => Err(answer.to_string()),
        other => Ok(other),
    });
    assert_eq!(
        (status, &answer["result"]),
        (500, &json!("failed")),
        "{answer}"
    );
    let message = answer["error"].as_str().unwrap();
    assert!(message.contains("NOT saved"), "{message}");
    assert_eq!(daemon.ask("GET", "/api/grasps", None).0, 404);
    fs::rename(&away, place.dataset()).unwrap();
    daemon.grasp("slip");
    daemon.stop();
    let found = grasps(&place.dataset());
    assert_eq!((found.len(), found.contains_key(&id)), (2, true));
    assert_eq!(verify(&place.dataset())["problems"], json!([]));
}

#[test]
fn killed_daemon_resumes_with_the_initial_frame() {
    let place = Place::new();
    let daemon = place.daemon();
    let id = daemon.grasp("stable");
    daemon.trigger();
    drop(daemon);
    let daemon = place.daemon();
    let answer = daemon.trigger();
    assert_eq!(answer["state"]["session"]["step"], "label", "{answer}");
    assert_eq!(daemon.stop(), Some(0));
    let found = grasps(&place.dataset());
    assert!(found.len() == 2 && found.contains_key(&id));
}

#[test]
fn reload_applies_guards_and_names_other_changes() {
    let place = Place::new();
    let config = place.0.path().join("c.toml");
    fs::write(&config, "").unwrap();
    let daemon = Daemon::start(place.command().arg("--config").arg(&config));
    daemon.trigger();
    fs::write(
        &config,
        "[guards]\nmin_contact_fraction = 1\n[collect]\nlicence = \"x\"\n",
    )
    .unwrap();
    daemon.signal(Signal::HUP);
    daemon.hear("settings reloaded");
    daemon.hear("need a restart: collect.licence");
    let reasons = poll(|| {
        let (status, answer) = daemon.command("trigger");
        assert_eq!(status, 409, "{answer}");
        let reasons = answer["reasons"].to_string();
        match reasons.contains("touch") || reasons.contains("contact") {
            true => Ok(reasons),
            false => Err(reasons),
        }
    });
    assert!(!reasons.is_empty());
    fs::write(&config, "[guards]\nmin_contact = 1\n").unwrap();
    daemon.signal(Signal::HUP);
    daemon.hear("settings NOT reloaded");
    assert_eq!(daemon.get("/api/state")["session"]["step"], "grasp");
}

#[test]
fn attach_requires_a_terminal_and_a_daemon() {
    let output = gripcast()
        .args(["collect", "--attach", "/proc/nonexistent/socket"])
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("terminal"), "{}", stderr(&output));
    let both = gripcast()
        .args(["collect", "--attach", "--rig", "virtual"])
        .output()
        .unwrap();
    assert_eq!(both.status.code(), Some(2));
}

/// Attaches a screen to a daemon in a pseudo-terminal of `script`.
#[test]
fn detached_screen_leaves_the_daemon_running() {
    let place = Place::new();
    let daemon = place.daemon();
    let line = format!(
        "{} collect --attach {}",
        env!("CARGO_BIN_EXE_gripcast"),
        place.socket().display()
    );
    let mut screen = Command::new("script")
        .args(["-qec", &line, "/dev/null"])
        .env("TERM", "xterm-256color")
        .env("XDG_CONFIG_HOME", "/proc/nonexistent")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .expect("`script` of bsdutils is part of every Debian and Ubuntu");
    let mut keys = screen.stdin.take().unwrap();
    let mut shown = screen.stdout.take().unwrap();
    // The screen is drawn when its first bytes come; the initial frame is asked for until taken.
    let mut bytes = [0; 1024];
    assert!(shown.read(&mut bytes).unwrap() > 0);
    let drain = std::thread::spawn(move || std::io::copy(&mut shown, &mut std::io::sink()));
    while daemon.get("/api/state")["session"]["step"] == "initial" {
        keys.write_all(b"i").unwrap();
    }
    while screen.try_wait().unwrap().is_none() {
        // The first asks whether to leave where a step is unfinished; the end closes the terminal.
        let _ = keys.write_all(b"q");
    }
    drain.join().unwrap().unwrap();
    assert_eq!(daemon.get("/api/state")["session"]["step"], "grasp");
    assert_eq!(daemon.stop(), Some(0));
}

/// A configuration file found next to data must not move the socket or set a token.
#[test]
fn discovered_configuration_cannot_open_sockets() {
    let place = Place::new();
    let dir = place.0.path();
    let (token, socket) = (dir.join("token"), dir.join("chosen.sock"));
    fs::write(&token, "known-to-somebody-else").unwrap();
    fs::set_permissions(&token, fs::Permissions::from_mode(0o600)).unwrap();
    let text = format!(
        "[daemon]\nlisten = \"0.0.0.0:0\"\nsocket = {socket:?}\ntoken_file = {token:?}\n\
         [collect]\nobject = \"cup\"\n"
    );
    fs::write(dir.join("gripcast.toml"), text).unwrap();
    let show = |arguments: &[&str]| {
        let mut command = gripcast();
        command.args(["config", "show"]).args(arguments);
        succeed(command.current_dir(dir))
    };
    let found = show(&["--json"]);
    let warning = stderr(&found);
    for key in ["daemon.listen", "daemon.socket", "daemon.token_file"] {
        let line = format!("gripcast.toml: `{key} = ");
        assert!(warning.contains(&line), "{warning}");
    }
    let listen = &json_of(&found)["daemon.listen"];
    assert_eq!(listen["value"], "127.0.0.1:7471");
    assert_eq!(
        listen["ignored"],
        json!({"value": "0.0.0.0:0", "file": "gripcast.toml"})
    );
    let text = String::from_utf8(show(&[]).stdout).unwrap();
    assert!(
        text.contains("default; \"0.0.0.0:0\" in gripcast.toml is ignored"),
        "{text}"
    );
    let named = show(&["--json", "--config", "./gripcast.toml"]);
    assert_eq!(stderr(&named), "");
    let listen = &json_of(&named)["daemon.listen"];
    assert_eq!(
        (&listen["value"], &listen["origin"]),
        (&json!("0.0.0.0:0"), &json!("./gripcast.toml:2"))
    );

    let mut command = gripcast();
    command
        .args(["daemon", "--rig", "virtual", "--dataset", "d"])
        .args(["--listen", "127.0.0.1:0"])
        .env("XDG_RUNTIME_DIR", dir)
        .current_dir(dir);
    let daemon = Daemon::start(&mut command);
    let state = daemon.get("/api/state");
    assert_eq!(state["session"]["object"], "cup");
    assert!(!socket.exists() && dir.join("gripcast.sock").exists());
}

/// A file of a hundred bytes that declares an image of 160 MB.
#[test]
fn oversized_image_is_not_decoded() {
    let place = Place::new();
    let daemon = place.daemon();
    let id = daemon.grasp("stable");
    let record = daemon.get(&format!("/api/grasps/{id}"));
    let name = record["grasp"]["cameras"]["depth"]["file"]
        .as_str()
        .unwrap();
    let path = place.dataset().join("grasps").join(&id).join(name);
    let mut bomb = fs::read(&path).unwrap();
    // Width and height stand at the beginning of the first chunk, IHDR; its checksum follows.
    bomb[16..20].copy_from_slice(&9000_u32.to_be_bytes());
    bomb[20..24].copy_from_slice(&9000_u32.to_be_bytes());
    let mut checksum = flate2::Crc::new();
    checksum.update(&bomb[12..29]);
    bomb[29..33].copy_from_slice(&checksum.sum().to_be_bytes());
    fs::write(&path, bomb).unwrap();
    let (status, answer) = daemon.ask(
        "GET",
        &format!("/api/grasps/{id}/preview/grasp/depth.jpg"),
        None,
    );
    let answer: Value = serde_json::from_slice(&answer).unwrap();
    let what = answer["error"]["what"].as_str().unwrap();
    assert_eq!(status, 422, "{answer}");
    assert!(what.contains("found 9000×9000"), "{answer}");
}

#[test]
fn token_is_never_printed() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("token");
    fs::write(&file, "a-very-secret-word").unwrap();
    fs::set_permissions(&file, fs::Permissions::from_mode(0o644)).unwrap();
    let output = gripcast()
        .args(["daemon", "--rig", "virtual", "--dataset"])
        .arg(Path::new("/proc/nonexistent"))
        .arg("--token-file")
        .arg(&file)
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(2));
    let text = stderr(&output);
    assert!(
        text.contains("chmod 600") && !text.contains("secret"),
        "{text}"
    );
}
