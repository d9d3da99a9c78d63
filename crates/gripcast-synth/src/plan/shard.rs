//! Shards: disjoint subsets of a plan for parallel processes.

use std::fmt;
use std::str::FromStr;

use super::{Plan, PlannedSimulation};
use gripcast_base::error::{Error, Result};
use gripcast_base::random::SeedStream;

/// Environment variables in which schedulers pass the index of a task, from 0.
pub const INDEX_VARIABLES: [&str; 4] = [
    "SLURM_ARRAY_TASK_ID",
    "JOB_COMPLETION_INDEX",
    "AWS_BATCH_JOB_ARRAY_INDEX",
    "PBS_ARRAY_INDEX",
];

/// Shard `index` (from 0) of `count`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    index: usize,
    count: usize,
}

impl Shard {
    /// The whole plan.
    pub const WHOLE: Self = Self { index: 0, count: 1 };

    /// Shard `index` of `count`.
    ///
    /// # Errors
    /// `Usage` unless `index` is below `count`.
    pub fn new(index: usize, count: usize) -> Result<Self> {
        if index < count {
            return Ok(Self { index, count });
        }
        Err(
            Error::usage(format!("shard {index}/{count} does not exist")).remedy(format!(
                "valid shards are 0/{count} to {}/{count}",
                count.max(1) - 1
            )),
        )
    }

    /// Parses `INDEX/COUNT`, or `/COUNT` with the index from `variable`, which reads the
    /// environment.
    ///
    /// # Errors
    /// `Usage` for other text, an index out of range, or a missing index.
    pub fn parse(text: &str, variable: impl Fn(&str) -> Option<String>) -> Result<Self> {
        let invalid = || {
            Error::usage(format!("invalid shard `{text}`"))
                .remedy("write INDEX/COUNT such as 0/8, or /8 if a scheduler passes the index")
        };
        let (index, count) = text.split_once('/').ok_or_else(invalid)?;
        let count = usize::from_str(count).map_err(|_| invalid())?;
        if !index.is_empty() {
            return Self::new(usize::from_str(index).map_err(|_| invalid())?, count);
        }
        let from_environment = INDEX_VARIABLES
            .iter()
            .find_map(|name| Some((name, variable(name)?)));
        let Some((name, value)) = from_environment else {
            return Err(
                Error::usage(format!("shard {text} has no index")).remedy(format!(
                    "write INDEX{text}, or set one of {}",
                    INDEX_VARIABLES.join(", ")
                )),
            );
        };
        let index = usize::from_str(value.trim()).map_err(|_| {
            Error::usage(format!("invalid array index `{value}` in {name}"))
                .remedy("array tasks are numbered from 0")
        })?;
        Self::new(index, count)
    }

    /// Selects the simulations of the shard, object by object in a random order that depends on the
    /// plan's seed: a plan is sorted by category, and what is finished of an interrupted run has to
    /// be a sample of it. Shards have equal estimated costs: each simulation, the most expensive
    /// first, goes to the shard with the lowest cost so far.
    pub fn select(self, plan: &Plan) -> Vec<&PlannedSimulation> {
        let all = &plan.simulations;
        let mut order: Vec<usize> = (0..all.len()).collect();
        order.sort_by(|a, b| all[*b].cost_s.total_cmp(&all[*a].cost_s).then(a.cmp(b)));
        let mut load = vec![0.0_f64; self.count];
        let mut mine = Vec::new();
        for index in order {
            let lightest = (0..self.count).min_by(|a, b| load[*a].total_cmp(&load[*b]));
            let Some(lightest) = lightest else { break };
            load[lightest] += all[index].cost_s;
            if lightest == self.index {
                mine.push(index);
            }
        }
        mine.sort_by_cached_key(|&index| {
            let object = format!("order of {}", all[index].object);
            (SeedStream::named(plan.header.seed, &object).bits(), index)
        });
        mine.into_iter().map(|index| &all[index]).collect()
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index, self.count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::sample_plan;
    use gripcast_base::files::SimulationId;

    fn nothing(_: &str) -> Option<String> {
        None
    }

    #[test]
    fn index_comes_from_text_or_scheduler() {
        assert_eq!(Shard::parse("2/8", nothing).unwrap().to_string(), "2/8");
        let slurm = |name: &str| (name == "SLURM_ARRAY_TASK_ID").then(|| "3".to_owned());
        assert_eq!(Shard::parse("/8", slurm).unwrap().to_string(), "3/8");
        let text = |shard: &str, index: &str| {
            let index = index.to_owned();
            let variable = |name: &str| (name == "JOB_COMPLETION_INDEX").then(|| index.clone());
            Shard::parse(shard, variable).unwrap_err().to_string()
        };
        assert!(
            text("/8", "eight").contains("invalid array index `eight` in JOB_COMPLETION_INDEX")
        );
        assert!(text("/8", "8").contains("8/8 does not exist"));
        assert!(text("8/8", "0").contains("does not exist"));
        assert!(text("0/0", "0").contains("does not exist"));
        assert!(text("half", "0").contains("invalid shard `half`"));
        let error = Shard::parse("/8", nothing).unwrap_err().to_string();
        assert!(error.contains("has no index"), "{error}");
    }

    #[test]
    fn half_a_run_has_half_of_each_category_and_whole_objects() {
        let mut plan = sample_plan(200);
        for (number, simulation) in plan.simulations.iter_mut().enumerate() {
            let name = format!("{}-{:04}", ["block", "tube"][number / 100], number / 2);
            simulation.object = SimulationId::parse(&name).unwrap();
        }
        let order = Shard::WHOLE.select(&plan);
        assert_eq!(order, Shard::WHOLE.select(&plan));
        for pair in order.chunks(2) {
            assert_eq!(pair[0].object, pair[1].object);
        }
        let half = &order[..100];
        let tubes = half
            .iter()
            .filter(|s| s.object.as_str().starts_with("tube"));
        assert!((35..=65).contains(&tubes.count()));
    }

    #[test]
    fn shards_are_disjoint_complete_and_balanced() {
        let plan = sample_plan(40);
        for count in [1, 3, 7, 64] {
            let mut seen = Vec::new();
            let mut costs = Vec::new();
            for index in 0..count {
                let shard = Shard::new(index, count).unwrap().select(&plan);
                costs.push(shard.iter().map(|s| s.cost_s).sum::<f64>());
                seen.extend(shard.iter().map(|s| &s.id));
            }
            seen.sort();
            let mut all: Vec<_> = plan.simulations.iter().map(|s| &s.id).collect();
            all.sort();
            assert_eq!(seen, all, "{count}");
            let [min, max] =
                [f64::min, f64::max].map(|pick| costs.iter().copied().reduce(pick).unwrap());
            let largest = plan
                .simulations
                .iter()
                .map(|s| s.cost_s)
                .fold(0.0, f64::max);
            assert!(max - min <= largest, "{count}: {costs:?}");
        }
    }
}
