//! Builds the demo data.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use super::images::DemoScene;
use super::object::{DemoObject, objects};
use super::plan::{DemoSettings, DemoStage, DemoWatch};
use super::recording::{Recorder, grasp_name};
use super::selection::{SelectedGrasp, select};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::Root;

/// Describes how this reality differs from its replay.
fn description(is_quick: bool) -> String {
    let meshes = if is_quick {
        "19 × 16 × 4 nodes (the replay's are 1 MPa, 0.3 and 13 × 11 × 3)"
    } else {
        "26 × 21 × 5 nodes (the replay's are 1 MPa, 0.3 and 19 × 16 × 4)"
    };
    format!(
        "gels of 0.435 MPa and Poisson's ratio 0.45 on a mesh of {meshes}, friction within 10 % of \
         0.4 and squeezing forces of 25 to 50 N, both unknown to the replay, a shorter hold and a \
         faster lift, other tactile sensors, and poses measured in rendered images"
    )
}

/// Paths of the demo data.
#[derive(Clone, Debug, PartialEq)]
pub struct DemoData {
    /// The dataset.
    pub dataset: PathBuf,
    /// The folder of object files.
    pub objects: PathBuf,
    /// How its reality differs from the default replay.
    pub description: String,
}

/// Builds the dataset `OUT/dataset` and the object files `OUT/objects`. Simulations are stored in
/// `OUT/simulated`, so an interrupted build can be resumed. Equal settings give identical bytes on
/// any number of threads.
///
/// # Errors
/// `Input` if the folder contains other grasps; `Stopped` once the watch is cancelled; `Io`,
/// `DiskFull`, ….
pub fn build_demo(settings: &DemoSettings, out: &Path, watch: &DemoWatch<'_>) -> Result<DemoData> {
    let all = objects(settings)?;
    fs::create_dir_all(out)
        .map_err(|e| Error::io("cannot create the folder", e).at(out.display()))?;
    let top = Root::new(out).top();
    let [dataset, object_files, simulated] =
        ["dataset", "objects", "simulated"].map(|name| top.join(name));
    for folder in [&object_files, &simulated] {
        folder
            .create_dir_all()
            .map_err(|e| Error::io("cannot create the folder", e).at(folder.display()))?;
    }
    let dataset = dataset.shown();
    for object in &all {
        object.save(&object_files)?;
    }
    let grasps = select(&all, settings, &simulated, watch)?;
    record(settings, &all, &grasps, &dataset, watch)?;
    Ok(DemoData {
        dataset,
        objects: object_files.shown(),
        description: description(settings.quick),
    })
}

/// Records the grasps.
fn record(
    settings: &DemoSettings,
    all: &[DemoObject],
    grasps: &[SelectedGrasp],
    dataset: &Path,
    watch: &DemoWatch<'_>,
) -> Result<()> {
    let recorder = Recorder::open(dataset, settings.seed, settings.quick)?;
    let names: BTreeSet<String> = grasps
        .iter()
        .map(|g| grasp_name(&all[g.object], g))
        .collect();
    if let Some(unexpected) = recorder.unexpected_grasp(&names) {
        let what = format!("the dataset contains `{unexpected}`, which is not part of this demo");
        return Err(Error::input(what)
            .at(dataset.display())
            .remedy("name an empty folder, or use the seed and size of the existing data"));
    }
    let scenes: Vec<DemoScene> = all
        .iter()
        .map(|object| DemoScene::new(object, settings.seed))
        .collect::<Result<_>>()?;
    let work = |grasp: &SelectedGrasp| {
        let index = grasp.object;
        recorder.record(&all[index], &scenes[index], grasp, watch)
    };
    watch.for_each(settings.jobs, DemoStage::Recording, grasps, &work)?;
    recorder.finish()
}
