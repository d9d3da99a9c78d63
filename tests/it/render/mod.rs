//! End-to-end tests of `gripcast render`.

mod calibrate;
mod clip;
mod figure;
mod tactile;
mod visual;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use crate::program::{gripcast, stderr, succeed};

/// A simulated grasp of the built-in mug, shared by the tests of this process.
fn trace() -> &'static Path {
    static TRACE: OnceLock<(tempfile::TempDir, PathBuf)> = OnceLock::new();
    let (_, path) = TRACE.get_or_init(|| {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("mug.bin");
        succeed(
            gripcast()
                .args(["sim", "grasp", "--object", "builtin:mug", "--gel", "coarse"])
                .args(["--adjust-s", "0.1", "--lift", "0.005", "--trace"])
                .arg(&path),
        );
        (dir, path)
    });
    path
}

fn render(kind: &str, words: &str) -> Command {
    let mut command = gripcast();
    command
        .args(["render", kind])
        .args(words.split_whitespace());
    command
}

/// Runs a command; returns its exit code and stderr.
fn refused(command: &mut Command) -> (i32, String) {
    let output = command.output().unwrap();
    (output.status.code().unwrap(), stderr(&output))
}

fn png(path: impl AsRef<Path>) -> image::RgbImage {
    let bytes = fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.as_ref().display()));
    gripcast_imaging::decode_png_rgb(&bytes).unwrap()
}

fn depth_png(path: impl AsRef<Path>) -> gripcast_imaging::DepthImage {
    gripcast_imaging::decode_png_grey16(&fs::read(path).unwrap()).unwrap()
}
