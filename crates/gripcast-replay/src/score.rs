//! Scores of an engine: how often it agrees with reality, for several choices of the setting.

use std::collections::BTreeMap;

use super::report::{CellScore, Confusion, Proportion, Score, Scores, Setting};

/// Labels of all grasps at all settings of one engine.
#[derive(Clone, Debug)]
pub struct OutcomeTable<'a> {
    /// Friction coefficients.
    pub frictions: &'a [f64],
    /// Forces, N.
    pub forces_n: &'a [f64],
    /// Object of each grasp.
    pub objects: Vec<&'a str>,
    /// Label of each grasp in reality: stable or slip.
    pub real: Vec<bool>,
    /// Label of each grasp in simulation, by friction, then force; none without an outcome.
    pub simulated: Vec<Vec<Option<bool>>>,
}

/// Scores, and the chosen setting of each grasp.
#[derive(Clone, Debug)]
pub struct Scoring {
    /// The scores.
    pub scores: Scores,
    /// Index of each grasp's setting by the paper's choice.
    pub chosen: Vec<usize>,
    /// Whether each grasp agrees at that setting; none without an outcome.
    pub agrees: Vec<Option<bool>>,
    /// The same at the setting that is chosen without that grasp.
    pub agrees_left_out: Vec<Option<bool>>,
}

/// A friction for all objects and a force for each.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct Choice {
    friction: usize,
    force: BTreeMap<String, usize>,
}

impl<'a> OutcomeTable<'a> {
    /// Returns all settings, friction by friction.
    pub fn settings(&self) -> Vec<Setting> {
        let forces = |friction: f64| {
            let setting = move |force_n: &f64| Setting {
                friction,
                force_n: *force_n,
            };
            self.forces_n.iter().map(setting)
        };
        self.frictions.iter().flat_map(|f| forces(*f)).collect()
    }

    /// Whether a grasp agrees with reality at a setting.
    pub fn agrees(&self, grasp: usize, setting: usize) -> Option<bool> {
        self.simulated[grasp][setting].map(|stable| stable == self.real[grasp])
    }

    /// Scores the engine.
    ///
    /// The paper's choice (A.2, A.4) is the friction with the most agreeing grasps if each object
    /// has its best force, then that force for each object. Leaving one out repeats the choice
    /// without the grasp. Ties go to the first setting.
    pub fn score(&self) -> Scoring {
        let all: Vec<usize> = (0..self.real.len()).collect();
        let best = self.choose(&all);
        let setting_of = |choice: &Choice, grasp: usize| {
            let force = choice.force.get(self.objects[grasp]).copied().unwrap_or(0);
            choice.friction * self.forces_n.len() + force
        };
        let chosen: Vec<usize> = all.iter().map(|g| setting_of(&best, *g)).collect();
        let agreement = |setting: &dyn Fn(usize) -> usize| -> Vec<Option<bool>> {
            all.iter().map(|g| self.agrees(*g, setting(*g))).collect()
        };
        let others = |is_other: &dyn Fn(usize) -> bool| -> Vec<usize> {
            all.iter().copied().filter(|g| is_other(*g)).collect()
        };
        let agrees = agreement(&|grasp| chosen[grasp]);
        let agrees_left_out =
            agreement(&|grasp| setting_of(&self.choose(&others(&|other| other != grasp)), grasp));
        let best_setting = self.best_setting(&all);
        let without_object = agreement(&|grasp| {
            let object = self.objects[grasp];
            self.best_setting(&others(&|other| self.objects[other] != object))
        });
        let settings = self.settings();
        let scores = Scores {
            paper: self.proportions(&agrees),
            leave_one_out: self.proportions(&agrees_left_out),
            one_setting: self.proportions(&agreement(&|_| best_setting)),
            leave_object_out: self.proportions(&without_object),
            friction: self.frictions.get(best.friction).copied().unwrap_or(0.0),
            force_n: best
                .force
                .iter()
                .map(|(object, force)| (object.clone(), self.forces_n[*force]))
                .collect(),
            best_setting: settings.get(best_setting).copied().unwrap_or_default(),
            confusion: self.confusion(&chosen),
            cells: self.cells(&settings),
        };
        Scoring {
            scores,
            chosen,
            agrees,
            agrees_left_out,
        }
    }

    fn object_names(&self) -> Vec<&'a str> {
        let mut names = self.objects.clone();
        names.sort_unstable();
        names.dedup();
        names
    }

    /// Counts the grasps of `among` that agree at a setting.
    fn agreeing(&self, among: &[usize], setting: usize) -> usize {
        let agree = |g: &&usize| self.agrees(**g, setting) == Some(true);
        among.iter().filter(agree).count()
    }

    fn choose(&self, among: &[usize]) -> Choice {
        let names = self.object_names();
        let choices = (0..self.frictions.len()).map(|friction| {
            let mut agreeing = 0;
            let mut force = BTreeMap::new();
            for name in &names {
                let of_object = among.iter().copied().filter(|g| self.objects[*g] == *name);
                let of_object: Vec<usize> = of_object.collect();
                let counts = (0..self.forces_n.len())
                    .map(|i| self.agreeing(&of_object, friction * self.forces_n.len() + i));
                let (index, count) = first_max(counts);
                agreeing += count;
                force.insert((*name).to_owned(), index);
            }
            (agreeing, Choice { friction, force })
        });
        let choices: Vec<(usize, Choice)> = choices.collect();
        let (index, _) = first_max(choices.iter().map(|(agreeing, _)| *agreeing));
        let chosen = choices.into_iter().nth(index);
        chosen.map(|(_, choice)| choice).unwrap_or_default()
    }

    fn best_setting(&self, among: &[usize]) -> usize {
        let settings = self.frictions.len() * self.forces_n.len();
        first_max((0..settings).map(|setting| self.agreeing(among, setting))).0
    }

    fn proportions(&self, agrees: &[Option<bool>]) -> Score {
        let count = |object: Option<&str>| {
            let grasps = self.objects.iter().zip(agrees);
            let grasps = grasps.filter(|(name, _)| object.is_none_or(|object| object == **name));
            let with_outcome: Vec<bool> = grasps.filter_map(|(_, agrees)| *agrees).collect();
            let agree = with_outcome.iter().filter(|agrees| **agrees).count();
            Proportion::new(agree, with_outcome.len())
        };
        let by_object: BTreeMap<String, Proportion> = self
            .object_names()
            .iter()
            .map(|name| ((*name).to_owned(), count(Some(name))))
            .collect();
        let counted: Vec<f64> = by_object
            .values()
            .filter(|proportion| proportion.n > 0)
            .map(|proportion| proportion.fraction)
            .collect();
        Score {
            all: count(None),
            mean: counted.iter().sum::<f64>() / counted.len().max(1) as f64,
            by_object,
        }
    }

    fn confusion(&self, chosen: &[usize]) -> Confusion {
        let mut counts = Confusion::default();
        for (grasp, setting) in chosen.iter().enumerate() {
            match (self.simulated[grasp][*setting], self.real[grasp]) {
                (Some(true), true) => counts.true_stable += 1,
                (Some(true), false) => counts.false_stable += 1,
                (Some(false), false) => counts.true_slip += 1,
                (Some(false), true) => counts.false_slip += 1,
                (None, _) => {}
            }
        }
        counts
    }

    fn cells(&self, settings: &[Setting]) -> Vec<CellScore> {
        let mut cells = Vec::new();
        for name in self.object_names() {
            let grasps = (0..self.real.len()).filter(|g| self.objects[*g] == name);
            let grasps: Vec<usize> = grasps.collect();
            for (index, setting) in settings.iter().enumerate() {
                let found: Vec<Option<bool>> =
                    grasps.iter().map(|g| self.agrees(*g, index)).collect();
                let n = found.iter().flatten().count();
                cells.push(CellScore {
                    object: name.to_owned(),
                    setting: *setting,
                    agree: self.agreeing(&grasps, index),
                    n,
                    without_outcome: grasps.len() - n,
                });
            }
        }
        cells
    }
}

/// Index and value of the first maximum; zeros without counts.
fn first_max(counts: impl Iterator<Item = usize>) -> (usize, usize) {
    let mut best = (0, 0);
    for (index, count) in counts.enumerate() {
        if count > best.1 {
            best = (index, count);
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRICTIONS: [f64; 2] = [0.2, 0.4];
    const FORCES: [f64; 2] = [20.0, 40.0];

    /// Two objects of three grasps; settings (0.2, 20), (0.2, 40), (0.4, 20), (0.4, 40).
    fn sample() -> OutcomeTable<'static> {
        let row = |text: &str| {
            text.chars()
                .map(|c| match c {
                    '1' => Some(true),
                    '0' => Some(false),
                    _ => None,
                })
                .collect::<Vec<Option<bool>>>()
        };
        OutcomeTable {
            frictions: &FRICTIONS,
            forces_n: &FORCES,
            objects: vec!["a", "a", "a", "b", "b", "b"],
            real: vec![true, true, false, true, false, false],
            simulated: ["0011", "0110", "0001", "1001", "0101", "010-"]
                .map(row)
                .to_vec(),
        }
    }

    /// Friction 0.2: a agrees with 1, 2 grasps; b with 3, 0. Friction 0.4: a 3, 1; b 2, 1.
    #[test]
    fn paper_choice_is_one_friction_and_a_force_per_object() {
        let found = sample().score();
        let scores = &found.scores;
        assert_eq!(scores.friction, 0.2);
        assert_eq!(scores.force_n["a"], 40.0);
        assert_eq!(scores.force_n["b"], 20.0);
        assert_eq!((scores.paper.all.agree, scores.paper.all.n), (5, 6));
        assert_eq!(scores.paper.by_object["b"].fraction, 1.0);
        assert!((scores.paper.mean - 0.5 * (2.0 / 3.0 + 1.0)).abs() < 1e-12);
        assert_eq!(found.chosen, [1, 1, 1, 0, 0, 0]);
    }

    #[test]
    fn leave_one_out_ignores_the_scored_grasp() {
        let mut outcomes = sample();
        // Without the grasp of a, both frictions tie, and the first one disagrees with it.
        outcomes.objects = vec!["a", "b", "b"];
        outcomes.real = vec![true, false, false];
        let keep = [0, 4, 5];
        outcomes.simulated = keep.map(|i| sample().simulated[i].clone()).to_vec();
        let found = outcomes.score();
        assert_eq!(found.scores.paper.by_object["a"].agree, 1);
        assert_eq!(found.scores.leave_one_out.by_object["a"].agree, 0);
    }

    #[test]
    fn cases_without_outcome_are_counted_separately() {
        let found = sample().score();
        let cell = found.scores.cells.last().unwrap();
        assert_eq!(cell.object, "b");
        assert_eq!((cell.agree, cell.n, cell.without_outcome), (1, 2, 1));
        let confusion = found.scores.confusion;
        assert_eq!(
            confusion,
            Confusion {
                true_stable: 2,
                false_stable: 0,
                true_slip: 3,
                false_slip: 1
            }
        );
    }

    #[test]
    fn leave_object_out_ignores_the_scored_object() {
        let found = sample().score();
        // (0.4, 20) agrees with 3 of a and 2 of b.
        assert_eq!(
            found.scores.best_setting,
            Setting {
                friction: 0.4,
                force_n: 20.0
            }
        );
        assert_eq!(found.scores.one_setting.all.agree, 5);
        // Without a, b alone would take (0.2, 20), which agrees with 1 of a; without b, (0.4, 20).
        let left_out = &found.scores.leave_object_out.by_object;
        assert_eq!((left_out["a"].agree, left_out["b"].agree), (1, 2));
    }
}
