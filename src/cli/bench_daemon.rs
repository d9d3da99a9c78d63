//! `gripcast bench daemon`: a daemon on the virtual rig, asked and watched while it collects.
//!
//! The virtual rig paints its images itself, which takes most of the cores; what viewers cost is
//! the difference between watched and not.

use std::fs;
use std::io::{BufRead as _, BufReader, Read as _};
use std::path::Path;
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

/// Ticks of CPU time a second in `/proc/PID/stat`: USER_HZ, the same on all machines.
const TICKS_PER_S: f64 = 100.0;
/// Cameras of the virtual rig that a page shows.
const SHOWN: [&str; 4] = ["left", "right", "rgb", "depth"];
/// How long a guard may refuse.
const PATIENCE: Duration = Duration::from_secs(30);
/// Pause before a refused trigger is tried again.
const RETRY: Duration = Duration::from_millis(20);

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Length of each of the two measurements of the cores
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=600))]
    seconds: u64,
    /// Grasps that are collected
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=1000))]
    grasps: u64,
    /// Pages that watch all cameras
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u64).range(1..=8))]
    viewers: u64,
    /// Folder for the dataset, on the disk that is to be measured [default: that of temporary files]
    #[arg(long, value_name = "DIR")]
    disk: Option<std::path::PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    pub(crate) json: bool,
}

/// What came out.
#[derive(Debug, Serialize)]
struct Figures {
    /// `GET /api/state` while grasps are collected and pages watch, ms.
    api_p50_ms: f64,
    api_p99_ms: f64,
    api_calls: usize,
    /// An accepted trigger until its frames are durable and it is answered, ms.
    durable_p50_ms: f64,
    durable_p99_ms: f64,
    /// Cores of the daemon without viewers, with them, and the difference.
    cores_alone: f64,
    cores_watched: f64,
    cores_of_viewers: f64,
    /// Images that reached the viewers, 1/s.
    images_per_s: f64,
    rss_alone_mb: f64,
    rss_watched_mb: f64,
    /// Frames lost by the cameras' counters.
    frames_lost: u64,
    stop_s: f64,
}

impl Args {
    /// Runs the bench.
    pub(crate) fn measure(&self, context: &Context) -> Result<Report> {
        let dir = match &self.disk {
            Some(disk) => tempfile::tempdir_in(disk),
            None => tempfile::tempdir(),
        };
        let dir = dir.map_err(|e| Error::io("cannot make a folder for the dataset", e))?;
        let mut daemon = Daemon::start(&dir.path().join("d"))?;
        if !context.quiet {
            note!(
                "a daemon at {}; two measurements of {} s, then {} grasps",
                daemon.url,
                self.seconds,
                self.grasps
            );
        }
        // The first frames come with the costs of the start.
        daemon.trigger()?;
        daemon.command("undo")?;
        let (cores_alone, rss_alone_mb) = daemon.cores(self.seconds)?;
        let viewers = Viewers::start(&daemon.url, self.viewers);
        let before = viewers.images();
        let (cores_watched, rss_watched_mb) = daemon.cores(self.seconds)?;
        let images_per_s = (viewers.images() - before) as f64 / self.seconds as f64;
        let asked = Asker::start(&daemon.url);
        let mut durable_ms = Vec::new();
        for number in 0..self.grasps {
            for _ in 0..2 {
                durable_ms.push(daemon.trigger()?);
            }
            daemon.command(if number % 2 == 0 { "stable" } else { "slip" })?;
        }
        let mut api_ms = asked.end()?;
        let frames_lost = daemon.frames_lost()?;
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
            cores_alone,
            cores_watched,
            cores_of_viewers: cores_watched - cores_alone,
            images_per_s,
            rss_alone_mb,
            rss_watched_mb,
            frames_lost,
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
            "a call of the API {:.1} ms (median) {:.1} ms (p99)\n\
         trigger until durable {:.0} ms (median) {:.0} ms (p99)\n\
         {:.2} cores alone, {:.2} with {} viewers ({:.0} images/s)\n\
         {:.0} MB alone, {:.0} MB watched; {} frames lost; stopped in {:.2} s",
            self.api_p50_ms,
            self.api_p99_ms,
            self.durable_p50_ms,
            self.durable_p99_ms,
            self.cores_alone,
            self.cores_watched,
            viewers,
            self.images_per_s,
            self.rss_alone_mb,
            self.rss_watched_mb,
            self.frames_lost,
            self.stop_s,
        )
    }
}

/// A value below which this part of all lies.
fn quantile(values: &mut [f64], part: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let place = (part * values.len().saturating_sub(1) as f64).ceil() as usize;
    values.get(place).copied().unwrap_or(f64::NAN)
}

fn unexpected(what: &str) -> Error {
    Error::internal(format!("the daemon {what}"))
        .remedy("run `gripcast daemon --rig virtual` by itself to see what it says")
}

/// The daemon under measurement; it is killed when dropped.
struct Daemon {
    child: Child,
    url: String,
}

impl Daemon {
    fn start(dataset: &Path) -> Result<Self> {
        let program =
            std::env::current_exe().map_err(|e| Error::io("cannot find the program itself", e))?;
        let mut child = Command::new(program)
            .args(["daemon", "--rig", "virtual", "--listen", "127.0.0.1:0"])
            .args(["--socket", "none", "--dataset"])
            .arg(dataset)
            // A loaded machine paints late; refusals are no matter of this measurement.
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
        // What it says from here on must not fill the pipe.
        std::thread::spawn(move || lines.for_each(drop));
        let url = url.ok_or_else(|| unexpected("ended at its start"))?;
        Ok(Self { child, url })
    }

    fn command(&self, command: &str) -> Result<(u16, Value)> {
        let body = json!({"command": command}).to_string();
        let answer = agent()
            .post(format!("{}/api/commands", self.url))
            .header("content-type", "application/json")
            .send(body);
        let mut answer = answer.map_err(|e| unexpected("did not answer").because(e))?;
        let text = answer.body_mut().read_to_string();
        let text = text.map_err(|e| unexpected("broke off an answer").because(e))?;
        let value = serde_json::from_str(&text).unwrap_or(Value::Null);
        Ok((answer.status().as_u16(), value))
    }

    /// Triggers until the guards agree; the time of the call that was carried out, ms.
    fn trigger(&self) -> Result<f64> {
        let give_up = Instant::now() + PATIENCE;
        loop {
            let asked = Instant::now();
            let (status, answer) = self.command("trigger")?;
            match status {
                200 => return Ok(asked.elapsed().as_secs_f64() * 1e3),
                409 if Instant::now() < give_up => std::thread::sleep(RETRY),
                _ => return Err(unexpected(&format!("refused a trigger: {answer}"))),
            }
        }
    }

    /// Cores that it takes over some seconds, and its memory then, MB.
    fn cores(&self, seconds: u64) -> Result<(f64, f64)> {
        let (started, before) = (Instant::now(), self.cpu_s()?);
        std::thread::sleep(Duration::from_secs(seconds));
        let cores = (self.cpu_s()? - before) / started.elapsed().as_secs_f64();
        Ok((cores, self.rss_mb()?))
    }

    fn proc(&self, file: &str) -> Result<String> {
        let path = format!("/proc/{}/{file}", self.child.id());
        fs::read_to_string(&path).map_err(|e| Error::io("cannot read what it takes", e).at(path))
    }

    fn cpu_s(&self) -> Result<f64> {
        let stat = self.proc("stat")?;
        // The name in brackets may hold blanks; utime and stime are 14th and 15th of all.
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

    fn frames_lost(&self) -> Result<u64> {
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
            .ok_or_else(|| unexpected("has no process"))?;
        rustix::process::kill_process(pid, rustix::process::Signal::TERM)
            .map_err(|e| Error::io("cannot stop the daemon", e.into()))?;
        let status = self.child.wait();
        match status {
            Ok(status) if status.success() => Ok(()),
            _ => Err(unexpected("did not end as it should")),
        }
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        // It has usually ended.
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
    let mut answer = answer.map_err(|e| unexpected("did not answer").because(e))?;
    let text = answer.body_mut().read_to_string();
    text.map_err(|e| unexpected("broke off an answer").because(e))
}

/// Asks for the state all the time, from a thread of its own.
struct Asker {
    stop: Arc<AtomicBool>,
    thread: JoinHandle<Result<Vec<f64>>>,
}

impl Asker {
    fn start(url: &str) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let (ended, url) = (Arc::clone(&stop), format!("{url}/api/state"));
        let thread = std::thread::spawn(move || {
            let (agent, mut times_ms) = (agent(), Vec::new());
            while !ended.load(Ordering::Relaxed) {
                let asked = Instant::now();
                get(&agent, &url)?;
                times_ms.push(asked.elapsed().as_secs_f64() * 1e3);
                // Fifty calls a second: more than pages and programs make.
                std::thread::sleep(RETRY);
            }
            Ok(times_ms)
        });
        Self { stop, thread }
    }

    fn end(self) -> Result<Vec<f64>> {
        self.stop.store(true, Ordering::Relaxed);
        let times = self.thread.join();
        times.unwrap_or_else(|_| Err(unexpected("made the measurement panic")))
    }
}

/// Pages that watch all cameras.
struct Viewers {
    images: Arc<AtomicU64>,
    threads: Vec<JoinHandle<()>>,
}

impl Viewers {
    fn start(url: &str, viewers: u64) -> Self {
        let images = Arc::new(AtomicU64::new(0));
        let streams = (0..viewers).flat_map(|_| SHOWN);
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
            // The daemon has closed the streams; a viewer that panicked has shown nothing more.
            let _ = thread.join();
        }
    }
}

/// Reads a stream to its end and counts the images.
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
    fn quantiles_are_values_that_were_measured() {
        let mut values: Vec<f64> = (1..=100).rev().map(f64::from).collect();
        assert!((quantile(&mut values, 0.5) - 51.0).abs() < 1e-12);
        assert!((quantile(&mut values, 0.99) - 100.0).abs() < 1e-12);
        assert!(quantile(&mut [], 0.5).is_nan());
    }
}
