//! `gripcast doctor`: diagnoses the rig, the machine and the dataset folder.
//!
//! Exit codes: 0 no failure · 2 usage or an invalid rig file · 4 a check failed · 130 interrupted.

use std::path::PathBuf;
use std::time::Duration;

use serde_json::json;

use super::flags::{given, path_text, seconds};
use super::working::interruptible;
use super::{ConfigFlag, Context, print_report};
use crate::config::Layered;
use crate::doctor::{CheckStatus, DoctorTarget, Finding};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_capture::calibration::RigFile;
use gripcast_capture::device::SystemRoot;

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Name or file of the rig [default: collect.rig of the configuration]
    #[arg(long, value_name = "NAME|FILE")]
    rig: Option<String>,
    /// Folder of the dataset, which may not exist yet [default: collect.dataset of the
    /// configuration]
    #[arg(long, value_name = "DIR")]
    dataset: Option<PathBuf>,
    /// Model, as for `collect`
    #[arg(long, value_name = "MODEL")]
    model: Option<String>,
    /// Measuring time of the cameras, s
    #[arg(long, value_name = "S", default_value_t = 2.0, value_parser = seconds)]
    seconds: f64,
    #[command(flatten)]
    config: ConfigFlag,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
    /// Read device descriptions below DIR instead of /sys
    #[arg(long, hide = true, value_name = "DIR", default_value = "/sys")]
    sysfs_root: PathBuf,
    /// Look for device nodes below DIR instead of /dev
    #[arg(long, hide = true, value_name = "DIR", default_value = "/dev")]
    dev_root: PathBuf,
    /// Look for the owners of device nodes below DIR instead of /proc
    #[arg(long, hide = true, value_name = "DIR", default_value = "/proc")]
    proc_root: PathBuf,
}

/// Runs the command.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    let dataset = path_text(args.dataset.as_ref());
    let flags = given([
        ("--rig", "collect.rig", args.rig),
        ("--dataset", "collect.dataset", dataset),
        ("--model", "collect.model", args.model),
    ]);
    let Layered { config, .. } = args.config.load(&flags)?;
    let settings = config.collect;
    let rig = (!settings.rig.is_empty())
        .then(|| RigFile::find(&settings.rig))
        .transpose()?;
    let name = rig.as_ref().map(|rig| rig.id.clone());
    let target = DoctorTarget {
        rig,
        dataset: (!settings.dataset.is_empty()).then(|| PathBuf::from(&settings.dataset)),
        model: settings.model,
        duration: Duration::from_secs_f64(args.seconds),
        guards: config.guards,
        root: SystemRoot {
            sys: args.sysfs_root,
            dev: args.dev_root,
            proc: args.proc_root,
        },
    };
    let findings = interruptible(context, "examining", move |progress| {
        target.examine(&|what| progress.stage(what))
    })??;
    let worst = findings.iter().map(|finding| finding.status).max();
    let worst = worst.unwrap_or(CheckStatus::Ok);
    let report = json!({ "findings": findings, "rig": name, "status": worst });
    print_report(args.json, &report, |_| text(&findings))?;
    if worst < CheckStatus::Fail {
        return Ok(());
    }
    let failed = findings.iter().filter(|f| f.status == CheckStatus::Fail);
    let names: Vec<String> = failed.map(|f| format!("{} {}", f.area, f.name)).collect();
    Err(Error::new(
        ErrorKind::Check,
        format!("collecting will not work: {}", names.join(", ")),
    )
    .remedy("apply the remedies above (→)"))
}

fn text(findings: &[Finding]) -> String {
    let mut lines = Vec::new();
    for finding in findings {
        lines.push(format!(
            "{:<4}  {:<8} {:<20} {}",
            finding.status.name(),
            finding.area,
            finding.name,
            finding.message.replace('\n', "\n        ")
        ));
        if let Some(remedy) = &finding.remedy {
            lines.push(format!("        → {}", remedy.replace('\n', "\n        ")));
        }
    }
    lines.join("\n")
}
