//! Fractions of the splits of a dataset, and assignment of groups to splits.

use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use super::shard_name;
use gripcast_base::error::{Error, Result};

/// Tolerance of the fractions' sum.
const SUM_TOLERANCE: f64 = 1e-6;

/// Splits of a dataset and their fractions: `train=0.8,validation=0.1,test=0.1`, or `test`.
///
/// Fractions are above 0 and sum to 1; in JSON an object of fractions by name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(into = "BTreeMap<String, f64>", try_from = "BTreeMap<String, f64>")]
pub struct SplitFractions(BTreeMap<String, f64>);

/// A group of grasps that is assigned to one split as a whole.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SplitGroup {
    /// Stratum, each of which is divided by the fractions.
    pub stratum: String,
    /// Number of grasps.
    pub size: usize,
}

impl SplitFractions {
    /// 80 % train, 10 % validation, 10 % test.
    pub fn standard() -> Self {
        let splits = [("train", 0.8), ("validation", 0.1), ("test", 0.1)];
        Self(
            splits
                .map(|(name, fraction)| (name.to_owned(), fraction))
                .into(),
        )
    }

    /// Everything in one split.
    ///
    /// # Errors
    /// `Usage` for an invalid name.
    pub fn single(name: &str) -> Result<Self> {
        Self::new(BTreeMap::from([(name.to_owned(), 1.0)]))
    }

    /// Names of the splits.
    pub fn names(&self) -> impl Iterator<Item = &String> {
        self.0.keys()
    }

    /// Assigns each group to a split, so that the splits get their fractions of each stratum and of
    /// the whole as nearly as possible. Groups are taken in the order of decreasing size, equal
    /// ones in random order; each goes to the split with the largest deficit.
    pub fn assign(
        &self,
        groups: &BTreeMap<String, SplitGroup>,
        seed: u64,
    ) -> BTreeMap<String, String> {
        let mut strata: BTreeMap<&String, Vec<(&String, usize)>> = BTreeMap::new();
        for (name, group) in groups {
            let members = strata.entry(&group.stratum).or_default();
            members.push((name, group.size));
        }
        let mut assigned = BTreeMap::new();
        let zero = || self.names().map(|split| (split, 0.0)).collect();
        let mut total: BTreeMap<&String, f64> = zero();
        for mut members in strata.into_values() {
            members.sort_by_cached_key(|(name, size)| (Reverse(*size), random_key(seed, name)));
            let all: usize = members.iter().map(|(_, size)| size).sum();
            let mut here: BTreeMap<&String, f64> = zero();
            let whole = total.values().sum::<f64>() + all as f64;
            for (name, size) in members {
                let deficit = |split: &String, fraction: f64| {
                    // In grasps, so that the deficits of small strata add up.
                    let in_stratum = fraction * all as f64 - here[split];
                    let overall = fraction * whole - total[split];
                    in_stratum + overall
                };
                let neediest = self
                    .0
                    .iter()
                    .max_by(|a, b| deficit(a.0, *a.1).total_cmp(&deficit(b.0, *b.1)));
                let Some((split, _)) = neediest else { break };
                *here.entry(split).or_default() += size as f64;
                *total.entry(split).or_default() += size as f64;
                assigned.insert(name.clone(), split.clone());
            }
        }
        assigned
    }

    fn new(splits: BTreeMap<String, f64>) -> Result<Self> {
        for name in splits.keys() {
            shard_name(name, 0, 1)?;
        }
        let sum: f64 = splits.values().sum();
        let is_fraction = |fraction: &f64| *fraction > 0.0 && *fraction <= 1.0;
        if splits.values().all(is_fraction) && (sum - 1.0).abs() <= SUM_TOLERANCE {
            return Ok(Self(splits));
        }
        Err(invalid(format!(
            "expected fractions above 0 that sum to 1, found {splits:?}"
        )))
    }
}

impl FromStr for SplitFractions {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let mut splits = BTreeMap::new();
        for item in text.split(',') {
            let (name, fraction) = item.split_once('=').unwrap_or((item, "1"));
            let number = fraction.parse().map_err(|_| {
                invalid(format!(
                    "invalid fraction {fraction:?} of the split `{name}`"
                ))
            })?;
            if splits.insert(name.to_owned(), number).is_some() {
                return Err(invalid(format!("the split `{name}` is given twice")));
            }
        }
        Self::new(splits)
    }
}

impl std::fmt::Display for SplitFractions {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let splits = self
            .0
            .iter()
            .map(|(name, fraction)| format!("{name}={fraction}"));
        f.write_str(&splits.collect::<Vec<_>>().join(","))
    }
}

impl TryFrom<BTreeMap<String, f64>> for SplitFractions {
    type Error = Error;

    fn try_from(splits: BTreeMap<String, f64>) -> Result<Self> {
        Self::new(splits)
    }
}

impl From<SplitFractions> for BTreeMap<String, f64> {
    fn from(split: SplitFractions) -> Self {
        split.0
    }
}

fn random_key(seed: u64, name: &str) -> [u8; 32] {
    Sha256::new()
        .chain_update(seed.to_le_bytes())
        .chain_update(name)
        .finalize()
        .into()
}

fn invalid(what: String) -> Error {
    Error::usage(what).remedy("for instance train=0.8,validation=0.1,test=0.1")
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_base::error::ErrorKind;

    fn group(stratum: String, size: usize) -> SplitGroup {
        SplitGroup { stratum, size }
    }

    #[test]
    fn fractions_are_parsed_and_checked() {
        let read = |text: &str| text.parse::<SplitFractions>();
        assert_eq!(
            read("test").unwrap(),
            SplitFractions::single("test").unwrap()
        );
        let standard = read("train=0.8,validation=0.1,test=0.1").unwrap();
        assert_eq!(standard, SplitFractions::standard());
        assert_eq!(read(&standard.to_string()).unwrap(), standard);
        let json = serde_json::to_string(&standard).unwrap();
        assert_eq!(json, r#"{"test":0.1,"train":0.8,"validation":0.1}"#);
        assert_eq!(
            serde_json::from_str::<SplitFractions>(&json).unwrap(),
            standard
        );
        for text in [
            "",
            "a/b",
            "train=",
            "train=0,test=1",
            "train=2,test=-1",
            "train=NaN",
            "=1",
            "train=0.8,test=0.3",
            "train=0.5,train=0.5",
        ] {
            assert_eq!(read(text).unwrap_err().kind(), ErrorKind::Usage, "{text}");
        }
        assert!(serde_json::from_str::<SplitFractions>(r#"{"train":0.5}"#).is_err());
    }

    #[test]
    fn strata_of_two_reach_all_fractions() {
        let groups = (0..60)
            .map(|k| {
                (
                    format!("object {k}"),
                    group(format!("category {}", k / 2), 4),
                )
            })
            .collect();
        let assigned = SplitFractions::standard().assign(&groups, 0);
        let count = |name: &str| assigned.values().filter(|split| *split == name).count();
        assert_eq!(assigned.len(), 60);
        for (name, expected) in [("train", 48), ("validation", 6), ("test", 6)] {
            assert!(
                count(name).abs_diff(expected) <= 1,
                "{name}: {}",
                count(name)
            );
        }
    }

    #[test]
    fn groups_of_any_size_reach_their_fractions() {
        let groups: BTreeMap<String, SplitGroup> = (0..100)
            .map(|n| (format!("object {n}"), group(String::new(), 1 + n % 7)))
            .collect();
        let split: SplitFractions = "train=0.6,test=0.4".parse().unwrap();
        let assigned = split.assign(&groups, 1);
        let size_of = |split: &str| -> usize {
            let groups = groups.iter().filter(|(name, _)| assigned[*name] == split);
            groups.map(|(_, group)| group.size).sum()
        };
        let fraction = size_of("train") as f64 / (size_of("train") + size_of("test")) as f64;
        assert!((fraction - 0.6).abs() < 0.03, "{fraction}");
        assert_ne!(split.assign(&groups, 2), assigned);
    }
}
