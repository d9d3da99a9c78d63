//! Simulations without a label, by reason.

use std::collections::BTreeMap;

use super::facts::UnlabelledGroup;
use super::results::{FinishedSimulation, PlanResults};

/// Groups simulations without a label, the most frequent reason first.
pub(super) fn unlabelled(plan_results: &PlanResults<'_>) -> Vec<UnlabelledGroup> {
    let mut groups: BTreeMap<(String, String), UnlabelledGroup> = BTreeMap::new();
    let without = plan_results
        .done
        .iter()
        .filter(|d| d.result.stable.is_none());
    for done in without {
        let outcome = &done.result.outcome;
        let full = reason(done);
        let short = without_numbers(&full);
        let key = (outcome.clone(), short.clone());
        let group = groups.entry(key).or_insert_with(|| UnlabelledGroup {
            outcome: outcome.clone(),
            reason: short,
            count: 0,
            example: done.simulation.id.to_string(),
            example_reason: full,
        });
        group.count += 1;
    }
    let mut groups: Vec<UnlabelledGroup> = groups.into_values().collect();
    // The sort is stable: equal counts stay in alphabetical order.
    groups.sort_by_key(|group| std::cmp::Reverse(group.count));
    groups
}

fn reason(done: &FinishedSimulation<'_>) -> String {
    if let Some(detail) = &done.result.detail {
        return detail.clone();
    }
    match &*done.result.outcome {
        "miss" => "the fingers missed the object",
        "closed" => "the gels met",
        "penetrating_start" => "the open gripper intersects the object",
        "not_converged" => "the solver did not converge",
        "success" | "slip" | "eject" => "no object between the fingers before the lift",
        _ => "unknown reason",
    }
    .to_owned()
}

/// Replaces numbers by `#`, so that reasons with different numbers are equal.
fn without_numbers(text: &str) -> String {
    let mut out = String::new();
    let mut rest = text;
    while let Some(start) = rest.find(|c: char| c.is_ascii_digit()) {
        let (before, number) = rest.split_at(start);
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

/// Drops a trailing minus sign, but not a hyphen.
fn drop_sign(out: &mut String) {
    let is_name = |c: char| c.is_alphanumeric() || c == '#';
    if let Some(before) = out.strip_suffix(['-', '−'])
        && !before.ends_with(is_name)
    {
        out.truncate(before.len());
    }
}

/// Whether a character continues a number: digit, decimal point, exponent.
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
    fn numbers_do_not_split_reasons() {
        let check = |text: &str, expected: &str| assert_eq!(without_numbers(text), expected);
        check("step 12: |g| = 3.5e-7 of -2.", "step #: |g| = # of #.");
        check("no numbers, größe", "no numbers, größe");
        check("7 end 8e", "# end #e");
        check("box-0007-10n: −3", "box-#-#n: #");
    }

    #[test]
    fn reasons_are_sorted_by_frequency() {
        let sample = Sample::new(6);
        let mut plan_results = labelled(&sample, &[true; 6]);
        for (k, done) in plan_results.done.iter_mut().enumerate().skip(1) {
            done.result.stable = None;
            (done.result.outcome, done.result.detail) = match k {
                1 => ("closed".to_owned(), None),
                _ => ("failed".to_owned(), Some(format!("step {k} was bad"))),
            };
        }
        let groups = unlabelled(&plan_results);
        let short: Vec<_> = groups.iter().map(|g| (g.count, &*g.reason)).collect();
        let expected = [(4, "step # was bad"), (1, "the gels met")];
        assert_eq!(short, expected);
        assert_eq!(groups[0].example_reason, "step 2 was bad");
        assert_eq!(groups[0].example, *plan_results.done[2].simulation.id);
    }
}
