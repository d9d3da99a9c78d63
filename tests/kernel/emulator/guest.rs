//! The driver inside the guest: plugs the rig in, runs the program under test against it, lets
//! the scenario happen, and writes down what came of it.
//!
//! Below the result directory it leaves `rig.toml`, `script.txt`, `stdout.json`, `stderr.txt`,
//! a copy of the dataset in `dataset/`, `memory.csv` (the program's memory over the guest's time)
//! and `result.json`.

use std::fs::{self, File};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Child, Command as Process, ExitStatus, Stdio};
use std::str::FromStr;
use std::thread;
use std::time::{Duration, Instant};

use gripcast_capture::calibration::{CameraConfig, PedalConfig, RigFile, SourceKind};
use gripcast_imaging::{PixelFormat, Role};

use crate::command::Command;
use crate::probe;
use crate::profile::TWIN_SERIAL;
use crate::rig::Rig;

/// A step of a scenario: a command to the rig, or something done to the guest.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Action {
    Rig(Command),
    /// Fills the dataset's disk until this much is left, KiB.
    FillDisk {
        leave_kib: u64,
    },
    /// Makes the dataset read-only, as a kernel does with a disk that reports errors.
    ReadOnly,
    /// Lets the kernel stamp images with the cameras' clocks.
    CameraClocks,
}

/// Parameter of the driver; 1: stamp images with the camera's clock.
const HARDWARE_TIMESTAMPS: &str = "/sys/module/uvcvideo/parameters/hwtimestamps";

impl FromStr for Action {
    type Err = String;

    fn from_str(line: &str) -> Result<Self, String> {
        match line {
            "read-only" => return Ok(Self::ReadOnly),
            "camera-clocks" => return Ok(Self::CameraClocks),
            _ => {}
        }
        match line.strip_prefix("fill-disk ") {
            Some(kib) => kib
                .parse()
                .map(|leave_kib| Self::FillDisk { leave_kib })
                .map_err(|_| format!("`{kib}` is no number of KiB")),
            None => line.parse().map(Self::Rig),
        }
    }
}

/// What to run.
pub(crate) struct Run<'a> {
    pub(crate) name: &'a str,
    /// Commands before the program starts.
    pub(crate) setup: &'a [&'a str],
    /// As those of a [`Scenario`](crate::scenario::Scenario), in the order of their times.
    pub(crate) steps: &'a [(f64, &'a str)],
    /// What the program follows.
    pub(crate) script: &'a str,
    /// The program under test.
    pub(crate) gripcast: &'a Path,
    /// Directory for the results, on the host's disk.
    pub(crate) out: &'a Path,
    /// Disk of the guest that holds the dataset.
    pub(crate) disk: &'a Path,
    pub(crate) left: &'a Path,
    pub(crate) right: &'a Path,
}

/// Cameras that the program uses.
const ROLES: [&str; 4] = ["left", "right", "rgb", "depth"];
/// The program has this long after the last step, on the guest's clock.
const PATIENCE: Duration = Duration::from_secs(90);
const POLL: Duration = Duration::from_millis(20);
/// Between two looks at the program's memory.
const MEMORY_EVERY: Duration = Duration::from_secs(30);

fn camera(
    (product, serial, interface): (&str, &str, Option<u8>),
    format: PixelFormat,
    (width, height, fps): (u32, u32, f64),
) -> CameraConfig {
    CameraConfig {
        source: SourceKind::V4l2,
        product: product.into(),
        serial: Some(serial.into()),
        interface,
        port: None,
        path: None,
        unpaced: false,
        format,
        width,
        height,
        fps,
        crop_profile: None,
        sensor_profile: None,
        force_calibration: None,
        depth_unit_m: None,
        intrinsics: None,
        controls: [].into(),
    }
}

/// The rig file that binds roles to the emulated devices: by serial, the tactile sensors by port
/// where they are twins.
fn rig_file(are_twins: bool) -> RigFile {
    let tactile = |serial, port: &str| {
        let serial = if are_twins { TWIN_SERIAL } else { serial };
        let mut mini = camera(
            ("GelSight Mini", serial, None),
            PixelFormat::Mjpg,
            (3280, 2464, 25.0),
        );
        mini.port = are_twins.then(|| port.to_owned());
        mini.crop_profile = Some("gsmini-seventh-v1".into());
        mini.controls = [
            ("auto_exposure", 1),
            ("exposure_time_absolute", 180),
            ("gain", 0),
            ("white_balance_automatic", 0),
            ("white_balance_temperature", 4500),
        ]
        .map(|(name, value)| (name.to_owned(), value))
        .into();
        mini
    };
    let d435 = |interface, format, (width, height)| {
        let name = "Intel(R) RealSense(TM) Depth Camera 435";
        camera(
            (name, "814412070123", Some(interface)),
            format,
            (width, height, 30.0),
        )
    };
    let rgb = d435(3, PixelFormat::Yuyv, (1280, 720));
    let mut depth = d435(0, PixelFormat::Z16, (640, 480));
    depth.depth_unit_m = Some(0.001);
    RigFile {
        schema: 1,
        id: "kernel-test".into(),
        cameras: [
            (Role::Left, tactile("2BNN4ZE7", "1-1")),
            (Role::Right, tactile("28F5K4RR", "1-2")),
            (Role::Rgb, rgb),
            (Role::Depth, depth),
        ]
        .into(),
        boards: None,
        pedals: vec![PedalConfig {
            vendor: 0x3553,
            product: 0xb001,
            keys: [("b".to_owned(), "trigger".to_owned())].into(),
            debounce_ms: 80,
        }],
    }
}

/// The program under test, following a script without a terminal.
fn collect(run: &Run<'_>, arguments: &[&str], script: &Path, dataset: &Path) -> Process {
    let mut command = Process::new(run.gripcast);
    command
        // Cameras are on trial, on one emulated processor: the classifier would take most of it.
        .args(["collect", "--headless", "--model", "baseline-contact"])
        .args(arguments)
        .arg("--script")
        .arg(script)
        .arg("--dataset")
        .arg(dataset)
        .current_dir(run.disk)
        .env("HOME", run.disk)
        .stdin(Stdio::null());
    command
}

fn start(run: &Run<'_>, dataset: &Path) -> io::Result<Child> {
    let rig = run.out.join("rig.toml");
    let are_twins = run.setup.contains(&"twin-serials");
    let text = toml::to_string_pretty(&rig_file(are_twins)).map_err(io::Error::other)?;
    fs::write(&rig, text)?;
    let script = run.out.join("script.txt");
    fs::write(&script, run.script)?;
    collect(run, &["--json"], &script, dataset)
        .arg("--rig")
        .arg(&rig)
        .stdout(File::create(run.out.join("stdout.json"))?)
        .stderr(File::create(run.out.join("stderr.txt"))?)
        .spawn()
}

/// Waits until all cameras have sent their first image; `None` where the program ends before.
fn first_images(rig: &Rig, child: &mut Child) -> io::Result<Option<Instant>> {
    let start = Instant::now();
    let mut latest = start;
    for role in ROLES {
        latest = loop {
            if let Some(first) = rig.feed(role)?.first_sent(POLL) {
                break latest.max(first);
            }
            if child.try_wait()?.is_some() || start.elapsed() > PATIENCE {
                return Ok(None);
            }
        };
    }
    Ok(Some(latest))
}

/// Waits for the program's end; kills it when its time is over.
fn finish(child: &mut Child) -> io::Result<Option<ExitStatus>> {
    let start = Instant::now();
    while start.elapsed() < PATIENCE {
        if let Some(status) = child.try_wait()? {
            return Ok(Some(status));
        }
        thread::sleep(POLL);
    }
    child.kill()?;
    child.wait()?;
    Ok(None)
}

/// What the program holds in memory, over the guest's time.
struct Memory {
    status: PathBuf,
    file: File,
    next: Instant,
}

impl Memory {
    fn of(child: &Child, csv: &Path) -> io::Result<Self> {
        let mut file = File::create(csv)?;
        writeln!(file, "second,resident_kib")?;
        Ok(Self {
            status: format!("/proc/{}/status", child.id()).into(),
            file,
            next: Instant::now(),
        })
    }

    /// A line where one is due; times are those since `start`.
    fn look(&mut self, start: Instant) -> io::Result<()> {
        let now = Instant::now();
        if now < self.next {
            return Ok(());
        }
        self.next = now + MEMORY_EVERY;
        let status = fs::read_to_string(&self.status).unwrap_or_default();
        let resident = status.lines().find_map(|l| l.strip_prefix("VmRSS:"));
        let Some(kib) = resident.and_then(|text| text.split_whitespace().next()) else {
            return Ok(());
        };
        writeln!(self.file, "{:.0},{kib}", (now - start).as_secs_f64())
    }
}

/// Writes a file of zeroes until only `leave_kib` are left.
fn fill_disk(disk: &Path, leave_kib: u64) -> io::Result<()> {
    let stat = rustix::fs::statvfs(disk)?;
    let free = stat.f_bavail * stat.f_frsize;
    let bytes = free.saturating_sub(leave_kib * 1024);
    io::copy(
        &mut io::Read::take(io::repeat(0), bytes),
        &mut File::create(disk.join("ballast"))?,
    )?;
    Ok(())
}

/// Mounts the directory read-only over itself. The program's own files are open for writing, so
/// the disk below cannot be remounted; every path below the directory becomes read-only at once.
fn make_read_only(dir: &Path) -> io::Result<()> {
    for options in ["bind", "remount,bind,ro"] {
        let status = Process::new("mount")
            .args(["-o", options])
            .args([dir, dir])
            .status()?;
        if !status.success() {
            return Err(io::Error::other(format!("mount -o {options}: {status}")));
        }
    }
    Ok(())
}

/// What another start of the program says about the dataset as it is now.
fn second_start(run: &Run<'_>, dataset: &Path) -> io::Result<serde_json::Value> {
    let script = run.out.join("quit.txt");
    fs::write(&script, "quit\n")?;
    let output = collect(run, &["--rig", "virtual"], &script, dataset).output()?;
    Ok(serde_json::json!({
        "exit_code": output.status.code(),
        "stderr": String::from_utf8_lossy(&output.stderr),
    }))
}

fn copy_tree(from: &Path, to: &Path) -> io::Result<()> {
    fs::create_dir_all(to)?;
    for entry in fs::read_dir(from)? {
        let entry = entry?;
        let target = to.join(entry.file_name());
        if entry.file_type()?.is_dir() {
            copy_tree(&entry.path(), &target)?;
        } else {
            fs::copy(entry.path(), target)?;
        }
    }
    Ok(())
}

/// Runs a scenario from plugging in to the copy of the dataset.
pub(crate) fn run(run: &Run<'_>) -> io::Result<()> {
    let invalid = |what: String| io::Error::new(io::ErrorKind::InvalidInput, what);
    let mut rig = Rig::new(run.left, run.right)?;
    for line in run.setup {
        rig.obey(&line.parse().map_err(invalid)?)?;
    }
    probe::wait_for_nodes()?;

    let dataset: PathBuf = run.disk.join("dataset");
    let started = Instant::now();
    let mut child = start(run, &dataset)?;
    let first = first_images(&rig, &mut child)?;
    let mut memory = Memory::of(&child, &run.out.join("memory.csv"))?;
    if let Some(first) = first {
        for (at_s, line) in run.steps {
            let due = first + Duration::from_secs_f64(*at_s);
            while let Some(pause) = due.checked_duration_since(Instant::now()) {
                memory.look(first)?;
                thread::sleep(pause.min(MEMORY_EVERY));
            }
            if child.try_wait()?.is_some() {
                break;
            }
            match line.parse().map_err(invalid)? {
                Action::Rig(command) => rig.obey(&command)?,
                Action::FillDisk { leave_kib } => fill_disk(run.disk, leave_kib)?,
                Action::ReadOnly => make_read_only(&dataset)?,
                Action::CameraClocks => fs::write(HARDWARE_TIMESTAMPS, "1")?,
            }
        }
    }
    let status = finish(&mut child)?;
    let second_start = second_start(run, &dataset)?;
    let result = serde_json::json!({
        "scenario": run.name,
        "exit_code": status.and_then(|s| s.code()),
        "timed_out": status.is_none(),
        "streams_started": first.is_some(),
        "guest_s": started.elapsed().as_secs_f64(),
        "sent": rig.counters(),
        "came_back_s": rig.came_back_s(),
        "second_start": second_start,
    });
    if dataset.is_dir() {
        copy_tree(&dataset, &run.out.join("dataset"))?;
    }
    fs::write(run.out.join("result.json"), format!("{result:#}\n"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rig_file_round_trips() {
        for are_twins in [false, true] {
            let text = toml::to_string_pretty(&rig_file(are_twins)).unwrap();
            assert_eq!(RigFile::parse(&text).unwrap(), rig_file(are_twins));
        }
    }

    #[test]
    fn actions_are_rig_commands_or_guest_commands() {
        assert_eq!(
            "fill-disk 64".parse(),
            Ok(Action::FillDisk { leave_kib: 64 })
        );
        assert_eq!("read-only".parse(), Ok(Action::ReadOnly));
        assert_eq!("quit".parse(), Ok(Action::Rig(Command::Quit)));
        assert!("fill-disk much".parse::<Action>().is_err());
    }
}
