//! The operator's terminal goes away: a closed window, a lost connection.

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

use crate::program::wait_until;

/// Collects in a terminal that `script` makes, takes the terminal away and waits for the end.
fn ends_with_its_terminal(prelude: &str) {
    let dir = tempfile::tempdir().unwrap();
    let (pid, dataset) = (dir.path().join("pid"), dir.path().join("d"));
    let line = format!(
        "{prelude} echo $$ > {}; exec {} collect --rig virtual --dataset {} --object mug",
        pid.display(),
        env!("CARGO_BIN_EXE_gripcast"),
        dataset.display()
    );
    let mut terminal = Command::new("script")
        .args(["-qec", &line, "/dev/null"])
        .env("TERM", "xterm-256color")
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .spawn()
        .expect("`script` of bsdutils is part of every Debian and Ubuntu");
    wait_until(&mut terminal, || dataset.join("dataset.toml").exists());
    let process = fs::read_to_string(&pid).unwrap();
    let state = Path::new("/proc").join(process.trim()).join("stat");
    assert!(state.exists());
    terminal.kill().unwrap();
    terminal.wait().unwrap();
    let mut waiting = Command::new("sleep").arg("600").spawn().unwrap();
    // Where nobody takes in orphans, an ended process stays as a zombie.
    let has_ended =
        || fs::read_to_string(&state).is_ok_and(|s| s.contains(") Z")) || !state.exists();
    wait_until(&mut waiting, has_ended);
    waiting.kill().unwrap();
    waiting.wait().unwrap();
}

#[test]
fn closed_terminal_ends_collection() {
    ends_with_its_terminal("");
}

#[test]
fn terminal_closed_without_signal_ends_collection() {
    ends_with_its_terminal("trap '' HUP;");
}
