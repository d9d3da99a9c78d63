//! Threads that restart after a panic, and a registry of their states.
//!
//! A thread cannot be killed from outside: one that is stuck, for instance in a driver, is reported
//! and makes the process unhealthy, so that the systemd watchdog restarts it.

use std::collections::BTreeMap;
use std::panic::AssertUnwindSafe;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use serde::Serialize;
use utoipa::ToSchema;

use super::thread::{lock, spawn, wait_while};
use gripcast_base::catch_panic;
use gripcast_base::error::Result;
use gripcast_capture::camera::monotonic_ns;

/// Delay before the first restart; doubles with each further restart.
const MIN_BACKOFF: Duration = Duration::from_millis(100);
/// Maximum delay before a restart.
const MAX_BACKOFF: Duration = Duration::from_secs(5);
/// Run time after which the restart delay is reset.
const BACKOFF_RESET: Duration = Duration::from_secs(60);
/// Time in one piece of work after which a task counts as stuck.
const STUCK_AFTER: Duration = Duration::from_secs(10);

/// State of a task.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum TaskState {
    /// Working or waiting for work.
    Running,
    /// Panicked; restarts after a delay.
    Restarting,
    /// Busy with one piece of work for too long.
    Stuck,
    /// Ended unexpectedly.
    Failed,
    /// Ended as expected.
    Ended,
}

/// State and restarts of a task.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub struct TaskReport {
    /// Name: `capture-left`, `inference`, ….
    pub name: String,
    /// State.
    pub state: TaskState,
    /// Number of restarts.
    pub restarts: u64,
    /// Reason of the last restart.
    pub last_error: Option<String>,
}

#[derive(Debug)]
struct Task {
    state: TaskState,
    restarts: u64,
    last_error: Option<String>,
    /// `CLOCK_MONOTONIC` at which the current work started, ns; 0 while idle.
    busy_since_ns: Arc<AtomicU64>,
}

#[derive(Debug, Default)]
struct Registry {
    entries: Mutex<(BTreeMap<String, Task>, bool)>,
    closing: Condvar,
}

/// Registry of all tasks; clones refer to the same registry.
#[derive(Clone, Debug, Default)]
pub struct Tasks(Arc<Registry>);

/// Time stamp by which a task shows that it runs, to distinguish stuck tasks from waiting ones.
#[derive(Clone, Debug)]
pub struct Heartbeat {
    busy_since_ns: Arc<AtomicU64>,
}

impl Heartbeat {
    /// Marks the start of a piece of work.
    pub(super) fn busy(&self) {
        self.busy_since_ns
            .store(monotonic_ns().max(1), Ordering::Relaxed);
    }

    /// Marks the end of the work.
    pub(super) fn idle(&self) {
        self.busy_since_ns.store(0, Ordering::Relaxed);
    }
}

impl Tasks {
    /// Registers a task.
    pub(crate) fn register(&self, name: &str) -> Heartbeat {
        let busy_since_ns = Arc::new(AtomicU64::new(0));
        let entry = Task {
            state: TaskState::Running,
            restarts: 0,
            last_error: None,
            busy_since_ns: Arc::clone(&busy_since_ns),
        };
        lock(&self.0.entries).0.insert(name.to_owned(), entry);
        Heartbeat { busy_since_ns }
    }

    /// Sets the state of a task.
    pub(crate) fn set(&self, name: &str, state: TaskState, error: Option<String>) {
        if let Some(entry) = lock(&self.0.entries).0.get_mut(name) {
            entry.state = state;
            entry.restarts += u64::from(state == TaskState::Restarting);
            entry.last_error = error.or_else(|| entry.last_error.take());
        }
    }

    /// Starts a thread that calls `body` again after a panic, until it returns or [`Tasks::close`].
    /// The state of `body` survives panics and must stay valid.
    ///
    /// # Errors
    /// `Io` if the thread cannot be started.
    pub(super) fn spawn(
        &self,
        name: &str,
        mut body: impl FnMut(&Heartbeat) + Send + 'static,
    ) -> Result<JoinHandle<()>> {
        let (tasks, heartbeat, task) = (self.clone(), self.register(name), name.to_owned());
        spawn(name.to_owned(), move || {
            let mut pause = MIN_BACKOFF;
            loop {
                let started_ns = monotonic_ns();
                let result = catch_panic::catch_panic(AssertUnwindSafe(|| body(&heartbeat)));
                heartbeat.idle();
                let Err(panic) = result else {
                    tasks.set(&task, TaskState::Ended, None);
                    return;
                };
                let worked = Duration::from_nanos(monotonic_ns().saturating_sub(started_ns));
                if worked >= BACKOFF_RESET {
                    pause = MIN_BACKOFF;
                }
                tasks.set(&task, TaskState::Restarting, Some(panic));
                if tasks.wait_for_close(pause) {
                    return;
                }
                pause = (pause * 2).min(MAX_BACKOFF);
                tasks.set(&task, TaskState::Running, None);
            }
        })
    }

    /// Ends all restart delays and prevents further restarts.
    pub(super) fn close(&self) {
        lock(&self.0.entries).1 = true;
        self.0.closing.notify_all();
    }

    fn wait_for_close(&self, pause: Duration) -> bool {
        let guard = lock(&self.0.entries);
        wait_while(&self.0.closing, guard, pause, |(_, closing)| !*closing).1
    }

    /// Returns the reports of all tasks, sorted by name.
    pub fn report(&self) -> Vec<TaskReport> {
        self.report_at(monotonic_ns())
    }

    fn report_at(&self, now_ns: u64) -> Vec<TaskReport> {
        let stuck_ns = STUCK_AFTER.as_nanos() as u64;
        let registry = lock(&self.0.entries);
        let report = |(name, entry): (&String, &Task)| {
            let since_ns = entry.busy_since_ns.load(Ordering::Relaxed);
            let is_stuck = since_ns != 0 && now_ns.saturating_sub(since_ns) > stuck_ns;
            let state = match entry.state {
                TaskState::Running if is_stuck => TaskState::Stuck,
                state => state,
            };
            TaskReport {
                name: name.clone(),
                state,
                restarts: entry.restarts,
                last_error: entry.last_error.clone(),
            }
        };
        registry.0.iter().map(report).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn panicked_task_restarts_and_reports_the_reason() {
        let tasks = Tasks::default();
        let mut calls = 0;
        let (sender, receiver) = std::sync::mpsc::channel();
        let thread = tasks
            .spawn("decode-left", move |_| {
                calls += 1;
                assert!(calls >= 3, "frame {calls} was odd");
                sender.send(calls).unwrap();
            })
            .unwrap();
        thread.join().unwrap();
        assert_eq!(
            receiver.recv(),
            Ok(3),
            "state of the body must survive panics"
        );
        let [report] = &tasks.report()[..] else {
            panic!("one task");
        };
        assert_eq!((report.restarts, report.state), (2, TaskState::Ended));
        assert!(
            report
                .last_error
                .as_ref()
                .unwrap()
                .contains("frame 2 was odd")
        );
    }

    #[test]
    fn close_ends_restart_delay() {
        let tasks = Tasks::default();
        tasks.close();
        let thread = tasks.spawn("inference", |_| panic!("always")).unwrap();
        thread.join().unwrap();
        assert_eq!(tasks.report()[0].restarts, 1);
    }

    #[test]
    fn busy_task_becomes_stuck_and_idle_task_does_not() {
        let tasks = Tasks::default();
        let (working, _waiting) = (tasks.register("store"), tasks.register("serve"));
        working.busy();
        let later_ns = monotonic_ns() + 11_000_000_000;
        let states = |now_ns| {
            let report = tasks.report_at(now_ns);
            report.iter().map(|task| task.state).collect::<Vec<_>>()
        };
        assert_eq!(states(later_ns), [TaskState::Running, TaskState::Stuck]);
        working.idle();
        assert_eq!(states(later_ns), [TaskState::Running; 2]);
    }
}
