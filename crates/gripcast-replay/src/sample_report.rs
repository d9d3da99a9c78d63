//! A small report with all optional contents and hostile names.

use std::collections::BTreeMap;

use serde_json::json;

use super::report::{
    CaseFacts, CellScore, ChangedOutcome, Changes, Confusion, Cost, Curves, DatasetFacts,
    EngineComparison, EngineFacts, ExcludedGrasp, GraspCell, GraspFacts, GraspReplay, ImagePair,
    ObjectFacts, PoseSamples, Proportion, REPORT_FORMAT, REPORT_VERSION, Reality, Report, Score,
    Scores, Setting, TactilePair,
};

/// Part of every free string of the sample.
pub(super) const HOSTILE: &str = "<script>alert(\"1\")</script>&'\u{202e}";

/// A JPEG header of 8 × 6 px, enough to read the size.
pub(super) const IMAGE: &str = "data:image/jpeg;base64,/9j/wAALCAAGAAgBAREA";

const ENGINES: [&str; 2] = ["fem", "rigid"];
const FRICTIONS: [f64; 3] = [0.2, 0.4, 0.8];
const FORCES_N: [f64; 3] = [20.0, 40.0, 80.0];
const CHOSEN: Setting = Setting {
    friction: 0.4,
    force_n: 40.0,
};

fn hostile(word: &str) -> String {
    format!("{word} {HOSTILE}")
}

/// Two objects, two engines, six grasps (one without an outcome), and an excluded one.
pub(super) fn sample_report() -> Report {
    let objects = [hostile("box"), "ring".to_owned()];
    let grasp = |i: usize| grasp(i, &objects[i % 2]);
    Report {
        format: REPORT_FORMAT.to_owned(),
        version: REPORT_VERSION,
        software: hostile("gripcast 0.1.0"),
        written_at: hostile("2026-01-02T03:04:05Z"),
        command: hostile("gripcast replay"),
        seed: 7,
        dataset: DatasetFacts {
            name: hostile("demo"),
            path: hostile("/tmp"),
            sha256: hostile("0123456789ab"),
            grasps: 7,
            reality: Reality::Simulated {
                description: hostile("finer gel mesh"),
            },
        },
        objects: objects.iter().map(|name| object(name)).collect(),
        engines: ENGINES.map(|name| engine(name, &objects)).to_vec(),
        comparison: Some(EngineComparison {
            both: 3,
            only_fem: 2,
            only_rigid: 0,
            neither: 0,
            mcnemar_p: 0.5,
            leave_one_out: [2, 1],
            leave_one_out_p: 1.0,
        }),
        grasps: (0..6).map(grasp).collect(),
        left_out: vec![ExcludedGrasp {
            grasp: hostile("g6"),
            object: hostile("box"),
            reason: hostile("no pose: annotate it"),
        }],
        cost: Cost {
            cases: 108,
            simulated_now: 100,
            wall_s: 61.0,
            jobs: 2,
            cpu_s: ENGINES.map(|name| (name.to_owned(), 50.0)).into(),
            processor: hostile("processor"),
        },
        changes: Some(changes()),
    }
}

fn object(name: &str) -> ObjectFacts {
    ObjectFacts {
        name: name.to_owned(),
        mesh: hostile("mesh.obj"),
        mesh_sha256: hostile("ab"),
        triangles: 12,
        size_m: [0.03, 0.04, 0.05],
        mass_kg: 0.07,
        grasps: 3,
        stable: 2,
        image: Some(IMAGE.to_owned()),
    }
}

fn proportion(agree: usize, n: usize) -> Proportion {
    let fraction = if n == 0 { 0.0 } else { agree as f64 / n as f64 };
    Proportion {
        agree,
        n,
        fraction,
        low: 0.8 * fraction,
        high: 0.5 + 0.5 * fraction,
    }
}

fn engine(name: &str, objects: &[String]) -> EngineFacts {
    let score = |agree: usize| Score {
        all: proportion(2 * agree, 6),
        mean: agree as f64 / 3.0,
        by_object: by_object(objects, proportion(agree, 3)),
    };
    let agree = if name == "fem" { 3 } else { 2 };
    EngineFacts {
        name: name.to_owned(),
        frictions: FRICTIONS.to_vec(),
        forces_n: FORCES_N.to_vec(),
        parameters: json!({ "note": hostile("text"), "dt_s": 0.01 }),
        scores: Scores {
            paper: score(agree),
            leave_one_out: score(agree - 1),
            one_setting: score(agree - 1),
            leave_object_out: score(0),
            friction: CHOSEN.friction,
            force_n: by_object(objects, CHOSEN.force_n),
            best_setting: Setting {
                friction: 0.8,
                force_n: 20.0,
            },
            confusion: Confusion {
                true_stable: 3,
                false_stable: 1,
                true_slip: 2,
                false_slip: 0,
            },
            cells: objects.iter().flat_map(|object| cells(object)).collect(),
        },
        without_outcome: usize::from(name == "fem"),
    }
}

fn by_object<T: Copy>(objects: &[String], value: T) -> BTreeMap<String, T> {
    objects.iter().map(|name| (name.clone(), value)).collect()
}

fn settings() -> impl Iterator<Item = Setting> {
    let of = |friction| FORCES_N.map(|force_n| Setting { friction, force_n });
    FRICTIONS.into_iter().flat_map(of)
}

fn cells(object: &str) -> Vec<CellScore> {
    let cell = |(i, setting): (usize, Setting)| CellScore {
        object: object.to_owned(),
        setting,
        agree: i % 4,
        n: 3,
        without_outcome: i % 2,
    };
    settings().enumerate().map(cell).collect()
}

fn grasp(i: usize, object: &str) -> GraspFacts {
    let has_images = i != 5;
    GraspFacts {
        id: hostile(&format!("g{i}")),
        object: object.to_owned(),
        stable: !i.is_multiple_of(4),
        t_object_gripper: [0.01, -0.002, 0.03, 1.0, 0.0, 0.0, 0.0],
        pose_sd_m: has_images.then_some([1e-4; 3]),
        pose_sd_rad: has_images.then_some([1e-3; 3]),
        replays: ENGINES.map(|engine| replay(i, engine)).to_vec(),
        view: has_images.then(images),
        tactile: if has_images {
            ["left", &hostile("right")].map(tactile).to_vec()
        } else {
            Vec::new()
        },
    }
}

fn images() -> ImagePair {
    ImagePair {
        real: IMAGE.to_owned(),
        sim: IMAGE.to_owned(),
    }
}

fn tactile(sensor: &str) -> TactilePair {
    TactilePair {
        sensor: sensor.to_owned(),
        images: images(),
        difference: IMAGE.to_owned(),
        contact_iou: Some(0.81),
        fve: Some(0.9),
        psnr_db: Some(27.0),
        l1: None,
    }
}

/// Grasp 2 disagrees in the rigid engine, grasp 3 in both; grasp 4 has no outcome with finite
/// elements.
fn replay(i: usize, engine: &str) -> GraspReplay {
    let agrees = match (i, engine) {
        (2, "rigid") | (3, _) => Some(false),
        (4, "fem") => None,
        _ => Some(true),
    };
    let outcome = match agrees {
        None => "not_converged".to_owned(),
        Some(false) => hostile("slip"),
        Some(true) => "success".to_owned(),
    };
    GraspReplay {
        engine: engine.to_owned(),
        chosen: CHOSEN,
        case: CaseFacts {
            outcome: outcome.clone(),
            detail: (i == 4).then(|| hostile("step 12")),
            min_height_m: 0.0481,
            lifted_m: 0.05,
            force_n: (i != 4).then_some(40.2),
            steps: 417,
            newton_iterations: if engine == "fem" { 586 } else { 0 },
            unconverged_steps: 0,
            cpu_s: 3.2,
        },
        agrees,
        cells: settings()
            .map(|setting| GraspCell {
                setting,
                outcome: outcome.clone(),
                agrees,
            })
            .collect(),
        disagreement: if agrees == Some(false) {
            0.3 * i as f64
        } else {
            0.0
        },
        pose_samples: (i == 3).then_some(PoseSamples { n: 10, stable: 7 }),
        curves: (i != 5).then(|| curves(i)),
    }
}

/// Grasp 0 has no points, grasp 1 a single one.
fn curves(i: usize) -> Curves {
    let points = [0, 1].get(i).copied().unwrap_or(50);
    let times: Vec<f64> = (0..points).map(|k| 0.1 * f64::from(k)).collect();
    let rise = |t: &f64| 0.02 * (t - 2.0).max(0.0);
    Curves {
        left_n: times.iter().map(|t| 40.0 * t.min(1.0)).collect(),
        right_n: times.iter().map(|t| 41.0 * t.min(1.0)).collect(),
        lifted_m: times.iter().map(rise).collect(),
        min_height_m: times.iter().map(rise).collect(),
        t_s: times,
        stages_s: [1.0, 2.0],
        success_height_m: 0.02,
    }
}

fn changes() -> Changes {
    Changes {
        path: hostile("old.json"),
        software: hostile("gripcast 0.0.9"),
        scores: [
            ("fem".to_owned(), [Some(0.9), Some(1.0)]),
            (hostile("x"), [None, None]),
        ]
        .into(),
        outcomes: vec![ChangedOutcome {
            grasp: hostile("g1"),
            object: hostile("box"),
            engine: hostile("x"),
            before: hostile("slip"),
            after: "success".to_owned(),
            agrees: Some(true),
        }],
        added: vec![hostile("g2")],
        removed: vec![hostile("g9")],
        conditions: vec![hostile("friction")],
    }
}
