//! The whole replay: cases, scores, drawn poses, images, report.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use super::camera_view::{ViewSettings, object_image, view_pair};
use super::case::{Case, CaseRecord, CaseStore};
use super::object_file::ReplayObject;
use super::recording::{RecordedGrasp, Recording};
use super::report::{
    Cost, DatasetFacts, Duel, EngineFacts, GraspCell, GraspFacts, GraspReplay, ImagePair, LeftOut,
    ObjectFacts, PoseSamples, REPORT_FORMAT, REPORT_VERSION, Reality, Report, Setting, TactilePair,
};
use super::score::{Outcomes, Scored};
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

/// An engine and what it is asked.
#[derive(Clone)]
pub struct EngineSweep {
    /// The engine.
    pub engine: Arc<dyn Engine>,
    /// Friction coefficients to try.
    pub frictions: Vec<f64>,
    /// Forces to try, N.
    pub forces_n: Vec<f64>,
}

/// How a dataset is replayed.
#[derive(Clone)]
pub struct ReplaySettings {
    /// Engines in the order of the tables.
    pub engines: Vec<EngineSweep>,
    /// Seed of drawn poses and of images.
    pub seed: u64,
    /// Cases at a time.
    pub jobs: usize,
    /// Poses to draw from each covariance, at the chosen setting.
    pub pose_samples: usize,
    /// Profile of the simulated sensors.
    pub sensor: SensorProfile,
    /// Paths for each pixel of the views; none for a report without images.
    pub view_samples: Option<u32>,
}

/// What is replayed.
pub struct ReplayInput<'a> {
    /// The dataset.
    pub dataset: &'a Dataset,
    /// Its grasps that can be replayed.
    pub recording: &'a Recording,
    /// Its objects.
    pub objects: &'a BTreeMap<ObjectName, Result<ReplayObject>>,
    /// Where its outcomes come from.
    pub reality: Reality,
    /// The command that repeats it.
    pub command: String,
    /// RFC 3339 UTC.
    pub written_at: String,
}

/// What a replay is at.
#[derive(Clone, Debug, PartialEq)]
pub enum ReplayProgress {
    /// It simulates.
    Cases(SweepProgress),
    /// It simulates drawn poses.
    Poses(SweepProgress),
    /// It draws the images of so many of so many grasps.
    Images {
        /// Grasps with images.
        done: usize,
        /// All grasps.
        all: usize,
    },
    /// Something to tell.
    Note(String),
}

type Told<'a> = dyn Fn(ReplayProgress) + Sync + 'a;

/// Replays a dataset. Finished cases are found in `store` again, so a replay that was cut off
/// goes on where it was.
///
/// # Errors
/// `Input` if no grasp can be replayed; those of storing cases.
pub fn replay(
    input: &ReplayInput<'_>,
    settings: &ReplaySettings,
    store: &CaseStore,
    progress: &Told<'_>,
) -> Result<Report> {
    let began = Instant::now();
    let grasps = &input.recording.grasps;
    if grasps.is_empty() || settings.engines.is_empty() {
        let reason = input.recording.left_out.first();
        let reason = reason.map_or(String::new(), |l| format!("; {}: {}", l.grasp, l.reason));
        return Err(Error::input(format!("there is no grasp to replay{reason}")));
    }
    let cases = all_cases(input, settings)?;
    let swept = sweep(&cases, store, settings.jobs, &|at| {
        progress(ReplayProgress::Cases(at));
    })?;
    let replayed = Replayed::new(input, settings, cases, swept.records);
    let drawn = replayed.drawn_poses(store, progress)?;
    let images = replayed.images(store, progress)?;
    let objects = replayed.objects(progress)?;
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
            grasps: input.recording.all,
            reality: input.reality.clone(),
        },
        objects,
        engines: replayed.engine_facts()?,
        duel: replayed.duel(),
        cost: Cost {
            cases: replayed.cases.len() + drawn.cases,
            simulated_now: swept.simulated + drawn.simulated,
            wall_s: began.elapsed().as_secs_f64(),
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

/// Engine by engine, grasp by grasp, setting by setting.
fn all_cases<'a>(input: &ReplayInput<'a>, settings: &'a ReplaySettings) -> Result<Vec<Case<'a>>> {
    let mut cases = Vec::new();
    for sweep in &settings.engines {
        for grasp in &input.recording.grasps {
            let object = object(input, grasp)?;
            for friction in &sweep.frictions {
                for force_n in &sweep.forces_n {
                    cases.push(Case {
                        engine: sweep.engine.as_ref(),
                        setup: grasp.setup.clone(),
                        object,
                        setting: Setting {
                            friction: *friction,
                            force_n: *force_n,
                        },
                    });
                }
            }
        }
    }
    Ok(cases)
}

/// The drawn poses of all engines and grasps.
struct Drawn {
    /// By engine, then grasp.
    samples: Vec<Vec<Option<PoseSamples>>>,
    cases: usize,
    simulated: usize,
}

/// Images of a grasp.
#[derive(Default)]
struct Images {
    view: Option<ImagePair>,
    tactile: Vec<TactilePair>,
}

/// A replay whose cases are there.
struct Replayed<'a> {
    input: &'a ReplayInput<'a>,
    settings: &'a ReplaySettings,
    cases: Vec<Case<'a>>,
    records: Vec<CaseRecord>,
    scored: Vec<Scored>,
}

impl<'a> Replayed<'a> {
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

    fn settings_of(&self, engine: usize) -> usize {
        let sweep = &self.settings.engines[engine];
        sweep.frictions.len() * sweep.forces_n.len()
    }

    /// Index of a case.
    fn at(&self, engine: usize, grasp: usize, setting: usize) -> usize {
        let before: usize = (0..engine)
            .map(|e| self.settings_of(e) * self.grasps().len())
            .sum();
        before + grasp * self.settings_of(engine) + setting
    }

    fn outcomes(&self, engine: usize) -> Outcomes<'a> {
        let sweep = &self.settings.engines[engine];
        let grasps = self.grasps();
        let simulated = (0..grasps.len()).map(|grasp| {
            (0..self.settings_of(engine))
                .map(|setting| self.records[self.at(engine, grasp, setting)].facts.stable())
                .collect()
        });
        Outcomes {
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
        self.at(engine, grasp, self.scored[engine].chosen[grasp])
    }

    /// Simulates drawn poses at the chosen settings.
    fn drawn_poses(&self, store: &CaseStore, progress: &Told<'_>) -> Result<Drawn> {
        let count = self.settings.pose_samples;
        let mut cases = Vec::new();
        let mut places = Vec::new();
        for engine in 0..self.settings.engines.len() {
            for (index, grasp) in self.grasps().iter().enumerate() {
                let chosen = &self.cases[self.chosen(engine, index)];
                for number in 0..count {
                    let Some(setup) = grasp.drawn(self.settings.seed, number) else {
                        continue;
                    };
                    cases.push(Case {
                        setup,
                        ..chosen.clone()
                    });
                    places.push((engine, index));
                }
            }
        }
        let mut samples = vec![vec![None; self.grasps().len()]; self.settings.engines.len()];
        if cases.is_empty() {
            return Ok(Drawn {
                samples,
                cases: 0,
                simulated: 0,
            });
        }
        let swept = sweep(&cases, store, self.settings.jobs, &|at| {
            progress(ReplayProgress::Poses(at));
        })?;
        for ((engine, grasp), record) in places.into_iter().zip(&swept.records) {
            let found: &mut PoseSamples =
                samples[engine][grasp].get_or_insert(PoseSamples { n: 0, stable: 0 });
            if let Some(stable) = record.facts.stable() {
                found.n += 1;
                found.stable += usize::from(stable);
            }
        }
        Ok(Drawn {
            samples,
            cases: cases.len(),
            simulated: swept.simulated,
        })
    }

    /// Images of the finite-element replay; without it there are none.
    fn images(&self, store: &CaseStore, progress: &Told<'_>) -> Result<Vec<Images>> {
        let grasps = self.grasps();
        let none = || grasps.iter().map(|_| Images::default()).collect();
        let fem = (0..self.settings.engines.len()).find(|e| self.kind(*e) == EngineKind::Fem);
        let (Some(fem), Some(samples)) = (fem, self.settings.view_samples) else {
            return Ok(none());
        };
        let Some((grid, d_hat_m)) = self.settings.engines[fem].engine.gel()? else {
            return Ok(none());
        };
        let gel = SimulatedGel { grid, d_hat_m };
        let renderer = ObjectDepthRenderer::new(&self.settings.sensor)?;
        let view = ViewSettings {
            samples,
            seed: self.settings.seed,
        };
        let of_grasp = |(index, grasp): &(usize, &RecordedGrasp)| -> Result<Images> {
            let case = &self.cases[self.chosen(fem, *index)];
            let Some(snapshot) = store.snapshot(case, StageName::Adjustment)? else {
                return Ok(Images::default());
            };
            let (dataset, object) = (self.input.dataset, case.object);
            let mut renderer = renderer.clone();
            let tactile = tactile_pairs(dataset, grasp, object, &gel, &snapshot, &mut renderer);
            let view = view_pair(dataset, grasp, object, &snapshot, &view);
            // What cannot be drawn is told and left out.
            let told = |e: &Error| {
                progress(ReplayProgress::Note(format!("{}: {e}", grasp.record.id)));
            };
            Ok(Images {
                view: view.inspect_err(told).ok(),
                tactile: tactile.inspect_err(told).unwrap_or_default(),
            })
        };
        let all = grasps.len();
        let told = |done| progress(ReplayProgress::Images { done, all });
        let items: Vec<(usize, &RecordedGrasp)> = grasps.iter().enumerate().collect();
        par_map_single_threaded(self.settings.jobs, &items, &of_grasp, &told)
    }

    fn objects(&self, progress: &Told<'_>) -> Result<Vec<ObjectFacts>> {
        let mut found: Vec<ObjectFacts> = Vec::new();
        for grasp in self.grasps() {
            let name = &grasp.record.object;
            if found.last().is_none_or(|last| last.name != **name) {
                let object = object(self.input, grasp)?;
                let view = self.settings.view_samples.map(|samples| ViewSettings {
                    samples,
                    seed: self.settings.seed,
                });
                let image = view.and_then(|view| {
                    let image = object_image(object, grasp, &view);
                    let told = |e: &Error| progress(ReplayProgress::Note(format!("{name}: {e}")));
                    image.inspect_err(told).ok()
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
                Ok(EngineFacts {
                    name: sweep.engine.kind().name().to_owned(),
                    frictions: sweep.frictions.clone(),
                    forces_n: sweep.forces_n.clone(),
                    parameters: sweep.engine.parameters()?,
                    scores: scored.scores.clone(),
                    without_outcome: scored.agrees.iter().filter(|a| a.is_none()).count(),
                })
            })
            .collect()
    }

    fn duel(&self) -> Option<Duel> {
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
        let [[_, rigid_out], [fem_out, _]] = counts(&fem.agrees_left_out, &rigid.agrees_left_out);
        Some(Duel {
            both,
            only_fem,
            only_rigid,
            neither,
            mcnemar_p: mcnemar_p(only_fem, only_rigid),
            leave_one_out: [fem_out, rigid_out],
            leave_one_out_p: mcnemar_p(fem_out, rigid_out),
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

    /// Cases without outcome, an entry for each grasp and engine.
    fn without_outcome(&self) -> Vec<LeftOut> {
        let mut found = Vec::new();
        for engine in 0..self.settings.engines.len() {
            for (index, grasp) in self.grasps().iter().enumerate() {
                let all = self.settings_of(engine);
                let cases = (0..all).map(|setting| self.at(engine, index, setting));
                let open: Vec<usize> = cases
                    .filter(|case| self.records[*case].facts.stable().is_none())
                    .collect();
                let Some(first) = open.first() else { continue };
                let facts = &self.records[*first].facts;
                let setting = self.cases[*first].setting;
                found.push(LeftOut {
                    grasp: grasp.record.id.to_string(),
                    object: grasp.record.object.to_string(),
                    reason: format!(
                        "{} has no outcome at {} of {all} settings; at friction {}, {} N: {}{}",
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

    fn grasp_facts(&self, drawn: Drawn, images: Vec<Images>) -> Vec<GraspFacts> {
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
        let cells: Vec<GraspCell> = (0..self.settings_of(engine))
            .map(|setting| {
                let case = self.at(engine, grasp, setting);
                let facts = &self.records[case].facts;
                GraspCell {
                    setting: self.cases[case].setting,
                    outcome: facts.outcome.clone(),
                    agrees: facts.stable().map(|stable| stable == real),
                }
            })
            .collect();
        let judged: Vec<bool> = cells.iter().filter_map(|cell| cell.agrees).collect();
        let disagree = judged.iter().filter(|agrees| !**agrees).count();
        GraspReplay {
            engine: self.kind(engine).name().to_owned(),
            chosen: self.cases[chosen].setting,
            case: record.facts.clone(),
            agrees: self.scored[engine].agrees[grasp],
            disagreement: disagree as f64 / judged.len().max(1) as f64,
            cells,
            pose_samples,
            curves: (!record.curves.t_s.is_empty()).then(|| record.curves.clone()),
        }
    }
}

/// Name of the processor and how many of it there are.
fn processor() -> String {
    let cores = cores();
    let info = read_text(Path::new("/proc/cpuinfo"), FileKind::Record).unwrap_or_default();
    let name = info
        .lines()
        .find_map(|line| line.strip_prefix("model name")?.split_once(':'))
        .map_or("unknown", |(_, name)| name.trim());
    format!("{cores} × {name}")
}
