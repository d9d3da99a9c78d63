//! Label counts by attributes that may predict the label.

use std::collections::{BTreeMap, BTreeSet};

use super::facts::{BalanceGroup, BalanceTable, LabelCounts};
use super::results::{FinishedSimulation, PlanResults};

/// Bin edges of friction coefficients.
const FRICTION: [f64; 5] = [0.3, 0.4, 0.5, 0.6, 0.8];
/// Bin edges of masses, kg.
const MASS_KG: [f64; 6] = [0.02, 0.05, 0.1, 0.15, 0.2, 0.5];

/// Sort key of a group, and its name.
type Key = (i64, String);

/// Attribute of a table with its unit, and the group of a simulation.
type Attribute = (&'static str, fn(&FinishedSimulation<'_>) -> Key);

const TABLES: [Attribute; 6] = [
    ("force, N", |done| force(done.simulation.stop_force_n)),
    ("grasp fault", |done| (0, fault(done))),
    ("category", |done| (0, done.object.category.clone())),
    ("material", |done| (0, done.object.material.clone())),
    ("friction", |done| {
        bin(done.simulation.friction_on(done.object), &FRICTION, 1.0)
    }),
    ("mass, g", |done| bin(done.object.mass_kg, &MASS_KG, 1e3)),
];

/// Computes all tables; `chosen` are the simulations of the dataset, if there is one.
pub(super) fn balance(
    plan_results: &PlanResults<'_>,
    chosen: Option<&BTreeSet<String>>,
) -> Vec<BalanceTable> {
    let table = |(by, key): &Attribute| {
        let mut groups: BTreeMap<Key, [LabelCounts; 2]> = BTreeMap::new();
        for (done, stable) in plan_results.labelled() {
            let [results, dataset] = groups.entry(key(done)).or_default();
            results.add(stable);
            if chosen.is_some_and(|chosen| chosen.contains(&*done.simulation.id)) {
                dataset.add(stable);
            }
        }
        let group = |((_, name), [results, dataset]): (Key, [LabelCounts; 2])| BalanceGroup {
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

/// Returns the fault in words.
pub(super) fn fault(done: &FinishedSimulation<'_>) -> String {
    match done.simulation.fault {
        Some(fault) => fault.name().replace('_', " "),
        None => "given".to_owned(),
    }
}

/// Returns the bin of a value. Bins include their upper edge, since masses end at the paper's 200
/// g.
fn bin(value: f64, edges: &[f64], unit: f64) -> Key {
    let index = edges.partition_point(|edge| *edge < value);
    let show = |edge: &f64| {
        // Converted edges are not exactly round.
        format!("{}", (edge * unit * 1e6).round() / 1e6)
    };
    let below = index.checked_sub(1).and_then(|below| edges.get(below));
    let name = match (below.map(show), edges.get(index).map(show)) {
        (Some(low), Some(high)) => format!("{low} to {high}"),
        (Some(low), None) => format!("above {low}"),
        (None, Some(high)) => format!("up to {high}"),
        (None, None) => String::new(),
    };
    (index as i64, name)
}

#[cfg(test)]
mod tests {
    use super::super::sample::{Sample, labelled};
    use super::*;

    #[test]
    fn bins_include_their_upper_edge() {
        assert_eq!(bin(0.02, &MASS_KG, 1e3), (0, "up to 20".into()));
        assert_eq!(bin(0.0201, &MASS_KG, 1e3), (1, "20 to 50".into()));
        assert_eq!(bin(0.2, &MASS_KG, 1e3), (4, "150 to 200".into()));
        assert_eq!(bin(0.9, &MASS_KG, 1e3), (6, "above 500".into()));
        assert_eq!(bin(0.35, &FRICTION, 1.0), (1, "0.3 to 0.4".into()));
    }

    #[test]
    fn labels_are_counted_by_group_and_dataset() {
        let sample = Sample::new(8);
        let stable = [true, true, true, false, false, true, false, false];
        let plan_results = labelled(&sample, &stable);
        let chosen: BTreeSet<String> = ["box-0000-00-10n", "box-0001-03-40n"]
            .map(str::to_owned)
            .into();
        let tables = balance(&plan_results, Some(&chosen));
        let force = &tables[0];
        assert_eq!(force.by, "force, N");
        let names: Vec<&str> = force.groups.iter().map(|g| &*g.name).collect();
        assert_eq!(names, ["10", "40"], "by number, not by letter");
        // Even numbers are at 10 N.
        assert_eq!(force.groups[0].results, LabelCounts { stable: 2, slip: 2 });
        assert_eq!(force.groups[1].results, LabelCounts { stable: 2, slip: 2 });
        let in_dataset = |k: usize| force.groups[k].dataset.unwrap();
        assert_eq!(in_dataset(0), LabelCounts { stable: 1, slip: 0 });
        assert_eq!(in_dataset(1), LabelCounts { stable: 0, slip: 1 });
        for table in &tables {
            let all: usize = table.groups.iter().map(|g| g.results.total()).sum();
            assert_eq!(all, 8, "{}", table.by);
        }
        assert_eq!(balance(&plan_results, None)[0].groups[0].dataset, None);
    }
}
