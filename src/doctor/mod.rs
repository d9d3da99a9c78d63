//! Checks of everything a collection needs, each with a status and a remedy.

mod board;
mod camera;
mod disk;
mod file_system;
mod machine;
mod model;
mod usb;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;

use serde::Serialize;

use crate::camera_check::check_cameras;
use crate::daemon::Boards;
use gripcast_base::error::{Error, Result};
use gripcast_capture::calibration::RigFile;
use gripcast_capture::camera::RigSources;
use gripcast_capture::device::SystemRoot;
use gripcast_capture::trigger::find_pedal;
use gripcast_session::GuardLimits;
use gripcast_virtual_rig::VirtualSource;

pub(crate) use usb::{access_text, connected_cameras, repeated_serials, shared_buses};

/// Status of a check, in ascending order of severity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum CheckStatus {
    /// Not checked, for the stated reason.
    Skipped,
    /// Passed.
    Ok,
    /// Usable with limitations.
    Warn,
    /// Collecting will fail, or data are at risk.
    Fail,
}

impl CheckStatus {
    /// Returns the displayed name.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Skipped => "skip",
            Self::Ok => "ok",
            Self::Warn => "warn",
            Self::Fail => "FAIL",
        }
    }
}

/// Result of one check.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Finding {
    /// `machine`, `usb`, `camera`, `pedal`, `board`, `disk` or `model`.
    pub(crate) area: &'static str,
    /// Name of the checked item.
    pub(crate) name: String,
    pub(crate) status: CheckStatus,
    /// Result, with the expected value if it differs.
    pub(crate) message: String,
    /// Remedy of a problem.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) remedy: Option<String>,
    /// Measured values, with units in their names.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub(crate) measurements: BTreeMap<&'static str, f64>,
}

impl Finding {
    fn new(
        area: &'static str,
        name: impl Into<String>,
        status: CheckStatus,
        message: impl Into<String>,
    ) -> Self {
        Self {
            area,
            name: name.into(),
            status,
            message: message.into(),
            remedy: None,
            measurements: BTreeMap::new(),
        }
    }

    /// Creates the finding of an error, with its remedy.
    fn failed(area: &'static str, name: impl Into<String>, error: &Error) -> Self {
        let text = error.to_string();
        let message = text.split("\n  → ").next().unwrap_or_default();
        let mut finding = Self::new(area, name, CheckStatus::Fail, message);
        finding.remedy = error.remedy_text().map(str::to_owned);
        finding
    }

    fn remedy(mut self, remedy: impl Into<String>) -> Self {
        self.remedy = Some(remedy.into());
        self
    }

    fn measurement(mut self, name: &'static str, value: f64) -> Self {
        self.measurements.insert(name, value);
        self
    }

    /// Turns a passed check into a warning.
    fn warn(mut self, remedy: impl Into<String>) -> Self {
        self.status = CheckStatus::Warn;
        self.remedy(remedy)
    }
}

/// Inputs of the checks.
#[derive(Debug)]
pub(crate) struct DoctorTarget {
    /// The rig; without one, only connected cameras are listed.
    pub(crate) rig: Option<RigFile>,
    /// Dataset directory, which need not exist.
    pub(crate) dataset: Option<PathBuf>,
    /// Model as in `collect`; empty for the default.
    pub(crate) model: String,
    /// Duration of the camera measurement.
    pub(crate) duration: Duration,
    /// Guard limits.
    pub(crate) guards: GuardLimits,
    /// Root of the device files.
    pub(crate) root: SystemRoot,
}

impl DoctorTarget {
    /// Runs all checks and reports each area to `on_progress`.
    ///
    /// # Errors
    /// For a rig file with unsupported settings. Problems of devices, disk and model are findings.
    pub(crate) fn examine(&self, on_progress: &dyn Fn(&'static str)) -> Result<Vec<Finding>> {
        on_progress("machine");
        let mut findings = machine::findings();
        on_progress("USB devices");
        findings.extend(usb::findings(&self.root, self.rig.as_ref()));
        if let Some(rig) = &self.rig {
            on_progress("cameras");
            findings.extend(self.rig_findings(rig)?);
        } else {
            let skipped = "no rig specified, so no camera was measured";
            findings.push(
                Finding::new("camera", "all", CheckStatus::Skipped, skipped)
                    .remedy("--rig NAME; `gripcast rig init` writes a rig file"),
            );
        }
        on_progress("disk");
        match &self.dataset {
            Some(dataset) => findings.extend(disk::findings(dataset, &self.guards)),
            None => findings.push(
                Finding::new("disk", "all", CheckStatus::Skipped, "no dataset specified")
                    .remedy("--dataset DIR"),
            ),
        }
        on_progress("model");
        findings.extend(model::findings(&self.model, self.rig.as_ref()));
        Ok(findings)
    }

    fn rig_findings(&self, rig: &RigFile) -> Result<Vec<Finding>> {
        let mut virtual_cameras = VirtualSource::new(1);
        let sources = RigSources::new(rig, &self.root, &mut virtual_cameras)?;
        let boards = match (&rig.boards, virtual_cameras.hand()) {
            (Some(boards), _) => Some(Boards::read(boards)),
            (None, Some(hand)) => Some(Boards::from_virtual_hand(hand)),
            (None, None) => None,
        };
        let clocks = machine::Clocks::now();
        let checks = check_cameras(sources.openers, &self.root, self.duration, None);
        let mut findings = vec![clocks.finding_since()];
        for check in &checks {
            let wanted = rig.cameras.get(&check.role);
            findings.extend(camera::findings(check, wanted, &self.guards));
        }
        for pedal in &rig.pedals {
            let name = format!("{:04x}:{:04x}", pedal.vendor, pedal.product);
            findings.push(match find_pedal(pedal) {
                Ok(product) => Finding::new("pedal", name, CheckStatus::Ok, product),
                // The keyboard works as well.
                Err(error) => Finding {
                    status: CheckStatus::Warn,
                    ..Finding::failed("pedal", name, &error)
                },
            });
        }
        findings.extend(board::findings(&checks, boards));
        Ok(findings)
    }
}
