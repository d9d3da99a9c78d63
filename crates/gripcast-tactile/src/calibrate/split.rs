//! Which presses are fitted and which are only scored.

use rand::SeedableRng as _;
use rand::seq::SliceRandom as _;
use rand_pcg::Pcg64;

use super::press_file::PressList;
use super::press_read::{ReadOptions, none_usable};
use super::press_set::PressSet;
use gripcast_base::error::{Error, Result};

/// Which presses of a folder are fitted and which are only scored.
#[derive(Clone, Debug, PartialEq)]
pub enum Split {
    /// The first part of a random order of the usable presses is fitted, the rest is scored.
    Random {
        /// Fraction to fit, above 0, at most 1; at least one press is fitted.
        train_fraction: f64,
        /// Maximum number of presses to fit; the rest of the fraction is not used, so that the
        /// scored presses do not depend on it.
        max_fitted: Option<usize>,
        /// Seed of the order.
        seed: u64,
    },
    /// Presses named by file, file without suffix, number from 1 in the list, or range of numbers
    /// (`1-14`). An empty list means all that the other does not name.
    Named {
        /// Presses to fit.
        train: Vec<String>,
        /// Presses to score.
        test: Vec<String>,
    },
}

impl Split {
    /// Half of the presses is fitted.
    pub const HALF: Self = Self::Random {
        train_fraction: 0.5,
        max_fitted: None,
        seed: 0,
    };

    /// # Errors
    /// `Usage` if the fraction is out of range.
    fn check(&self) -> Result<()> {
        match self {
            Self::Random { train_fraction, .. }
                if !(*train_fraction > 0.0 && *train_fraction <= 1.0) =>
            {
                Err(Error::usage(format!(
                    "the fraction of presses to fit must be above 0 and at most 1, found \
                     {train_fraction}"
                )))
            }
            _ => Ok(()),
        }
    }

    /// Returns the positions in the list of the presses to fit and to score, if they are named.
    fn named(&self, list: &PressList) -> Result<Option<[Vec<usize>; 2]>> {
        let Self::Named { train, test } = self else {
            return Ok(None);
        };
        let [train, test] = [list.positions(train)?, list.positions(test)?];
        let others = |named: &[usize]| {
            let all = 0..list.presses.len();
            all.filter(|position| !named.contains(position)).collect()
        };
        match (train.is_empty(), test.is_empty()) {
            (true, true) => Err(Error::usage("no press is named to fit or to score")),
            (true, false) => Ok(Some([others(&test), test])),
            (false, true) => {
                let test = others(&train);
                Ok(Some([train, test]))
            }
            (false, false) => match train.iter().find(|position| test.contains(position)) {
                Some(&both) => Err(Error::usage(format!(
                    "{} is named both to fit and to score",
                    list.presses[both].file
                ))),
                None => Ok(Some([train, test])),
            },
        }
    }
}

/// Presses of a folder by their use.
#[derive(Clone, Debug)]
pub struct SplitPresses {
    /// The presses.
    pub set: PressSet,
    /// Indices of the presses to fit.
    pub train: Vec<usize>,
    /// Indices of the presses to score.
    pub held_out: Vec<usize>,
    /// Files that are neither fitted nor scored although nothing is wrong with them.
    pub unused: Vec<String>,
}

impl SplitPresses {
    /// Reads a folder. Presses that are named neither to fit nor to score are not read.
    ///
    /// # Errors
    /// Those of [`PressSet::read`]; `Usage` if the fraction is out of range, a name is unknown or a
    /// press is named twice; `Input` if none of the presses named to score is usable.
    pub fn read(options: &ReadOptions, split: &Split) -> Result<Self> {
        split.check()?;
        let list = PressList::read(&options.folder)?;
        let folder = options.folder.display();
        let Some([train, test]) = split.named(&list).map_err(|e| e.at(&folder))? else {
            let all: Vec<usize> = (0..list.presses.len()).collect();
            return Ok(Self::drawn(PressSet::read_at(options, &list, &all)?, split));
        };
        let mut positions: Vec<usize> = train.iter().chain(&test).copied().collect();
        positions.sort_unstable();
        let set = PressSet::read_at(options, &list, &positions)?;
        let held_out = set.indices_of(&test);
        if held_out.is_empty() && !test.is_empty() {
            let skipped = set.skipped.into_iter();
            let to_score = skipped.filter(|press| test.contains(&(press.number - 1)));
            return Err(none_usable(&to_score.collect::<Vec<_>>()).at(folder));
        }
        let unused = list.presses.iter().enumerate();
        let unused = unused.filter(|(position, _)| !positions.contains(position));
        Ok(Self {
            train: set.indices_of(&train),
            held_out,
            unused: unused.map(|(_, entry)| entry.file.clone()).collect(),
            set,
        })
    }

    fn drawn(set: PressSet, split: &Split) -> Self {
        let &Split::Random {
            train_fraction,
            max_fitted,
            seed,
        } = split
        else {
            return Self {
                set,
                train: Vec::new(),
                held_out: Vec::new(),
                unused: Vec::new(),
            };
        };
        let mut train: Vec<usize> = (0..set.presses.len()).collect();
        train.shuffle(&mut Pcg64::seed_from_u64(seed));
        let count = (train_fraction * train.len() as f64).round() as usize;
        let held_out = train.split_off(count.clamp(1, train.len()));
        let unused = train.split_off(max_fitted.unwrap_or(usize::MAX).clamp(1, train.len()));
        let unused = unused.iter().map(|i| set.presses[*i].file.clone());
        Self {
            unused: unused.collect(),
            set,
            train,
            held_out,
        }
    }
}
