//! What the results cost, and how well the plan knew it.

use std::collections::BTreeMap;

use super::facts::{CostFacts, EstimateFacts, Quantiles, SettingCost};
use super::gather::{Done, Gathered};
use super::numbers::correlation;
use crate::store::CpuSeconds;

/// Seconds of an hour.
const HOUR_S: f64 = 3600.0;

/// Costs of all results that have times.
pub(super) fn costs(gathered: &Gathered<'_>) -> CostFacts {
    let timed: Vec<&Done<'_>> = gathered.done.iter().filter(|d| d.cpu_s() > 0.0).collect();
    let labelled = timed.iter().filter(|d| d.result.stable.is_some()).count();
    let all_s: f64 = timed.iter().map(|done| done.cpu_s()).sum();
    let in_an_hour = |count: usize| (all_s > 0.0).then(|| HOUR_S * count as f64 / all_s);
    CostFacts {
        simulations: timed.len(),
        total_s: total(&timed),
        each_s: each(&timed),
        per_core_hour: in_an_hour(timed.len()),
        labelled_per_core_hour: in_an_hour(labelled),
        settings: settings(&timed),
        estimate: estimate(&timed),
    }
}

fn total(timed: &[&Done<'_>]) -> CpuSeconds {
    let sum = |part: fn(&CpuSeconds) -> f64| timed.iter().map(|d| part(&d.result.cpu_s)).sum();
    CpuSeconds {
        prepare: sum(|cpu| cpu.prepare),
        simulate: sum(|cpu| cpu.simulate),
        tactile: sum(|cpu| cpu.tactile),
        visual: sum(|cpu| cpu.visual),
    }
}

fn each(timed: &[&Done<'_>]) -> BTreeMap<String, Quantiles> {
    let of = |name: &str, part: fn(&Done<'_>) -> f64| {
        let values = timed.iter().map(|done| part(done));
        (name.to_owned(), Quantiles::of(values))
    };
    [
        of("prepare", |done| done.result.cpu_s.prepare),
        of("simulate", |done| done.result.cpu_s.simulate),
        of("tactile", |done| done.result.cpu_s.tactile),
        of("visual", |done| done.result.cpu_s.visual),
        of("all", |done| done.cpu_s()),
    ]
    .into()
}

fn settings(timed: &[&Done<'_>]) -> Vec<SettingCost> {
    let mut settings: BTreeMap<(&str, u64), Vec<&Done<'_>>> = BTreeMap::new();
    for done in timed {
        let simulation = done.simulation;
        // The bits of numbers above 0 are ordered as the numbers are.
        let key = (simulation.engine.name(), simulation.stop_force_n.to_bits());
        settings.entry(key).or_default().push(done);
    }
    let setting = |((engine, force), all): ((&str, u64), Vec<&Done<'_>>)| {
        let values = |of: fn(&Done<'_>) -> f64| Quantiles::of(all.iter().map(|done| of(done)));
        let unconverged = all.iter().map(|done| done.result.unconverged_steps);
        SettingCost {
            engine: engine.to_owned(),
            stop_force_n: f64::from_bits(force),
            simulations: all.len(),
            simulate_s: values(|done| done.result.cpu_s.simulate),
            all_s: values(|done| done.cpu_s()),
            total_s: all.iter().map(|done| done.cpu_s()).sum(),
            newton_iterations: values(|done| done.result.newton_iterations as f64),
            steps: all.iter().map(|done| done.result.steps).sum(),
            unconverged_steps: unconverged.clone().sum(),
            unconverged_simulations: unconverged.filter(|steps| *steps > 0).count(),
        }
    };
    settings.into_iter().map(setting).collect()
}

fn estimate(timed: &[&Done<'_>]) -> Option<EstimateFacts> {
    let pair = |done: &&Done<'_>| [done.simulation.cost_s, done.cpu_s()];
    let pairs: Vec<[f64; 2]> = timed.iter().map(pair).filter(|p| p[0] > 0.0).collect();
    (!pairs.is_empty()).then(|| EstimateFacts {
        estimated_s: pairs.iter().map(|pair| pair[0]).sum(),
        found_s: pairs.iter().map(|pair| pair[1]).sum(),
        ratio: Quantiles::of(pairs.iter().map(|pair| pair[1] / pair[0])),
        correlation: correlation(&pairs),
    })
}

#[cfg(test)]
mod tests {
    use super::super::sample::{Sample, labelled};
    use super::*;

    #[test]
    fn costs_add_up_and_failures_have_none() {
        let sample = Sample::new(8);
        let mut gathered = labelled(&sample, &[true; 8]);
        gathered.done[7].result.cpu_s = CpuSeconds::default();
        gathered.done[6].result.stable = None;
        gathered.done[1].result.unconverged_steps = 3;
        let costs = costs(&gathered);
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
        assert!((estimate.found_s - 35.0).abs() < 1e-9);
        assert!((estimate.ratio.max - 2.0).abs() < 1e-9);
        assert!((estimate.correlation.unwrap() - 1.0).abs() < 1e-9);
    }

    #[test]
    fn nothing_costs_nothing() {
        let costs = costs(&Gathered::default());
        assert_eq!((costs.simulations, costs.per_core_hour), (0, None));
        assert_eq!(costs.estimate, None);
        assert!(costs.settings.is_empty());
    }
}
