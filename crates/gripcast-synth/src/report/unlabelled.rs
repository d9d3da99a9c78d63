//! Simulations that gave no label, by reason.

use std::collections::BTreeMap;

use super::facts::UnlabelledGroup;
use super::gather::{Done, Gathered};

/// Groups of them, the most frequent first.
pub(super) fn unlabelled(gathered: &Gathered<'_>) -> Vec<UnlabelledGroup> {
    let mut groups: BTreeMap<(String, String), UnlabelledGroup> = BTreeMap::new();
    let without = gathered.done.iter().filter(|d| d.result.stable.is_none());
    for done in without {
        let outcome = &done.result.outcome;
        let in_full = reason(done);
        let short = without_numbers(&in_full);
        let key = (outcome.clone(), short.clone());
        let group = groups.entry(key).or_insert_with(|| UnlabelledGroup {
            outcome: outcome.clone(),
            reason: short,
            count: 0,
            example: done.simulation.id.to_string(),
            example_reason: in_full,
        });
        group.count += 1;
    }
    let mut groups: Vec<UnlabelledGroup> = groups.into_values().collect();
    // Stable: the same count stays in the order of the words.
    groups.sort_by_key(|group| std::cmp::Reverse(group.count));
    groups
}

fn reason(done: &Done<'_>) -> String {
    if let Some(detail) = &done.result.detail {
        return detail.clone();
    }
    match &*done.result.outcome {
        "miss" => "the fingers met nothing",
        // `closed` in older data.
        "gels_met" | "closed" => "the fingers met each other",
        "penetrating_start" => "the open gripper was in the object",
        "not_converged" => "the solver gave up",
        "success" | "slip" | "eject" => "nothing between the fingers before the lift",
        _ => "no reason was kept",
    }
    .to_owned()
}

/// Numbers become `#`, so that the same reason with other numbers is the same.
fn without_numbers(text: &str) -> String {
    let mut out = String::new();
    let mut rest = text;
    while let Some(at) = rest.find(|c: char| c.is_ascii_digit()) {
        let (before, number) = rest.split_at(at);
        let number_end = number
            .char_indices()
            .find(|(at, c)| !is_in_number(number, *at, *c))
            .map_or(number.len(), |(at, _)| at);
        out.push_str(before);
        drop_sign(&mut out);
        out.push('#');
        rest = &number[number_end..];
    }
    out + rest
}

/// Drops a minus at the end that is no hyphen.
fn drop_sign(out: &mut String) {
    let is_name = |c: char| c.is_alphanumeric() || c == '#';
    if let Some(before) = out.strip_suffix(['-', '−'])
        && !before.ends_with(is_name)
    {
        out.truncate(before.len());
    }
}

/// Digits, a point before a digit, an exponent.
fn is_in_number(text: &str, at: usize, c: char) -> bool {
    let next = |k: usize| text.as_bytes().get(at + k).copied().unwrap_or(b' ');
    match c {
        '0'..='9' => true,
        '.' => next(1).is_ascii_digit(),
        'e' => next(1).is_ascii_digit() || (next(1) == b'-' && next(2).is_ascii_digit()),
        '-' => text[..at].ends_with('e') && next(1).is_ascii_digit(),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::super::sample::{Sample, labelled};
    use super::*;

    #[test]
    fn numbers_do_not_split_a_reason() {
        let check = |text: &str, expected: &str| assert_eq!(without_numbers(text), expected);
        check("step 12: |g| = 3.5e-7 of -2.", "step #: |g| = # of #.");
        check("no numbers, größe", "no numbers, größe");
        check("7 end 8e", "# end #e");
        check("box-0007-10n: −3", "box-#-#n: #");
    }

    #[test]
    fn reasons_are_grouped_the_most_frequent_first() {
        let sample = Sample::new(6);
        let mut gathered = labelled(&sample, &[true; 6]);
        for (k, done) in gathered.done.iter_mut().enumerate().skip(1) {
            done.result.stable = None;
            (done.result.outcome, done.result.detail) = match k {
                1 => ("closed".to_owned(), None),
                _ => ("failed".to_owned(), Some(format!("step {k} was bad"))),
            };
        }
        let groups = unlabelled(&gathered);
        let short: Vec<_> = groups.iter().map(|g| (g.count, &*g.reason)).collect();
        let expected = [(4, "step # was bad"), (1, "the fingers met each other")];
        assert_eq!(short, expected);
        assert_eq!(groups[0].example_reason, "step 2 was bad");
        assert_eq!(groups[0].example, *gathered.done[2].simulation.id);
    }
}
