//! Replays of a small dataset by a fake engine. One file, because all tests share dataset and
//! engine.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use serde_json::{Value, json};
use tempfile::TempDir;

use super::{
    Case, CaseStore, EngineSweep, Reality, Recording, ReplayInput, ReplayObject, ReplaySettings,
    Report, Setting, compare, load_objects, read_report, replay, sweep,
};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::{ObjectName, Root};
use gripcast_dataset::sample::{capture, meta, new_dataset};
use gripcast_dataset::{Dataset, DatasetWriter, GraspId, Outcome, PoseRecord};
use gripcast_geometry::{Pose, builtin, save_mesh};
use gripcast_sim::fem::GelPad;
use gripcast_sim::grasp::{GelForce, GraspOutcome, GraspResult, StageName, Trace, TraceStep};
use gripcast_sim::solver::PhaseTimes;
use gripcast_sim::{Engine, EngineKind, GraspSetup};
use gripcast_tactile::SensorProfile;

/// An engine with predictable outcomes: stable above a force that grows with the gripper's height.
#[derive(Debug)]
struct FakeEngine {
    kind: EngineKind,
    runs: AtomicUsize,
}

impl FakeEngine {
    fn new(kind: EngineKind) -> Arc<Self> {
        Arc::new(Self {
            kind,
            runs: AtomicUsize::new(0),
        })
    }
}

impl Engine for FakeEngine {
    fn kind(&self) -> EngineKind {
        self.kind
    }

    fn parameters(&self) -> Result<Value> {
        Ok(json!({"fake": true}))
    }

    fn pad(&self) -> GelPad {
        GelPad::default()
    }

    fn success_height_m(&self) -> f64 {
        0.02
    }

    fn simulate(&self, setup: &GraspSetup, friction: f64, force_n: f64) -> Result<GraspResult> {
        self.runs.fetch_add(1, Ordering::Relaxed);
        let height = (setup.t_world_object.inverse() * setup.t_world_gripper)
            .translation_m
            .z;
        if friction > 0.7 {
            return Err(Error::input("too sticky to compute"));
        }
        let is_stable = friction * force_n > 1e3 * height;
        let outcome = match (friction < 0.15, is_stable) {
            (true, _) => GraspOutcome::NotConverged,
            (_, true) => GraspOutcome::Success,
            (_, false) => GraspOutcome::Slip,
        };
        let step = |stage, t_s| TraceStep {
            stage,
            t_s,
            force: [GelForce {
                normal_n: force_n,
                ..GelForce::default()
            }; 2],
            t_world_object: setup.t_world_object,
            opening_m: setup.opening_m,
            lifted_m: 0.0,
            min_gap_m: [None; 2],
            solver: None,
        };
        Ok(GraspResult {
            outcome,
            detail: None,
            lifted_m: 0.0,
            friction_use: None,
            unconverged_steps: 0,
            times: PhaseTimes::default(),
            trace: Trace {
                steps: vec![
                    step(StageName::Closure, 0.01),
                    step(StageName::Adjustment, 0.02),
                    step(StageName::Lift, 0.03),
                ],
                snapshots: Vec::new(),
                lift_snapshots: Vec::new(),
                fields: None,
            },
        })
    }
}

fn pose(height_m: f64) -> PoseRecord {
    PoseRecord {
        t_m: [0.0, 0.0, height_m],
        q_wxyz: [0.0, 1.0, 0.0, 0.0],
        frame: "t_object_gripper".into(),
        covariance: Some(
            (0..36)
                .map(|i| if i % 7 == 0 { 1e-8 } else { 0.0 })
                .collect(),
        ),
        reprojection_px: None,
        corrected_by_hand: true,
        quality: None,
    }
}

/// A dataset of grasps: object, label, pose.
fn dataset(path: &Path, grasps: &[(&str, Outcome, Option<PoseRecord>)]) -> Vec<GraspId> {
    let (mut writer, _) = DatasetWriter::open_or_create(path, &new_dataset()).unwrap();
    let mut ids = Vec::new();
    for (index, (object, outcome, pose)) in grasps.iter().enumerate() {
        let number = 2 * index as u32;
        let initial = writer.save_initial(&capture(number), Vec::new()).unwrap();
        let grasp = writer.save_grasp(&initial, &capture(number + 1), meta(object));
        let id = grasp.unwrap().id;
        let at = capture(number + 1).captured_at;
        writer.set_outcome(&id, *outcome, at, None).unwrap();
        if let Some(pose) = pose {
            writer.set_pose(&id, pose.clone()).unwrap();
        }
        ids.push(id);
    }
    ids
}

fn objects(folder: &Path) -> BTreeMap<ObjectName, Result<ReplayObject>> {
    fs::create_dir_all(folder).unwrap();
    let write = |name: &str, text: &str| fs::write(folder.join(name), text).unwrap();
    write(
        "box.toml",
        "schema = 1\nmesh = \"builtin:box\"\nmass_kg = 0.06\nstable_pose = 0\n",
    );
    write(
        "mug.toml",
        "schema = 1\nmesh = \"builtin:mug\"\nmass_kg = 60\n",
    );
    write(
        "part.toml",
        "schema = 1\nmesh = \"part.stl\"\nmass_kg = 0.06\n",
    );
    load_objects(folder).unwrap()
}

struct Bench {
    folder: TempDir,
    dataset: Dataset,
    objects: BTreeMap<ObjectName, Result<ReplayObject>>,
    recording: Recording,
}

/// Four grasps of the box: at 4 mm and 12 mm above its middle, twice.
fn bench() -> Bench {
    use Outcome::{Slip, Stable};
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("data");
    let at = |height: f64| Some(pose(height));
    dataset(
        &path,
        &[
            ("box", Stable, at(0.004)),
            ("box", Slip, at(0.012)),
            ("box", Stable, at(0.005)),
            ("box", Slip, at(0.013)),
        ],
    );
    let dataset = Dataset::open(&path).unwrap();
    let objects = objects(&folder.path().join("objects"));
    let recording = Recording::read(&dataset, &objects, None).unwrap();
    Bench {
        dataset,
        objects,
        recording,
        folder,
    }
}

fn settings(engines: Vec<EngineSweep>) -> ReplaySettings {
    ReplaySettings {
        measured_forces: false,
        engines,
        seed: 1,
        jobs: 2,
        pose_samples: 0,
        sensor: SensorProfile::gelsight_mini().unwrap(),
        view_spp: None,
    }
}

fn engine(fake: &Arc<FakeEngine>, frictions: &[f64]) -> EngineSweep {
    EngineSweep {
        engine: fake.clone(),
        frictions: frictions.to_vec(),
        forces_n: vec![10.0, 20.0, 40.0],
    }
}

impl Bench {
    fn replay(&self, settings: &ReplaySettings) -> Report {
        let input = ReplayInput {
            dataset: &self.dataset,
            recording: &self.recording,
            objects: &self.objects,
            reality: Reality::Real,
            command: "gripcast replay".into(),
            written_at: "2026-11-20T00:00:00Z".into(),
        };
        let store = CaseStore::new(Root::new(self.folder.path()).top().join("cases"));
        replay(&input, settings, &store, &|_| {}).unwrap()
    }
}

#[test]
fn best_setting_is_chosen() {
    let fake = FakeEngine::new(EngineKind::Fem);
    let report = bench().replay(&settings(vec![engine(&fake, &[0.2, 0.4])]));
    let facts = &report.engines[0];
    // At friction 0.2, 4 mm is stable at 40 N (8) but not at 20 N (4); 12 mm never is.
    assert_eq!(facts.scores.friction, 0.2);
    assert_eq!(facts.scores.force_n["box"], 40.0);
    assert_eq!(
        (facts.scores.paper.all.agree, facts.scores.paper.all.n),
        (4, 4)
    );
    assert_eq!(report.objects[0].grasps, 4);
    assert_eq!(report.objects[0].stable, 2);
    let grasp = &report.grasps[0];
    assert_eq!(grasp.replays[0].agrees, Some(true));
    assert_eq!(grasp.replays[0].cells.len(), 6);
    assert!((grasp.pose_sd_m.unwrap()[0] - 1e-4).abs() < 1e-12);
    assert_eq!(grasp.replays[0].case.force_n, Some(40.0));
    assert_eq!(report.cost.cases, 24);
    assert!(report.left_out.is_empty());
}

#[test]
fn finished_cases_are_not_simulated_again() {
    let bench = bench();
    let fake = FakeEngine::new(EngineKind::Fem);
    let settings = settings(vec![engine(&fake, &[0.2])]);
    let first = bench.replay(&settings);
    assert_eq!(
        (fake.runs.load(Ordering::Relaxed), first.cost.simulated_now),
        (12, 12)
    );
    let second = bench.replay(&settings);
    assert_eq!(
        (fake.runs.load(Ordering::Relaxed), second.cost.simulated_now),
        (12, 0)
    );
    assert_eq!(first.grasps, second.grasps);
    // Truncated and exchanged cases are simulated again.
    let mut files = Vec::new();
    for folder in fs::read_dir(bench.folder.path().join("cases")).unwrap() {
        for file in fs::read_dir(folder.unwrap().path()).unwrap() {
            files.push(file.unwrap().path());
        }
    }
    assert_eq!(files.len(), 12);
    let text = fs::read(&files[0]).unwrap();
    fs::write(&files[0], &text[..text.len() / 2]).unwrap();
    fs::copy(&files[1], &files[2]).unwrap();
    let third = bench.replay(&settings);
    assert_eq!(third.cost.simulated_now, 2);
    assert_eq!(first.grasps.len(), third.grasps.len());
}

#[test]
fn results_are_independent_of_jobs() {
    let bench = bench();
    let fake = FakeEngine::new(EngineKind::Fem);
    let cases: Vec<Case<'_>> = bench
        .recording
        .grasps
        .iter()
        .flat_map(|grasp| {
            let object = bench.objects["box"].as_ref().unwrap();
            let fake = fake.as_ref();
            [0.2, 0.3, 0.4].map(move |friction| Case {
                engine: fake,
                setup: grasp.setup.clone(),
                object,
                setting: Setting {
                    friction,
                    force_n: 20.0,
                },
            })
        })
        .collect();
    let run = |jobs: usize| {
        let store = CaseStore::new(
            Root::new(bench.folder.path())
                .top()
                .join_number("cases-", jobs),
        );
        let records = sweep(&cases, &store, jobs, &|_| {}).unwrap().records;
        records
            .into_iter()
            .map(|record| (record.facts.outcome, record.curves))
            .collect::<Vec<_>>()
    };
    let one = run(1);
    assert!(one == run(2) && one == run(5));
}

#[test]
fn cases_without_outcome_are_counted_separately() {
    let fake = FakeEngine::new(EngineKind::Rigid);
    let report = bench().replay(&settings(vec![engine(&fake, &[0.1, 0.2, 0.8])]));
    assert_eq!(report.engines[0].scores.friction, 0.2);
    assert_eq!(report.engines[0].without_outcome, 0);
    // At 0.1 nothing converges, 0.8 is refused: six of nine settings.
    assert_eq!(report.left_out.len(), 4);
    let reason = &report.left_out[0].reason;
    assert!(
        reason.contains("rigid has no outcome at 6 of 9 settings"),
        "{reason}"
    );
    assert!(reason.contains("not_converged"), "{reason}");
    let cell = |friction: f64| {
        let cells = &report.engines[0].scores.cells;
        cells
            .iter()
            .find(|c| c.setting.friction == friction)
            .unwrap()
    };
    assert_eq!((cell(0.1).n, cell(0.1).without_outcome), (0, 4));
    let refused = report.grasps[0].replays[0].cells.last().unwrap();
    assert_eq!(
        (refused.outcome.as_str(), refused.agrees),
        ("refused", None)
    );
}

#[test]
fn engines_are_compared_in_pairs() {
    let (fem, rigid) = (
        FakeEngine::new(EngineKind::Fem),
        FakeEngine::new(EngineKind::Rigid),
    );
    let mut weak = engine(&rigid, &[0.2]);
    weak.forces_n = vec![10.0];
    let report = bench().replay(&settings(vec![engine(&fem, &[0.2]), weak]));
    let comparison = report.comparison.unwrap();
    // The weak engine always slips, which agrees with the two real slips.
    assert_eq!(
        (
            comparison.both,
            comparison.only_fem,
            comparison.only_rigid,
            comparison.neither
        ),
        (2, 2, 0, 0)
    );
    assert_eq!(comparison.mcnemar_p, 0.5);
}

#[test]
fn drawn_poses_have_the_covariance_and_are_reproducible() {
    let bench = bench();
    let fake = FakeEngine::new(EngineKind::Fem);
    let mut settings = settings(vec![engine(&fake, &[0.2])]);
    settings.pose_samples = 5;
    let report = bench.replay(&settings);
    let samples = report.grasps[0].replays[0].pose_samples.unwrap();
    // 8 N mm against 4 ± 0.1 mm.
    assert_eq!((samples.n, samples.stable), (5, 5));
    assert_eq!(report.cost.cases, 12 + 20);
    let grasp = &bench.recording.grasps[0];
    let drawn: Vec<GraspSetup> = (0..200)
        .map(|i| grasp.with_drawn_pose(1, i).unwrap())
        .collect();
    let again = grasp.with_drawn_pose(1, 3).unwrap();
    assert_eq!(again.t_world_gripper, drawn[3].t_world_gripper);
    let off = |setup: &GraspSetup| {
        setup.t_world_gripper.translation_m - grasp.setup.t_world_gripper.translation_m
    };
    let square: f64 = drawn.iter().map(|setup| off(setup).length_squared()).sum();
    let rms = (square / (3.0 * drawn.len() as f64)).sqrt();
    assert!((0.9e-4..1.1e-4).contains(&rms), "{rms}");
}

#[test]
fn excluded_grasps_have_a_reason() {
    use Outcome::{Slip, Stable, Unlabelled};
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("data");
    let mut elsewhere = pose(0.0);
    elsewhere.frame = "t_camera_gripper".into();
    let mut long = pose(0.0);
    long.q_wxyz = [2.0, 0.0, 0.0, 0.0];
    let ids = dataset(
        &path,
        &[
            ("box", Stable, Some(pose(0.0))),
            ("box", Unlabelled, Some(pose(0.0))),
            ("box", Slip, None),
            ("boxx", Slip, Some(pose(0.0))),
            ("box", Slip, Some(pose(4.0))),
            ("mug", Slip, Some(pose(0.0))),
            ("part", Slip, Some(pose(0.0))),
            ("box", Slip, Some(elsewhere)),
            ("box", Slip, Some(long)),
        ],
    );
    let objects = objects(&folder.path().join("objects"));
    let dataset = Dataset::open(&path).unwrap();
    let recording = Recording::read(&dataset, &objects, None).unwrap();
    assert_eq!(recording.grasps.len(), 1);
    assert_eq!(recording.grasps[0].record.id, ids[0]);
    let reasons: Vec<&str> = recording
        .left_out
        .iter()
        .map(|l| l.reason.as_str())
        .collect();
    let expected = [
        "no label",
        "gripcast annotate",
        "the nearest name is box",
        "t_m is in metres",
        "70 g are 0.070",
        "unit = \"mm\"",
        "t_camera_gripper",
        "unit quaternion",
    ];
    assert_eq!(reasons.len(), expected.len());
    for (reason, expected) in reasons.iter().zip(expected) {
        assert!(reason.contains(expected), "{reason}");
    }
    let only_mugs = Recording::read(&dataset, &objects, Some(&["mug".to_owned()])).unwrap();
    assert_eq!((only_mugs.grasps.len(), only_mugs.left_out.len()), (0, 1));
    let input = ReplayInput {
        dataset: &dataset,
        recording: &only_mugs,
        objects: &objects,
        reality: Reality::Real,
        command: String::new(),
        written_at: String::new(),
    };
    let fake = FakeEngine::new(EngineKind::Fem);
    let store = CaseStore::new(Root::new(folder.path()).top().join("cases"));
    let error = replay(
        &input,
        &settings(vec![engine(&fake, &[0.2])]),
        &store,
        &|_| {},
    );
    assert!(
        error
            .unwrap_err()
            .to_string()
            .contains("no grasp to replay")
    );
}

fn loaded(path: &Path) -> Result<ReplayObject> {
    let folder = Root::new(path.parent().unwrap());
    ReplayObject::load(&folder, &folder.entry(path))
}

#[test]
fn mesh_outside_of_the_folder_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    fs::create_dir_all(at("objects/sub")).unwrap();
    for name in ["secret.obj", "objects/own.obj", "objects/sub/own.obj"] {
        save_mesh(&at(name), &builtin("box").unwrap()).unwrap();
    }
    std::os::unix::fs::symlink("../secret.obj", at("objects/link.obj")).unwrap();
    std::os::unix::fs::symlink("..", at("objects/up")).unwrap();
    let load = |mesh: &str| {
        let text = format!("schema = 1\nmesh = {mesh:?}\nunit = \"m\"\nmass_kg = 0.06\n");
        fs::write(at("objects/box.toml"), text).unwrap();
        loaded(&at("objects/box.toml"))
    };
    let absolute = at("secret.obj");
    for mesh in [
        absolute.to_str().unwrap(),
        "../secret.obj",
        "sub/../../secret.obj",
    ] {
        let error = load(mesh).unwrap_err();
        let remedy = error.remedy_text().unwrap_or_default();
        assert!(
            remedy.contains("beside") && remedy.contains("LINKED_FOLDERS"),
            "{error}"
        );
    }
    for mesh in ["link.obj", "up/secret.obj"] {
        let error = load(mesh).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Input, "{error}");
        assert!(error.to_string().contains("leads out of"), "{error}");
    }
    for mesh in ["own.obj", "./own.obj", "sub/own.obj"] {
        assert!(load(mesh).is_ok(), "{mesh}");
    }
    // The object file itself.
    fs::rename(at("objects/box.toml"), at("box.toml")).unwrap();
    std::os::unix::fs::symlink("../box.toml", at("objects/box.toml")).unwrap();
    let objects = load_objects(&at("objects")).unwrap();
    assert_eq!(
        objects["box"].as_ref().unwrap_err().kind(),
        ErrorKind::Input
    );
}

#[test]
fn links_out_of_the_cases_are_not_followed_or_written() {
    let bench = bench();
    let cases = bench.folder.path().join("cases");
    let replay = || {
        let fake = FakeEngine::new(EngineKind::Fem);
        bench.replay(&settings(vec![engine(&fake, &[0.2])]))
    };
    let first = replay();
    let secret = bench.folder.path().join("secret");
    fs::write(&secret, "secret").unwrap();
    let mut linked = 0;
    for folder in fs::read_dir(&cases).unwrap() {
        for file in fs::read_dir(folder.unwrap().path()).unwrap() {
            let file = file.unwrap().path();
            fs::remove_file(&file).unwrap();
            std::os::unix::fs::symlink(&secret, &file).unwrap();
            linked += 1;
        }
    }
    assert!(linked > 0);
    let again = replay();
    assert_eq!(again.grasps.len(), first.grasps.len());
    assert_eq!(again.cost.simulated_now, first.cost.simulated_now);
    assert_eq!(fs::read(&secret).unwrap(), b"secret");
}

#[test]
fn changed_mesh_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("box.toml");
    let text = "schema = 1\nmesh = \"builtin:box\"\nmass_kg = 0.06\nmesh_sha256 = \"0123\"\n";
    fs::write(&path, text).unwrap();
    let error = loaded(&path).unwrap_err().to_string();
    assert!(error.contains("the mesh changed: expected 0123"), "{error}");
    let hash = builtin("box").unwrap().content_hash();
    fs::write(&path, text.replace("0123", &hash)).unwrap();
    let object = loaded(&path).unwrap();
    assert!((object.t_world_object(None).unwrap().translation_m.z - 0.03).abs() < 1e-9);
}

#[test]
fn object_pose_and_sheet_are_checked() {
    use gripcast_pose::PrintedSheet;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("box.toml");
    let base = "schema = 1\nmesh = \"builtin:box\"\nmass_kg = 0.06\n";
    let floating = "t_world_object = { t_m = [0, 0, 0.05], q_wxyz = [1, 0, 0, 0] }\n";
    fs::write(&path, format!("{base}{floating}")).unwrap();
    let error = loaded(&path).unwrap().t_world_object(None);
    let error = error.unwrap_err().to_string();
    assert!(error.contains("20.0 mm"), "{error}");

    let mut sheet = PrintedSheet {
        object: "builtin:box".into(),
        object_sha256: builtin("box").unwrap().content_hash(),
        paper: "A4".into(),
        printed_hash: "0".into(),
        measured_mm: [100.0; 2],
        t_world_object: Pose::from_translation(glam::DVec3::new(0.01, 0.02, 0.03)),
    };
    fs::write(&path, base).unwrap();
    let object = loaded(&path).unwrap();
    assert_eq!(
        object.t_world_object(Some(&sheet)).unwrap(),
        sheet.t_world_object
    );
    sheet.object_sha256 = "abc".into();
    let error = object.t_world_object(Some(&sheet)).unwrap_err().to_string();
    assert!(error.contains("drawn for another mesh"), "{error}");
    fs::write(&path, format!("{base}drawn_from_sha256 = \"abc\"\n")).unwrap();
    let object = loaded(&path).unwrap();
    assert!(object.t_world_object(Some(&sheet)).is_ok());
}

#[test]
fn report_reads_back_and_is_compared() {
    let bench = bench();
    let fake = FakeEngine::new(EngineKind::Fem);
    let old = bench.replay(&settings(vec![engine(&fake, &[0.2])]));
    let path = bench.folder.path().join("report.json");
    fs::write(&path, serde_json::to_vec(&old).unwrap()).unwrap();
    let old = read_report(&path).unwrap();
    let mut weak = engine(&fake, &[0.2]);
    weak.forces_n = vec![10.0];
    let new = bench.replay(&settings(vec![weak]));
    let changes = compare(&old, &new, &path);
    // Both stable grasps slip now.
    assert_eq!(changes.outcomes.len(), 2);
    assert_eq!(changes.outcomes[0].before, "success");
    assert_eq!(changes.outcomes[0].agrees, Some(false));
    assert_eq!(changes.scores["fem"], [Some(1.0), Some(0.5)]);
    assert_eq!(changes.conditions, ["settings of fem differ"]);
    assert!(changes.added.is_empty() && changes.removed.is_empty());

    let other = bench.folder.path().join("other.json");
    fs::write(&other, "{\"format\": \"x\", \"version\": 1}").unwrap();
    let error = read_report(&other).unwrap_err().to_string();
    assert!(error.contains("found x version 1"), "{error}");
    fs::write(&other, "[]").unwrap();
    assert!(read_report(&other).is_err());
}
