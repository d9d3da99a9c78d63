//! Running the program as a user does.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

/// The program, without the settings of whoever runs the tests.
pub(crate) fn gripcast() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_gripcast"));
    set_environment(&mut command);
    command.stdin(Stdio::null());
    command
}

/// Removes the settings of whoever runs the tests from the environment of a command.
pub(crate) fn set_environment(command: &mut Command) {
    let inherited: Vec<String> = std::env::vars()
        .map(|(name, _)| name)
        .filter(|name| name.starts_with("GRIPCAST__"))
        .collect();
    for name in inherited {
        command.env_remove(name);
    }
    command
        .env("XDG_CONFIG_HOME", "/proc/nonexistent")
        .env("NO_COLOR", "1");
}

/// `collect` on the virtual rig with a script.
pub(crate) fn collect(script: &Path, dataset: &Path) -> Command {
    collect_on(Path::new("virtual"), script, dataset)
}

/// `collect` with a script, and with relaxed guards.
pub(crate) fn collect_on(rig: &Path, script: &Path, dataset: &Path) -> Command {
    let mut command = gripcast();
    command
        .args(["collect", "--json", "--rig"])
        .arg(rig)
        .arg("--script")
        .arg(script)
        .arg("--dataset")
        .arg(dataset);
    relax_guards(&mut command);
    command
}

/// Sets guards that a loaded machine can hold: these tests are about what is saved, not about how
/// fresh frames are.
pub(crate) fn relax_guards(command: &mut Command) {
    command
        .env("GRIPCAST__GUARDS__MAX_FRAME_AGE_MS", "60000")
        .env("GRIPCAST__GUARDS__MAX_SKEW_MS", "60000")
        .env("GRIPCAST__GUARDS__MIN_FREE_BYTES", "0");
}

/// A script file in `dir`.
pub(crate) fn script(dir: &Path, lines: &str) -> PathBuf {
    let path = dir.join("script.txt");
    std::fs::write(&path, lines).unwrap();
    path
}

pub(crate) fn json(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout).unwrap_or_else(|error| {
        panic!(
            "no JSON on stdout: {error}\n{}\n{}",
            String::from_utf8_lossy(&output.stdout),
            stderr(output)
        )
    })
}

pub(crate) fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Runs a command that has to succeed.
pub(crate) fn succeed(command: &mut Command) -> Output {
    let output = command.output().unwrap();
    assert!(output.status.success(), "{command:?}\n{}", stderr(&output));
    output
}

/// What `dataset verify --json` says.
pub(crate) fn verify(dataset: &Path) -> Value {
    let output = gripcast()
        .args(["dataset", "verify", "--json"])
        .arg(dataset)
        .output()
        .unwrap();
    json(&output)
}

/// Records of all grasps that are visible in a dataset, by id.
pub(crate) fn grasps(dataset: &Path) -> std::collections::BTreeMap<String, Value> {
    let mut found = std::collections::BTreeMap::new();
    let Ok(entries) = std::fs::read_dir(dataset.join("grasps")) else {
        return found;
    };
    for entry in entries {
        let entry = entry.unwrap();
        let name = entry.file_name().into_string().unwrap();
        if name.starts_with('.') {
            continue;
        }
        let text = std::fs::read_to_string(entry.path().join("grasp.json"))
            .unwrap_or_else(|error| panic!("half a grasp is visible: {name}: {error}"));
        found.insert(name, serde_json::from_str(&text).unwrap());
    }
    found
}

/// Whoever waits longer is stuck: everything that tests wait for takes seconds.
pub(crate) const STUCK: Duration = Duration::from_secs(600);

/// Repeats a step until it has a result; a test that is stuck fails with what it saw last.
pub(crate) fn poll<T>(mut step: impl FnMut() -> Result<T, String>) -> T {
    let start = Instant::now();
    loop {
        match step() {
            Ok(result) => return result,
            Err(seen) => assert!(start.elapsed() < STUCK, "stuck at: {seen}"),
        }
        std::thread::yield_now();
    }
}

/// Waits for what a running program does; it must not end before.
pub(crate) fn wait_until(child: &mut Child, mut done: impl FnMut() -> bool) {
    poll(|| {
        if done() {
            return Ok(());
        }
        let status = child.try_wait().unwrap();
        assert!(status.is_none(), "the program ended too early");
        Err("a running program".to_owned())
    });
}

/// Waits for the end of a program; one that is stuck is killed.
pub(crate) fn end_of(child: &mut Child) -> ExitStatus {
    let start = Instant::now();
    loop {
        if let Some(status) = child.try_wait().unwrap() {
            return status;
        }
        if start.elapsed() > STUCK {
            child.kill().unwrap();
            panic!("the program does not end");
        }
        std::thread::yield_now();
    }
}
