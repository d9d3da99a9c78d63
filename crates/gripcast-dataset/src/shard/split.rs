//! Parts of a dataset, and which object goes into which.

use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use super::shard_name;
use gripcast_base::error::{Error, Result};

/// Largest deviation of the fractions' sum from 1 that is taken as rounding.
const SUM_TOLERANCE: f64 = 1e-6;

/// Parts of a dataset and the fraction of each: `train=0.8,validation=0.1,test=0.1`, or `test`.
///
/// Fractions are above 0 and sum to 1; in JSON it is an object of fractions by name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(into = "BTreeMap<String, f64>", try_from = "BTreeMap<String, f64>")]
pub struct Split(BTreeMap<String, f64>);

/// What stays together in one part.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SplitGroup {
    /// Groups of a stratum are divided by the fractions as nearly as whole groups allow.
    pub stratum: String,
    /// How much of the dataset it is, in grasps.
    pub size: usize,
}

impl Split {
    /// 80 % to train, 10 % each to validate and test.
    pub fn usual() -> Self {
        let parts = [("train", 0.8), ("validation", 0.1), ("test", 0.1)];
        Self(
            parts
                .map(|(name, fraction)| (name.to_owned(), fraction))
                .into(),
        )
    }

    /// Everything in one part.
    ///
    /// # Errors
    /// `Usage` for a name that files cannot have.
    pub fn one(name: &str) -> Result<Self> {
        Self::of(BTreeMap::from([(name.to_owned(), 1.0)]))
    }

    /// Names of the parts.
    pub fn names(&self) -> impl Iterator<Item = &String> {
        self.0.keys()
    }

    /// The part of each group: the parts get their fractions of each stratum, and of all of them, as
    /// nearly as whole groups allow. Each group, the largest first and equals by chance, goes to the
    /// part that lacks most.
    pub fn deal(
        &self,
        groups: &BTreeMap<String, SplitGroup>,
        seed: u64,
    ) -> BTreeMap<String, String> {
        let mut strata: BTreeMap<&String, Vec<(&String, usize)>> = BTreeMap::new();
        for (name, group) in groups {
            let members = strata.entry(&group.stratum).or_default();
            members.push((name, group.size));
        }
        let mut dealt = BTreeMap::new();
        let nothing = || self.names().map(|part| (part, 0.0)).collect();
        let mut total: BTreeMap<&String, f64> = nothing();
        for mut members in strata.into_values() {
            members.sort_by_cached_key(|(name, size)| (Reverse(*size), chance(seed, name)));
            let all: usize = members.iter().map(|(_, size)| size).sum();
            let mut here: BTreeMap<&String, f64> = nothing();
            let whole = total.values().sum::<f64>() + all as f64;
            for (name, size) in members {
                let lacks = |part: &String, fraction: f64| {
                    // In grasps, so that what small strata cannot give adds up until it counts.
                    let in_stratum = fraction * all as f64 - here[part];
                    let overall = fraction * whole - total[part];
                    in_stratum + overall
                };
                let most = self
                    .0
                    .iter()
                    .max_by(|a, b| lacks(a.0, *a.1).total_cmp(&lacks(b.0, *b.1)));
                let Some((part, _)) = most else { break };
                *here.entry(part).or_default() += size as f64;
                *total.entry(part).or_default() += size as f64;
                dealt.insert(name.clone(), part.clone());
            }
        }
        dealt
    }

    fn of(parts: BTreeMap<String, f64>) -> Result<Self> {
        for name in parts.keys() {
            shard_name(name, 0, 1)?;
        }
        let sum: f64 = parts.values().sum();
        let is_fraction = |fraction: &f64| *fraction > 0.0 && *fraction <= 1.0;
        if parts.values().all(is_fraction) && (sum - 1.0).abs() <= SUM_TOLERANCE {
            return Ok(Self(parts));
        }
        Err(wrong(format!(
            "the fractions of the parts must be above 0 and sum to 1, found {parts:?}"
        )))
    }
}

impl FromStr for Split {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let mut parts = BTreeMap::new();
        for part in text.split(',') {
            let (name, fraction) = part.split_once('=').unwrap_or((part, "1"));
            let number = fraction
                .parse()
                .map_err(|_| wrong(format!("the fraction of the part `{name}` is {fraction:?}")))?;
            if parts.insert(name.to_owned(), number).is_some() {
                return Err(wrong(format!("the part `{name}` is given twice")));
            }
        }
        Self::of(parts)
    }
}

impl std::fmt::Display for Split {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let parts = self
            .0
            .iter()
            .map(|(name, fraction)| format!("{name}={fraction}"));
        f.write_str(&parts.collect::<Vec<_>>().join(","))
    }
}

impl TryFrom<BTreeMap<String, f64>> for Split {
    type Error = Error;

    fn try_from(parts: BTreeMap<String, f64>) -> Result<Self> {
        Self::of(parts)
    }
}

impl From<Split> for BTreeMap<String, f64> {
    fn from(split: Split) -> Self {
        split.0
    }
}

fn chance(seed: u64, name: &str) -> [u8; 32] {
    Sha256::new()
        .chain_update(seed.to_le_bytes())
        .chain_update(name)
        .finalize()
        .into()
}

fn wrong(what: String) -> Error {
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
    fn fractions_are_read_and_checked() {
        let read = |text: &str| text.parse::<Split>();
        assert_eq!(read("test").unwrap(), Split::one("test").unwrap());
        let usual = read("train=0.8,validation=0.1,test=0.1").unwrap();
        assert_eq!(usual, Split::usual());
        assert_eq!(read(&usual.to_string()).unwrap(), usual);
        let json = serde_json::to_string(&usual).unwrap();
        assert_eq!(json, r#"{"test":0.1,"train":0.8,"validation":0.1}"#);
        assert_eq!(serde_json::from_str::<Split>(&json).unwrap(), usual);
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
        assert!(serde_json::from_str::<Split>(r#"{"train":0.5}"#).is_err());
    }

    #[test]
    fn strata_of_two_give_all_parts_their_fraction() {
        let groups = (0..60)
            .map(|k| {
                (
                    format!("object {k}"),
                    group(format!("category {}", k / 2), 4),
                )
            })
            .collect();
        let dealt = Split::usual().deal(&groups, 0);
        let count = |name: &str| dealt.values().filter(|part| *part == name).count();
        assert_eq!(dealt.len(), 60);
        for (name, expected) in [("train", 48), ("validation", 6), ("test", 6)] {
            assert!(
                count(name).abs_diff(expected) <= 1,
                "{name}: {}",
                count(name)
            );
        }
    }

    #[test]
    fn groups_of_any_size_come_to_their_fractions() {
        let groups: BTreeMap<String, SplitGroup> = (0..100)
            .map(|n| (format!("object {n}"), group(String::new(), 1 + n % 7)))
            .collect();
        let split: Split = "train=0.6,test=0.4".parse().unwrap();
        let dealt = split.deal(&groups, 1);
        let of = |part: &str| -> usize {
            let groups = groups.iter().filter(|(name, _)| dealt[*name] == part);
            groups.map(|(_, group)| group.size).sum()
        };
        let fraction = of("train") as f64 / (of("train") + of("test")) as f64;
        assert!((fraction - 0.6).abs() < 0.03, "{fraction}");
        assert_ne!(split.deal(&groups, 2), dealt);
    }
}
