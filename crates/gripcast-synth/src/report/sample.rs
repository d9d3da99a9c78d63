//! A sample plan with results for tests.

use image::{Rgb, RgbImage};

use super::results::{FinishedSimulation, PlanResults};
use crate::plan::{Plan, sample_plan};
use crate::store::{CpuSeconds, SimulationResult};
use gripcast_base::files::SimulationId;
use gripcast_dataset::shard::{ShardEngine, ShardFacts, ShardImages, ShardOutcome, ShardRow};
use gripcast_geometry::Pose;
use gripcast_imaging::encode_jpeg;

/// A plan of two objects, `box-0000` and `box-0001`, the second of its own category and material;
/// simulation k has object k mod 2, at 10 N for even k and 40 N for odd k.
pub(crate) struct Sample {
    pub(super) plan: Plan,
}

impl Sample {
    pub(super) fn new(count: usize) -> Self {
        let mut plan = sample_plan(count);
        for simulation in plan.simulations.iter_mut().skip(1).step_by(2) {
            simulation.stop_force_n = 40.0;
            let id = simulation.id.replace("10n", "40n");
            simulation.id = SimulationId::parse(&id).unwrap();
        }
        let mut objects: Vec<_> = plan.objects.into_values().collect();
        objects[1].category = "ring <b>".to_owned();
        objects[1].material = "steel".to_owned();
        objects[1].mass_kg = 0.12;
        Self {
            plan: Plan::new(plan.header, objects, plan.simulations).unwrap(),
        }
    }

    /// Result of simulation k with a CPU time of 2 + k s.
    pub(super) fn result(&self, k: usize, stable: bool) -> SimulationResult {
        let mut result = SimulationResult::new(&self.plan, &self.plan.simulations[k]);
        result.outcome = if stable { "success" } else { "slip" }.to_owned();
        result.stable = Some(stable);
        result.steps = 100;
        result.newton_iterations = 1000 + k as u64;
        result.cpu_s = CpuSeconds {
            prepare: 0.1,
            simulate: 1.0 + k as f64,
            tactile: 0.2,
            visual: 0.7,
        };
        result
    }

    /// One rendering of simulation k, with or without contact.
    pub(super) fn row(&self, k: usize, stable: bool, has_contact: bool) -> ShardRow {
        let simulation = &self.plan.simulations[k];
        let object = &self.plan.objects[&simulation.object];
        let plain = jpeg(40, 30, 0);
        let touched = jpeg(40, 30, if has_contact { 12 } else { 0 });
        ShardRow {
            facts: ShardFacts {
                id: format!("{}-r0", simulation.id),
                simulation: simulation.id.to_string(),
                object: object.name.to_string(),
                category: object.category.clone(),
                engine: ShardEngine::Fem,
                outcome: match stable {
                    true => ShardOutcome::Stable,
                    false => ShardOutcome::Slip,
                },
                outcome_detail: "success".to_owned(),
                stop_force_n: Some(simulation.stop_force_n),
                friction: Some(simulation.friction_on(object)),
                mass_kg: Some(object.mass_kg),
                lifted_m: Some(0.05),
                force_left_n: None,
                force_right_n: None,
                opening_m: Some(0.03),
                t_object_gripper: Some(Pose::IDENTITY),
                fault: None,
                appearance: "red & shiny".to_owned(),
                rendering: 0,
                seed: 1,
                crop_profile: "paper".to_owned(),
                geometry: None,
                lift: None,
                contact: None,
            },
            images: ShardImages {
                initial_left: plain.clone(),
                initial_right: plain,
                grasp_left: touched.clone(),
                grasp_right: touched,
                grasp_rgb: jpeg(320, 240, k as u32),
                initial_rgb: None,
                grasp_depth: None,
            },
        }
    }
}

/// A grey image with a brighter square.
fn jpeg(width: u32, height: u32, side: u32) -> Vec<u8> {
    let image = RgbImage::from_fn(width, height, |x, y| {
        Rgb([if x < side && y < side { 200 } else { 100 }; 3])
    });
    encode_jpeg(&image, 92).unwrap()
}

/// Results of the first simulations with the given labels.
pub(super) fn labelled<'a>(sample: &'a Sample, stable: &[bool]) -> PlanResults<'a> {
    let done = sample.plan.simulations.iter().zip(stable).enumerate();
    let done = done.map(|(k, (simulation, stable))| FinishedSimulation {
        simulation,
        object: sample.plan.object(simulation).unwrap(),
        result: sample.result(k, *stable),
    });
    PlanResults {
        done: done.collect(),
        ..PlanResults::default()
    }
}
