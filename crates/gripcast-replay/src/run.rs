//! The complete replay: cases, scores, drawn poses, images and report.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use super::camera_view::{ViewSettings, object_image, view_pair};
use super::case::{Case, CaseRecord, CaseStore};
use super::object_file::ReplayObject;
use super::recording::{MeasuredForce, RecordedGrasp, Recording};
use super::report::{
    Cost, DatasetFacts, EngineComparison, EngineFacts, ExcludedGrasp, GraspCell, GraspFacts,
    GraspReplay, ImagePair, ObjectFacts, PoseSamples, REPORT_FORMAT, REPORT_VERSION, Reality,
    Report, Setting, TactilePair,
};
use super::score::{OutcomeTable, Scoring};
use super::sweep::{SweepProgress, sweep};
use super::tactile_pair::tactile_pairs;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{FileKind, ObjectName, read_text};
use gripcast_base::statistics::mcnemar_p;
use gripcast_base::workers::{cores, par_map_single_threaded};
use gripcast_dataset::Dataset;
use gripcast_sim::grasp::StageName;
use gripcast_sim::{Engine, EngineKind};
use gripcast_tactile::{ObjectDepthRenderer, SensorProfile, SimulatedGel};

/// An engine and its settings.
#[derive(Clone)]
pub struct EngineSweep {
    /// The engine.
    pub engine: Arc<dyn Engine>,
    /// Friction coefficients.
    pub frictions: Vec<f64>,
    /// Forces, N.
    pub forces_n: Vec<f64>,
}

/// Settings of a replay.
#[derive(Clone)]
pub struct ReplaySettings {
    /// Engines in the order of the tables.
    pub engines: Vec<EngineSweep>,
    /// Seed of drawn poses and of images.
    pub seed: u64,
    /// Cases in parallel.
    pub jobs: usize,
    /// Number of poses drawn from each covariance, at the chosen setting.
    pub pose_samples: usize,
    /// Whether each grasp is simulated with the force that was measured on it, instead of
    /// [`EngineSweep::forces_n`], which then has one force: the median, for the tables.
    pub measured_forces: bool,
    /// Profile of the simulated sensors.
    pub sensor: SensorProfile,
    /// Samples per pixel of the camera views; none for a report without images.
    pub view_spp: Option<u32>,
}

/// Input of a replay.
pub struct ReplayInput<'a> {
    /// The dataset.
    pub dataset: &'a Dataset,
    /// Replayable grasps of the dataset.
    pub recording: &'a Recording,
    /// Objects of the dataset.
    pub objects: &'a BTreeMap<ObjectName, Result<ReplayObject>>,
    /// Source of its outcomes.
    pub reality: Reality,
    /// Command that repeats the replay.
    pub command: String,
    /// Creation time, RFC 3339 UTC.
    pub written_at: String,
}

/// Progress of a replay.
#[derive(Clone, Debug, PartialEq)]
pub enum ReplayProgress {
    /// Simulating cases.
    Cases(SweepProgress),
    /// Simulating drawn poses.
    Poses(SweepProgress),
    /// Rendering images.
    Images {
        /// Number of grasps with images.
        done: usize,
        /// Number of grasps.
        total: usize,
    },
    /// A message.
    Note(String),
}

type OnProgress<'a> = dyn Fn(ReplayProgress) + Sync + 'a;

/// Replays a dataset. Finished cases are loaded from `store`, so an interrupted replay can be
/// resumed.
///
/// # Errors
/// `Input` if no grasp can be replayed; errors of storing cases.
pub fn replay(
    input: &ReplayInput<'_>,
    settings: &ReplaySettings,
    store: &CaseStore,
    on_progress: &OnProgress<'_>,
) -> Result<Report> {
    let start = Instant::now();
    let grasps = &input.recording.grasps;
    if grasps.is_empty() || settings.engines.is_empty() {
        let reason = input.recording.left_out.first();
        let reason = reason.map_or(String::new(), |l| format!("; {}: {}", l.grasp, l.reason));
        return Err(Error::input(format!("no grasp to replay{reason}")));
    }
    let cases = all_cases(input, settings)?;
    let swept = sweep(&cases, store, settings.jobs, &|at| {
        on_progress(ReplayProgress::Cases(at));
    })?;
    let replayed = CompletedReplay::new(input, settings, cases, swept.records);
    let drawn = replayed.drawn_poses(store, on_progress)?;
    let images = replayed.images(store, on_progress)?;
    let objects = replayed.objects(on_progress)?;
    let mut left_out = input.recording.left_out.clone();
    left_out.extend(replayed.without_outcome());
    Ok(Report {
        format: REPORT_FORMAT.to_owned(),
        version: REPORT_VERSION,
        software: concat!("gripcast ", env!("CARGO_PKG_VERSION")).to_owned(),
        written_at: input.written_at.clone(),
        command: input.command.clone(),
        seed: settings.seed,
        dataset: DatasetFacts {
            name: input.dataset.descriptor().name.clone(),
            path: input.dataset.path().display().to_string(),
            sha256: input.recording.sha256.clone(),
            grasps: input.recording.total,
            reality: input.reality.clone(),
        },
        objects,
        engines: replayed.engine_facts()?,
        comparison: replayed.comparison(),
        cost: Cost {
            cases: replayed.cases.len() + drawn.cases,
            simulated_now: swept.simulated + drawn.simulated,
            wall_s: start.elapsed().as_secs_f64(),
            jobs: settings.jobs,
            cpu_s: replayed.cpu_s(),
            processor: processor(),
        },
        grasps: replayed.grasp_facts(drawn, images),
        left_out,
        changes: None,
    })
}

fn object<'a>(input: &ReplayInput<'a>, grasp: &RecordedGrasp) -> Result<&'a ReplayObject> {
    let found = input.objects.get(grasp.record.object.as_str());
    found
        .and_then(|object| object.as_ref().ok())
        .ok_or_else(|| Error::internal(format!("{} has no object", grasp.record.id)))
}

fn measured_force(grasp: &RecordedGrasp) -> Result<MeasuredForce> {
    let force = MeasuredForce::of(&grasp.record);
    force.ok_or_else(|| Error::internal(format!("{} has no measured force", grasp.record.id)))
}

/// Returns all cases, by engine, grasp and setting.
fn all_cases<'a>(input: &ReplayInput<'a>, settings: &'a ReplaySettings) -> Result<Vec<Case<'a>>> {
    let mut cases = Vec::new();
    for sweep in &settings.engines {
        for grasp in &input.recording.grasps {
            let object = object(input, grasp)?;
            for friction in &sweep.frictions {
                for force_n in &sweep.forces_n {
                    let force_n = match settings.measured_forces {
                        true => measured_force(grasp)?.normal_n,
                        false => *force_n,
                    };
                    cases.push(Case {
                        engine: sweep.engine.as_ref(),
                        setup: grasp.setup.clone(),
                        object,
                        setting: Setting {
                            friction: *friction,
                            force_n,
                        },
                    });
                }
            }
        }
    }
    Ok(cases)
}

/// Results of the drawn poses.
struct DrawnPoses {
    /// By engine, then grasp.
    samples: Vec<Vec<Option<PoseSamples>>>,
    cases: usize,
    simulated: usize,
}

/// Images of a grasp.
#[derive(Default)]
struct GraspImages {
    view: Option<ImagePair>,
    tactile: Vec<TactilePair>,
}

/// A replay whose cases are finished.
struct CompletedReplay<'a> {
    input: &'a ReplayInput<'a>,
    settings: &'a ReplaySettings,
    cases: Vec<Case<'a>>,
    records: Vec<CaseRecord>,
    scored: Vec<Scoring>,
}

impl<'a> CompletedReplay<'a> {
    fn new(
        input: &'a ReplayInput<'a>,
        settings: &'a ReplaySettings,
        cases: Vec<Case<'a>>,
        records: Vec<CaseRecord>,
    ) -> Self {
        let mut replayed = Self {
            input,
            settings,
            cases,
            records,
            scored: Vec::new(),
        };
        let engines = 0..settings.engines.len();
        replayed.scored = engines.map(|e| replayed.outcomes(e).score()).collect();
        replayed
    }

    fn grasps(&self) -> &'a [RecordedGrasp] {
        &self.input.recording.grasps
    }

    /// Returns the indices of the cases of a grasp, by setting.
    fn case_range(&self, engine: usize, grasp: usize) -> Range<usize> {
        let count = |sweep: &EngineSweep| sweep.frictions.len() * sweep.forces_n.len();
        let engines = &self.settings.engines;
        let before: usize = engines[..engine].iter().map(count).sum();
        let count = count(&engines[engine]);
        let start = before * self.grasps().len() + grasp * count;
        start..start + count
    }

    fn outcomes(&self, engine: usize) -> OutcomeTable<'a> {
        let sweep = &self.settings.engines[engine];
        let grasps = self.grasps();
        let simulated = (0..grasps.len()).map(|grasp| {
            let records = self.records[self.case_range(engine, grasp)].iter();
            records.map(|record| record.facts.stable()).collect()
        });
        OutcomeTable {
            frictions: &sweep.frictions,
            forces_n: &sweep.forces_n,
            objects: grasps.iter().map(|g| g.record.object.as_str()).collect(),
            real: grasps.iter().map(|g| g.stable).collect(),
            simulated: simulated.collect(),
        }
    }

    fn kind(&self, engine: usize) -> EngineKind {
        self.settings.engines[engine].engine.kind()
    }

    fn chosen(&self, engine: usize, grasp: usize) -> usize {
        self.case_range(engine, grasp).start + self.scored[engine].chosen[grasp]
    }

    /// Simulates drawn poses at the chosen settings.
    fn drawn_poses(&self, store: &CaseStore, on_progress: &OnProgress<'_>) -> Result<DrawnPoses> {
        let count = self.settings.pose_samples;
        let mut cases = Vec::new();
        let mut indices = Vec::new();
        for engine in 0..self.settings.engines.len() {
            for (index, grasp) in self.grasps().iter().enumerate() {
                let chosen = &self.cases[self.chosen(engine, index)];
                for number in 0..count {
                    let Some(setup) = grasp.with_drawn_pose(self.settings.seed, number) else {
                        continue;
                    };
                    cases.push(Case {
                        setup,
                        ..chosen.clone()
                    });
                    indices.push((engine, index));
                }
            }
        }
        let mut drawn = DrawnPoses {
            samples: vec![vec![None; self.grasps().len()]; self.settings.engines.len()],
            cases: cases.len(),
            simulated: 0,
        };
        if cases.is_empty() {
            return Ok(drawn);
        }
        let swept = sweep(&cases, store, self.settings.jobs, &|at| {
            on_progress(ReplayProgress::Poses(at));
        })?;
        for ((engine, grasp), record) in indices.into_iter().zip(&swept.records) {
            let sample =
                drawn.samples[engine][grasp].get_or_insert(PoseSamples { n: 0, stable: 0 });
            if let Some(stable) = record.facts.stable() {
                sample.n += 1;
                sample.stable += usize::from(stable);
            }
        }
        drawn.simulated = swept.simulated;
        Ok(drawn)
    }

    fn view(&self) -> Option<ViewSettings> {
        let seed = self.settings.seed;
        let spp = self.settings.view_spp;
        spp.map(|spp| ViewSettings { spp, seed })
    }

    /// Renders the images of the finite-element replay; without it there are none.
    fn images(&self, store: &CaseStore, on_progress: &OnProgress<'_>) -> Result<Vec<GraspImages>> {
        let grasps = self.grasps();
        let none = || grasps.iter().map(|_| GraspImages::default()).collect();
        let fem = (0..self.settings.engines.len()).find(|e| self.kind(*e) == EngineKind::Fem);
        let (Some(fem), Some(view)) = (fem, self.view()) else {
            return Ok(none());
        };
        let Some((grid, d_hat_m)) = self.settings.engines[fem].engine.gel()? else {
            return Ok(none());
        };
        let gel = SimulatedGel { grid, d_hat_m };
        let renderer = ObjectDepthRenderer::new(&self.settings.sensor)?;
        let of_grasp = |(index, grasp): &(usize, &RecordedGrasp)| -> Result<GraspImages> {
            let case = &self.cases[self.chosen(fem, *index)];
            let Some(snapshot) = store.snapshot(case, StageName::Adjustment)? else {
                return Ok(GraspImages::default());
            };
            let (dataset, object) = (self.input.dataset, case.object);
            let mut renderer = renderer.clone();
            let tactile = tactile_pairs(dataset, grasp, object, &gel, &snapshot, &mut renderer);
            let view = view_pair(dataset, grasp, object, &snapshot, &view);
            // Images that cannot be rendered are reported and omitted.
            let report = |e: &Error| {
                on_progress(ReplayProgress::Note(format!("{}: {e}", grasp.record.id)));
            };
            Ok(GraspImages {
                view: view.inspect_err(report).ok(),
                tactile: tactile.inspect_err(report).unwrap_or_default(),
            })
        };
        let total = grasps.len();
        let report = |done| on_progress(ReplayProgress::Images { done, total });
        let items: Vec<(usize, &RecordedGrasp)> = grasps.iter().enumerate().collect();
        par_map_single_threaded(self.settings.jobs, &items, &of_grasp, &report)
    }

    fn objects(&self, on_progress: &OnProgress<'_>) -> Result<Vec<ObjectFacts>> {
        let mut found: Vec<ObjectFacts> = Vec::new();
        for grasp in self.grasps() {
            let name = &grasp.record.object;
            if found.last().is_none_or(|last| last.name != **name) {
                let object = object(self.input, grasp)?;
                let image = self.view().and_then(|view| {
                    let image = object_image(object, grasp, &view);
                    let report =
                        |e: &Error| on_progress(ReplayProgress::Note(format!("{name}: {e}")));
                    image.inspect_err(report).ok()
                });
                found.push(ObjectFacts {
                    name: name.to_string(),
                    mesh: object.file.mesh.clone(),
                    mesh_sha256: object.mesh_sha256.clone(),
                    triangles: object.mesh.triangles.len(),
                    size_m: object.mesh.bounds().extent().to_array(),
                    mass_kg: object.file.mass_kg,
                    grasps: 0,
                    stable: 0,
                    image,
                });
            }
            if let Some(last) = found.last_mut() {
                last.grasps += 1;
                last.stable += usize::from(grasp.stable);
            }
        }
        Ok(found)
    }

    fn engine_facts(&self) -> Result<Vec<EngineFacts>> {
        let engines = self.settings.engines.iter().zip(&self.scored);
        engines
            .map(|(sweep, scored)| {
                let mut parameters = sweep.engine.parameters()?;
                if let (true, Some(all)) =
                    (self.settings.measured_forces, parameters.as_object_mut())
                {
                    let source = "measured on each grasp; the listed force is their median";
                    all.insert("force_n".to_owned(), source.into());
                }
                Ok(EngineFacts {
                    name: sweep.engine.kind().name().to_owned(),
                    frictions: sweep.frictions.clone(),
                    forces_n: sweep.forces_n.clone(),
                    parameters,
                    scores: scored.scores.clone(),
                    without_outcome: scored.agrees.iter().filter(|a| a.is_none()).count(),
                })
            })
            .collect()
    }

    fn comparison(&self) -> Option<EngineComparison> {
        let find = |kind| (0..self.settings.engines.len()).find(|e| self.kind(*e) == kind);
        let fem = &self.scored[find(EngineKind::Fem)?];
        let rigid = &self.scored[find(EngineKind::Rigid)?];
        let counts = |fem: &[Option<bool>], rigid: &[Option<bool>]| {
            let mut counts = [[0; 2]; 2];
            for (fem, rigid) in fem.iter().zip(rigid) {
                if let (Some(fem), Some(rigid)) = (fem, rigid) {
                    counts[usize::from(*fem)][usize::from(*rigid)] += 1;
                }
            }
            counts
        };
        let [[neither, only_rigid], [only_fem, both]] = counts(&fem.agrees, &rigid.agrees);
        let [[_, left_out_rigid], [left_out_fem, _]] =
            counts(&fem.agrees_left_out, &rigid.agrees_left_out);
        Some(EngineComparison {
            both,
            only_fem,
            only_rigid,
            neither,
            mcnemar_p: mcnemar_p(only_fem, only_rigid),
            leave_one_out: [left_out_fem, left_out_rigid],
            leave_one_out_p: mcnemar_p(left_out_fem, left_out_rigid),
        })
    }

    fn cpu_s(&self) -> BTreeMap<String, f64> {
        let mut sums = BTreeMap::new();
        for (case, record) in self.cases.iter().zip(&self.records) {
            let sum = sums.entry(case.engine.kind().name().to_owned());
            *sum.or_insert(0.0) += record.facts.cpu_s;
        }
        sums
    }

    /// Lists the cases without an outcome, one entry per grasp and engine.
    fn without_outcome(&self) -> Vec<ExcludedGrasp> {
        let mut found = Vec::new();
        for engine in 0..self.settings.engines.len() {
            for (index, grasp) in self.grasps().iter().enumerate() {
                let cases = self.case_range(engine, index);
                let total = cases.len();
                let open: Vec<usize> = cases
                    .filter(|case| self.records[*case].facts.stable().is_none())
                    .collect();
                let Some(first) = open.first() else { continue };
                let facts = &self.records[*first].facts;
                let setting = self.cases[*first].setting;
                found.push(ExcludedGrasp {
                    grasp: grasp.record.id.to_string(),
                    object: grasp.record.object.to_string(),
                    reason: format!(
                        "{} has no outcome at {} of {total} settings; at friction {}, {} N: {}{}",
                        self.kind(engine).name(),
                        open.len(),
                        setting.friction,
                        setting.force_n,
                        facts.outcome,
                        facts
                            .detail
                            .as_ref()
                            .map_or(String::new(), |d| format!(" ({d})")),
                    ),
                });
            }
        }
        found
    }

    fn grasp_facts(&self, drawn: DrawnPoses, images: Vec<GraspImages>) -> Vec<GraspFacts> {
        let grasps = self.grasps().iter().enumerate().zip(images);
        grasps
            .map(|((index, grasp), images)| {
                let engines = 0..self.settings.engines.len();
                let t = grasp.t_object_gripper;
                let ([x, y, z], q) = (t.translation_m.to_array(), t.rotation);
                let sd = grasp.pose_sd();
                GraspFacts {
                    id: grasp.record.id.to_string(),
                    object: grasp.record.object.to_string(),
                    stable: grasp.stable,
                    t_object_gripper: [x, y, z, q.w, q.x, q.y, q.z],
                    pose_sd_m: sd.map(|[position, _]| position),
                    pose_sd_rad: sd.map(|[_, rotation]| rotation),
                    replays: engines
                        .map(|engine| self.replay_of(engine, index, drawn.samples[engine][index]))
                        .collect(),
                    view: images.view,
                    tactile: images.tactile,
                }
            })
            .collect()
    }

    fn replay_of(
        &self,
        engine: usize,
        grasp: usize,
        pose_samples: Option<PoseSamples>,
    ) -> GraspReplay {
        let real = self.grasps()[grasp].stable;
        let chosen = self.chosen(engine, grasp);
        let record = &self.records[chosen];
        let cells: Vec<GraspCell> = self
            .case_range(engine, grasp)
            .map(|case| {
                let facts = &self.records[case].facts;
                GraspCell {
                    setting: self.cases[case].setting,
                    outcome: facts.outcome.clone(),
                    agrees: facts.stable().map(|stable| stable == real),
                }
            })
            .collect();
        let agreements: Vec<bool> = cells.iter().filter_map(|cell| cell.agrees).collect();
        let disagreeing = agreements.iter().filter(|agrees| !**agrees).count();
        GraspReplay {
            engine: self.kind(engine).name().to_owned(),
            chosen: self.cases[chosen].setting,
            case: record.facts.clone(),
            agrees: self.scored[engine].agrees[grasp],
            disagreement: disagreeing as f64 / agreements.len().max(1) as f64,
            cells,
            pose_samples,
            curves: (!record.curves.t_s.is_empty()).then(|| record.curves.clone()),
        }
    }
}

/// Returns the number of cores and the processor name.
fn processor() -> String {
    let cores = cores();
    let info = read_text(Path::new("/proc/cpuinfo"), FileKind::Record).unwrap_or_default();
    let name = info
        .lines()
        .find_map(|line| line.strip_prefix("model name")?.split_once(':'))
        .map_or("unknown", |(_, name)| name.trim());
    format!("{cores} × {name}")
}
