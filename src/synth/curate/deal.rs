//! Deals groups of simulations to the parts of a dataset.

use std::collections::BTreeMap;

use super::chance;

/// The part of each group. `groups` have a stratum and a size; within each stratum (category) the
/// parts get their shares as nearly as whole groups allow, and over all of them too: each group,
/// the largest first and equals by chance, goes to the part that lacks most.
pub(super) fn deal(
    groups: &BTreeMap<String, (String, usize)>,
    parts: &BTreeMap<String, f64>,
    seed: u64,
) -> BTreeMap<String, String> {
    let mut strata: BTreeMap<&String, Vec<(&String, usize)>> = BTreeMap::new();
    for (group, (stratum, size)) in groups {
        strata.entry(stratum).or_default().push((group, *size));
    }
    let mut dealt = BTreeMap::new();
    let mut total: BTreeMap<&String, f64> = parts.keys().map(|part| (part, 0.0)).collect();
    for (_, mut members) in strata {
        members.sort_by_key(|(group, size)| (std::cmp::Reverse(*size), chance(seed, group)));
        let all: usize = members.iter().map(|(_, size)| size).sum();
        let mut here: BTreeMap<&String, f64> = parts.keys().map(|part| (part, 0.0)).collect();
        let whole: f64 = total.values().sum::<f64>() + all as f64;
        for (group, size) in members {
            let lacks = |part: &String, share: f64| {
                // In simulations, so that what small strata cannot give adds up until it counts.
                let in_stratum = share * all as f64 - here[part];
                let overall = share * whole - total[part];
                in_stratum + overall
            };
            let most = parts
                .iter()
                .max_by(|a, b| lacks(a.0, *a.1).total_cmp(&lacks(b.0, *b.1)));
            let Some((part, _)) = most else { break };
            *here.entry(part).or_default() += size as f64;
            *total.entry(part).or_default() += size as f64;
            dealt.insert(group.clone(), part.clone());
        }
    }
    dealt
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strata_of_two_give_all_parts_their_share() {
        let parts = [("test", 0.1), ("train", 0.8), ("validation", 0.1)];
        let parts = parts.map(|(name, share)| (name.to_owned(), share)).into();
        let group = |k: usize| (format!("object {k}"), (format!("category {}", k / 2), 4));
        let groups = (0..60).map(group).collect();
        let dealt = deal(&groups, &parts, 0);
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
}
