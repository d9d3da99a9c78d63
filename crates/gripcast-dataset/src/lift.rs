//! Lift frames: the frames of both gels in the seconds after the grasp trigger, so that the lift
//! itself is in the dataset.
//!
//! One file for each gel, not one for each frame: two seconds of both gels are a hundred frames, and
//! a hundred files would need a hundred flushes (measured: 0.6 s against 0.02 s). The file is the frames one after the other, which is
//! what video programs call MJPEG; the record has the size of each.
//!
//! They are added after the grasp was acknowledged and never endanger it: the files are written and
//! flushed beside it, then one replacement of the record makes them visible. Files that no record
//! names are removed at the next start.

use std::collections::BTreeMap;
use std::io;

use serde::{Deserialize, Serialize};

use super::digest::{FileDigest, digest};
use super::disk::Disk;
use super::encode::encode;
use super::grasp::GraspRecord;
use super::image_file;
use super::writer::DatasetWriter;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, FileKind, FileName, GraspId};
use gripcast_imaging::{Frame, PixelFormat, Role};

/// Gels whose frames can be kept.
const ROLES: [Role; 2] = [Role::Left, Role::Right];
/// Extension of frames in their compressed form, one after the other, which ffmpeg plays.
const MJPEG: &str = "mjpeg";
/// Extension of raw frames as PNG, one after the other.
const PNGS: &str = "pngs";

/// Lift frames of a grasp.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LiftRecord {
    /// Time after the grasp trigger that was to be kept, s. The frames end earlier where the next
    /// trigger came first.
    pub requested_s: f64,
    /// Frames by gel.
    pub cameras: BTreeMap<Role, LiftCamera>,
}

/// Lift frames of one gel: its file has them one after the other.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LiftCamera {
    /// File name inside the grasp's directory.
    pub file: FileName,
    /// Format as sent by the camera.
    pub format: PixelFormat,
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Frames in the order of the file.
    pub frames: Vec<LiftFrame>,
}

/// One lift frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LiftFrame {
    /// Size in the file, bytes.
    pub bytes: u64,
    /// Driver's frame counter; gaps are lost frames.
    pub sequence: u32,
    /// Driver's capture time, `CLOCK_MONOTONIC`, ns.
    pub driver_time_ns: u64,
}

impl LiftCamera {
    /// Splits the contents of the file into its frames.
    ///
    /// # Errors
    /// `Input`: it has another size, or a frame is damaged.
    pub fn split<'a>(&self, bytes: &'a [u8]) -> Result<Vec<(LiftFrame, &'a [u8])>> {
        let mut frames = Vec::with_capacity(self.frames.len());
        let mut rest = bytes;
        for (number, frame) in self.frames.iter().enumerate() {
            let size = usize::try_from(frame.bytes).unwrap_or(usize::MAX);
            let Some((image, after)) = rest.split_at_checked(size) else {
                return Err(self.other_size(bytes.len()));
            };
            if let Some(defect) = image_file::defect(image, self.format, self.width, self.height) {
                return Err(Error::input(format!("lift frame {number}: {defect}")));
            }
            frames.push((*frame, image));
            rest = after;
        }
        if rest.is_empty() {
            Ok(frames)
        } else {
            Err(self.other_size(bytes.len()))
        }
    }

    fn other_size(&self, found: usize) -> Error {
        let bytes = self.frames.iter().map(|frame| u128::from(frame.bytes));
        let (count, expected) = (self.frames.len(), bytes.sum::<u128>());
        Error::input(format!(
            "expected {count} lift frames of {expected} bytes as recorded, found {found} bytes"
        ))
    }
}

/// Name of the file with the lift frames of a gel.
fn lift_name(role: Role, format: PixelFormat) -> FileName {
    let extension = match format {
        PixelFormat::Mjpg => MJPEG,
        _ => PNGS,
    };
    FileName::from_words(&["lift", role.name(), extension])
}

/// Files of lift frames that a grasp may have.
pub(super) fn lift_files(grasp: &BeneathPath) -> impl Iterator<Item = BeneathPath> + '_ {
    ROLES.into_iter().flat_map(move |role| {
        [PixelFormat::Mjpg, PixelFormat::Yuyv].map(|format| grasp.join(lift_name(role, format)))
    })
}

/// Whether a name is one of [`lift_files`].
pub(super) fn is_lift_file(name: &str) -> bool {
    name.starts_with("lift.")
}

/// Lift frames as they are stored.
struct EncodedLift {
    record: LiftRecord,
    contents: BTreeMap<FileName, Vec<u8>>,
    files: BTreeMap<FileName, FileDigest>,
}

/// # Errors
/// `Input`: no complete frame, frames of another camera, too many.
fn encode_lift(frames: &BTreeMap<Role, Vec<Frame>>, requested_s: f64) -> Result<EncodedLift> {
    let mut lift = EncodedLift {
        record: LiftRecord {
            requested_s,
            cameras: BTreeMap::new(),
        },
        contents: BTreeMap::new(),
        files: BTreeMap::new(),
    };
    for (&role, frames) in frames {
        let Some(first) = frames.first() else {
            continue;
        };
        if !role.is_tactile() {
            return Err(Error::input(format!(
                "expected lift frames of left or right, found {role}"
            )));
        }
        let (format, width, height) = (first.format, first.width, first.height);
        let file = lift_name(role, format);
        let mut contents = Vec::new();
        let mut camera = LiftCamera {
            file: file.clone(),
            format,
            width,
            height,
            frames: Vec::with_capacity(frames.len()),
        };
        for frame in frames.iter().filter(|frame| frame.format == format) {
            // One damaged frame must not cost the others.
            let Ok((image, _)) = encode(frame) else {
                continue;
            };
            if image_file::defect(&image, format, width, height).is_some() {
                continue;
            }
            camera.frames.push(LiftFrame {
                bytes: image.len() as u64,
                sequence: frame.sequence,
                driver_time_ns: frame.driver_time_ns,
            });
            contents.extend_from_slice(&image);
        }
        let max = FileKind::Image.max_bytes();
        if contents.len() as u64 > max {
            return Err(Error::input(format!(
                "lift frames of {} MiB, at most {} MiB can be kept",
                contents.len() >> 20,
                max >> 20
            ))
            .at(role)
            .remedy("keep a shorter lift"));
        }
        if camera.frames.is_empty() {
            continue;
        }
        lift.files.insert(file.clone(), digest(&contents));
        lift.contents.insert(file, contents);
        lift.record.cameras.insert(role, camera);
    }
    if lift.contents.is_empty() {
        return Err(Error::input("expected lift frames, found no complete one"));
    }
    Ok(lift)
}

impl DatasetWriter {
    /// Adds the frames of the gels after the grasp trigger, by time, to a saved grasp; durable when
    /// this returns. `requested_s`: the time that was to be kept. Damaged frames and those of another
    /// size than the first are left out; the sequence numbers have gaps there.
    ///
    /// # Errors
    /// `Input`: no complete frame, or the grasp has lift frames. `NotFound`: the grasp was
    /// undone. `DiskFull`, `Io`, … with the grasp as before.
    pub fn append_lift(
        &mut self,
        id: &GraspId,
        frames: &BTreeMap<Role, Vec<Frame>>,
        requested_s: f64,
    ) -> Result<GraspRecord> {
        let what = format!("cannot keep the lift of {id}");
        if self.read(id)?.lift.is_some() {
            return Err(Error::input(format!("the lift of {id} is kept already")));
        }
        let lift = encode_lift(frames, requested_s)?;
        let dir = self.layout.grasp(id);
        if let Err(error) = write_files(self.disk.as_ref(), &dir, &lift.contents) {
            remove_files(self.disk.as_ref(), &dir, &lift.contents);
            return Err(self.failed(&what, error));
        }
        let contents = lift.contents;
        let changed = self.change(id, &what, |record| {
            record.lift = Some(lift.record);
            record.files.extend(lift.files);
            Ok(())
        });
        changed.inspect_err(|_| {
            // Not while a record may name them: its replacement can fail after the rename.
            let is_unnamed = self.read(id).is_ok_and(|record| record.lift.is_none());
            if is_unnamed && self.disk.sync_dir(&dir).is_ok() {
                remove_files(self.disk.as_ref(), &dir, &contents);
            }
        })
    }
}

/// Writes files whose names are durable when this returns.
fn write_files(
    disk: &dyn Disk,
    dir: &BeneathPath,
    contents: &BTreeMap<FileName, Vec<u8>>,
) -> io::Result<()> {
    contents
        .iter()
        .try_for_each(|(name, bytes)| disk.write(&dir.join(name), bytes))?;
    disk.sync_dir(dir)
}

/// Removes files as far as possible; the next start removes the rest.
fn remove_files(disk: &dyn Disk, dir: &BeneathPath, contents: &BTreeMap<FileName, Vec<u8>>) {
    for name in contents.keys() {
        let _ = disk.remove_file(&dir.join(name));
    }
}
