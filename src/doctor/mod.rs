//! What keeps a rig from collecting: every part looked at, each with a verdict and how to fix it.

mod board;
mod camera;
mod disk;
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

pub(crate) use usb::{access_text, crowding, plugged_cameras};

/// How good a thing is; the worst one last.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Verdict {
    /// Could not be looked at, with the reason; says nothing about it.
    Skipped,
    /// As it should be.
    Ok,
    /// It can be worked with.
    Warn,
    /// Collecting will not work, or data are in danger.
    Fail,
}

impl Verdict {
    /// The word for people.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Skipped => "skip",
            Self::Ok => "ok",
            Self::Warn => "warn",
            Self::Fail => "FAIL",
        }
    }
}

/// One thing that was looked at.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Finding {
    /// `machine`, `usb`, `camera`, `pedal`, `board`, `disk` or `model`.
    pub(crate) area: &'static str,
    /// What of it.
    pub(crate) name: String,
    pub(crate) verdict: Verdict,
    /// What was found, with what was expected where it differs.
    pub(crate) found: String,
    /// What helps.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) remedy: Option<String>,
    /// Numbers that were measured, the unit in the name.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub(crate) figures: BTreeMap<&'static str, f64>,
}

impl Finding {
    fn new(
        area: &'static str,
        name: impl Into<String>,
        verdict: Verdict,
        found: impl Into<String>,
    ) -> Self {
        Self {
            area,
            name: name.into(),
            verdict,
            found: found.into(),
            remedy: None,
            figures: BTreeMap::new(),
        }
    }

    /// Something that cannot be used, with the error's own remedy.
    fn failed(area: &'static str, name: impl Into<String>, error: &Error) -> Self {
        let text = error.to_string();
        let found = text.split("\n  → ").next().unwrap_or_default();
        let mut finding = Self::new(area, name, Verdict::Fail, found);
        finding.remedy = error.remedy_text().map(str::to_owned);
        finding
    }

    fn remedy(mut self, remedy: impl Into<String>) -> Self {
        self.remedy = Some(remedy.into());
        self
    }

    fn figure(mut self, name: &'static str, value: f64) -> Self {
        self.figures.insert(name, value);
        self
    }
}

/// What is looked at.
#[derive(Debug)]
pub(crate) struct Patient {
    /// The rig; without one only what is plugged in is listed.
    pub(crate) rig: Option<RigFile>,
    /// Folder of the dataset, which need not exist.
    pub(crate) dataset: Option<PathBuf>,
    /// Name of the model as `collect` takes it; empty for the usual one.
    pub(crate) model: String,
    /// How long cameras are measured.
    pub(crate) duration: Duration,
    /// What triggers are guarded by.
    pub(crate) guards: GuardLimits,
    /// Where devices are found.
    pub(crate) root: SystemRoot,
}

impl Patient {
    /// Looks at everything; `told` hears what is being looked at.
    ///
    /// # Errors
    /// When the rig file asks for what a source cannot do. What is wrong with devices, disk and
    /// model is a finding.
    pub(crate) fn examine(&self, on_progress: &dyn Fn(&'static str)) -> Result<Vec<Finding>> {
        on_progress("machine");
        let mut findings = machine::findings();
        on_progress("USB devices");
        findings.extend(usb::findings(&self.root, self.rig.as_ref()));
        if let Some(rig) = &self.rig {
            on_progress("cameras");
            findings.extend(self.of_rig(rig)?);
        } else {
            let skipped = "no rig was named, so no camera was measured";
            findings.push(
                Finding::new("camera", "all", Verdict::Skipped, skipped)
                    .remedy("--rig NAME; `gripcast rig init` writes a rig file"),
            );
        }
        on_progress("disk");
        match &self.dataset {
            Some(dataset) => findings.extend(disk::findings(dataset, &self.guards)),
            None => findings.push(
                Finding::new("disk", "all", Verdict::Skipped, "no dataset was named")
                    .remedy("--dataset DIR"),
            ),
        }
        on_progress("model");
        findings.extend(model::findings(&self.model, self.rig.as_ref()));
        Ok(findings)
    }

    fn of_rig(&self, rig: &RigFile) -> Result<Vec<Finding>> {
        let mut virtual_cameras = VirtualSource::new(1);
        let sources = RigSources::of(rig, &self.root, &mut virtual_cameras)?;
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
                Ok(product) => Finding::new("pedal", name, Verdict::Ok, product),
                // The keyboard does as well.
                Err(error) => Finding {
                    verdict: Verdict::Warn,
                    ..Finding::failed("pedal", name, &error)
                },
            });
        }
        findings.extend(board::findings(&checks, boards));
        Ok(findings)
    }
}
