//! The closing report of `collect` and `daemon`, and their exit code.

use std::fmt::Write as _;

use super::print_report;
use crate::daemon::{BlackBoxReport, CollectReport, EndReason};
use gripcast_base::error::{Error, ErrorKind, Result};

/// Prints the report of a finished collection. For a service (`is_service`), SIGTERM is a normal
/// end.
///
/// # Errors
/// `Interrupted` after Ctrl-C, `Stopped` after SIGTERM, `Partial` if a save failed.
pub(super) fn conclude(report: &CollectReport, as_json: bool, is_service: bool) -> Result<()> {
    print_report(as_json, report, summary)?;
    match report.ended {
        EndReason::Interrupted => Err(Error::new(
            ErrorKind::Interrupted,
            "interrupted; all acknowledged data is on disk",
        )),
        EndReason::Terminated if !is_service => Err(Error::new(
            ErrorKind::Stopped,
            "stopped; all acknowledged data is on disk",
        )),
        EndReason::Terminated | EndReason::Quit | EndReason::ScriptDone => {
            match report.session.failed {
                0 => Ok(()),
                failed => Err(Error::new(
                    ErrorKind::Partial,
                    format!("{failed} save(s) failed; see the messages above"),
                )),
            }
        }
    }
}

/// Formats the report.
fn summary(report: &CollectReport) -> String {
    let mut text = String::new();
    for grasp in &report.grasps {
        let predicted = grasp
            .p_stable
            .map_or_else(|| "no prediction".into(), |p| format!("predicted {p:.2}"));
        let _ = writeln!(
            text,
            "{}  {:<16} {:<10} {predicted}",
            grasp.id, grasp.object, grasp.outcome
        );
    }
    let session = &report.session;
    let _ = writeln!(
        text,
        "{} grasp(s) saved, {} label(s), {} trigger(s) refused, {} step(s) undone; dataset {}",
        session.saved, session.labelled, session.refused, session.undone, report.dataset
    );
    for (role, camera) in &report.cameras {
        let counters = &camera.counters;
        let _ = writeln!(
            text,
            "{role:<9} {:>5.1} fps, {} frames, {} dropped, {} damaged, {} late, {} reconnects",
            camera.measured_fps,
            counters.received,
            counters.sequence_gaps,
            counters.damaged,
            counters.late,
            counters.reconnects
        );
        for warning in &camera.warnings {
            let _ = writeln!(text, "          {warning}");
        }
    }
    let prediction = &report.prediction;
    if let (Some(model), Some(p50), Some(p99)) = (
        &prediction.model,
        prediction.latency_p50_ms,
        prediction.latency_p99_ms,
    ) {
        let _ = writeln!(
            text,
            "{} prediction(s) by {model}, frame to prediction {p50:.0} ms (median), {p99:.0} ms (p99)",
            prediction.predictions
        );
    }
    if let Some(black_box) = &report.black_box {
        text.push_str(&black_box_summary(black_box));
    }
    text
}

fn black_box_summary(report: &BlackBoxReport) -> String {
    let mut text = format!(
        "black box: {} file(s), {:.1} MB in {}",
        report.files,
        report.bytes as f64 * 1e-6,
        report.directory
    );
    if report.removed_files > 0 {
        let _ = write!(text, ", {} old file(s) removed", report.removed_files);
    }
    text.push('\n');
    for (role, frames) in &report.frames {
        let _ = writeln!(
            text,
            "          {role:<9} {} frames, {} dropped",
            frames.written, frames.dropped
        );
    }
    if let Some(reason) = &report.stopped {
        let _ = writeln!(text, "          ended early: {reason}");
    }
    text
}
