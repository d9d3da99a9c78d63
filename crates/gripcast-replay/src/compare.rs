//! Compares a report with an earlier one.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use serde::Deserialize;

use super::report::{
    ChangedOutcome, Changes, EngineFacts, GraspFacts, GraspReplay, REPORT_FORMAT, REPORT_VERSION,
    Report,
};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{FileKind, read_regular};

/// Reads a report.
///
/// # Errors
/// I/O errors; `Input` for an invalid file or another version.
pub fn read_report(path: &Path) -> Result<Report> {
    #[derive(Deserialize)]
    struct Head {
        format: String,
        version: u32,
    }
    let invalid = |what: String| {
        Error::input(what)
            .at(path.display())
            .remedy("name the report.json of an earlier `gripcast replay`")
    };
    let bytes = read_regular(path, FileKind::Mesh)
        .map_err(|e| Error::io("cannot read the report", e).at(path.display()))?;
    let head: Head = serde_json::from_slice(&bytes)
        .map_err(|e| invalid("not a replay report".to_owned()).because(e))?;
    if head.format != REPORT_FORMAT || head.version != REPORT_VERSION {
        return Err(invalid(format!(
            "expected {REPORT_FORMAT} version {REPORT_VERSION}, found {} version {}",
            head.format, head.version
        )));
    }
    serde_json::from_slice(&bytes)
        .map_err(|e| invalid("invalid replay report".to_owned()).because(e))
}

/// Lists the changes in `new`; `path` is the file of the old report.
pub fn compare(old: &Report, new: &Report, path: &Path) -> Changes {
    let ids = |report: &Report| -> BTreeSet<String> {
        report.grasps.iter().map(|g| g.id.clone()).collect()
    };
    let (before, after) = (ids(old), ids(new));
    Changes {
        path: path.display().to_string(),
        software: old.software.clone(),
        scores: scores(old, new),
        outcomes: outcomes(old, new),
        added: after.difference(&before).cloned().collect(),
        removed: before.difference(&after).cloned().collect(),
        conditions: conditions(old, new),
    }
}

fn engine<'a>(report: &'a Report, name: &str) -> Option<&'a EngineFacts> {
    report.engines.iter().find(|engine| engine.name == name)
}

fn scores(old: &Report, new: &Report) -> BTreeMap<String, [Option<f64>; 2]> {
    let names = old.engines.iter().chain(&new.engines).map(|e| &e.name);
    let fraction = |report, name: &str| engine(report, name).map(|e| e.scores.paper.all.fraction);
    names
        .map(|name| (name.clone(), [fraction(old, name), fraction(new, name)]))
        .collect()
}

fn outcomes(old: &Report, new: &Report) -> Vec<ChangedOutcome> {
    let before: BTreeMap<&str, &GraspFacts> =
        old.grasps.iter().map(|g| (g.id.as_str(), g)).collect();
    let mut changed = Vec::new();
    for grasp in &new.grasps {
        let Some(old) = before.get(grasp.id.as_str()) else {
            continue;
        };
        for now in &grasp.replays {
            let same_engine = |r: &&GraspReplay| r.engine == now.engine;
            let Some(old) = old.replays.iter().find(same_engine) else {
                continue;
            };
            if old.case.outcome != now.case.outcome {
                changed.push(ChangedOutcome {
                    grasp: grasp.id.clone(),
                    object: grasp.object.clone(),
                    engine: now.engine.clone(),
                    before: old.case.outcome.clone(),
                    after: now.case.outcome.clone(),
                    agrees: now.agrees,
                });
            }
        }
    }
    changed
}

/// Describes differences of the conditions other than the software.
fn conditions(old: &Report, new: &Report) -> Vec<String> {
    let mut found = Vec::new();
    if old.seed != new.seed {
        found.push(format!("seed changed from {} to {}", old.seed, new.seed));
    }
    if old.dataset.sha256 != new.dataset.sha256 {
        found.push(format!(
            "records changed from {} to {}",
            old.dataset.sha256, new.dataset.sha256
        ));
    }
    for now in &new.engines {
        match engine(old, &now.name) {
            None => found.push(format!("engine {} is new", now.name)),
            Some(was) => {
                if was.parameters != now.parameters {
                    found.push(format!("parameters of {} differ", now.name));
                }
                if was.frictions != now.frictions || was.forces_n != now.forces_n {
                    found.push(format!("settings of {} differ", now.name));
                }
            }
        }
    }
    for was in &old.engines {
        if engine(new, &was.name).is_none() {
            found.push(format!("engine {} was removed", was.name));
        }
    }
    for now in &new.objects {
        let was = old.objects.iter().find(|was| was.name == now.name);
        if was.is_some_and(|was| was.mesh_sha256 != now.mesh_sha256) {
            found.push(format!("{} has another mesh", now.name));
        }
        if let Some(was) = was.filter(|was| was.mass_kg != now.mass_kg) {
            found.push(format!(
                "mass of {} changed from {} kg to {} kg",
                now.name, was.mass_kg, now.mass_kg
            ));
        }
    }
    found
}
