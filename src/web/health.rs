//! Health, model and Prometheus metrics of the daemon.

use std::fmt::Write as _;
use std::sync::Arc;

use axum::Json;
use axum::extract::State as Shared;
use axum::http::{StatusCode, header};
use axum::response::IntoResponse;
use serde::Serialize;
use utoipa::ToSchema;

use super::backend::Backend;
use super::failure::{ErrorResponse, Failure};
use gripcast_imaging::Role;

use crate::daemon::{
    CameraState, CameraStatus, EngineStatus, ModelInfo, PredictionStatus, TaskReport, TaskState,
};

/// Health of daemon and cameras.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct HealthReport {
    /// Whether every task is running and no camera has a fault.
    ok: bool,
    version: &'static str,
    uptime_s: f64,
    tasks: Vec<TaskReport>,
    cameras: Vec<CameraHealth>,
}

/// State of one camera, as in `/api/state`.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct CameraHealth {
    role: Role,
    #[serde(flatten)]
    state: CameraState,
}

/// Returns whether all tasks are running, for the watchdog.
pub(crate) fn is_healthy(tasks: &[TaskReport]) -> bool {
    tasks
        .iter()
        .all(|task| matches!(task.state, TaskState::Running | TaskState::Restarting))
}

/// State of the engine
#[utoipa::path(get, path = "/api/state", tag = "session", responses((status = 200, body = EngineStatus)))]
pub(crate) async fn state(Shared(backend): Shared<Arc<Backend>>) -> Json<EngineStatus> {
    Json(backend.state())
}

/// Health of the daemon
#[utoipa::path(get, path = "/api/health", tag = "daemon",
    responses((status = 200, body = HealthReport), (status = 503, body = HealthReport)))]
pub(crate) async fn health(
    Shared(backend): Shared<Arc<Backend>>,
) -> (StatusCode, Json<HealthReport>) {
    let tasks = backend.tasks.report();
    let is_healthy = is_healthy(&tasks);
    // Restarting the daemon repairs its tasks, but no camera.
    let status = match is_healthy {
        true => StatusCode::OK,
        false => StatusCode::SERVICE_UNAVAILABLE,
    };
    let state = Arc::clone(&backend.status.borrow());
    let cameras: Vec<CameraHealth> = state
        .cameras
        .iter()
        .map(|camera| CameraHealth {
            role: camera.role,
            state: camera.state.clone(),
        })
        .collect();
    let health = HealthReport {
        ok: is_healthy && !cameras.iter().any(|camera| camera.state.is_fault()),
        version: env!("CARGO_PKG_VERSION"),
        uptime_s: backend.started.elapsed().as_secs_f64(),
        tasks,
        cameras,
    };
    (status, Json(health))
}

/// The model used for predictions
#[utoipa::path(get, path = "/api/model", tag = "daemon",
    responses((status = 200, body = ModelInfo), (status = 404, body = ErrorResponse)))]
pub(crate) async fn model(
    Shared(backend): Shared<Arc<Backend>>,
) -> Result<Json<ModelInfo>, Failure> {
    let model = backend.model.clone();
    model
        .map(Json)
        .ok_or_else(|| Failure::not_found("no model: the daemon was started with --model none"))
}

/// Prometheus metrics
#[utoipa::path(get, path = "/metrics", tag = "daemon",
    responses((status = 200, body = String, content_type = "text/plain")))]
pub(crate) async fn metrics(Shared(backend): Shared<Arc<Backend>>) -> impl IntoResponse {
    let status = Arc::clone(&backend.status.borrow());
    let mut text = Metrics::default();
    text.dataset(&status);
    text.cameras(&status.cameras);
    text.predictions(status.prediction.as_ref());
    text.tasks(&backend.tasks.report());
    let format = "text/plain; version=0.0.4; charset=utf-8";
    ([(header::CONTENT_TYPE, format)], text.0)
}

/// Optional label and value of a sample.
type Sample<'a> = (Option<(&'static str, &'a str)>, f64);

/// Prometheus text, exposition format 0.0.4.
#[derive(Default)]
struct Metrics(String);

impl Metrics {
    /// Writes a metric family: a counter if the name ends in `_total`, else a gauge.
    fn family<'a>(&mut self, name: &str, help: &str, values: impl IntoIterator<Item = Sample<'a>>) {
        let kind = match name.ends_with("_total") {
            true => "counter",
            false => "gauge",
        };
        // Writing to a string cannot fail.
        let _ = writeln!(self.0, "# HELP {name} {help}\n# TYPE {name} {kind}");
        for (label, value) in values {
            let label =
                label.map_or_else(String::new, |(key, value)| format!("{{{key}=\"{value}\"}}"));
            let _ = writeln!(self.0, "{name}{label} {value}");
        }
    }

    fn dataset(&mut self, status: &EngineStatus) {
        let counts = status.session.counts;
        let grasps = [
            ("stable", counts.stable),
            ("slip", counts.slip),
            ("unlabelled", counts.unlabelled),
        ];
        self.family(
            "gripcast_grasps",
            "Grasps in the dataset by outcome.",
            grasps.map(|(outcome, count)| (Some(("outcome", outcome)), count as f64)),
        );
        if let Some(free) = status.disk_free_bytes {
            self.family(
                "gripcast_disk_free_bytes",
                "Free space on the dataset's disk.",
                [(None, free as f64)],
            );
        }
    }

    fn cameras(&mut self, cameras: &[CameraStatus]) {
        const FAMILIES: [(&str, &str); 7] = [
            ("live", "1 while frames arrive and decode."),
            ("fps", "Measured frame rate."),
            ("frame_age_seconds", "Age of the newest frame."),
            ("frames_total", "Frames received."),
            ("frames_lost_total", "Frames lost before they arrived."),
            ("frames_damaged_total", "Damaged frames."),
            ("reconnects_total", "Times the camera was reopened."),
        ];
        let values = |camera: &CameraStatus| {
            let counters = camera.counters;
            [
                Some(f64::from(u8::from(camera.state.is_live()))),
                Some(camera.measured_fps),
                camera.frame_age_ms.map(|age_ms| age_ms * 1e-3),
                Some(counters.received as f64),
                Some(counters.sequence_gaps as f64),
                Some(counters.damaged as f64),
                Some(counters.reconnects as f64),
            ]
        };
        for (index, (name, help)) in FAMILIES.into_iter().enumerate() {
            let samples = cameras
                .iter()
                .filter_map(|c| Some((Some(("role", c.role.name())), values(c)[index]?)));
            self.family(&format!("gripcast_camera_{name}"), help, samples);
        }
    }

    fn predictions(&mut self, prediction: Option<&PredictionStatus>) {
        let Some(PredictionStatus { record, .. }) = prediction else {
            return;
        };
        self.family(
            "gripcast_p_stable",
            "Live probability that the grasp is stable.",
            [(None, record.p_stable)],
        );
        self.family(
            "gripcast_prediction_latency_seconds",
            "Time from frame to prediction.",
            [(None, record.latency_ms * 1e-3)],
        );
    }

    fn tasks(&mut self, tasks: &[TaskReport]) {
        let restarts = tasks
            .iter()
            .map(|task| (Some(("task", task.name.as_str())), task.restarts as f64));
        self.family(
            "gripcast_task_restarts_total",
            "Restarts of a task.",
            restarts,
        );
        self.family(
            "gripcast_healthy",
            "1 while every task is running.",
            [(None, f64::from(u8::from(is_healthy(tasks))))],
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stuck_or_ended_task_is_unhealthy_and_restart_is_not() {
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
    fn metrics_have_one_line_per_sample() {
        let mut metrics = Metrics::default();
        metrics.family("a", "Help.", [(None, 1.5), (Some(("role", "left")), 2.0)]);
        metrics.family("b_total", "Help.", []);
        assert_eq!(
            metrics.0,
            "# HELP a Help.\n# TYPE a gauge\na 1.5\na{role=\"left\"} 2\n\
             # HELP b_total Help.\n# TYPE b_total counter\n"
        );
    }
}
