//! The disk of the dataset.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Instant;

use super::{CheckStatus, Finding, file_system};
use crate::daemon::disk_free_bytes;
use gripcast_base::error::{Error, Result};
use gripcast_base::files;
use gripcast_dataset::Dataset;
use gripcast_session::GuardLimits;

/// Number and size of the test writes: about the images of a grasp's stage.
const WRITES: usize = 20;
const BYTES: usize = 1 << 20;
/// Maximum time of a write that operators do not notice, ms.
const MAX_WRITE_MS: f64 = 150.0;
/// Number of grasps that should fit; each takes about 2 MB.
const MIN_GRASPS: u64 = 1000;
const GRASP_BYTES: u64 = 2_000_000;
/// `statfs` types of in-memory file systems (Linux, `magic.h`).
const TMPFS: u64 = 0x0102_1994;
const RAMFS: u64 = 0x8584_58f6;

/// Checks dataset, free space, file system and time of durable writes.
pub(super) fn findings(dataset: &Path, guards: &GuardLimits) -> Vec<Finding> {
    let mut findings = vec![contents(dataset)];
    let Some(folder) = existing(dataset) else {
        let found = format!("no parent folder of {} exists", dataset.display());
        findings.push(
            Finding::new("disk", "folder", CheckStatus::Fail, found)
                .remedy("set another --dataset"),
        );
        return findings;
    };
    findings.extend(space(&folder, guards));
    findings.extend(try_out(&folder));
    findings.extend(file_system::trash_finding(dataset));
    findings
}

/// Tries the writer's operations in a hidden directory, which is removed.
fn try_out(folder: &Path) -> Vec<Finding> {
    let probe = folder.join(format!(".gripcast-doctor-{}", std::process::id()));
    let at_folder = |what: &str, e: io::Error| {
        let remedy = files::disk_remedy(&e).unwrap_or("choose a dataset on another disk");
        let error = Error::io(what, e).at(folder.display()).remedy(remedy);
        Finding::failed("disk", "writes", &error)
    };
    if let Err(error) = fs::create_dir(&probe) {
        return vec![at_folder("cannot write", error)];
    }
    let mut findings = file_system::findings(&probe);
    findings.push(match durable_writes(&probe) {
        Ok(took_ms) => durability(took_ms),
        Err(error) => Finding::failed("disk", "writes", &error),
    });
    if let Err(error) = fs::remove_dir_all(&probe) {
        findings.push(at_folder("cannot remove the test files", error));
    }
    findings
}

fn contents(dataset: &Path) -> Finding {
    if !dataset.exists() {
        let found = format!("{} will be created", dataset.display());
        return Finding::new("disk", "dataset", CheckStatus::Ok, found);
    }
    let count = Dataset::open(dataset).and_then(|dataset| Ok(dataset.ids()?.len()));
    match count {
        Ok(count) => {
            let found = format!("{}: {count} grasps", dataset.display());
            Finding::new("disk", "dataset", CheckStatus::Ok, found)
                .measurement("grasps", count as f64)
        }
        Err(error) => Finding::failed("disk", "dataset", &error),
    }
}

/// Returns the folder or its nearest existing parent.
fn existing(path: &Path) -> Option<PathBuf> {
    let absolute = std::path::absolute(path).ok()?;
    let mut above = absolute.ancestors();
    above.find(|folder| folder.is_dir()).map(Path::to_path_buf)
}

fn space(folder: &Path, guards: &GuardLimits) -> Vec<Finding> {
    let Some(free) = disk_free_bytes(folder) else {
        return Vec::new();
    };
    let gigabytes = free as f64 / 1e9;
    let found = format!("{gigabytes:.1} GB free");
    let remedy = "free disk space, or choose a dataset on another disk";
    let finding = if free < guards.min_free_bytes {
        let min_gb = guards.min_free_bytes as f64 / 1e9;
        let found = format!("{found}; triggers are refused below {min_gb:.1} GB");
        Finding::new("disk", "space", CheckStatus::Fail, found).remedy(remedy)
    } else if free < guards.min_free_bytes + MIN_GRASPS * GRASP_BYTES {
        let found = format!("{found}, not enough for {MIN_GRASPS} grasps");
        Finding::new("disk", "space", CheckStatus::Warn, found).remedy(remedy)
    } else {
        Finding::new("disk", "space", CheckStatus::Ok, found)
    };
    let mut findings = vec![finding.measurement("free_gb", gigabytes)];
    let kind = rustix::fs::statfs(folder).map_or(0, |stat| stat.f_type as u64);
    if kind == TMPFS || kind == RAMFS {
        let found = format!(
            "{} is in memory: the dataset is lost when the computer is switched off",
            folder.display()
        );
        findings.push(
            Finding::new("disk", "kind", CheckStatus::Warn, found)
                .remedy("choose a dataset on a disk"),
        );
    }
    findings
}

/// Measures durable writes in `probe` and returns their times in ascending order, ms.
fn durable_writes(probe: &Path) -> Result<Vec<f64>> {
    // Pseudo-random bytes, because some disks compress.
    let mut state = 1_u32;
    let bytes: Vec<u8> = std::iter::repeat_with(|| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    })
    .take(BYTES)
    .collect();
    let took: Result<Vec<f64>> = (0..WRITES)
        .map(|number| {
            let start = Instant::now();
            files::save(&probe.join(number.to_string()), &bytes)?;
            Ok(start.elapsed().as_secs_f64() * 1e3)
        })
        .collect();
    let mut took = took?;
    took.sort_by(f64::total_cmp);
    Ok(took)
}

fn durability(took_ms: Vec<f64>) -> Finding {
    let median = took_ms.get(took_ms.len() / 2).copied().unwrap_or_default();
    let max = took_ms.last().copied().unwrap_or_default();
    let found = format!("durable write of 1 MiB: median {median:.1} ms, maximum {max:.1} ms");
    let finding = Finding::new("disk", "writes", CheckStatus::Ok, found)
        .measurement("durable_ms_median", median)
        .measurement("durable_ms_max", max);
    if max <= MAX_WRITE_MS {
        return finding;
    }
    finding.warn("tones are delayed by this disk, but no data is lost; use a solid-state disk")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_folder_is_measured_at_its_parent() {
        let folder = tempfile::tempdir().unwrap();
        let guards = GuardLimits {
            min_free_bytes: 0,
            ..GuardLimits::default()
        };
        let found = findings(&folder.path().join("a/b"), &guards);
        let of = |name: &str| found.iter().find(|f| f.name == name).unwrap();
        assert!(of("dataset").message.contains("will be created"));
        assert!(of("writes").measurements["durable_ms_max"] > 0.0);
        assert_eq!(
            fs::read_dir(folder.path()).unwrap().count(),
            0,
            "the probe must be removed"
        );
    }

    #[test]
    fn slow_full_and_invalid_folders_are_reported() {
        assert_eq!(durability(vec![1.0, 2.0, 40.0]).status, CheckStatus::Ok);
        let slow = durability(vec![1.0, 2.0, 400.0]);
        assert_eq!(
            (slow.status, slow.remedy.is_some()),
            (CheckStatus::Warn, true)
        );

        let folder = tempfile::tempdir().unwrap();
        let guards = |min_free_bytes| GuardLimits {
            min_free_bytes,
            ..GuardLimits::default()
        };
        assert_eq!(
            space(folder.path(), &guards(u64::MAX))[0].status,
            CheckStatus::Fail
        );

        fs::write(folder.path().join("dataset.toml"), "what").unwrap();
        let foreign = contents(folder.path());
        assert_eq!(foreign.status, CheckStatus::Fail, "{foreign:?}");
    }
}
