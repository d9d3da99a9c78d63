//! Text formatting of the dataset commands.

use std::collections::BTreeMap;

use gripcast_dataset::Outcome;

/// Formats the number of grasps per outcome.
pub(super) fn outcomes_text(outcomes: &BTreeMap<Outcome, usize>) -> String {
    let parts: Vec<String> = [Outcome::Stable, Outcome::Slip, Outcome::Unlabelled]
        .into_iter()
        .map(|outcome| {
            let count = outcomes.get(&outcome).copied().unwrap_or(0);
            format!("{count} {outcome}")
        })
        .collect();
    parts.join(", ")
}

/// Formats a count with its noun, in the plural if needed.
pub(super) fn counted(count: usize, noun: &str) -> String {
    let plural = if count == 1 { "" } else { "s" };
    format!("{count} {noun}{plural}")
}

/// Formats a size in decimal units.
pub(super) fn size_text(bytes: u64) -> String {
    let mut size = bytes as f64;
    for unit in ["B", "kB", "MB", "GB"] {
        if size < 1000.0 {
            return if unit == "B" {
                format!("{size:.0} {unit}")
            } else {
                format!("{size:.1} {unit}")
            };
        }
        size /= 1000.0;
    }
    format!("{size:.1} TB")
}

/// Returns the JSON name of a unit variant.
pub(super) fn name_of(kind: &impl serde::Serialize) -> String {
    let value = serde_json::to_value(kind).unwrap_or_default();
    value.as_str().unwrap_or_default().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn size_text_uses_decimal_units() {
        assert_eq!(size_text(999), "999 B");
        assert_eq!(size_text(1_500), "1.5 kB");
        assert_eq!(size_text(2_000_000_000), "2.0 GB");
        assert_eq!(size_text(3_000_000_000_000_000), "3000.0 TB");
    }
}
