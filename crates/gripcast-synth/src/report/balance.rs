//! Labels by what may decide them.

use std::collections::{BTreeMap, BTreeSet};

use super::facts::{BalanceGroup, BalanceTable, Labels};
use super::gather::{Done, Gathered};

/// Limits between groups of friction coefficients.
const FRICTION: [f64; 5] = [0.3, 0.4, 0.5, 0.6, 0.8];
/// Limits between groups of masses, kg.
const MASS_KG: [f64; 6] = [0.02, 0.05, 0.1, 0.15, 0.2, 0.5];

/// Place of a group in its table, and its name.
type Key = (i64, String);

/// What a table's groups are made by, with its unit, and how.
type By = (&'static str, fn(&Done<'_>) -> Key);

const TABLES: [By; 6] = [
    ("force, N", |done| force(done.simulation.stop_force_n)),
    ("departure of the grasp", |done| (0, fault(done))),
    ("category", |done| (0, done.object.category.clone())),
    ("material", |done| (0, done.object.material.clone())),
    ("friction", |done| bin(done.object.friction, &FRICTION, 1.0)),
    ("mass, g", |done| bin(done.object.mass_kg, &MASS_KG, 1e3)),
];

/// All tables; `chosen`: the simulations of the dataset, where there is one.
pub(super) fn balance(
    gathered: &Gathered<'_>,
    chosen: Option<&BTreeSet<String>>,
) -> Vec<BalanceTable> {
    let table = |(by, key): &By| {
        let mut groups: BTreeMap<Key, [Labels; 2]> = BTreeMap::new();
        for (done, held) in gathered.labelled() {
            let [results, dataset] = groups.entry(key(done)).or_default();
            results.note(held);
            if chosen.is_some_and(|chosen| chosen.contains(&*done.simulation.id)) {
                dataset.note(held);
            }
        }
        let group = |((_, name), [results, dataset]): (Key, [Labels; 2])| BalanceGroup {
            name,
            results,
            dataset: chosen.map(|_| dataset),
        };
        BalanceTable {
            by: (*by).to_owned(),
            groups: groups.into_iter().map(group).collect(),
        }
    };
    TABLES.iter().map(table).collect()
}

fn force(force_n: f64) -> Key {
    // Forces are far below 1e9 N.
    ((1e6 * force_n) as i64, format!("{force_n}"))
}

/// The fault in words.
pub(super) fn fault(done: &Done<'_>) -> String {
    match done.simulation.fault {
        Some(fault) => fault.name().replace('_', " "),
        None => "given".to_owned(),
    }
}

/// The group of a value: at a limit it is in the group below, as masses end at the paper's 200 g.
fn bin(value: f64, limits: &[f64], unit: f64) -> Key {
    let at = limits.partition_point(|limit| *limit < value);
    let show = |limit: &f64| {
        let shown = limit * unit;
        // Limits in other units are not quite round.
        format!("{}", (shown * 1e6).round() / 1e6)
    };
    let below = at.checked_sub(1).and_then(|at| limits.get(at)).map(show);
    let name = match (below, limits.get(at).map(show)) {
        (Some(low), Some(high)) => format!("{low} to {high}"),
        (Some(low), None) => format!("above {low}"),
        (None, Some(high)) => format!("up to {high}"),
        (None, None) => String::new(),
    };
    (at as i64, name)
}

#[cfg(test)]
mod tests {
    use super::super::sample::{Sample, labelled};
    use super::*;

    #[test]
    fn bins_have_their_limits() {
        assert_eq!(bin(0.02, &MASS_KG, 1e3), (0, "up to 20".into()));
        assert_eq!(bin(0.0201, &MASS_KG, 1e3), (1, "20 to 50".into()));
        assert_eq!(bin(0.2, &MASS_KG, 1e3), (4, "150 to 200".into()));
        assert_eq!(bin(0.9, &MASS_KG, 1e3), (6, "above 500".into()));
        assert_eq!(bin(0.35, &FRICTION, 1.0), (1, "0.3 to 0.4".into()));
    }

    #[test]
    fn labels_are_counted_by_group_and_the_dataset_apart() {
        let sample = Sample::new(8);
        let held = [true, true, true, false, false, true, false, false];
        let gathered = labelled(&sample, &held);
        let chosen: BTreeSet<String> = ["box-0000-00-10n", "box-0001-03-40n"]
            .map(str::to_owned)
            .into();
        let tables = balance(&gathered, Some(&chosen));
        let force = &tables[0];
        assert_eq!(force.by, "force, N");
        let names: Vec<&str> = force.groups.iter().map(|g| &*g.name).collect();
        assert_eq!(names, ["10", "40"], "by number, not by letter");
        // Even numbers are at 10 N.
        assert_eq!(force.groups[0].results, Labels { held: 2, lost: 2 });
        assert_eq!(force.groups[1].results, Labels { held: 2, lost: 2 });
        let in_dataset = |k: usize| force.groups[k].dataset.unwrap();
        assert_eq!(in_dataset(0), Labels { held: 1, lost: 0 });
        assert_eq!(in_dataset(1), Labels { held: 0, lost: 1 });
        for table in &tables {
            let all: usize = table.groups.iter().map(|g| g.results.all()).sum();
            assert_eq!(all, 8, "{}", table.by);
        }
        assert_eq!(balance(&gathered, None)[0].groups[0].dataset, None);
    }
}
