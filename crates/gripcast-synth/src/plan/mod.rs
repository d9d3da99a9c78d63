//! Plans: objects, grasps, forces and seeds, fixed before any simulation runs.
//!
//! A plan is a folder with `plan.jsonl` (one JSON object per line: the header, the objects, the
//! simulations) and `plan.sha256`. Meshes and textures are stored beside it, in `meshes/` and
//! `textures/`, so that the folder can be moved to another machine; results go to `results/`.

mod acronym;
mod draft;
mod file;
mod make;
mod preset;
mod shard;
mod table;
mod texture;

use serde::{Deserialize, Serialize};
use serde_json::Value;

pub(super) use file::replace;

pub use acronym::acronym_drafts;
pub use draft::{Drafts, LeftOutObject, ObjectDraft};
pub use file::{HASH_FILE, PLAN_FILE, PLAN_FORMAT, PLAN_VERSION, Plan};
pub use make::{MIN_FRICTION_FRACTION, PlanBundle, PlanSettings, check_parameters, make_plan};
pub use preset::{PlanPreset, family_drafts};
pub use shard::{INDEX_VARIABLES, Shard};
pub use table::table_drafts;
pub use texture::{ImageTexture, TextureDraft, load_textures};

use super::grasp::GraspFault;
use super::properties::{DescribedAppearance, PropertySource};
use gripcast_base::error::Result;
use gripcast_base::files::{FileName, SimulationId};
use gripcast_geometry::Pose;
use gripcast_sim::EngineKind;
use gripcast_tactile::SensorName;

/// Folder of the meshes inside the plan's folder.
pub(super) const MESHES: &str = "meshes";
/// Folder of the textures inside the plan's folder.
pub(super) const TEXTURES: &str = "textures";

/// Header of a plan: what all its simulations share.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlanHeader {
    /// [`PLAN_FORMAT`].
    pub format: String,
    /// [`PLAN_VERSION`].
    pub version: u32,
    /// `gripcast <version>` that created it.
    pub software: String,
    /// Name of the preset it is based on.
    pub preset: String,
    /// Random seed.
    pub seed: u64,
    /// Simulator.
    pub engine: EngineKind,
    /// All its parameters except friction and force.
    pub parameters: Value,
    /// How images are rendered from a simulation.
    pub rendering: RenderingPlan,
    /// What the friction of an object follows from.
    #[serde(default, skip_serializing_if = "FrictionFrom::is_soiled")]
    pub friction_from: FrictionFrom,
}

/// What the friction between gel and object follows from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FrictionFrom {
    /// The material and its contamination, which no image shows: each object keeps a random
    /// fraction of its clean friction.
    #[default]
    Soiled,
    /// Category and appearance alone, as in the paper (A.1). A simulation has one of the object's
    /// appearances in all its renderings, and the friction of that.
    Material,
}

impl FrictionFrom {
    /// Name in files and flags.
    pub fn name(self) -> &'static str {
        match self {
            Self::Soiled => "soiled",
            Self::Material => "material",
        }
    }

    fn is_soiled(&self) -> bool {
        *self == Self::Soiled
    }
}

/// How images are rendered from a simulation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RenderingPlan {
    /// Renderings of each simulation, each with other light, ground, camera, appearance and
    /// sensors.
    pub renderings: u32,
    /// Samples per pixel (spp) of the colour images.
    #[serde(rename = "samples")]
    pub samples_per_pixel: u32,
    /// Spread of the tactile sensors: 0 is the shipped profile, 1 the spread between real sensors.
    pub sensor_spread: f64,
    /// Spread of the colour camera's pose and lens and of the light's brightness: 0 is nominal, 1
    /// the default.
    #[serde(default = "default_spread", skip_serializing_if = "is_default_spread")]
    pub visual_spread: f64,
    /// Tactile sensor.
    #[serde(default = "default_sensor", skip_serializing_if = "is_default_sensor")]
    pub sensor: SensorName,
}

fn default_sensor() -> SensorName {
    SensorName::GELSIGHT_MINI
}

fn is_default_sensor(sensor: &SensorName) -> bool {
    *sensor == default_sensor()
}

fn default_spread() -> f64 {
    1.0
}

fn is_default_spread(spread: &f64) -> bool {
    *spread == default_spread()
}

/// Source of an object's mesh.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "from", rename_all = "snake_case", deny_unknown_fields)]
pub enum MeshSource {
    /// A built-in family.
    Family {
        /// Category of the family.
        category: String,
        /// Seed of the shape.
        seed: u64,
    },
    /// A file in the plan's folder `meshes`: binary PLY, metres, ready for simulation.
    File {
        /// File name.
        file: FileName,
    },
}

impl MeshSource {
    /// Source of a mesh that is stored under its object's name.
    ///
    /// # Errors
    /// None for a valid object name.
    pub(super) fn stored(object: &SimulationId) -> Result<Self> {
        let file = FileName::parse(&format!("{object}.ply"))?;
        Ok(Self::File { file })
    }
}

/// An object of a plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlannedObject {
    /// Name: a key and the start of file names.
    pub name: SimulationId,
    /// Category, for instance `mug`.
    pub category: String,
    /// Source of the mesh.
    pub mesh: MeshSource,
    /// [`gripcast_geometry::TriangleMesh::content_hash`] of the mesh in metres.
    pub mesh_sha256: String,
    /// Material name.
    pub material: String,
    /// Mass, kg.
    pub mass_kg: f64,
    /// Coulomb friction coefficient between gel and object; the mean over its appearances where
    /// simulations have [their own](PlannedSimulation::friction).
    pub friction: f64,
    /// Source of mass and friction.
    pub properties: PropertySource,
    /// Appearances it may have.
    #[serde(rename = "looks")]
    pub appearances: Vec<DescribedAppearance>,
    /// Textures it may have.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub textures: Vec<ImageTexture>,
}

/// A simulation of a plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlannedSimulation {
    /// `<object>-<grasp>-<force>n`: a key and a file name.
    pub id: SimulationId,
    /// Name of the object.
    pub object: SimulationId,
    /// Number of the grasp on its object.
    pub grasp: u32,
    /// Deviation from an antipodal grasp; none for a given grasp.
    pub fault: Option<GraspFault>,
    /// Index of a given grasp in its file of ACRONYM.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub acronym_grasp: Option<u32>,
    /// Outcome of a given grasp in ACRONYM's simulator FleX, with its own mass and friction.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub acronym_stable: Option<bool>,
    /// Simulator.
    pub engine: EngineKind,
    /// Stopping force of finite elements, closing force of rigid bodies, N.
    pub stop_force_n: f64,
    /// Pose of the object on the ground z = 0.
    pub t_world_object: Pose,
    /// Pose of the gripper before the fingers close.
    pub t_world_gripper: Pose,
    /// Distance between the gels' faces at the start, m.
    pub opening_m: f64,
    /// Seed of its images, below 2⁵³ so that every JSON reader preserves it.
    pub seed: u64,
    /// Index of the appearance that all renderings show: among the object's appearances, then its
    /// textures. None where each rendering draws one.
    #[serde(rename = "look", default, skip_serializing_if = "Option::is_none")]
    pub appearance: Option<u32>,
    /// Coulomb friction coefficient of that appearance; none where the object has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub friction: Option<f64>,
    /// Estimated CPU time, s.
    pub cost_s: f64,
}

impl PlannedSimulation {
    /// Coulomb friction coefficient between gel and `object`, which is that of the simulation.
    pub fn friction_on(&self, object: &PlannedObject) -> f64 {
        self.friction.unwrap_or(object.friction)
    }
}

/// Returns a plan of `count` simulations of two objects with different costs.
#[cfg(test)]
pub(crate) fn sample_plan(count: usize) -> Plan {
    tests::plan(count)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use glam::DVec3;

    use super::*;
    use gripcast_base::error::ErrorKind;
    use gripcast_base::files::{Label, Root};

    fn object(name: &str) -> PlannedObject {
        PlannedObject {
            name: SimulationId::parse(name).unwrap(),
            category: "box".to_owned(),
            mesh: MeshSource::Family {
                category: "box".to_owned(),
                seed: 7,
            },
            mesh_sha256: "00".to_owned(),
            material: "wood".to_owned(),
            mass_kg: 0.05,
            friction: 0.4,
            properties: PropertySource::Table,
            appearances: Vec::new(),
            textures: Vec::new(),
        }
    }

    fn simulation(number: usize) -> PlannedSimulation {
        let object = ["box-0000", "box-0001"][number % 2];
        PlannedSimulation {
            id: SimulationId::parse(&format!("{object}-{number:02}-10n")).unwrap(),
            object: SimulationId::parse(object).unwrap(),
            grasp: number as u32,
            fault: Some(GraspFault::Roll),
            acronym_grasp: None,
            acronym_stable: None,
            engine: EngineKind::Fem,
            stop_force_n: 10.0,
            t_world_object: Pose::IDENTITY,
            t_world_gripper: Pose::from_translation(DVec3::Z * 0.04),
            opening_m: 0.05,
            seed: number as u64,
            appearance: None,
            friction: None,
            cost_s: 1.0 + (number % 7) as f64,
        }
    }

    pub(super) fn plan(count: usize) -> Plan {
        let header = PlanHeader {
            format: PLAN_FORMAT.to_owned(),
            version: PLAN_VERSION,
            software: "gripcast 0".to_owned(),
            preset: "tiny".to_owned(),
            seed: 3,
            engine: EngineKind::Fem,
            parameters: serde_json::json!({"preset": "paper"}),
            rendering: RenderingPlan {
                renderings: 3,
                samples_per_pixel: 8,
                sensor_spread: 1.0,
                visual_spread: 1.0,
                sensor: SensorName::GELSIGHT_MINI,
            },
            friction_from: FrictionFrom::Soiled,
        };
        let objects = ["box-0000", "box-0001"].map(object).to_vec();
        Plan::new(header, objects, (0..count).map(simulation).collect()).unwrap()
    }

    #[test]
    fn plan_reads_back_and_is_never_replaced() {
        let folder = tempfile::tempdir().unwrap();
        plan(5).write(&Root::new(folder.path())).unwrap();
        assert_eq!(Plan::read(folder.path()).unwrap(), plan(5));
        plan(5).write(&Root::new(folder.path())).unwrap();
        let other = plan(6).write(&Root::new(folder.path())).unwrap_err();
        assert_eq!(other.kind(), ErrorKind::Input);
        assert_eq!(Plan::read(folder.path()).unwrap(), plan(5));
        assert_ne!(plan(5).sha256, plan(6).sha256);
    }

    #[test]
    fn default_visual_spread_and_sensor_are_not_serialised() {
        let mut rendering = plan(0).header.rendering;
        let text = serde_json::to_string(&rendering).unwrap();
        assert!(
            !text.contains("visual_spread") && !text.contains("gelsight"),
            "{text}"
        );
        assert_eq!(
            serde_json::from_str::<RenderingPlan>(&text).unwrap(),
            rendering
        );
        rendering.visual_spread = 2.0;
        rendering.sensor = SensorName::by_name("gelsight-mini-markers").unwrap();
        let text = serde_json::to_string(&rendering).unwrap();
        assert_eq!(
            serde_json::from_str::<RenderingPlan>(&text).unwrap(),
            rendering
        );
    }

    #[test]
    fn altered_plan_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        plan(5).write(&Root::new(folder.path())).unwrap();
        let path = folder.path().join(PLAN_FILE);
        let text = fs::read_to_string(&path).unwrap();
        let check = |text: String, words: &str| {
            fs::write(&path, text).unwrap();
            let error = Plan::read(folder.path()).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        };
        check(text.replace("0.4,", "0.9,"), "was altered");
        fs::write(&path, &text).unwrap();
        fs::remove_file(folder.path().join(HASH_FILE)).unwrap();
        assert!(Plan::read(folder.path()).is_err());
        assert!(Plan::read(&folder.path().join("nothing")).is_err());
    }

    /// The text of a small plan with a stored mesh and an image.
    fn stored_plan() -> String {
        let Plan {
            header,
            mut objects,
            simulations,
            ..
        } = plan(2);
        for object in objects.values_mut() {
            object.mesh = MeshSource::stored(&object.name).unwrap();
            object.textures = vec![ImageTexture {
                file: FileName::parse("0123456789ab.png").unwrap(),
                name: Label::nearest("label"),
                sha256: String::new(),
                width_m: 0.1,
            }];
        }
        let objects = objects.into_values().collect();
        let folder = tempfile::tempdir().unwrap();
        let plan = Plan::new(header, objects, simulations).unwrap();
        plan.write(&Root::new(folder.path())).unwrap();
        fs::read_to_string(folder.path().join(PLAN_FILE)).unwrap()
    }

    #[test]
    fn plan_with_paths_as_names_is_refused() {
        let text = stored_plan();
        assert!(Plan::from_bytes(text.as_bytes()).is_ok());
        for (key, valid) in [
            ("id", "box-0001-01-10n"),
            ("object", "box-0001"),
            ("name", "box-0001"),
            ("file", "box-0001.ply"),
            ("file", "0123456789ab.png"),
        ] {
            for hostile in ["../../x", "/tmp/x", "a/b", "..", ".x", "", "a\u{1b}[2J"] {
                let from = format!("\"{key}\":\"{valid}\"");
                let to = format!("\"{key}\":{}", serde_json::to_string(hostile).unwrap());
                assert!(text.contains(&from), "{from}");
                let error = Plan::from_bytes(text.replace(&from, &to).as_bytes()).unwrap_err();
                assert!(error.to_string().contains("invalid"), "{to}: {error}");
            }
        }
    }

    #[test]
    fn plan_with_mesh_paths_has_a_remedy() {
        let text = stored_plan().replace("\"file\":\"box-0000.ply\"", "\"path\":\"/x.obj\"");
        let error = Plan::from_bytes(text.as_bytes()).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Input, "{error}");
        let remedy = error.remedy_text().unwrap();
        assert!(remedy.contains("the same flags"), "{remedy}");
    }

    #[test]
    fn plan_of_families_keeps_its_hash() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../models/plans/train-fem");
        let plan = Plan::read(std::path::Path::new(folder)).unwrap();
        assert_eq!(
            plan.sha256,
            Plan::new(
                plan.header.clone(),
                plan.objects.values().cloned().collect(),
                plan.simulations.clone(),
            )
            .unwrap()
            .sha256
        );
    }

    #[test]
    fn links_out_of_the_folder_are_not_read_or_written() {
        use std::os::unix::fs::symlink;
        let dir = tempfile::tempdir().unwrap();
        let [folder, secret] = ["plan", "secret"].map(|name| dir.path().join(name));
        fs::create_dir(&folder).unwrap();
        let root = Root::new(&folder);
        plan(2).write(&root).unwrap();
        for name in [PLAN_FILE, HASH_FILE] {
            let path = folder.join(name);
            fs::rename(&path, &secret).unwrap();
            let kept = fs::read(&secret).unwrap();
            symlink(&secret, &path).unwrap();
            let error = Plan::read(&folder).unwrap_err();
            assert_eq!(error.kind(), ErrorKind::Input, "{error}");
            let _ = plan(2).write(&root);
            assert_eq!(fs::read(&secret).unwrap(), kept, "{name}");
            fs::remove_file(&path).unwrap();
            plan(2).write(&root).unwrap();
        }
    }

    #[test]
    fn contradictory_plans_are_refused() {
        let mut twice = plan(2).simulations;
        twice.push(twice[0].clone());
        let objects = || plan(0).objects.into_values().collect::<Vec<_>>();
        let error = Plan::new(plan(0).header, objects(), twice).unwrap_err();
        assert!(error.to_string().contains("two simulations"));
        let error = Plan::new(plan(0).header, Vec::new(), plan(1).simulations).unwrap_err();
        assert!(error.to_string().contains("unknown object"));
    }
}
