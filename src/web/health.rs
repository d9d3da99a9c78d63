//! How the daemon does: health, model, figures for Prometheus.

use std::fmt::Write as _;
use std::sync::Arc;

use axum::Json;
use axum::extract::State as Shared;
use axum::http::{StatusCode, header};
use axum::response::IntoResponse;
use serde::Serialize;
use utoipa::ToSchema;

use super::backend::{Backend, ModelInfo};
use super::failure::{Complaint, Failure};
use super::state::State;
use crate::daemon::{TaskReport, TaskState};

/// Health of the daemon.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Health {
    /// Whether every task works.
    ok: bool,
    version: &'static str,
    uptime_s: f64,
    tasks: Vec<Task>,
}

/// A task of the daemon.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Task {
    name: String,
    /// `running`, `restarting`, `stuck`, `failed` or `ended`.
    #[schema(value_type = String)]
    state: TaskState,
    restarts: u64,
    last_error: Option<String>,
}

impl From<TaskReport> for Task {
    fn from(report: TaskReport) -> Self {
        Self {
            name: report.name,
            state: report.state,
            restarts: report.restarts,
            last_error: report.last_error,
        }
    }
}

/// Whether all tasks work: what the watchdog is told.
pub(crate) fn is_healthy(tasks: &[TaskReport]) -> bool {
    tasks
        .iter()
        .all(|task| matches!(task.state, TaskState::Running | TaskState::Restarting))
}

/// The engine at this moment
#[utoipa::path(get, path = "/api/state", tag = "session", responses((status = 200, body = State)))]
pub(crate) async fn state(Shared(backend): Shared<Arc<Backend>>) -> Json<State> {
    Json(backend.state())
}

/// Whether every task works
#[utoipa::path(get, path = "/api/health", tag = "daemon",
    responses((status = 200, body = Health), (status = 503, body = Health)))]
pub(crate) async fn health(Shared(backend): Shared<Arc<Backend>>) -> (StatusCode, Json<Health>) {
    let tasks = backend.tasks.report();
    let ok = is_healthy(&tasks);
    let status = if ok {
        StatusCode::OK
    } else {
        StatusCode::SERVICE_UNAVAILABLE
    };
    let health = Health {
        ok,
        version: env!("CARGO_PKG_VERSION"),
        uptime_s: backend.started.elapsed().as_secs_f64(),
        tasks: tasks.into_iter().map(Task::from).collect(),
    };
    (status, Json(health))
}

/// The model that predicts
#[utoipa::path(get, path = "/api/model", tag = "daemon",
    responses((status = 200, body = ModelInfo), (status = 404, body = Complaint)))]
pub(crate) async fn model(
    Shared(backend): Shared<Arc<Backend>>,
) -> Result<Json<ModelInfo>, Failure> {
    let model = backend.model.clone();
    model
        .map(Json)
        .ok_or_else(|| Failure::not_found("nothing predicts: it was started with --model none"))
}

/// Figures for Prometheus
#[utoipa::path(get, path = "/metrics", tag = "daemon",
    responses((status = 200, body = String, content_type = "text/plain")))]
pub(crate) async fn metrics(Shared(backend): Shared<Arc<Backend>>) -> impl IntoResponse {
    let status = Arc::clone(&backend.status.borrow());
    let mut text = Metrics::default();
    let counts = status.session.counts;
    text.family(
        "gripcast_grasps",
        "gauge",
        "Grasps in the dataset by outcome.",
    );
    for (outcome, count) in [
        ("stable", counts.stable),
        ("slip", counts.slip),
        ("unlabelled", counts.unlabelled),
    ] {
        text.value("gripcast_grasps", &[("outcome", outcome)], count as f64);
    }
    if let Some(free) = status.disk_free_bytes {
        text.family(
            "gripcast_disk_free_bytes",
            "gauge",
            "Free space on the dataset's disk.",
        );
        text.value("gripcast_disk_free_bytes", &[], free as f64);
    }
    type Reading = fn(&crate::daemon::CameraStatus) -> Option<f64>;
    let cameras: [(&str, &str, &str, Reading); 7] = [
        (
            "gripcast_camera_live",
            "gauge",
            "1 while frames arrive.",
            |c| Some(f64::from(u8::from(c.state.is_live()))),
        ),
        (
            "gripcast_camera_fps",
            "gauge",
            "Measured frame rate.",
            |c| Some(c.measured_fps),
        ),
        (
            "gripcast_camera_frame_age_seconds",
            "gauge",
            "Age of the newest frame.",
            |c| c.frame_age_ms.map(|age_ms| age_ms * 1e-3),
        ),
        (
            "gripcast_camera_frames_total",
            "counter",
            "Frames received.",
            |c| Some(c.received as f64),
        ),
        (
            "gripcast_camera_frames_lost_total",
            "counter",
            "Frames lost before they arrived.",
            |c| Some(c.sequence_gaps as f64),
        ),
        (
            "gripcast_camera_frames_damaged_total",
            "counter",
            "Damaged frames.",
            |c| Some(c.damaged as f64),
        ),
        (
            "gripcast_camera_reconnects_total",
            "counter",
            "Times it was opened again.",
            |c| Some(c.reconnects as f64),
        ),
    ];
    for (name, kind, help, reading) in cameras {
        text.family(name, kind, help);
        for camera in &status.cameras {
            if let Some(value) = reading(camera) {
                text.value(name, &[("role", camera.role.name())], value);
            }
        }
    }
    if let Some(prediction) = &status.prediction {
        text.family(
            "gripcast_p_stable",
            "gauge",
            "Live probability that the grasp holds.",
        );
        text.value("gripcast_p_stable", &[], prediction.p_stable);
        text.family(
            "gripcast_prediction_latency_seconds",
            "gauge",
            "Frame to prediction.",
        );
        text.value(
            "gripcast_prediction_latency_seconds",
            &[],
            prediction.latency_ms * 1e-3,
        );
    }
    text.family(
        "gripcast_task_restarts_total",
        "counter",
        "Restarts of a task.",
    );
    let tasks = backend.tasks.report();
    for task in &tasks {
        let labels = [("task", task.name.as_str())];
        text.value(
            "gripcast_task_restarts_total",
            &labels,
            task.restarts as f64,
        );
    }
    text.family("gripcast_healthy", "gauge", "1 while every task works.");
    text.value(
        "gripcast_healthy",
        &[],
        f64::from(u8::from(is_healthy(&tasks))),
    );
    let format = "text/plain; version=0.0.4; charset=utf-8";
    ([(header::CONTENT_TYPE, format)], text.0)
}

/// Prometheus text, exposition format 0.0.4.
#[derive(Default)]
struct Metrics(String);

impl Metrics {
    fn family(&mut self, name: &str, kind: &str, help: &str) {
        // Writing to a string cannot fail.
        let _ = writeln!(self.0, "# HELP {name} {help}\n# TYPE {name} {kind}");
    }

    fn value(&mut self, name: &str, labels: &[(&str, &str)], value: f64) {
        let labels: Vec<String> = labels.iter().map(|(k, v)| format!("{k}=\"{v}\"")).collect();
        let labels = match labels.is_empty() {
            true => String::new(),
            false => format!("{{{}}}", labels.join(",")),
        };
        let _ = writeln!(self.0, "{name}{labels} {value}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stuck_or_ended_task_is_unhealthy_and_a_restart_is_not() {
        let task = |state| TaskReport {
            name: "decode-left".into(),
            state,
            restarts: 1,
            last_error: None,
        };
        assert!(is_healthy(&[
            task(TaskState::Running),
            task(TaskState::Restarting)
        ]));
        for state in [TaskState::Stuck, TaskState::Failed, TaskState::Ended] {
            assert!(!is_healthy(&[task(TaskState::Running), task(state)]));
        }
    }

    #[test]
    fn metrics_are_one_line_a_value() {
        let mut metrics = Metrics::default();
        metrics.family("a", "gauge", "Help.");
        metrics.value("a", &[], 1.5);
        metrics.value("a", &[("role", "left")], 2.0);
        assert_eq!(
            metrics.0,
            "# HELP a Help.\n# TYPE a gauge\na 1.5\na{role=\"left\"} 2\n"
        );
    }
}
