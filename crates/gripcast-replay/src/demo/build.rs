//! Builds the demo data.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use super::images::Stand;
use super::object::{DemoObject, objects};
use super::plan::{DemoSettings, DemoStage, DemoWatch};
use super::recording::{Recorder, film};
use super::selection::{Chosen, choose};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::Root;

/// How this reality differs from its replay.
fn how(is_quick: bool) -> String {
    let meshes = if is_quick {
        "19 × 16 × 4 nodes (the replay's are 1 MPa, 0.3 and 13 × 11 × 3)"
    } else {
        "26 × 21 × 5 nodes (the replay's are 1 MPa, 0.3 and 19 × 16 × 4)"
    };
    format!(
        "gels of 0.435 MPa and Poisson's ratio 0.45 on a mesh of {meshes}, friction within 10 % of \
         0.4 and a squeeze between 25 and 50 N that the replay is not told, a shorter hold and a \
         faster lift, other tactile sensors, and poses that were measured in rendered images"
    )
}

/// Demo data that was built.
#[derive(Clone, Debug, PartialEq)]
pub struct DemoData {
    /// The dataset.
    pub dataset: PathBuf,
    /// The folder of object files.
    pub objects: PathBuf,
    /// One sentence: how its reality differs from the default replay.
    pub how: String,
}

/// Builds the dataset `OUT/dataset` and the object files `OUT/objects`; simulations are kept in
/// `OUT/simulated`, so that a build that was stopped goes on. The same settings give the same
/// bytes, on any number of threads.
///
/// # Errors
/// `Input` where the folder holds grasps of another plan; `Stopped` once the watch is cancelled;
/// `Io`, `DiskFull`, ….
pub fn build_demo(settings: &DemoSettings, out: &Path, watch: &DemoWatch<'_>) -> Result<DemoData> {
    let all = objects(settings)?;
    fs::create_dir_all(out)
        .map_err(|e| Error::io("cannot make the folder", e).at(out.display()))?;
    let top = Root::new(out).top();
    let [dataset, object_files, simulated] =
        ["dataset", "objects", "simulated"].map(|name| top.join(name));
    for folder in [&object_files, &simulated] {
        folder
            .create_dir_all()
            .map_err(|e| Error::io("cannot make the folder", e).at(folder.display()))?;
    }
    let dataset = dataset.shown();
    for object in &all {
        object.save(&object_files)?;
    }
    let grasps = choose(&all, settings, &simulated, watch)?;
    record(settings, &all, &grasps, &dataset, watch)?;
    Ok(DemoData {
        dataset,
        objects: object_files.shown(),
        how: how(settings.quick),
    })
}

/// Records the grasps.
fn record(
    settings: &DemoSettings,
    all: &[DemoObject],
    grasps: &[Chosen],
    dataset: &Path,
    watch: &DemoWatch<'_>,
) -> Result<()> {
    let recorder = Recorder::open(dataset, settings.seed, settings.quick)?;
    let names: BTreeSet<String> = grasps.iter().map(|g| film(&all[g.object], g)).collect();
    if let Some(foreign) = recorder.foreign(&names) {
        let what = format!("the dataset holds `{foreign}`, which is no grasp of this demo");
        return Err(Error::input(what)
            .at(dataset.display())
            .remedy("give an empty folder, or the seed and size that the data was begun with"));
    }
    let stands: Vec<Stand> = all
        .iter()
        .map(|object| Stand::new(object, settings.seed))
        .collect::<Result<_>>()?;
    let work = |chosen: &Chosen| {
        let at = chosen.object;
        recorder.record(&all[at], &stands[at], chosen, watch)
    };
    watch.for_each(settings.jobs, DemoStage::Recording, grasps, &work)?;
    recorder.finish()
}
