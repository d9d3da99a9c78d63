//! The disk that a dataset lies on, or will.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use super::{Finding, Verdict};
use gripcast_base::error::{Error, Result};
use gripcast_base::files;
use gripcast_dataset::Dataset;
use gripcast_session::GuardLimits;

/// Files that are written, and their size: about the images of a grasp's stage.
const WRITES: usize = 20;
const BYTES: usize = 1 << 20;
/// Longest time for one of them that no operator notices, ms.
const SWIFT_MS: f64 = 150.0;
/// Grasps that should still fit; each takes about 2 MB.
const GRASPS_AHEAD: u64 = 1000;
const GRASP_BYTES: u64 = 2_000_000;
/// `statfs` type of a file system in memory (Linux, `magic.h`).
const TMPFS: u64 = 0x0102_1994;
const RAMFS: u64 = 0x8584_58f6;

/// Dataset, space, kind of file system and time until a write is durable.
pub(super) fn findings(dataset: &Path, guards: &GuardLimits) -> Vec<Finding> {
    let mut findings = vec![contents(dataset)];
    let Some(folder) = existing(dataset) else {
        let found = format!("there is no folder above {}", dataset.display());
        findings.push(
            Finding::new("disk", "folder", Verdict::Fail, found).remedy("choose another --dataset"),
        );
        return findings;
    };
    findings.extend(room(&folder, guards));
    findings.push(match durable_writes(&folder) {
        Ok(took_ms) => durability(took_ms),
        Err(error) => Finding::failed("disk", "writes", &error),
    });
    findings
}

fn contents(dataset: &Path) -> Finding {
    if !dataset.exists() {
        let found = format!("{} will be made", dataset.display());
        return Finding::new("disk", "dataset", Verdict::Ok, found);
    }
    let count = Dataset::open(dataset).and_then(|dataset| Ok(dataset.ids()?.len()));
    match count {
        Ok(count) => {
            let found = format!("{}: {count} grasps", dataset.display());
            Finding::new("disk", "dataset", Verdict::Ok, found).figure("grasps", count as f64)
        }
        Err(error) => Finding::failed("disk", "dataset", &error),
    }
}

/// The folder, or the nearest one above it that exists.
fn existing(path: &Path) -> Option<PathBuf> {
    let absolute = std::path::absolute(path).ok()?;
    let mut above = absolute.ancestors();
    above.find(|folder| folder.is_dir()).map(Path::to_path_buf)
}

fn room(folder: &Path, guards: &GuardLimits) -> Vec<Finding> {
    let Ok(space) = rustix::fs::statvfs(folder) else {
        return Vec::new();
    };
    let free = space.f_bavail.saturating_mul(space.f_frsize);
    let gigabytes = free as f64 / 1e9;
    let found = format!("{gigabytes:.1} GB free");
    let remedy = "free some, or choose a dataset on another disk";
    let finding = if free < guards.min_free_bytes {
        let least = guards.min_free_bytes as f64 / 1e9;
        let found = format!("{found}; triggers are refused below {least:.1} GB");
        Finding::new("disk", "space", Verdict::Fail, found).remedy(remedy)
    } else if free < guards.min_free_bytes + GRASPS_AHEAD * GRASP_BYTES {
        let found = format!("{found}, less than {GRASPS_AHEAD} grasps may take");
        Finding::new("disk", "space", Verdict::Warn, found).remedy(remedy)
    } else {
        Finding::new("disk", "space", Verdict::Ok, found)
    };
    let mut findings = vec![finding.figure("free_gb", gigabytes)];
    let kind = rustix::fs::statfs(folder).map_or(0, |stat| stat.f_type as u64);
    if kind == TMPFS || kind == RAMFS {
        let found = format!(
            "{} is in memory: what is saved is gone when it is switched off",
            folder.display()
        );
        findings.push(
            Finding::new("disk", "kind", Verdict::Warn, found).remedy("choose a dataset on a disk"),
        );
    }
    findings
}

/// Times of writes that were as durable as a grasp's, ms, sorted.
fn durable_writes(folder: &Path) -> Result<Vec<f64>> {
    let probe = folder.join(format!(".gripcast-doctor-{}", std::process::id()));
    let at_probe = |e| Error::io("cannot write", e).at(folder.display());
    fs::create_dir(&probe).map_err(at_probe)?;
    // Not the same bytes again and again: some disks would notice.
    let mut state = 1_u32;
    let bytes: Vec<u8> = std::iter::repeat_with(|| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    })
    .take(BYTES)
    .collect();
    let took: Result<Vec<f64>> = (0..WRITES)
        .map(|number| {
            let began = Instant::now();
            files::save(&probe.join(number.to_string()), &bytes)?;
            Ok(began.elapsed().as_secs_f64() * 1e3)
        })
        .collect();
    let removed = fs::remove_dir_all(&probe);
    let mut took = took?;
    removed.map_err(at_probe)?;
    took.sort_by(f64::total_cmp);
    Ok(took)
}

fn durability(took_ms: Vec<f64>) -> Finding {
    let median = took_ms.get(took_ms.len() / 2).copied().unwrap_or_default();
    let longest = took_ms.last().copied().unwrap_or_default();
    let found =
        format!("1 MiB is durable after {median:.1} ms (median), {longest:.1} ms (longest)");
    let finding = Finding::new("disk", "writes", Verdict::Ok, found)
        .figure("durable_ms_median", median)
        .figure("durable_ms_max", longest);
    if longest <= SWIFT_MS {
        return finding;
    }
    Finding {
        verdict: Verdict::Warn,
        ..finding
    }
    .remedy("tones come late on this disk, though nothing is lost; a solid-state disk is quicker")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_that_is_not_there_yet_is_measured_where_it_will_be() {
        let folder = tempfile::tempdir().unwrap();
        let guards = GuardLimits {
            min_free_bytes: 0,
            ..GuardLimits::default()
        };
        let found = findings(&folder.path().join("a/b"), &guards);
        let of = |name: &str| found.iter().find(|f| f.name == name).unwrap();
        assert!(of("dataset").found.contains("will be made"));
        assert!(of("writes").figures["durable_ms_max"] > 0.0);
        assert_eq!(
            fs::read_dir(folder.path()).unwrap().count(),
            0,
            "nothing stays"
        );
    }

    #[test]
    fn slow_full_and_foreign_folders_are_told() {
        assert_eq!(durability(vec![1.0, 2.0, 40.0]).verdict, Verdict::Ok);
        let slow = durability(vec![1.0, 2.0, 400.0]);
        assert_eq!((slow.verdict, slow.remedy.is_some()), (Verdict::Warn, true));

        let folder = tempfile::tempdir().unwrap();
        let guards = |min_free_bytes| GuardLimits {
            min_free_bytes,
            ..GuardLimits::default()
        };
        assert_eq!(
            room(folder.path(), &guards(u64::MAX))[0].verdict,
            Verdict::Fail
        );

        fs::write(folder.path().join("dataset.toml"), "what").unwrap();
        let foreign = contents(folder.path());
        assert_eq!(foreign.verdict, Verdict::Fail, "{foreign:?}");
    }
}
