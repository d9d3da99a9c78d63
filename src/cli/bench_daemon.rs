//! `gripcast bench daemon`: benchmarks a collecting daemon on the virtual rig under API load.
//!
//! Rendering the virtual rig takes most of the CPU time; the cost of viewers is the difference
//! between the measurements with and without them.

use std::fs;
use std::io::{BufRead as _, BufReader, Read as _};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use serde::Serialize;
use serde_json::{Value, json};

use super::Context;
use super::bench::Report;
use crate::note;
use gripcast_base::error::{Error, Result};

/// CPU time ticks per second in `/proc/PID/stat` (USER_HZ).
const TICKS_PER_S: f64 = 100.0;
/// Cameras shown by a page.
const CAMERAS: [&str; 4] = ["left", "right", "rgb", "depth"];
/// Maximum time that guards may refuse a trigger.
const TRIGGER_TIMEOUT: Duration = Duration::from_secs(30);
/// Interval of retries and of API calls.
const CALL_INTERVAL: Duration = Duration::from_millis(20);

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Measuring time of the CPU load without and with viewers, s
    #[arg(long, value_name = "S", default_value_t = 10,
        value_parser = clap::value_parser!(u64).range(1..=600))]
    seconds: u64,
    /// Number of grasps to collect
    #[arg(long, value_name = "N", default_value_t = 20,
        value_parser = clap::value_parser!(u64).range(1..=1000))]
    grasps: u64,
    /// Number of viewers of all cameras
    #[arg(long, value_name = "N", default_value_t = 2,
        value_parser = clap::value_parser!(u64).range(1..=8))]
    viewers: u64,
    /// Folder on the disk to benchmark [default: temporary folder]
    #[arg(long, value_name = "DIR")]
    disk: Option<PathBuf>,
    /// Print the result as JSON
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Serialize)]
struct Figures {
    /// Latency of `GET /api/state` during collection with viewers, ms.
    api_p50_ms: f64,
    api_p99_ms: f64,
    api_calls: usize,
    /// Latency from an accepted trigger to the response after its frames are durable, ms.
    durable_p50_ms: f64,
    durable_p99_ms: f64,
    /// CPU cores of the daemon without viewers, with viewers, and the difference.
    cores_idle: f64,
    cores_viewers: f64,
    cores_added: f64,
    /// Images received by the viewers, 1/s.
    images_per_s: f64,
    rss_idle_mb: f64,
    rss_viewers_mb: f64,
    /// Dropped frames by the sequence counters of the cameras.
    frames_dropped: u64,
    stop_s: f64,
}

impl Args {
    /// Runs the benchmark.
    pub(crate) fn measure(&self, context: &Context) -> Result<Report> {
        let dir = match &self.disk {
            Some(disk) => tempfile::tempdir_in(disk),
            None => tempfile::tempdir(),
        };
        let dir = dir.map_err(|e| Error::io("cannot create a folder for the dataset", e))?;
        let mut daemon = Daemon::start(&dir.path().join("d"))?;
        if !context.quiet {
            note!(
                "a daemon at {}; two measurements of {} s, then {} grasps",
                daemon.url,
                self.seconds,
                self.grasps
            );
        }
        // Warm-up.
        daemon.trigger()?;
        daemon.command("undo")?;
        let (cores_idle, rss_idle_mb) = daemon.cores(self.seconds)?;
        let viewers = Viewers::start(&daemon.url, self.viewers);
        let before = viewers.images();
        let (cores_viewers, rss_viewers_mb) = daemon.cores(self.seconds)?;
        let images_per_s = (viewers.images() - before) as f64 / self.seconds as f64;
        let load = ApiLoad::start(&daemon.url);
        let mut durable_ms = Vec::new();
        for number in 0..self.grasps {
            for _ in 0..2 {
                durable_ms.push(daemon.trigger()?);
            }
            daemon.command(if number % 2 == 0 { "stable" } else { "slip" })?;
        }
        let mut api_ms = load.end()?;
        let frames_dropped = daemon.frames_dropped()?;
        let started = Instant::now();
        daemon.stop()?;
        let stop_s = started.elapsed().as_secs_f64();
        viewers.end();
        let figures = Figures {
            api_p50_ms: quantile(&mut api_ms, 0.5),
            api_p99_ms: quantile(&mut api_ms, 0.99),
            api_calls: api_ms.len(),
            durable_p50_ms: quantile(&mut durable_ms, 0.5),
            durable_p99_ms: quantile(&mut durable_ms, 0.99),
            cores_idle,
            cores_viewers,
            cores_added: cores_viewers - cores_idle,
            images_per_s,
            rss_idle_mb,
            rss_viewers_mb,
            frames_dropped,
            stop_s,
        };
        let params = json!({
            "seconds": self.seconds,
            "grasps": self.grasps,
            "viewers": self.viewers,
        });
        let text = figures.text(self.viewers);
        Ok(Report::new("daemon", params, json!(figures), text))
    }
}

impl Figures {
    fn text(&self, viewers: u64) -> String {
        format!(
            "API call {:.1} ms (median) {:.1} ms (p99)\n\
         trigger to durable {:.0} ms (median) {:.0} ms (p99)\n\
         {:.2} cores, {:.2} with {} viewers ({:.0} images/s)\n\
         {:.0} MB, {:.0} MB with viewers; {} frames dropped; stopped in {:.2} s",
            self.api_p50_ms,
            self.api_p99_ms,
            self.durable_p50_ms,
            self.durable_p99_ms,
            self.cores_idle,
            self.cores_viewers,
            viewers,
            self.images_per_s,
            self.rss_idle_mb,
            self.rss_viewers_mb,
            self.frames_dropped,
            self.stop_s,
        )
    }
}

/// Returns a quantile that is one of the values.
fn quantile(values: &mut [f64], q: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let index = (q * values.len().saturating_sub(1) as f64).ceil() as usize;
    values.get(index).copied().unwrap_or(f64::NAN)
}

fn unexpected(what: &str) -> Error {
    Error::internal(format!("the daemon {what}"))
        .remedy("run `gripcast daemon --rig virtual` to see its messages")
}

/// The measured daemon; killed when dropped.
struct Daemon {
    child: Child,
    url: String,
}

impl Daemon {
    fn start(dataset: &Path) -> Result<Self> {
        let program = std::env::current_exe()
            .map_err(|e| Error::io("cannot find the gripcast executable", e))?;
        let mut child = Command::new(program)
            .args(["daemon", "--rig", "virtual", "--listen", "127.0.0.1:0"])
            .args(["--socket", "none", "--dataset"])
            .arg(dataset)
            // Guards must not refuse triggers on a loaded machine.
            .env("GRIPCAST__GUARDS__MAX_FRAME_AGE_MS", "2000")
            .env("GRIPCAST__GUARDS__MAX_SKEW_MS", "2000")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(|e| Error::io("cannot start a daemon", e))?;
        let errors = child
            .stderr
            .take()
            .ok_or_else(|| unexpected("has no stderr"))?;
        let mut lines = BufReader::new(errors).lines().map_while(|line| line.ok());
        let url = lines.find_map(|line| {
            let url = line.strip_prefix("page and API: ")?;
            Some(url.trim_end_matches('/').to_owned())
        });
        // Keeps the pipe empty.
        std::thread::spawn(move || lines.for_each(drop));
        let url = url.ok_or_else(|| unexpected("failed to start"))?;
        Ok(Self { child, url })
    }

    fn command(&self, command: &str) -> Result<(u16, Value)> {
        let body = json!({"command": command}).to_string();
        let answer = agent()
            .post(format!("{}/api/commands", self.url))
            .header("content-type", "application/json")
            .send(body);
        let mut answer = answer.map_err(|e| unexpected("did not respond").because(e))?;
        let text = answer.body_mut().read_to_string();
        let text = text.map_err(|e| unexpected("closed a response early").because(e))?;
        let value = serde_json::from_str(&text).unwrap_or(Value::Null);
        Ok((answer.status().as_u16(), value))
    }

    /// Triggers until the guards accept; returns the duration of the accepted call, ms.
    fn trigger(&self) -> Result<f64> {
        let deadline = Instant::now() + TRIGGER_TIMEOUT;
        loop {
            let start = Instant::now();
            let (status, answer) = self.command("trigger")?;
            match status {
                200 => return Ok(start.elapsed().as_secs_f64() * 1e3),
                409 if Instant::now() < deadline => std::thread::sleep(CALL_INTERVAL),
                _ => return Err(unexpected(&format!("refused a trigger: {answer}"))),
            }
        }
    }

    /// Measures CPU cores over some seconds, and then memory, MB.
    fn cores(&self, seconds: u64) -> Result<(f64, f64)> {
        let (started, before) = (Instant::now(), self.cpu_s()?);
        std::thread::sleep(Duration::from_secs(seconds));
        let cores = (self.cpu_s()? - before) / started.elapsed().as_secs_f64();
        Ok((cores, self.rss_mb()?))
    }

    fn proc(&self, file: &str) -> Result<String> {
        let path = format!("/proc/{}/{file}", self.child.id());
        fs::read_to_string(&path)
            .map_err(|e| Error::io("cannot read the process statistics", e).at(path))
    }

    fn cpu_s(&self) -> Result<f64> {
        let stat = self.proc("stat")?;
        // The name in brackets may contain spaces; utime and stime are fields 14 and 15.
        let after = stat.rsplit(')').next().unwrap_or_default();
        let ticks = after.split_whitespace().skip(11).take(2);
        Ok(ticks.filter_map(|t| t.parse::<f64>().ok()).sum::<f64>() / TICKS_PER_S)
    }

    fn rss_mb(&self) -> Result<f64> {
        let status = self.proc("status")?;
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
        let kb = line.and_then(|line| line.split_whitespace().next()?.parse::<f64>().ok());
        Ok(kb.unwrap_or(f64::NAN) / 1024.0)
    }

    fn frames_dropped(&self) -> Result<u64> {
        let state = get(&agent(), &format!("{}/api/state", self.url))?;
        let state: Value = serde_json::from_str(&state).unwrap_or(Value::Null);
        let cameras = state["cameras"].as_array().into_iter().flatten();
        Ok(cameras
            .filter_map(|camera| camera["sequence_gaps"].as_u64())
            .sum())
    }

    fn stop(&mut self) -> Result<()> {
        let pid = i32::try_from(self.child.id())
            .ok()
            .and_then(rustix::process::Pid::from_raw)
            .ok_or_else(|| unexpected("has no process id"))?;
        rustix::process::kill_process(pid, rustix::process::Signal::TERM)
            .map_err(|e| Error::io("cannot stop the daemon", e.into()))?;
        let status = self.child.wait();
        match status {
            Ok(status) if status.success() => Ok(()),
            _ => Err(unexpected("did not stop cleanly")),
        }
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        // Usually it has ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn agent() -> ureq::Agent {
    ureq::Agent::config_builder()
        .http_status_as_error(false)
        .build()
        .into()
}

fn get(agent: &ureq::Agent, url: &str) -> Result<String> {
    let answer = agent.get(url).call();
    let mut answer = answer.map_err(|e| unexpected("did not respond").because(e))?;
    let text = answer.body_mut().read_to_string();
    text.map_err(|e| unexpected("closed a response early").because(e))
}

/// Polls the state in its own thread.
struct ApiLoad {
    stop: Arc<AtomicBool>,
    thread: JoinHandle<Result<Vec<f64>>>,
}

impl ApiLoad {
    fn start(url: &str) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let (ended, url) = (Arc::clone(&stop), format!("{url}/api/state"));
        let thread = std::thread::spawn(move || {
            let (agent, mut times_ms) = (agent(), Vec::new());
            while !ended.load(Ordering::Relaxed) {
                let start = Instant::now();
                get(&agent, &url)?;
                times_ms.push(start.elapsed().as_secs_f64() * 1e3);
                // 50 calls per second: more than pages and programs make.
                std::thread::sleep(CALL_INTERVAL);
            }
            Ok(times_ms)
        });
        Self { stop, thread }
    }

    fn end(self) -> Result<Vec<f64>> {
        self.stop.store(true, Ordering::Relaxed);
        let times = self.thread.join();
        times.unwrap_or_else(|_| Err(unexpected("load thread panicked")))
    }
}

/// Viewers of all camera streams.
struct Viewers {
    images: Arc<AtomicU64>,
    threads: Vec<JoinHandle<()>>,
}

impl Viewers {
    fn start(url: &str, viewers: u64) -> Self {
        let images = Arc::new(AtomicU64::new(0));
        let streams = (0..viewers).flat_map(|_| CAMERAS);
        let threads = streams
            .map(|role| {
                let url = format!("{url}/api/cameras/{role}/preview.mjpg");
                let images = Arc::clone(&images);
                std::thread::spawn(move || watch(&url, &images))
            })
            .collect();
        Self { images, threads }
    }

    fn images(&self) -> u64 {
        self.images.load(Ordering::Relaxed)
    }

    fn end(self) {
        for thread in self.threads {
            // The daemon has closed the streams.
            let _ = thread.join();
        }
    }
}

/// Reads a stream to its end and counts its images.
fn watch(url: &str, images: &AtomicU64) {
    let Ok(answer) = agent().get(url).call() else {
        return;
    };
    let mut reader = BufReader::new(answer.into_body().into_reader());
    let mut line = Vec::new();
    loop {
        line.clear();
        match reader.read_until(b'\n', &mut line) {
            Ok(0) | Err(_) => return,
            Ok(_) => {}
        }
        let length = std::str::from_utf8(&line)
            .ok()
            .and_then(|line| line.strip_prefix("Content-Length: "))
            .and_then(|length| length.trim().parse::<u64>().ok());
        if let Some(length) = length {
            // The blank line, then the image.
            let mut skipped = reader.by_ref().take(length + 2);
            if std::io::copy(&mut skipped, &mut std::io::sink()).is_err() {
                return;
            }
            images.fetch_add(1, Ordering::Relaxed);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantile_returns_measured_value() {
        let mut values: Vec<f64> = (1..=100).rev().map(f64::from).collect();
        assert!((quantile(&mut values, 0.5) - 51.0).abs() < 1e-12);
        assert!((quantile(&mut values, 0.99) - 100.0).abs() < 1e-12);
        assert!(quantile(&mut [], 0.5).is_nan());
    }
}
