//! How often an engine ends as reality did, with settings chosen in several ways.

use std::collections::BTreeMap;

use super::report::{CellScore, Confusion, Proportion, Score, Scores, Setting};

/// What an engine made of all grasps at all settings.
#[derive(Clone, Debug)]
pub struct Outcomes<'a> {
    /// Friction coefficients that were tried.
    pub frictions: &'a [f64],
    /// Forces that were tried, N.
    pub forces_n: &'a [f64],
    /// Object of each grasp.
    pub objects: Vec<&'a str>,
    /// Whether each grasp was stable in reality.
    pub real: Vec<bool>,
    /// Whether each was stable in simulation, by friction, then force; none without outcome.
    pub simulated: Vec<Vec<Option<bool>>>,
}

/// Scores with what was chosen for each grasp.
#[derive(Clone, Debug)]
pub struct Scored {
    /// The scores.
    pub scores: Scores,
    /// Setting of each grasp by the paper's way: an index into the settings.
    pub chosen: Vec<usize>,
    /// Whether each grasp agrees at that setting; none without outcome.
    pub agrees: Vec<Option<bool>>,
    /// The same with the setting that was chosen without that grasp.
    pub agrees_left_out: Vec<Option<bool>>,
}

/// A friction for all objects and a force for each.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Choice {
    friction: usize,
    force: BTreeMap<String, usize>,
}

impl<'a> Outcomes<'a> {
    /// All settings, friction by friction.
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
    /// The paper's way (A.2, A.4): the friction with most agreeing grasps when each object has its
    /// best force, then that force for each object. Leaving one out chooses again without the
    /// grasp. Ties go to what comes first, so the order of the settings counts.
    pub fn score(&self) -> Scored {
        let all: Vec<usize> = (0..self.real.len()).collect();
        let best = self.choose(&all);
        let at = |choice: &Choice, grasp: usize| {
            let force = choice.force.get(self.objects[grasp]).copied().unwrap_or(0);
            choice.friction * self.forces_n.len() + force
        };
        let chosen: Vec<usize> = all.iter().map(|g| at(&best, *g)).collect();
        let agrees: Vec<Option<bool>> = all.iter().map(|g| self.agrees(*g, chosen[*g])).collect();
        let agrees_left_out: Vec<Option<bool>> = all
            .iter()
            .map(|&grasp| {
                let others: Vec<usize> = all.iter().copied().filter(|g| *g != grasp).collect();
                self.agrees(grasp, at(&self.choose(&others), grasp))
            })
            .collect();
        let one = self.best_setting(&all);
        let with_one: Vec<Option<bool>> = all.iter().map(|g| self.agrees(*g, one)).collect();
        let without_object: Vec<Option<bool>> = all
            .iter()
            .map(|&grasp| {
                let others = all.iter().copied();
                let others = others.filter(|g| self.objects[*g] != self.objects[grasp]);
                self.agrees(grasp, self.best_setting(&others.collect::<Vec<_>>()))
            })
            .collect();
        let settings = self.settings();
        let scores = Scores {
            paper: self.proportions(&agrees),
            leave_one_out: self.proportions(&agrees_left_out),
            one_setting: self.proportions(&with_one),
            leave_object_out: self.proportions(&without_object),
            friction: self.frictions.get(best.friction).copied().unwrap_or(0.0),
            force_n: best
                .force
                .iter()
                .map(|(object, force)| (object.clone(), self.forces_n[*force]))
                .collect(),
            one: settings.get(one).copied().unwrap_or(Setting {
                friction: 0.0,
                force_n: 0.0,
            }),
            confusion: self.confusion(&chosen),
            cells: self.cells(&settings),
        };
        Scored {
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

    /// Grasps of `among` that agree at a setting.
    fn agreeing(&self, among: &[usize], setting: usize) -> usize {
        let agree = |g: &&usize| self.agrees(**g, setting) == Some(true);
        among.iter().filter(agree).count()
    }

    fn choose(&self, among: &[usize]) -> Choice {
        let names = self.object_names();
        let choices = (0..self.frictions.len()).map(|friction| {
            let mut right = 0;
            let mut force = BTreeMap::new();
            for name in &names {
                let of_object = among.iter().copied().filter(|g| self.objects[*g] == *name);
                let of_object: Vec<usize> = of_object.collect();
                let counts = (0..self.forces_n.len())
                    .map(|i| self.agreeing(&of_object, friction * self.forces_n.len() + i));
                let (index, count) = first_most(counts);
                right += count;
                force.insert((*name).to_owned(), index);
            }
            (right, Choice { friction, force })
        });
        let choices: Vec<(usize, Choice)> = choices.collect();
        let (index, _) = first_most(choices.iter().map(|(right, _)| *right));
        choices.into_iter().nth(index).map_or(
            Choice {
                friction: 0,
                force: BTreeMap::new(),
            },
            |(_, choice)| choice,
        )
    }

    fn best_setting(&self, among: &[usize]) -> usize {
        let settings = self.frictions.len() * self.forces_n.len();
        first_most((0..settings).map(|setting| self.agreeing(among, setting))).0
    }

    fn proportions(&self, agrees: &[Option<bool>]) -> Score {
        let count = |object: Option<&str>| {
            let mine = self.objects.iter().zip(agrees);
            let mine = mine.filter(|(name, _)| object.is_none_or(|object| object == **name));
            let with_outcome: Vec<bool> = mine.filter_map(|(_, agrees)| *agrees).collect();
            let agree = with_outcome.iter().filter(|agrees| **agrees).count();
            Proportion::of(agree, with_outcome.len())
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

/// Place and value of the first of the largest counts; zeros if there is none.
fn first_most(counts: impl Iterator<Item = usize>) -> (usize, usize) {
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
    fn sample() -> Outcomes<'static> {
        let row = |text: &str| {
            text.chars()
                .map(|c| match c {
                    '1' => Some(true),
                    '0' => Some(false),
                    _ => None,
                })
                .collect::<Vec<Option<bool>>>()
        };
        Outcomes {
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
    fn the_paper_chooses_one_friction_and_a_force_for_each_object() {
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
    fn a_grasp_has_no_say_in_its_own_setting() {
        let mut outcomes = sample();
        // Without the grasp of a, both frictions are as good, and the first is the wrong one for it.
        outcomes.objects = vec!["a", "b", "b"];
        outcomes.real = vec![true, false, false];
        let keep = [0, 4, 5];
        outcomes.simulated = keep.map(|i| sample().simulated[i].clone()).to_vec();
        let found = outcomes.score();
        assert_eq!(found.scores.paper.by_object["a"].agree, 1);
        assert_eq!(found.scores.leave_one_out.by_object["a"].agree, 0);
    }

    #[test]
    fn cases_without_outcome_are_not_counted_but_told() {
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
    fn one_setting_is_shared_and_chosen_without_the_object() {
        let found = sample().score();
        // (0.4, 20) agrees with 3 of a and 2 of b.
        assert_eq!(
            found.scores.one,
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
