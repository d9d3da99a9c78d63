//! Quick checks of gripcast's files and results against other libraries. The longer checks are in
//! tools/test-peers.sh.

use std::path::{Path, PathBuf};
use std::process::Command;

use gripcast_testing::{Needs, skip};

/// A script of tests/peers, run with the Python of `GRIPCAST_PYTHON`, which must have the libraries
/// of tests/peers/requirements.txt; skips the calling test if it is not set.
pub(crate) fn peer(script: &str) -> Option<Command> {
    let Some(python) = std::env::var_os("GRIPCAST_PYTHON").filter(|python| !python.is_empty())
    else {
        skip(
            Needs::Python,
            "the Python libraries of tests/peers/requirements.txt are not installed \
             (tools/setup.sh test, or set GRIPCAST_PYTHON)",
        );
        return None;
    };
    let mut command = Command::new(python);
    command
        .arg(in_repository("tests/peers").join(script))
        .env("HF_HUB_OFFLINE", "1");
    Some(command)
}

/// Runs a script that must succeed and returns its output.
pub(crate) fn agrees(command: &mut Command) -> String {
    let output = command.output().unwrap();
    let texts = [output.stdout, output.stderr].map(|text| String::from_utf8(text).unwrap());
    assert!(output.status.success(), "{}", texts.concat());
    texts.concat()
}

fn in_repository(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

#[test]
fn onnxruntime_matches_gripcast() {
    for model in ["baseline-contact", "gripcast-vt"] {
        let Some(mut check) = peer("check_onnx.py") else {
            return;
        };
        check
            .arg(in_repository(&format!("models/{model}.onnx")))
            .args(["--n", "2", "--gripcast", env!("CARGO_BIN_EXE_gripcast")]);
        agrees(&mut check);
    }
}

#[test]
fn camera_files_round_trip_through_opencv_and_yaml() {
    if let Some(mut check) = peer("camera_files.py") {
        agrees(check.arg(env!("CARGO_BIN_EXE_gripcast")));
    }
}

#[test]
fn markers_are_those_of_opencv_and_found_where_it_finds_them() {
    if let Some(mut check) = peer("markers.py") {
        agrees(check.args([env!("CARGO_BIN_EXE_gripcast"), "--sizes", "16,20,28"]));
    }
}
