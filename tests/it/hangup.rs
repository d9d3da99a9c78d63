//! The operator's terminal goes away: a closed window, a lost connection.

use std::fs;
use std::io::Write as _;
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

/// A terminal that answers no question gets the screen with half blocks, and its modes back.
#[test]
fn terminal_without_answers_shows_the_screen_and_is_restored() {
    let dir = tempfile::tempdir().unwrap();
    let output = dir.path().join("output");
    let line = format!(
        "stty rows 24 cols 80; exec {} collect --rig virtual --dataset {} --object mug",
        env!("CARGO_BIN_EXE_gripcast"),
        dir.path().join("d").display()
    );
    let mut terminal = Command::new("script")
        .args(["-qfec", &line])
        .arg(&output)
        .env("TERM", "xterm-256color")
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .spawn()
        .expect("`script` of bsdutils is part of every Debian and Ubuntu");
    let shown = || String::from_utf8_lossy(&fs::read(&output).unwrap_or_default()).into_owned();
    wait_until(&mut terminal, || shown().contains("STEP 1/3"));
    let mut keys = terminal.stdin.take().unwrap();
    // Pasted text and an unknown key, then the end.
    keys.write_all(b"\x1b[200~q\nsf!\x1b[201~\x1b[6~").unwrap();
    wait_until(&mut terminal, || shown().contains("Page Down is not bound"));
    keys.write_all(b"q").unwrap();
    assert!(terminal.wait().unwrap().success());
    let all = shown();
    for (on, off) in [
        ("\x1b[?1049h", "\x1b[?1049l"),
        ("\x1b[?2004h", "\x1b[?2004l"),
        ("\x1b[>15u", "\x1b[<1u"),
        ("\x1b[?25l", "\x1b[?25h"),
    ] {
        let [on_at, off_at] = [on, off].map(|mode| all.rfind(mode));
        assert!(on_at.is_some() && on_at < off_at, "{on:?} {off:?}");
    }
    assert!(all.contains('▀'), "images are half blocks");
}
