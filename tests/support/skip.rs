//! How a test says that it cannot run here: one way for tests/it and for the tests in src.

// Each of the two test programs needs some of these.
#![allow(dead_code)]

use std::fmt::Display;
use std::fs::OpenOptions;
use std::io::Write as _;

/// What a test needs beside the repository.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Needs {
    /// OpenCV's ChArUco pictures, in the folder `GRIPCAST_CHARUCO`.
    Charuco,
    /// The User-Mode-Linux kernel of tests/kernel.
    Kernel,
    /// A checker of manual pages.
    Mandoc,
    /// A Python with the peers' packages, `GRIPCAST_PYTHON`.
    Python,
    /// Real data, in `GRIPCAST_SHARED` or `../shared`.
    Shared,
    /// A Slurm cluster of this machine alone.
    Slurm,
}

impl Needs {
    fn name(self) -> &'static str {
        match self {
            Self::Charuco => "charuco",
            Self::Kernel => "kernel",
            Self::Mandoc => "mandoc",
            Self::Python => "python",
            Self::Shared => "shared",
            Self::Slurm => "slurm",
        }
    }
}

fn is_set(variable: &str) -> bool {
    std::env::var_os(variable).is_some_and(|value| !value.is_empty())
}

/// Says that the calling test is skipped: on stderr, and in the file that `GRIPCAST_SKIPS` names
/// (tools/run-tests.sh prints it as a summary).
///
/// # Panics
/// Where `GRIPCAST_REQUIRE_KERNEL`, `GRIPCAST_REQUIRE_SHARED`, … makes what is missing a failure.
pub(crate) fn skip(needs: Needs, reason: impl Display) {
    let name = needs.name();
    let required = format!("GRIPCAST_REQUIRE_{}", name.to_uppercase());
    assert!(!is_set(&required), "{required} is set, but: {reason}");
    let thread = std::thread::current();
    let test = thread.name().unwrap_or("a test");
    let reason = reason.to_string().replace(['\n', '\t'], " ");
    // The harness captures `eprintln!` and drops it where a test passes; it does not see this.
    let _ = writeln!(std::io::stderr(), "SKIPPED {test}: {name}: {reason}");
    if is_set("GRIPCAST_SKIPS") {
        let path = std::env::var_os("GRIPCAST_SKIPS").unwrap_or_default();
        // In one write each: tests run side by side.
        OpenOptions::new()
            .create(true)
            .append(true)
            .open(&path)
            .and_then(|mut file| file.write_all(format!("{name}\t{test}\t{reason}\n").as_bytes()))
            .unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    }
}
