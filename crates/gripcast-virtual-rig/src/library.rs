//! Clips of a virtual rig.

use std::borrow::Cow;
use std::path::Path;
use std::sync::Arc;

use super::clip::{Clip, ClipFiles, TRACE};
use super::random::mixed;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::Root;

macro_rules! built_in_clips {
    ($($name:literal),* $(,)?) => {
        [$((
            $name,
            ClipFiles {
                trace: Cow::Borrowed(include_bytes!(concat!(
                    "../../../calib/virtual-rig/", $name, ".trace.bin"
                ))),
                colour: Cow::Borrowed(include_bytes!(concat!(
                    "../../../calib/virtual-rig/", $name, ".colour.jpg"
                ))),
                depth: Cow::Borrowed(include_bytes!(concat!(
                    "../../../calib/virtual-rig/", $name, ".depth.png"
                ))),
                external: Cow::Borrowed(include_bytes!(concat!(
                    "../../../calib/virtual-rig/", $name, ".external.jpg"
                ))),
                sheet: Cow::Borrowed(include_bytes!(concat!(
                    "../../../calib/virtual-rig/", $name, ".sheet.toml"
                ))),
            },
        )),*]
    };
}

/// The clips that a virtual hand plays, at least one.
#[derive(Clone, Debug)]
pub struct ClipLibrary {
    clips: Vec<Arc<Clip>>,
}

impl ClipLibrary {
    /// Returns the built-in clips.
    ///
    /// # Errors
    /// None; a test reads all of them.
    pub fn built_in() -> Result<Self> {
        let clips = built_in_clips!(
            "mug",
            "bottle-low",
            "ball",
            "ball-aside",
            "bottle",
            "wedge",
            "box",
            "box-end",
        );
        let parsed = clips
            .into_iter()
            .map(|(name, files)| Clip::parse(name, files, Path::new("")).map(Arc::new));
        Ok(Self {
            clips: parsed.collect::<Result<_>>()?,
        })
    }

    /// Reads and checks all clips in a folder, sorted by name.
    ///
    /// # Errors
    /// `NotFound`, `Io` for an unreadable folder or file, or a folder without clips; `Input` for
    /// an invalid clip.
    pub fn read(folder: &Path) -> Result<Self> {
        let at = |e| Error::io("cannot read the clips", e).at(folder.display());
        let mut names = Vec::new();
        for entry in Root::new(folder).top().entries().map_err(at)? {
            names.extend(entry.name().strip_suffix(TRACE).map(str::to_owned));
        }
        names.sort();
        if names.is_empty() {
            return Err(Error::not_found("the folder has no clips")
                .at(folder.display())
                .remedy(
                    "simulate grasps with `gripcast sim grasp … --trace FILE.bin`, then record \
                     clips with `gripcast render clip`",
                ));
        }
        let clips = names.iter().map(|name| {
            let read = || -> Result<Clip> {
                let clip = Clip::parse(name, ClipFiles::read(folder, name)?, folder)?;
                clip.check()?;
                Ok(clip)
            };
            read()
                .map(Arc::new)
                .map_err(|e| e.at(folder.join(name).display()))
        });
        Ok(Self {
            clips: clips.collect::<Result<_>>()?,
        })
    }

    /// Returns the clip of grasp `number` in a session with `seed`. Every round plays each clip
    /// once, the first round in library order, so that demonstrations are reproducible.
    pub fn clip(&self, seed: u64, number: u64) -> Arc<Clip> {
        let count = self.clips.len() as u64;
        let round = number / count;
        let mut order: Vec<usize> = (0..self.clips.len()).collect();
        if round > 0 {
            order.sort_by_key(|clip| mixed(seed, round, *clip as u64));
        }
        self.clips[order[(number % count) as usize]].clone()
    }

    /// Returns all clips.
    pub fn clips(&self) -> &[Arc<Clip>] {
        &self.clips
    }
}

#[cfg(test)]
mod tests {
    use gripcast_base::error::ErrorKind;
    use std::fs;

    use super::*;
    use gripcast_sim::grasp::GraspOutcome;

    fn is_stable(clip: &Clip) -> bool {
        clip.outcome() == GraspOutcome::Success
    }

    #[test]
    fn all_built_in_clips_are_valid() {
        let library = ClipLibrary::built_in().unwrap();
        assert_eq!(library.clips().len(), 8);
        for clip in library.clips() {
            clip.check().unwrap();
            let last = clip.steps.last().unwrap();
            let first_m = clip.truth_at(0).opening_m;
            assert!(
                (first_m - clip.start.opening_m).abs() < 1e-3,
                "{}",
                clip.name
            );
            let rest = clip.start.t_world_object.translation_m.z;
            let rise = last.t_world_object.translation_m.z - rest;
            assert_eq!(is_stable(clip), rise > 0.045, "{}: {rise}", clip.name);
        }
        let stable = library
            .clips()
            .iter()
            .filter(|clip| is_stable(clip))
            .count();
        assert!((3..=5).contains(&stable), "{stable} stable");
    }

    #[test]
    fn first_round_is_fixed_and_rounds_play_every_clip() {
        let library = ClipLibrary::built_in().unwrap();
        let count = library.clips().len() as u64;
        for seed in 0..20 {
            let first = [0, 1, 2].map(|number| is_stable(&library.clip(seed, number)));
            assert_eq!(first, [true, false, true]);
            for round in 0..3 {
                let mut names: Vec<_> = (0..count)
                    .map(|n| library.clip(seed, round * count + n).name.clone())
                    .collect();
                names.sort();
                names.dedup();
                assert_eq!(names.len() as u64, count);
            }
        }
        let session = |seed| (0..24).map(move |n| (seed, n));
        let names = |seed| -> Vec<_> {
            session(seed)
                .map(|(s, n)| library.clip(s, n).name.clone())
                .collect()
        };
        assert_eq!(names(1), names(1));
        assert!(names(1) != names(2), "later rounds follow the seed");
    }

    #[test]
    fn folder_without_clips_is_not_found() {
        let folder = tempfile::tempdir().unwrap();
        let text = ClipLibrary::read(folder.path()).unwrap_err().to_string();
        assert!(text.contains("render clip"), "{text}");
        let lost = folder.path().join("lost");
        assert_eq!(
            ClipLibrary::read(&lost).unwrap_err().kind(),
            ErrorKind::NotFound
        );
        fs::write(folder.path().join("a.trace.bin"), b"no").unwrap();
        assert_eq!(
            ClipLibrary::read(folder.path()).unwrap_err().kind(),
            ErrorKind::NotFound
        );
    }

    #[test]
    fn damaged_clip_is_rejected_and_valid_one_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let built_in = ClipLibrary::built_in().unwrap();
        let clip = &built_in.clips()[0];
        let write = |end: usize, bytes: &[u8]| {
            let files = clip.files.named("grip");
            fs::write(folder.path().join(&files[end].0), bytes).unwrap();
        };
        let whole: Vec<Vec<u8>> = clip.files.named("").iter().map(|f| f.1.to_vec()).collect();
        for (end, bytes) in whole.iter().enumerate() {
            write(end, bytes);
        }
        let read = ClipLibrary::read(folder.path()).unwrap();
        assert_eq!(read.clips()[0].name, "grip");
        assert_eq!(read.clips()[0].steps, clip.steps);
        for (end, bytes) in whole.iter().enumerate() {
            write(end, &bytes[..bytes.len() / 3]);
            let text = ClipLibrary::read(folder.path()).unwrap_err().to_string();
            assert!(text.contains("grip"), "{text}");
            write(end, bytes);
        }
    }
}
