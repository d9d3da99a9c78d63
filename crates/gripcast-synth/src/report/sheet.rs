//! Selects the grasps of the contact sheet.

use std::collections::BTreeMap;

use super::balance::fault;
use super::contact::InspectedSimulation;
use super::facts::Example;
use super::results::FinishedSimulation;
use gripcast_base::random::SeedStream;

/// Selects up to `count` results and returns their ids: round-robin over categories, and within a
/// category over objects, in an order that depends only on the seed and the names.
pub(super) fn choose<'a, 'p>(
    results: &[&'a FinishedSimulation<'p>],
    count: usize,
    seed: u64,
) -> Vec<&'a str> {
    let shuffle_key = |name: &str| SeedStream::named(seed, &format!("sheet {name}")).bits();
    let mut mixed: Vec<&'a FinishedSimulation<'p>> = results.to_vec();
    mixed.sort_by_key(|done| (shuffle_key(&done.simulation.id), &done.simulation.id));
    let mut by_object = numbered_by_group(mixed, |done| &done.object.name);
    by_object.sort_by_key(|(round, _)| *round);
    let by_object = by_object.into_iter().map(|(_, done)| done).collect();
    let mut by_category = numbered_by_group(by_object, |done| &done.object.category);
    by_category.sort_by_key(|(round, done)| (*round, shuffle_key(&done.object.category)));
    let chosen = by_category.into_iter().take(count);
    chosen.map(|(_, done)| &*done.simulation.id).collect()
}

/// Numbers the results within their groups.
fn numbered_by_group<'a, 'p>(
    results: Vec<&'a FinishedSimulation<'p>>,
    group: impl Fn(&'a FinishedSimulation<'p>) -> &'a str,
) -> Vec<(usize, &'a FinishedSimulation<'p>)> {
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    let mut numbered = Vec::with_capacity(results.len());
    for done in results {
        let count = counts.entry(group(done)).or_default();
        numbered.push((*count, done));
        *count += 1;
    }
    numbered
}

/// Returns the contact sheet: stable grasps first, then by category and name.
pub(super) fn examples(inspected: &[InspectedSimulation<'_>]) -> Vec<Example> {
    let mut shown: Vec<Example> = inspected.iter().filter_map(example).collect();
    shown.sort_by(|a, b| {
        let key = |one: &Example| (!one.stable, one.category.clone(), one.simulation.clone());
        key(a).cmp(&key(b))
    });
    shown
}

fn example(inspected: &InspectedSimulation<'_>) -> Option<Example> {
    let FinishedSimulation {
        simulation,
        object,
        result,
    } = inspected.done;
    Some(Example {
        simulation: simulation.id.to_string(),
        object: object.name.to_string(),
        category: object.category.clone(),
        material: object.material.clone(),
        fault: simulation.fault.map(|_| fault(inspected.done)),
        stop_force_n: simulation.stop_force_n,
        friction: simulation.friction_on(object),
        mass_kg: object.mass_kg,
        lifted_m: result.lifted_m,
        outcome: result.outcome.clone(),
        stable: inspected.stable,
        rendering: inspected.change.rendering,
        appearance: inspected.change.appearance.clone(),
        images: inspected.change.images.clone()?,
    })
}

#[cfg(test)]
mod tests {
    use super::super::sample::{Sample, labelled};
    use super::*;

    #[test]
    fn selection_is_round_robin_over_categories_and_objects() {
        let sample = Sample::new(12);
        let plan_results = labelled(&sample, &[true; 12]);
        let mut results: Vec<&FinishedSimulation<'_>> = plan_results.done.iter().collect();
        // Each object has its own category.
        let first = choose(&results, 4, 0);
        let boxes = first.iter().filter(|id| id.starts_with("box-0000"));
        assert_eq!(boxes.count(), 2, "{first:?}");
        results.reverse();
        assert_eq!(choose(&results, 4, 0), first, "the order does not matter");
        let others = (1..9).filter(|seed| choose(&results, 4, *seed) != first);
        assert!(others.count() > 4);
        // Nine results of one object and three of the other: the first two have both.
        results.retain(|done| done.simulation.grasp % 2 == 0 || done.simulation.grasp > 6);
        let two = choose(&results, 2, 3);
        assert_ne!(two[0][..8], two[1][..8], "{two:?}");
        assert_eq!(choose(&results, 99, 0).len(), results.len());
    }
}
