//! Words and bars that the verbs of `dataset` fraction.

use std::collections::BTreeMap;
use std::io::{self, IsTerminal as _};

use indicatif::{ProgressBar, ProgressStyle};
use serde_json::Value;

use super::Context;
use gripcast_base::error::{Error, Result};
use gripcast_dataset::Outcome;

/// How many grasps have which outcome.
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

/// A number and its noun, in the plural where it must be.
pub(super) fn counted(count: usize, noun: &str) -> String {
    let plural = if count == 1 { "" } else { "s" };
    format!("{count} {noun}{plural}")
}

/// Decimal units, as disks are sold.
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

/// A bar on stderr; hidden where stderr is no terminal.
pub(super) fn progress_bar(context: &Context, what: &'static str) -> ProgressBar {
    if context.quiet || !io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new(0).with_message(what);
    if let Ok(style) = ProgressStyle::with_template("{msg} {bar:40} {pos}/{len} grasps, {eta} left")
    {
        bar.set_style(style);
    }
    bar
}

/// The name that a kind has in JSON.
pub(super) fn name_of(kind: &impl serde::Serialize) -> String {
    let value = to_value(kind).unwrap_or_default();
    value.as_str().unwrap_or_default().to_owned()
}

/// A report as JSON.
pub(super) fn to_value(report: &impl serde::Serialize) -> Result<Value> {
    serde_json::to_value(report)
        .map_err(|e| Error::internal("cannot write the report as JSON").because(e))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_read_well() {
        assert_eq!(size_text(999), "999 B");
        assert_eq!(size_text(1_500), "1.5 kB");
        assert_eq!(size_text(2_000_000_000), "2.0 GB");
        assert_eq!(size_text(3_000_000_000_000_000), "3000.0 TB");
    }
}
