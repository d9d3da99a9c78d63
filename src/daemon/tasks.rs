//! Threads that come back after a panic, and a board that tells how each of them does.
//!
//! A thread cannot be killed from outside: one that is stuck, for instance in a driver, is reported
//! and makes the process unhealthy, so that its supervisor (systemd's watchdog) replaces the whole.

use std::collections::BTreeMap;
use std::panic::AssertUnwindSafe;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use serde::Serialize;
use utoipa::ToSchema;

use super::thread::spawn;
use gripcast_base::catch_panic::catch_panic;
use gripcast_base::error::Result;
use gripcast_capture::camera::monotonic_ns;

/// Pause before the first restart; it doubles with each one that follows soon.
const FIRST_PAUSE: Duration = Duration::from_millis(100);
/// Longest pause before a restart.
const MAX_PAUSE: Duration = Duration::from_secs(5);
/// A task that worked this long starts with the first pause again.
const STEADY: Duration = Duration::from_secs(60);
/// A task that is busy with one piece of work for this long is stuck.
const STUCK: Duration = Duration::from_secs(10);

/// How a task does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum TaskState {
    /// Working or waiting for work.
    Running,
    /// It panicked and starts again soon.
    Restarting,
    /// Busy with one piece of work for too long.
    Stuck,
    /// It has ended before its time.
    Failed,
    /// It has ended as it should.
    Ended,
}

/// A task as the board tells it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub struct TaskReport {
    /// Name: `capture-left`, `inference`, ….
    pub name: String,
    /// How it does.
    pub state: TaskState,
    /// How often it was started again.
    pub restarts: u64,
    /// Why it was started again last.
    pub last_error: Option<String>,
}

#[derive(Debug)]
struct Entry {
    state: TaskState,
    restarts: u64,
    last_error: Option<String>,
    /// `CLOCK_MONOTONIC` since when it is busy, ns; 0 while it waits for work.
    busy_since_ns: Arc<AtomicU64>,
}

#[derive(Debug, Default)]
struct Board {
    entries: Mutex<(BTreeMap<String, Entry>, bool)>,
    closing: Condvar,
}

/// The board of all tasks; clones show the same board.
#[derive(Clone, Debug, Default)]
pub struct Tasks(Arc<Board>);

/// With this a task says that it works, so that being stuck can be told from waiting.
#[derive(Clone, Debug)]
pub struct Beat {
    busy_since_ns: Arc<AtomicU64>,
}

impl Beat {
    /// A piece of work begins.
    pub(super) fn busy(&self) {
        self.busy_since_ns
            .store(monotonic_ns().max(1), Ordering::Relaxed);
    }

    /// It is done; what follows is waiting.
    pub(super) fn idle(&self) {
        self.busy_since_ns.store(0, Ordering::Relaxed);
    }
}

impl Tasks {
    fn lock(&self) -> MutexGuard<'_, (BTreeMap<String, Entry>, bool)> {
        // A panicking holder leaves plain data behind, which is still true.
        self.0
            .entries
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }

    /// Puts a task on the board.
    pub(crate) fn enter(&self, name: &str) -> Beat {
        let busy_since_ns = Arc::new(AtomicU64::new(0));
        let entry = Entry {
            state: TaskState::Running,
            restarts: 0,
            last_error: None,
            busy_since_ns: Arc::clone(&busy_since_ns),
        };
        self.lock().0.insert(name.to_owned(), entry);
        Beat { busy_since_ns }
    }

    /// Says how a task does.
    pub(crate) fn set(&self, name: &str, state: TaskState, error: Option<String>) {
        if let Some(entry) = self.lock().0.get_mut(name) {
            entry.state = state;
            entry.restarts += u64::from(state == TaskState::Restarting);
            entry.last_error = error.or_else(|| entry.last_error.take());
        }
    }

    /// Starts a thread whose `body` is called again after a panic, until it returns or everything
    /// is closing. What the body keeps outlives its panics and must bear it.
    ///
    /// # Errors
    /// When the operating system gives no thread.
    pub(super) fn spawn(
        &self,
        name: &str,
        mut body: impl FnMut(&Beat) + Send + 'static,
    ) -> Result<JoinHandle<()>> {
        let (tasks, beat, task) = (self.clone(), self.enter(name), name.to_owned());
        spawn(name.to_owned(), move || {
            let mut pause = FIRST_PAUSE;
            loop {
                let started_ns = monotonic_ns();
                let result = catch_panic(AssertUnwindSafe(|| body(&beat)));
                beat.idle();
                let Err(panic) = result else {
                    tasks.set(&task, TaskState::Ended, None);
                    return;
                };
                let worked = Duration::from_nanos(monotonic_ns().saturating_sub(started_ns));
                if worked >= STEADY {
                    pause = FIRST_PAUSE;
                }
                tasks.set(&task, TaskState::Restarting, Some(panic));
                if tasks.closes_within(pause) {
                    return;
                }
                pause = (pause * 2).min(MAX_PAUSE);
                tasks.set(&task, TaskState::Running, None);
            }
        })
    }

    /// Ends the pauses of all tasks for good.
    pub(super) fn close(&self) {
        self.lock().1 = true;
        self.0.closing.notify_all();
    }

    fn closes_within(&self, pause: Duration) -> bool {
        let (entries, _) = self
            .0
            .closing
            .wait_timeout_while(self.lock(), pause, |(_, closing)| !*closing)
            .unwrap_or_else(PoisonError::into_inner);
        entries.1
    }

    /// All tasks by name, now.
    #[must_use]
    pub fn report(&self) -> Vec<TaskReport> {
        self.report_at(monotonic_ns())
    }

    fn report_at(&self, now_ns: u64) -> Vec<TaskReport> {
        let stuck_ns = STUCK.as_nanos() as u64;
        let board = self.lock();
        let report = |(name, entry): (&String, &Entry)| {
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
        board.0.iter().map(report).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_task_that_panics_comes_back_and_the_board_says_why() {
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
            "what the body keeps outlives panics"
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
    fn closing_ends_a_pause() {
        let tasks = Tasks::default();
        tasks.close();
        let thread = tasks.spawn("inference", |_| panic!("always")).unwrap();
        thread.join().unwrap();
        assert_eq!(tasks.report()[0].restarts, 1);
    }

    #[test]
    fn a_task_that_is_busy_for_too_long_is_stuck_and_one_that_waits_is_not() {
        let tasks = Tasks::default();
        let (working, _waiting) = (tasks.enter("store"), tasks.enter("serve"));
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
