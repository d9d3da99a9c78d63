//! The report of a replay: files and terminal text.

use std::fmt::Write as _;
use std::path::Path;

use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::{BeneathPath, Root};
use gripcast_replay::{Proportion, Reality, Report};
use serde::Serialize;

/// Writes `report.json`, then `report.html`.
///
/// # Errors
/// `Io`.
pub(super) fn write_report(report: &impl Serialize, page: &str, out: &Path) -> Result<()> {
    let json = serde_json::to_vec_pretty(report)
        .map_err(|e| Error::internal("cannot write JSON").because(e))?;
    let save = |place: BeneathPath, bytes: &[u8]| {
        let saved = place.replace(bytes);
        saved.map_err(|e| Error::io("cannot write the report", e).at(place.display()))
    };
    let top = Root::new(out).top();
    save(top.join("report.json"), &json)?;
    save(top.join("report.html"), page.as_bytes())
}

/// Formats the result.
pub(super) fn text(report: &Report, out: &Path) -> String {
    let mut text = String::new();
    let _ = writeln!(
        text,
        "{} grasps of {} objects replayed, {} left out",
        report.grasps.len(),
        report.objects.len(),
        report.dataset.grasps.saturating_sub(report.grasps.len())
    );
    if let Reality::Simulated { description: how } = &report.dataset.reality {
        let _ = writeln!(text, "reality is simulated: {how}");
    }
    let _ = writeln!(text, "agreement with reality (95 % interval):");
    for engine in &report.engines {
        let scores = &engine.scores;
        let _ = writeln!(
            text,
            "  {:5}  best settings {}, leave-one-out {}, one setting for all {}",
            engine.name,
            fraction(&scores.paper.all),
            fraction(&scores.leave_one_out.all),
            fraction(&scores.one_setting.all)
        );
        let forces = scores.force_n.iter();
        let forces = forces.map(|(object, force)| format!("{object} {force} N"));
        let _ = writeln!(
            text,
            "         friction {}; {}",
            scores.friction,
            forces.collect::<Vec<_>>().join(", ")
        );
    }
    if let Some(comparison) = &report.comparison {
        let _ = writeln!(
            text,
            "only fem correct {}, only rigid correct {}: McNemar p = {}",
            comparison.only_fem,
            comparison.only_rigid,
            probability(comparison.mcnemar_p)
        );
    }
    if let Some(changes) = &report.changes {
        let _ = writeln!(
            text,
            "compared with {}: {} outcomes changed",
            changes.path,
            changes.outcomes.len()
        );
    }
    let _ = write!(text, "{}", out.join("report.html").display());
    text
}

fn fraction(proportion: &Proportion) -> String {
    let Proportion {
        agree,
        n,
        fraction,
        low,
        high,
    } = proportion;
    format!("{fraction:.2} ({low:.2}–{high:.2}; {agree} of {n})")
}

fn probability(p: f64) -> String {
    if p < 1e-3 {
        format!("{p:.1e}")
    } else {
        format!("{p:.3}")
    }
}

/// Checks that nothing was left out.
///
/// # Errors
/// `Partial` if grasps or cases were left out.
pub(super) fn finish(report: &Report) -> Result<()> {
    if report.left_out.is_empty() {
        return Ok(());
    }
    Err(Error::new(
        ErrorKind::Partial,
        format!(
            "{} grasps or some of their cases were left out of the report",
            report.left_out.len()
        ),
    )
    .remedy("the report lists the reasons"))
}
