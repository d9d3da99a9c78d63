//! CPU time of the results, compared with the plan's estimate.

use std::collections::BTreeMap;

use super::facts::{CostFacts, EstimateFacts, Quantiles, SettingCost};
use super::numbers::correlation;
use super::results::{FinishedSimulation, PlanResults};
use crate::store::CpuSeconds;

const HOUR_S: f64 = 3600.0;

/// Computes the costs of all results with CPU times.
pub(super) fn costs(plan_results: &PlanResults<'_>) -> CostFacts {
    let timed: Vec<&FinishedSimulation<'_>> = plan_results
        .done
        .iter()
        .filter(|d| d.result.cpu_s.total() > 0.0)
        .collect();
    let labelled = timed.iter().filter(|d| d.result.stable.is_some()).count();
    let all_s: f64 = timed.iter().map(|done| done.result.cpu_s.total()).sum();
    let per_hour = |count: usize| (all_s > 0.0).then(|| HOUR_S * count as f64 / all_s);
    CostFacts {
        simulations: timed.len(),
        total_s: total(&timed),
        each_s: each(&timed),
        per_core_hour: per_hour(timed.len()),
        labelled_per_core_hour: per_hour(labelled),
        settings: settings(&timed),
        estimate: estimate(&timed),
    }
}

fn total(timed: &[&FinishedSimulation<'_>]) -> CpuSeconds {
    let sum = |stage: fn(&CpuSeconds) -> f64| timed.iter().map(|d| stage(&d.result.cpu_s)).sum();
    CpuSeconds {
        prepare: sum(|cpu| cpu.prepare),
        simulate: sum(|cpu| cpu.simulate),
        tactile: sum(|cpu| cpu.tactile),
        visual: sum(|cpu| cpu.visual),
    }
}

fn each(timed: &[&FinishedSimulation<'_>]) -> BTreeMap<String, Quantiles> {
    let of = |name: &str, value: fn(&CpuSeconds) -> f64| {
        let values = timed.iter().map(|done| value(&done.result.cpu_s));
        (name.to_owned(), Quantiles::of(values))
    };
    [
        of("prepare", |cpu| cpu.prepare),
        of("simulate", |cpu| cpu.simulate),
        of("tactile", |cpu| cpu.tactile),
        of("visual", |cpu| cpu.visual),
        of("all", CpuSeconds::total),
    ]
    .into()
}

fn settings(timed: &[&FinishedSimulation<'_>]) -> Vec<SettingCost> {
    let mut settings: BTreeMap<(&str, u64), Vec<&FinishedSimulation<'_>>> = BTreeMap::new();
    for done in timed {
        let simulation = done.simulation;
        // The bits of positive numbers have the order of the numbers.
        let key = (simulation.engine.name(), simulation.stop_force_n.to_bits());
        settings.entry(key).or_default().push(done);
    }
    let setting = |((engine, force), all): ((&str, u64), Vec<&FinishedSimulation<'_>>)| {
        let values =
            |of: fn(&FinishedSimulation<'_>) -> f64| Quantiles::of(all.iter().map(|done| of(done)));
        let unconverged = all.iter().map(|done| done.result.unconverged_steps);
        SettingCost {
            engine: engine.to_owned(),
            stop_force_n: f64::from_bits(force),
            simulations: all.len(),
            simulate_s: values(|done| done.result.cpu_s.simulate),
            all_s: values(|done| done.result.cpu_s.total()),
            total_s: all.iter().map(|done| done.result.cpu_s.total()).sum(),
            newton_iterations: values(|done| done.result.newton_iterations as f64),
            steps: all.iter().map(|done| done.result.steps).sum(),
            unconverged_steps: unconverged.clone().sum(),
            unconverged_simulations: unconverged.filter(|steps| *steps > 0).count(),
        }
    };
    settings.into_iter().map(setting).collect()
}

fn estimate(timed: &[&FinishedSimulation<'_>]) -> Option<EstimateFacts> {
    let pair = |done: &&FinishedSimulation<'_>| [done.simulation.cost_s, done.result.cpu_s.total()];
    let pairs: Vec<[f64; 2]> = timed.iter().map(pair).filter(|p| p[0] > 0.0).collect();
    (!pairs.is_empty()).then(|| EstimateFacts {
        estimated_s: pairs.iter().map(|pair| pair[0]).sum(),
        measured_s: pairs.iter().map(|pair| pair[1]).sum(),
        ratio: Quantiles::of(pairs.iter().map(|pair| pair[1] / pair[0])),
        correlation: correlation(&pairs),
    })
}

#[cfg(test)]
mod tests {
    use super::super::sample::{Sample, labelled};
    use super::*;

    #[test]
    fn costs_add_up_without_failures() {
        let sample = Sample::new(8);
        let mut plan_results = labelled(&sample, &[true; 8]);
        plan_results.done[7].result.cpu_s = CpuSeconds::default();
        plan_results.done[6].result.stable = None;
        plan_results.done[1].result.unconverged_steps = 3;
        let costs = costs(&plan_results);
        // Result k costs 0.1, 1 + k, 0.2 and 0.7 s.
        assert_eq!(costs.simulations, 7);
        assert!((costs.total_s.simulate - 28.0).abs() < 1e-9);
        assert!((costs.each_s["all"].max - 8.0).abs() < 1e-9);
        assert!((costs.each_s["simulate"].median - 4.0).abs() < 1e-9);
        let per_hour = costs.per_core_hour.unwrap();
        assert!((per_hour - 7.0 * 3600.0 / 35.0).abs() < 1e-6, "{per_hour}");
        let labelled = costs.labelled_per_core_hour.unwrap();
        assert!((labelled - 6.0 * 3600.0 / 35.0).abs() < 1e-6);
        let [weak, strong] = &costs.settings[..] else {
            unreachable!()
        };
        assert_eq!((weak.stop_force_n, strong.stop_force_n), (10.0, 40.0));
        assert_eq!((weak.simulations, strong.simulations), (4, 3));
        let unconverged = |s: &SettingCost| (s.unconverged_steps, s.unconverged_simulations);
        assert_eq!((unconverged(weak), unconverged(strong)), ((0, 0), (3, 1)));
        // Estimates are 1 + k.
        let estimate = costs.estimate.unwrap();
        assert!((estimate.estimated_s - 28.0).abs() < 1e-9);
        assert!((estimate.measured_s - 35.0).abs() < 1e-9);
        assert!((estimate.ratio.max - 2.0).abs() < 1e-9);
        assert!((estimate.correlation.unwrap() - 1.0).abs() < 1e-9);
    }

    #[test]
    fn no_results_have_no_costs() {
        let costs = costs(&PlanResults::default());
        assert_eq!((costs.simulations, costs.per_core_hour), (0, None));
        assert_eq!(costs.estimate, None);
        assert!(costs.settings.is_empty());
    }
}
