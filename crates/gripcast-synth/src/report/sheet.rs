//! The contact sheet: which grasps are on it, and what is said of them.

use std::collections::BTreeMap;

use super::balance::fault;
use super::contact::Seen;
use super::facts::Example;
use super::gather::Done;
use gripcast_base::random::SeedStream;

/// Chooses up to `count` of some results: one of each category after the other, and in a category
/// one of each object after the other. Who is first follows from the seed and the names alone.
/// Ids in the order of the choice.
pub(super) fn choose<'a, 'p>(results: &[&'a Done<'p>], count: usize, seed: u64) -> Vec<&'a str> {
    let chance = |name: &str| SeedStream::named(seed, &format!("sheet {name}")).bits();
    let mut mixed: Vec<&'a Done<'p>> = results.to_vec();
    mixed.sort_by_key(|done| (chance(&done.simulation.id), &done.simulation.id));
    let mut by_object = in_turn(mixed, |done| &done.object.name);
    by_object.sort_by_key(|(turn, _)| *turn);
    let by_object = by_object.into_iter().map(|(_, done)| done).collect();
    let mut by_category = in_turn(by_object, |done| &done.object.category);
    by_category.sort_by_key(|(turn, done)| (*turn, chance(&done.object.category)));
    let chosen = by_category.into_iter().take(count);
    chosen.map(|(_, done)| &*done.simulation.id).collect()
}

/// Each result with how many of its group are before it.
fn in_turn<'a, 'p>(
    results: Vec<&'a Done<'p>>,
    group: impl Fn(&'a Done<'p>) -> &'a str,
) -> Vec<(usize, &'a Done<'p>)> {
    let mut turns: BTreeMap<&str, usize> = BTreeMap::new();
    let mut numbered = Vec::with_capacity(results.len());
    for done in results {
        let turn = turns.entry(group(done)).or_default();
        numbered.push((*turn, done));
        *turn += 1;
    }
    numbered
}

/// What is shown, held grasps first, then by category and name.
pub(super) fn examples(seen: &[Seen<'_>]) -> Vec<Example> {
    let mut shown: Vec<Example> = seen.iter().filter_map(example).collect();
    shown.sort_by(|a, b| {
        let key = |one: &Example| (!one.held, one.category.clone(), one.simulation.clone());
        key(a).cmp(&key(b))
    });
    shown
}

fn example(seen: &Seen<'_>) -> Option<Example> {
    let Done {
        simulation,
        object,
        result,
    } = seen.done;
    Some(Example {
        simulation: simulation.id.to_string(),
        object: object.name.to_string(),
        category: object.category.clone(),
        material: object.material.clone(),
        fault: simulation.fault.map(|_| fault(seen.done)),
        stop_force_n: simulation.stop_force_n,
        friction: object.friction,
        mass_kg: object.mass_kg,
        lifted_m: result.lifted_m,
        outcome: result.outcome.clone(),
        held: seen.held,
        rendering: seen.look.rendering,
        appearance: seen.look.appearance.clone(),
        images: seen.look.images.clone()?,
    })
}

#[cfg(test)]
mod tests {
    use super::super::sample::{Sample, labelled};
    use super::*;

    #[test]
    fn categories_take_turns_and_so_do_objects() {
        let sample = Sample::new(12);
        let gathered = labelled(&sample, &[true; 12]);
        let mut results: Vec<&Done<'_>> = gathered.done.iter().collect();
        // One of the boxes is alone in its category.
        let first = choose(&results, 4, 0);
        let boxes = first.iter().filter(|id| id.starts_with("box-0000"));
        assert_eq!(boxes.count(), 2, "{first:?}");
        results.reverse();
        assert_eq!(choose(&results, 4, 0), first, "the order does not matter");
        let others = (1..9).filter(|seed| choose(&results, 4, *seed) != first);
        assert!(others.count() > 4);
        // Nine of one object and three of the other: both are in the first two.
        results.retain(|done| done.simulation.grasp % 2 == 0 || done.simulation.grasp > 6);
        let two = choose(&results, 2, 3);
        assert_ne!(two[0][..8], two[1][..8], "{two:?}");
        assert_eq!(choose(&results, 99, 0).len(), results.len());
    }
}
