//! Shared test helpers: location of real data, and reporting of skipped tests.

// Test helpers may panic.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

pub mod jpeg;
pub mod shuffled_mesh;
pub mod sysfs_tree;

use std::fmt::Display;
use std::fs::OpenOptions;
use std::io::Write as _;
use std::path::PathBuf;

/// External requirement of a test.
#[derive(Clone, Copy, Debug)]
pub enum Needs {
    /// OpenCV's ChArUco images, in the folder `GRIPCAST_CHARUCO`.
    Charuco,
    /// Two file systems: /dev/shm beside the build directory.
    Disks,
    /// The program ffmpeg.
    Ffmpeg,
    /// The User-Mode-Linux kernel of tests/kernel.
    Kernel,
    /// A linter for manual pages.
    Mandoc,
    /// A Python with the peers' packages, `GRIPCAST_PYTHON`.
    Python,
    /// Real data, in `GRIPCAST_SHARED` or `../shared`.
    Shared,
    /// A local Slurm cluster.
    Slurm,
}

impl Needs {
    fn name(self) -> &'static str {
        match self {
            Self::Charuco => "charuco",
            Self::Disks => "disks",
            Self::Ffmpeg => "ffmpeg",
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

/// Reports that the calling test is skipped: on stderr, and in the file `GRIPCAST_SKIPS`
/// (tools/run-tests.sh prints a summary).
///
/// # Panics
/// If `GRIPCAST_REQUIRE_KERNEL`, `GRIPCAST_REQUIRE_SHARED`, … makes a missing requirement a
/// failure.
pub fn skip(needs: Needs, reason: impl Display) {
    let name = needs.name();
    let required = format!("GRIPCAST_REQUIRE_{}", name.to_uppercase());
    assert!(!is_set(&required), "{required} is set, but: {reason}");
    let thread = std::thread::current();
    let test = thread.name().unwrap_or("a test");
    let reason = reason.to_string().replace(['\n', '\t'], " ");
    // Unlike `eprintln!`, this is not captured by the test harness.
    let _ = writeln!(std::io::stderr(), "SKIPPED {test}: {name}: {reason}");
    if is_set("GRIPCAST_SKIPS") {
        let path = std::env::var_os("GRIPCAST_SKIPS").unwrap_or_default();
        // One write each: tests run in parallel.
        OpenOptions::new()
            .create(true)
            .append(true)
            .open(&path)
            .and_then(|mut file| file.write_all(format!("{name}\t{test}\t{reason}\n").as_bytes()))
            .unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    }
}

/// Root directory of the repository.
pub fn repository() -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
}

/// Path of an item of the shared directory: `GRIPCAST_SHARED`, else `../shared`. If it is missing,
/// the calling test is skipped.
pub fn shared(item: &str) -> Option<PathBuf> {
    let given = std::env::var_os("GRIPCAST_SHARED").unwrap_or_else(|| "../shared".into());
    let path = repository().join(given).join(item);
    if path.exists() {
        return Some(path);
    }
    skip(
        Needs::Shared,
        format_args!("{} not found (set GRIPCAST_SHARED)", path.display()),
    );
    None
}

/// Mean absolute difference of two images of equal size, grey levels.
pub fn mean_difference(a: &image::RgbImage, b: &image::RgbImage) -> f64 {
    assert_eq!(a.dimensions(), b.dimensions());
    let pairs = a.iter().zip(b.iter());
    let sum: u64 = pairs.map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
    sum as f64 / a.len() as f64
}
