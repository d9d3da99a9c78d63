//! Parts of a dataset, and which object goes into which.

use std::collections::{BTreeMap, BTreeSet};
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use crate::error::{Error, ErrorKind, Result};
use crate::shard::shard_name;

/// Largest deviation of the shares' sum from 1 that is taken as rounding.
const SUM_TOLERANCE: f64 = 1e-6;

/// A part and its share of the grasps: `test`, or `train=0.7`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PartShare {
    /// Name of the part.
    pub name: String,
    /// Share of the grasps, above 0, at most 1.
    pub share: f64,
}

impl FromStr for PartShare {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let (name, share) = text.split_once('=').unwrap_or((text, "1"));
        // As of the files it will have.
        shard_name(name, 0, 1)?;
        match share.parse() {
            Ok(share) if share > 0.0 && share <= 1.0 => Ok(Self {
                name: name.to_owned(),
                share,
            }),
            _ => Err(usage(format!(
                "the share of the part `{name}` must be above 0 and at most 1, found {share:?}"
            ))),
        }
    }
}

/// # Errors
/// `Usage`: no part, one twice, or shares that are not 1 together.
pub(super) fn check(parts: &[PartShare]) -> Result<()> {
    let names: BTreeSet<&str> = parts.iter().map(|part| &*part.name).collect();
    if names.len() != parts.len() {
        return Err(usage("a part is given twice".to_owned()));
    }
    let sum: f64 = parts.iter().map(|part| part.share).sum();
    if (sum - 1.0).abs() > SUM_TOLERANCE {
        return Err(usage(format!(
            "the shares of the parts must be 1 together, found {sum}"
        )));
    }
    Ok(())
}

/// Deals objects with their counts of grasps to parts: in the order of their names' hashes, until a
/// part has its share. The number of the part by object.
///
/// # Errors
/// `Input`: a part would be empty.
pub(super) fn deal(
    objects: &BTreeMap<String, usize>,
    parts: &[PartShare],
) -> Result<BTreeMap<String, usize>> {
    let mut order: Vec<(&String, usize)> =
        objects.iter().map(|(name, count)| (name, *count)).collect();
    order.sort_by_cached_key(|(name, _)| Sha256::digest(name.as_bytes()));
    let all: usize = objects.values().sum();
    let mut dealt = BTreeMap::new();
    let mut before = 0;
    for (object, count) in order {
        let middle = (before as f64 + 0.5 * count as f64) / all as f64;
        let mut end = 0.0;
        let part = parts.iter().position(|part| {
            end += part.share;
            middle < end
        });
        dealt.insert(object.clone(), part.unwrap_or(parts.len() - 1));
        before += count;
    }
    for (number, part) in parts.iter().enumerate() {
        if !dealt.values().any(|of| *of == number) {
            let what = format!(
                "the part `{}` would be empty: there are only {} objects",
                part.name,
                objects.len()
            );
            return Err(
                Error::new(ErrorKind::Input, what).remedy("give more files, or fewer parts")
            );
        }
    }
    Ok(dealt)
}

fn usage(what: String) -> Error {
    Error::new(ErrorKind::Usage, what)
        .remedy("give `--part test`, or `--part train=0.7 --part validation=0.15 --part test=0.15`")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_parsed_and_checked() {
        let parsed = |text: &str| text.parse::<PartShare>();
        let train = parsed("train=0.7").unwrap();
        assert_eq!((&*train.name, train.share), ("train", 0.7));
        assert_eq!(parsed("test").unwrap().share, 1.0);
        for wrong in ["", "a/b", "train=", "train=0", "train=2", "train=NaN", "=1"] {
            assert_eq!(
                parsed(wrong).unwrap_err().kind(),
                ErrorKind::Usage,
                "{wrong}"
            );
        }
        check(&[train.clone(), parsed("test=0.3").unwrap()]).unwrap();
        for wrong in [vec![], vec![train.clone()], vec![train.clone(), train]] {
            assert_eq!(check(&wrong).unwrap_err().kind(), ErrorKind::Usage);
        }
    }

    #[test]
    fn objects_are_dealt_by_their_shares() {
        let objects: BTreeMap<String, usize> = (0..100)
            .map(|n| (format!("object {n}"), 1 + n % 7))
            .collect();
        let parts = ["train=0.6", "test=0.4"].map(|part| part.parse().unwrap());
        let dealt = deal(&objects, &parts).unwrap();
        let of = |part| -> usize {
            let objects = objects.iter().filter(|(name, _)| dealt[*name] == part);
            objects.map(|(_, count)| count).sum()
        };
        let all = of(0) + of(1);
        assert_eq!(all, objects.values().sum::<usize>());
        assert!((of(0) as f64 / all as f64 - 0.6).abs() < 0.03, "{}", of(0));
        let one = BTreeMap::from([("duck".to_owned(), 9)]);
        let error = deal(&one, &parts).unwrap_err();
        assert!(error.to_string().contains("would be empty"), "{error}");
        assert_eq!(deal(&one, &parts[..1]).unwrap()["duck"], 0);
    }
}
