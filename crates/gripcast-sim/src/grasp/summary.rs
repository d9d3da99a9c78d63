//! Summary of a grasp in figures.

use serde::Serialize;

use super::protocol::Protocol;
use super::run::{GraspOutcome, GraspResult, MIN_CONTACT_FORCE_N};
use super::trace::{StageName, Trace, TraceStep, mean};
use gripcast_base::statistics::median;

/// Number of final adjustment steps used for force statistics.
pub const STEADY_STEPS: usize = 20;
/// Largest deviation of a steady mean from the stopping force, as a fraction of it.
const STEADY_FRACTION: f64 = 0.02;
/// Largest steady force change per step, as a multiple of the one expected from the stiffness.
const STEP_TOLERANCE: f64 = 1.1;
/// Force changes below this fraction of the stopping force are always steady.
const NOISE_FRACTION: f64 = 1e-3;
/// Largest load of friction, as a fraction of its limit, that counts as sticking.
const MAX_STICKING_USE: f64 = 0.95;
/// Smallest load of friction that creeps far: a third of `eps_v` at half the limit, 0.7 mm in the
/// paper's lift.
const MIN_CREEPING_USE: f64 = 0.5;
/// Largest difference of the gels' forces in the lift, as a fraction.
const MAX_IMBALANCE: f64 = 0.05;

/// One value per gel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PerGel {
    /// Left gel.
    pub left: f64,
    /// Right gel.
    pub right: f64,
}

/// Solver work in one stage.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct StageWork {
    /// Stage of the protocol.
    pub stage: StageName,
    /// Time steps, including free motion.
    pub steps: usize,
    /// Newton iterations per solved step.
    pub newton_per_step: f64,
}

/// Summary of a grasp.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GraspSummary {
    /// Outcome of the protocol.
    pub outcome: GraspOutcome,
    /// Further explanation of the outcome.
    pub detail: Option<String>,
    /// Rise of the object's centre of mass, m.
    pub lifted_m: f64,
    /// Normal force of each gel at the end of the adjustment (without one, at the end), N.
    pub force_n: PerGel,
    /// Stopping force, N.
    pub stop_force_n: f64,
    /// Whether the mean force reached the stopping force before the lift.
    pub reached_stop_force: bool,
    /// Mean force of both gels over the last [`STEADY_STEPS`] adjustment steps, N.
    pub mean_force_n: Option<f64>,
    /// Standard deviation of that force, N.
    pub std_force_n: Option<f64>,
    /// Load of the grip's friction in the lift as a fraction of its limit
    /// ([`GraspResult::friction_use`]).
    pub friction_use: Option<f64>,
    /// Whether the force was steady at the end of the adjustment (docs/explanation/simulator.md);
    /// `None` without an adjustment.
    pub steady: Option<bool>,
    /// Time steps, including free motion.
    pub steps: usize,
    /// Simulated time, s.
    pub simulated_s: f64,
    /// Newton iterations per solved step.
    pub newton_per_step: f64,
    /// Maximum Newton iterations of a step.
    pub newton_max: u32,
    /// Steps that did not converge.
    pub unconverged_steps: usize,
    /// Stages that were reached.
    pub stages: Vec<StageWork>,
    /// Reasons to doubt the result, for the user.
    pub warnings: Vec<String>,
}

impl GraspSummary {
    /// Summarises a grasp; `dt_s` is its time step.
    pub fn new(result: &GraspResult, protocol: &Protocol, dt_s: f64) -> Self {
        let trace = &result.trace;
        let last = trace
            .stage(StageName::Adjustment)
            .next_back()
            .or(trace.steps.last());
        let forces = trace.last_forces(StageName::Adjustment, STEADY_STEPS);
        let mean = mean(&forces);
        let force = |gel: usize| last.map_or(0.0, |step| step.force[gel].normal_n);
        let mut warnings = Vec::new();
        if result.unconverged_steps > 0 && result.outcome != GraspOutcome::NotConverged {
            warnings.push(format!(
                "{} of {} steps did not converge",
                result.unconverged_steps,
                trace.steps.len()
            ));
        }
        let steady = is_steady(trace, protocol, dt_s);
        let max_force_n = max_force(trace);
        let reached_stop_force = max_force_n >= protocol.stop_force_n;
        if max_force_n > MIN_CONTACT_FORCE_N && !reached_stop_force {
            warnings.push(format!(
                "the stopping force of {} N was never reached: the gels felt at most {max_force_n:.2} N",
                protocol.stop_force_n
            ));
        }
        if let (Some(false), Some(mean)) = (steady, mean) {
            warnings.push(format!(
                "the force was not steady at the end of the adjustment: {mean:.2} ± {:.2} N for a \
                 stopping force of {} N",
                deviation(&forces, mean),
                protocol.stop_force_n
            ));
        }
        warnings.extend(lost_by_creep(result));
        warnings.extend(force_imbalance(trace));
        Self {
            outcome: result.outcome,
            detail: result.detail.clone(),
            lifted_m: result.lifted_m,
            force_n: PerGel {
                left: force(0),
                right: force(1),
            },
            stop_force_n: protocol.stop_force_n,
            reached_stop_force,
            mean_force_n: mean,
            std_force_n: mean.map(|mean| deviation(&forces, mean)),
            friction_use: result.friction_use,
            steady,
            steps: trace.steps.len(),
            simulated_s: trace.steps.last().map_or(0.0, |step| step.t_s),
            newton_per_step: newton_per_step(trace.steps.iter()),
            newton_max: iterations(trace.steps.iter()).max().unwrap_or(0),
            unconverged_steps: result.unconverged_steps,
            stages: StageName::ALL
                .into_iter()
                .filter_map(|stage| work(trace, stage))
                .collect(),
            warnings,
        }
    }
}

/// Largest mean force of both gels before the lift, N.
fn max_force(trace: &Trace) -> f64 {
    let before_lift = trace.steps.iter().filter(|s| s.stage != StageName::Lift);
    before_lift.map(TraceStep::mean_force_n).fold(0.0, f64::max)
}

/// Warns of a slip below the friction limit. Regularised friction creeps there, where Coulomb
/// friction sticks.
fn lost_by_creep(result: &GraspResult) -> Option<String> {
    let friction_use = result.friction_use?;
    let is_creeping = (MIN_CREEPING_USE..MAX_STICKING_USE).contains(&friction_use);
    (result.outcome == GraspOutcome::Slip && is_creeping).then(|| {
        format!(
            "the object was lost by creep: the lift needed {:.0} % of the friction limit, and \
             regularised friction creeps below it; a smaller --eps-v creeps less",
            100.0 * friction_use
        )
    })
}

/// Warns if the gels' forces differ in the lift. Off the ground they must balance; a difference
/// means that driven nodes, which the force per gel leaves out, carry part of the contact.
fn force_imbalance(trace: &Trace) -> Option<String> {
    let last: Vec<&TraceStep> = trace
        .stage(StageName::Lift)
        .rev()
        .take(STEADY_STEPS)
        .collect();
    let force = |gel: usize| -> Vec<f64> {
        let steps = last.iter();
        steps.map(|step| step.force[gel].normal_n).collect()
    };
    let (left, right) = (mean(&force(0))?, mean(&force(1))?);
    ((left - right).abs() > MAX_IMBALANCE * left.max(right).max(1.0)).then(|| {
        format!(
            "in the lift the left gel feels {left:.1} N and the right {right:.1} N: the object \
             also touches driven nodes at the edge of a gel's back, which the force leaves out"
        )
    })
}

fn work(trace: &Trace, stage: StageName) -> Option<StageWork> {
    let steps = trace.stage(stage).count();
    (steps > 0).then(|| StageWork {
        stage,
        steps,
        newton_per_step: newton_per_step(trace.stage(stage)),
    })
}

fn iterations<'a>(steps: impl Iterator<Item = &'a TraceStep>) -> impl Iterator<Item = u32> {
    steps.filter_map(|step| step.solver.map(|report| report.iterations))
}

fn newton_per_step<'a>(steps: impl Iterator<Item = &'a TraceStep>) -> f64 {
    let (mut count, mut sum) = (0u32, 0u32);
    for iterations in iterations(steps) {
        count += 1;
        sum += iterations;
    }
    f64::from(sum) / f64::from(count.max(1))
}

fn deviation(values: &[f64], mean: f64) -> f64 {
    let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
    (squares / values.len().max(1) as f64).sqrt()
}

/// Whether the force is steady at the end of the adjustment; `None` without an adjustment.
///
/// Let k be the force change per metre of finger motion (median over the adjustment) and
/// s = k · adjustment speed · dt the force of one controller step, or 20 % F_stop where steps are
/// shortened ([`super::ForceRule::BangBang`]). The force is steady if, over the
/// last [`STEADY_STEPS`] steps, its mean lies within max(2 % F_stop, s/2) of F_stop and no step
/// changes it by more than max(1.1 s, 0.1 % F_stop).
fn is_steady(trace: &Trace, protocol: &Protocol, dt_s: f64) -> Option<bool> {
    let forces = trace.last_forces(StageName::Adjustment, STEADY_STEPS);
    let mean = mean(&forces)?;
    let step_n = protocol.step_force_n(stiffness(trace), dt_s);
    let band = (STEADY_FRACTION * protocol.stop_force_n).max(0.5 * step_n);
    let max_change = (STEP_TOLERANCE * step_n).max(NOISE_FRACTION * protocol.stop_force_n);
    let is_quiet = forces.windows(2).all(|w| (w[1] - w[0]).abs() <= max_change);
    Some((mean - protocol.stop_force_n).abs() <= band && is_quiet)
}

/// Median force change per metre of finger motion over the adjustment, N/m.
fn stiffness(trace: &Trace) -> f64 {
    let steps: Vec<&TraceStep> = trace.stage(StageName::Adjustment).collect();
    let moved = |w: &[&TraceStep]| 0.5 * (w[0].opening_m - w[1].opening_m);
    let longest = steps.windows(2).map(|w| moved(w).abs()).fold(0.0, f64::max);
    let slopes = steps
        .windows(2)
        .filter(|w| moved(w).abs() > 0.01 * longest)
        .map(|w| ((w[1].mean_force_n() - w[0].mean_force_n()) / moved(w)).abs());
    median(slopes).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grasp::sample_trace;
    use crate::solver::PhaseTimes;

    fn result() -> GraspResult {
        GraspResult {
            outcome: GraspOutcome::Success,
            detail: None,
            lifted_m: 0.05,
            friction_use: Some(0.4),
            unconverged_steps: 1,
            times: PhaseTimes::default(),
            trace: sample_trace(),
        }
    }

    #[test]
    fn summary_of_a_cycling_force() {
        let summary = GraspSummary::new(&result(), &Protocol::default(), 0.01);
        assert!((summary.mean_force_n.unwrap() - 40.005).abs() < 1e-9);
        assert!((summary.std_force_n.unwrap() - 0.5).abs() < 1e-9);
        assert_eq!(summary.force_n.left, 40.5);
        assert_eq!(summary.steady, Some(true));
        assert_eq!((summary.steps, summary.newton_max), (62, 3));
        assert_eq!(summary.newton_per_step, 3.0);
        let counts: Vec<usize> = summary.stages.iter().map(|s| s.steps).collect();
        assert_eq!(counts, [12, 30, 20]);
        assert_eq!(summary.warnings, ["1 of 62 steps did not converge"]);
    }

    #[test]
    fn force_jump_or_offset_is_not_steady() {
        let protocol = Protocol::default();
        let mut trace = sample_trace();
        assert_eq!(is_steady(&trace, &protocol, 0.01), Some(true));
        let late = trace.steps.len() - 25;
        for force in &mut trace.steps[late].force {
            force.normal_n += 1.5;
        }
        assert_eq!(is_steady(&trace, &protocol, 0.01), Some(false));
        let other = Protocol {
            stop_force_n: 42.0,
            ..protocol
        };
        assert_eq!(is_steady(&sample_trace(), &other, 0.01), Some(false));
        assert_eq!(is_steady(&Trace::default(), &protocol, 0.01), None);
    }

    #[test]
    fn force_imbalance_in_lift_is_a_warning() {
        let mut result = result();
        for step in &mut result.trace.steps {
            step.force[1].normal_n *= 0.8;
        }
        let summary = GraspSummary::new(&result, &Protocol::default(), 0.01);
        let text = summary.warnings.last().unwrap();
        assert!(text.contains("40.0 N") && text.contains("32.0 N"), "{text}");
    }

    #[test]
    fn force_that_was_never_reached_is_a_warning() {
        let protocol = Protocol {
            stop_force_n: 60.0,
            ..Protocol::default()
        };
        let summary = GraspSummary::new(&result(), &protocol, 0.01);
        assert!(!summary.reached_stop_force);
        assert_eq!(summary.steady, Some(false));
        let text = summary.warnings.join("\n");
        assert!(
            text.contains("60 N was never reached: the gels felt at most 40.5"),
            "{text}"
        );
        assert!(
            text.contains("not steady") && text.contains("40.0"),
            "{text}"
        );
        let reached = GraspSummary::new(&result(), &Protocol::default(), 0.01);
        assert!(reached.reached_stop_force);
    }

    #[test]
    fn slip_below_the_friction_limit_is_called_creep() {
        let mut slip = result();
        slip.outcome = GraspOutcome::Slip;
        slip.friction_use = Some(0.85);
        let text = GraspSummary::new(&slip, &Protocol::default(), 0.01)
            .warnings
            .join("\n");
        assert!(text.contains("creep") && text.contains("85 %"), "{text}");
        slip.friction_use = Some(0.99);
        let summary = GraspSummary::new(&slip, &Protocol::default(), 0.01);
        assert!(!summary.warnings.join("\n").contains("creep"));
    }

    #[test]
    fn grasp_without_steps_has_no_force() {
        let result = GraspResult::penetrating_start("the left gel is inside the object".into());
        let summary = GraspSummary::new(&result, &Protocol::default(), 0.01);
        assert_eq!((summary.steps, summary.mean_force_n), (0, None));
        let value = serde_json::to_value(summary).unwrap();
        assert_eq!(value["outcome"], "penetrating_start");
        assert_eq!(value["force_n"]["left"], 0.0);
        assert_eq!(value["newton_per_step"], 0.0);
    }
}
