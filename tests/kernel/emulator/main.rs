//! USB cameras and a pedal that exist only for `vhci_hcd`: two GelSight Minis, a RealSense D435
//! and a foot switch, presented to the kernel's own USB, UVC and HID drivers.
//!
//! ```text
//! usbip-cameras scenarios
//! usbip-cameras serve LEFT RIGHT                 plugs all in, then obeys commands on stdin
//! usbip-cameras probe LEFT RIGHT OUT             streams all cameras and compares
//! usbip-cameras run SCENARIO LEFT RIGHT OUT DISK GRIPCAST
//! usbip-cameras soak SECONDS SEED LEFT RIGHT OUT DISK GRIPCAST
//! ```
//!
//! LEFT and RIGHT are directories of JPEG files (`free/` and `pressed/`, or one for both).
//! Needs root in a kernel with `vhci_hcd`; `docs/how-to/kernel-tests.md` tells how such a kernel is
//! run.

use std::io::{self, BufRead as _};
use std::path::Path;
use std::process::ExitCode;
use std::str::FromStr;

use crate::command::Command;
use crate::rig::Rig;
use crate::soak::Soak;

mod camera;
mod command;
mod control;
mod descriptors;
mod device;
mod feed;
mod guest;
mod hid_pedal;
mod link;
mod pattern;
mod probe;
mod profile;
mod rig;
mod scenario;
mod soak;
mod sysfs;
mod usbip;

fn plugged_rig(left: &Path, right: &Path) -> io::Result<Rig> {
    let mut rig = Rig::new(left, right)?;
    for device in 0..profile::DEVICES {
        let port = device as u8;
        rig.obey(&Command::Attach { device, port })?;
    }
    Ok(rig)
}

fn serve(left: &Path, right: &Path) -> io::Result<()> {
    let mut rig = plugged_rig(left, right)?;
    eprintln!("usbip-cameras: plugged in {}", profile::NAMES.join(", "));
    for line in io::stdin().lock().lines() {
        let line = line?;
        match line.parse::<Command>() {
            Ok(Command::Quit) => break,
            Ok(command) => {
                if let Err(error) = rig.obey(&command) {
                    eprintln!("usbip-cameras: {line}: {error}");
                }
            }
            Err(what) => eprintln!("usbip-cameras: {what}"),
        }
    }
    println!("{:#}", serde_json::json!(rig.counters()));
    Ok(())
}

/// Ends the guest. Programs that could do it are not on every host.
fn poweroff() -> io::Result<()> {
    // SAFETY: `reboot` takes one integer and touches no memory of this process.
    if unsafe { libc::reboot(libc::LINUX_REBOOT_CMD_POWER_OFF) } == 0 {
        Ok(())
    } else {
        Err(io::Error::last_os_error())
    }
}

fn number<T: FromStr>(text: &str) -> io::Result<T> {
    text.parse().map_err(|_| {
        let what = format!("`{text}` is no number");
        io::Error::new(io::ErrorKind::InvalidInput, what)
    })
}

fn run(arguments: &[&str]) -> io::Result<()> {
    match *arguments {
        ["scenarios"] => {
            for scenario in scenario::SCENARIOS {
                println!("{:20} {}", scenario.name, scenario.about);
            }
            Ok(())
        }
        ["serve", left, right] => serve(left.as_ref(), right.as_ref()),
        ["probe", left, right, out] => {
            let (left, right) = (left.as_ref(), right.as_ref());
            let _rig = plugged_rig(left, right)?;
            probe::run(left, right, out.as_ref())
        }
        ["run", name, left, right, out, disk, gripcast] => {
            let Some(scenario) = scenario::find(name) else {
                let what = format!("unknown scenario `{name}`; see `usbip-cameras scenarios`");
                return Err(io::Error::new(io::ErrorKind::InvalidInput, what));
            };
            guest::run(&guest::Run {
                name: scenario.name,
                setup: scenario.setup,
                steps: scenario.steps,
                script: scenario.script,
                gripcast: gripcast.as_ref(),
                out: out.as_ref(),
                disk: disk.as_ref(),
                left: left.as_ref(),
                right: right.as_ref(),
            })
        }
        ["soak", seconds, seed, left, right, out, disk, gripcast] => {
            let soak = Soak::new(number(seconds)?, number(seed)?);
            guest::run(&guest::Run {
                name: "soak",
                setup: soak.setup(),
                steps: &soak.steps(),
                script: soak.script(),
                gripcast: gripcast.as_ref(),
                out: out.as_ref(),
                disk: disk.as_ref(),
                left: left.as_ref(),
                right: right.as_ref(),
            })
        }
        ["soak-disk-size", seconds] => {
            println!("{}m", soak::disk_mib(number(seconds)?));
            Ok(())
        }
        ["disk-size", name] => {
            let mib = scenario::find(name).map_or(0, |scenario| scenario.disk_mib);
            println!("{mib}m");
            Ok(())
        }
        // The last act of an init: without file systems to sync, the guest ends at once.
        ["poweroff"] => poweroff(),
        _ => Err(io::Error::new(
            io::ErrorKind::InvalidInput,
            "usage: usbip-cameras scenarios | serve LEFT RIGHT | probe LEFT RIGHT OUT | \
             run SCENARIO LEFT RIGHT OUT DISK GRIPCAST | \
             soak SECONDS SEED LEFT RIGHT OUT DISK GRIPCAST",
        )),
    }
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match run(&arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("usbip-cameras: {error}");
            ExitCode::FAILURE
        }
    }
}
