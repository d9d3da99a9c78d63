//! `plan.jsonl`: objects and simulations of a synthetic dataset.

use gripcast_synth::plan::Plan;

/// Panics where something is wrong.
pub(crate) fn check(input: &[u8]) {
    if let Ok(plan) = Plan::from_bytes(input) {
        for simulation in &plan.simulations {
            plan.object(simulation).expect("a plan names its objects");
        }
    }
}
