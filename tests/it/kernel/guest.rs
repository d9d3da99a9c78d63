//! Boots the User-Mode-Linux guest and reads what it left behind.

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;
use std::sync::mpsc;
use std::time::Duration;

use gripcast_dataset::GraspRecord;
use serde_json::Value;
use sha2::{Digest as _, Sha256};

use super::images::Images;
use gripcast_testing::{Needs, skip};

/// Timeout of a guest, wall clock of the host.
const WATCHDOG: Duration = Duration::from_secs(420);
/// Memory of the guest without its disk.
const MEMORY_MIB: u64 = 1024;

/// Finds the kernel built by `tests/kernel/build-kernel.sh`, or returns the reason for its absence.
fn find_kernel() -> Result<PathBuf, String> {
    if std::env::var_os("GRIPCAST_SKIP_KERNEL").is_some() {
        return Err("GRIPCAST_SKIP_KERNEL is set".into());
    }
    let cache = std::env::var_os("GRIPCAST_CACHE").map_or_else(
        || PathBuf::from(std::env::var_os("HOME").unwrap_or_default()).join(".cache/gripcast"),
        PathBuf::from,
    );
    let digest = Sha256::digest(include_bytes!("../../kernel/uml.fragment"));
    let fragment: String = digest[..6]
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect();
    let mut found: Vec<PathBuf> = fs::read_dir(cache.join("uml"))
        .into_iter()
        .flatten()
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|dir| dir.to_string_lossy().ends_with(&format!("-{fragment}")))
        .map(|dir| dir.join("umlinux"))
        .filter(|kernel| kernel.is_file())
        .collect();
    found.sort();
    found.pop().ok_or_else(|| {
        format!(
            "no test kernel in {}; tests/kernel/build-kernel.sh builds it",
            cache.join("uml").display()
        )
    })
}

/// Returns the test kernel; without one the calling test is skipped.
pub(super) fn kernel() -> Option<PathBuf> {
    match find_kernel() {
        Ok(kernel) => Some(kernel),
        Err(reason) => {
            skip(Needs::Kernel, reason);
            None
        }
    }
}

/// Builds the emulator from the current sources.
fn emulator() -> &'static Path {
    static EMULATOR: OnceLock<PathBuf> = OnceLock::new();
    EMULATOR.get_or_init(|| {
        let program_dir = Path::new(env!("CARGO_BIN_EXE_gripcast")).parent().unwrap();
        let mut cargo = Command::new(env!("CARGO"));
        cargo
            // With the features that libraries have in `cargo test --workspace`: with others, as for
            // this package alone, they would all be compiled again.
            .args(["build", "--offline", "--quiet", "--workspace"])
            .args(["--lib", "--bins", "--examples"])
            .arg("--target-dir")
            .arg(program_dir.parent().unwrap())
            .current_dir(env!("CARGO_MANIFEST_DIR"));
        // What cargo tells a test of its package is, to the next cargo, a changed input of build
        // scripts: it would build half of the libraries again, and so would the one after it.
        for (name, _) in std::env::vars_os() {
            let name = name.to_string_lossy();
            let of_package = ["CARGO_PKG_", "CARGO_MANIFEST_", "OUT_DIR"];
            if of_package.iter().any(|start| name.starts_with(start)) {
                cargo.env_remove(&*name);
            }
        }
        if program_dir.ends_with("release") {
            cargo.arg("--release");
        }
        assert!(cargo.status().unwrap().success(), "the emulator must build");
        program_dir.join("examples/usbip-cameras")
    })
}

fn quoted(path: &Path) -> String {
    format!("'{}'", path.to_str().unwrap().replace('\'', r"'\''"))
}

/// Returns the directory of the guests' memory files: in memory if there is enough space
/// (containers often have 64 MiB), else on disk.
fn memory_dir() -> PathBuf {
    const ROOM: u64 = 4 << 30;
    let shared = Path::new("/dev/shm");
    let has_room =
        rustix::fs::statvfs(shared).is_ok_and(|stat| stat.f_bavail * stat.f_frsize >= ROOM);
    if has_room {
        return shared.to_owned();
    }
    let dir = Path::new(env!("CARGO_TARGET_TMPDIR")).join("guest-memory");
    fs::create_dir_all(&dir).unwrap();
    dir
}

/// Boots the guest with a command for its shell; returns the result directory once the guest
/// has ended. `$OUT` and `$DISK` are known to the command.
fn boot(kernel: &Path, name: &str, disk: &str, command: &str) -> PathBuf {
    boot_with(kernel, name, disk, command, MEMORY_MIB, WATCHDOG)
}

fn boot_with(
    kernel: &Path,
    name: &str,
    disk: &str,
    command: &str,
    memory_mib: u64,
    watchdog: Duration,
) -> PathBuf {
    let out = Path::new(env!("CARGO_TARGET_TMPDIR"))
        .join("kernel")
        .join(name);
    if out.exists() {
        fs::remove_dir_all(&out).unwrap();
    }
    fs::create_dir_all(&out).unwrap();
    fs::write(out.join("command.sh"), command).unwrap();
    let init = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/kernel/guest-init.sh");
    let mut guest = Command::new(kernel)
        .arg(format!("mem={memory_mib}M"))
        .args(["root=/dev/root", "rootfstype=hostfs", "rootflags=/", "ro"])
        .args([
            "con=null",
            "con0=null",
            "loglevel=2",
            "quiet",
            "time-travel=inf-cpu",
        ])
        // Its default is below the home directory, which need not be there.
        .arg(format!("uml_dir={}/", out.display()))
        .arg(format!("init={}", init.display()))
        .arg(format!("GRIPCAST_OUT={}", out.display()))
        .arg(format!("GRIPCAST_DISK={disk}"))
        .arg(format!("GRIPCAST_POWEROFF={}", emulator().display()))
        .env("TMPDIR", memory_dir())
        .stdin(Stdio::null())
        .stdout(fs::File::create(out.join("console.log")).unwrap())
        .stderr(fs::File::create(out.join("console.err")).unwrap())
        .process_group(0)
        .spawn()
        .unwrap();
    let group = rustix::process::Pid::from_child(&guest);
    let (ended, end) = mpsc::channel();
    let waiter = std::thread::spawn(move || {
        let status = guest.wait();
        // The receiver is gone only where the watchdog has bitten.
        let _ = ended.send(());
        status
    });
    let in_time = end.recv_timeout(watchdog).is_ok();
    // Processes of the guest are processes of the host; none may outlive it.
    let _ = rustix::process::kill_process_group(group, rustix::process::Signal::KILL);
    waiter.join().unwrap().unwrap();
    assert!(in_time, "{name}: the guest hangs; see {}", out.display());
    let log = fs::read_to_string(out.join("guest.log")).unwrap_or_default();
    let rc = fs::read_to_string(out.join("rc")).unwrap_or_default();
    assert_eq!(rc.trim(), "0", "{name}: {}\n{log}", out.display());
    out
}

/// Streams all emulated cameras without the program under test; returns the emulator's report.
pub(super) fn probe(kernel: &Path, images: &Images) -> Value {
    let command = format!(
        "{} probe {} {} \"$OUT\"\n",
        quoted(emulator()),
        quoted(&images.left),
        quoted(&images.right)
    );
    let out = boot(kernel, "probe", "64m", &command);
    read_json(&out.join("probe.json"))
}

fn read_json(path: &Path) -> Value {
    let text = fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    serde_json::from_str(&text).unwrap_or_else(|e| panic!("{}: {e}: {text}", path.display()))
}

/// A saved grasp.
#[derive(Debug)]
pub(super) struct SavedGrasp {
    pub(super) dir: PathBuf,
    pub(super) record: GraspRecord,
}

/// Result of a scenario.
#[derive(Debug)]
pub(super) struct Outcome {
    /// Directory with all that the guest left behind.
    pub(super) out: PathBuf,
    /// Exit code of `gripcast collect`; `None` where it did not end.
    pub(super) exit_code: Option<i64>,
    /// Closing report of `gripcast collect --json`; null where it printed none.
    pub(super) report: Value,
    /// Images sent intact and spoilt, by camera and kind.
    pub(super) sent: BTreeMap<String, BTreeMap<String, u64>>,
    /// Exit code and messages of a second start on the dataset, with the virtual rig.
    pub(super) second_start: Value,
    /// From plugging a camera in again to its next image, s.
    pub(super) came_back_s: BTreeMap<String, Vec<f64>>,
    /// Grasps in the dataset, in the order of their keys.
    pub(super) grasps: Vec<SavedGrasp>,
}

impl Outcome {
    /// A number of a camera in the closing report.
    pub(super) fn counter(&self, role: &str, name: &str) -> u64 {
        self.report["cameras"][role][name]
            .as_u64()
            .unwrap_or_else(|| panic!("no {role}.{name} in the report: {self}"))
    }

    /// A number of the session in the closing report.
    pub(super) fn session(&self, name: &str) -> u64 {
        self.report["session"][name]
            .as_u64()
            .unwrap_or_else(|| panic!("no session.{name} in the report: {self}"))
    }
}

impl Outcome {
    /// What the program told the operator, line by line.
    pub(super) fn told(&self) -> String {
        fs::read_to_string(self.out.join("stderr.txt")).unwrap_or_default()
    }

    /// Memory of the program, KiB, by the guest's second.
    pub(super) fn memory_kib(&self) -> Vec<(f64, f64)> {
        let text = fs::read_to_string(self.out.join("memory.csv")).unwrap();
        let line = |line: &str| {
            let (second, kib) = line.split_once(',').unwrap();
            (second.parse().unwrap(), kib.parse().unwrap())
        };
        text.lines().skip(1).map(line).collect()
    }
}

impl std::fmt::Display for Outcome {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let stderr = self.told();
        write!(
            f,
            "{}: exit code {:?}\nreport {:#}\nsent {:?}\nstderr:\n{stderr}",
            self.out.display(),
            self.exit_code,
            self.report,
            self.sent
        )
    }
}

fn saved_grasps(dataset: &Path) -> Vec<SavedGrasp> {
    let Ok(entries) = fs::read_dir(dataset.join("grasps")) else {
        return Vec::new();
    };
    let mut dirs: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    dirs.sort();
    dirs.into_iter()
        .filter(|dir| dir.join("grasp.json").exists())
        .map(|dir| {
            let text = fs::read_to_string(dir.join("grasp.json")).unwrap();
            let record = serde_json::from_str(&text).unwrap();
            SavedGrasp { dir, record }
        })
        .collect()
}

/// Runs `gripcast collect` through a scenario of the emulator.
pub(super) fn run(kernel: &Path, name: &str, run: &str, images: &Images) -> Outcome {
    let emulator = emulator();
    let disk = Command::new(emulator)
        .args(["disk-size", name])
        .output()
        .unwrap();
    let command = format!(
        "{} run {name} {} {} \"$OUT\" \"$DISK\" {}\n",
        quoted(emulator),
        quoted(&images.left),
        quoted(&images.right),
        quoted(&program())
    );
    let disk = String::from_utf8(disk.stdout).unwrap();
    outcome(boot(kernel, run, disk.trim(), &command))
}

/// Runs a collection of `seconds` on the guest's clock with random faults.
pub(super) fn soak(kernel: &Path, seconds: u64, seed: u64, images: &Images) -> Outcome {
    let emulator = emulator();
    let disk = Command::new(emulator)
        .args(["soak-disk-size", &seconds.to_string()])
        .output()
        .unwrap();
    let disk = String::from_utf8(disk.stdout).unwrap();
    let disk_mib: u64 = disk.trim().trim_end_matches('m').parse().unwrap();
    let command = format!(
        "{} soak {seconds} {seed} {} {} \"$OUT\" \"$DISK\" {}\n",
        quoted(emulator),
        quoted(&images.left),
        quoted(&images.right),
        quoted(&program())
    );
    let watchdog = WATCHDOG + Duration::from_secs(4 * seconds);
    let memory = MEMORY_MIB + disk_mib;
    outcome(boot_with(
        kernel,
        "soak",
        disk.trim(),
        &command,
        memory,
        watchdog,
    ))
}

/// Returns the program under test: `GRIPCAST_PROGRAM`, or that of this build.
fn program() -> PathBuf {
    std::env::var_os("GRIPCAST_PROGRAM")
        .map_or_else(|| env!("CARGO_BIN_EXE_gripcast").into(), PathBuf::from)
}

fn outcome(out: PathBuf) -> Outcome {
    let result = read_json(&out.join("result.json"));
    let report = fs::read_to_string(out.join("stdout.json")).unwrap();
    Outcome {
        exit_code: result["exit_code"].as_i64(),
        report: serde_json::from_str(&report).unwrap_or(Value::Null),
        sent: serde_json::from_value(result["sent"].clone()).unwrap(),
        second_start: result["second_start"].clone(),
        came_back_s: serde_json::from_value(result["came_back_s"].clone()).unwrap(),
        grasps: saved_grasps(&out.join("dataset")),
        out,
    }
}
