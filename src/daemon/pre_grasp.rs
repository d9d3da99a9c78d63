//! Pre-grasp frames: the last frames of the external camera before the gripper closes, with the
//! boards detected in them.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use image::imageops::grayscale;

use super::boards::Boards;
use super::hub::{CameraSlot, Hub};
use super::status::MarkerStatus;
use super::thread::{lock, spawn};
use gripcast_annotate::{Annotation, Annotator, BoardHashes, Observation, annotation};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::FileName;
use gripcast_dataset::{PoseRecord, pre_grasp_name};
use gripcast_imaging::{Decoder, Frame, Intrinsics, Role};
use gripcast_pose::detect::FullSearch;

/// Interval between two kept frames.
const INTERVAL: Duration = Duration::from_millis(120);
/// Maximum kept frames. The newest half is kept completely; older frames are thinned where the gap
/// is smallest for their age, so that the whole time since the initial frame stays covered.
const MAX_FRAMES: usize = 48;
/// Time before the initial trigger from which frames count: the operator holds still to press, ns.
const BEFORE_TRIGGER_NS: u64 = 700_000_000;
/// Frames stored if no board is detected.
const FRAMES_WITHOUT_POSE: usize = 5;

/// A frame and the boards detected in it.
#[derive(Clone)]
struct MeasuredFrame {
    frame: Frame,
    observation: Option<Result<Observation, String>>,
    /// Hash of the expected sheet.
    sheet: String,
}

/// State shared by the engine and the thread.
#[derive(Default)]
struct Shared {
    object: String,
    ring: VecDeque<MeasuredFrame>,
    /// Detection result of the newest frame.
    newest: Option<MarkerStatus>,
}

/// Boards of the current object.
struct CurrentBoards {
    hashes: BoardHashes,
    /// Texts of the board files: sheet, tags.
    texts: [String; 2],
}

/// Frames stored with a grasp, and its pose.
#[derive(Default)]
pub(super) struct PreGraspFrames {
    /// Frames in order of time, without that of the initial stage.
    pub(super) frames: Vec<Frame>,
    /// The pose; it refers to the file names of the frames.
    pub(super) pose: Option<PoseRecord>,
    /// Texts of the board files: sheet, tags.
    pub(super) boards: Option<[String; 2]>,
    /// Reason why there is no pose.
    pub(super) no_pose_reason: Option<String>,
}

/// Recorder of the external camera's frames.
pub(super) struct PreGraspRecorder {
    shared: Arc<Mutex<Shared>>,
    boards: Option<Arc<Boards>>,
    thread: JoinHandle<()>,
}

impl PreGraspRecorder {
    /// Starts the thread if there is an external camera. Without boards or intrinsics, frames are
    /// kept without detection.
    ///
    /// # Errors
    /// `Io` if the thread cannot be started.
    pub(super) fn start(
        hub: &Hub,
        boards: Option<Boards>,
        intrinsics: Option<Intrinsics>,
    ) -> Result<Option<Self>> {
        let Some(slot) = hub.slot(Role::External) else {
            return Ok(None);
        };
        let shared = Arc::new(Mutex::new(Shared::default()));
        let boards = boards.map(Arc::new);
        let measurer = boards
            .clone()
            .zip(intrinsics)
            .map(|(boards, intrinsics)| Measurer {
                boards,
                intrinsics,
                annotator: None,
            });
        let (slot, thread_state) = (Arc::clone(slot), Arc::clone(&shared));
        let decoder = Decoder::new()?;
        let thread = spawn("pre-grasp".into(), move || {
            run(&slot, &thread_state, measurer, decoder);
        })?;
        Ok(Some(Self {
            shared,
            boards,
            thread,
        }))
    }

    /// Sets the current object.
    pub(super) fn set_object(&self, object: &str) {
        object.clone_into(&mut lock(&self.shared).object);
    }

    /// Returns the detection result of the newest frame.
    pub(super) fn newest(&self) -> Option<MarkerStatus> {
        lock(&self.shared).newest.clone()
    }

    /// Returns the frames for a grasp between the initial trigger at `initial_ns` and `until_ns`.
    /// `initial` is the external camera's frame of the initial stage: driver time and file.
    pub(super) fn take(
        &self,
        initial_ns: u64,
        until_ns: u64,
        initial: Option<&(u64, FileName)>,
    ) -> PreGraspFrames {
        let shared = lock(&self.shared);
        let current = self.current(&shared.object);
        shared.take(initial_ns, until_ns, initial, current)
    }

    fn current(&self, object: &str) -> Option<CurrentBoards> {
        let boards = self.boards.as_ref()?;
        // An unreadable sheet has already been reported by the detection.
        let sheet = boards.sheet(object).ok()??;
        Some(CurrentBoards {
            hashes: BoardHashes {
                sheet: sheet.board.hash(),
                tags: boards.tags.board.hash(),
            },
            texts: [sheet.to_toml(), boards.tags.to_toml()],
        })
    }

    /// Waits for the thread, which ends with the hub.
    pub(super) fn join(self) {
        // A panic has been reported already.
        let _ = self.thread.join();
    }
}

impl Shared {
    fn take(
        &self,
        initial_ns: u64,
        until_ns: u64,
        initial: Option<&(u64, FileName)>,
        boards: Option<CurrentBoards>,
    ) -> PreGraspFrames {
        let from_ns = initial_ns.saturating_sub(BEFORE_TRIGGER_NS);
        let initial_file = |frame: &Frame| {
            let (time_ns, file) = initial?;
            (*time_ns == frame.driver_time_ns).then_some(file)
        };
        let within: Vec<&MeasuredFrame> = self
            .ring
            .iter()
            .filter(|measured| (from_ns..until_ns).contains(&measured.frame.driver_time_ns))
            .collect();
        let numbers: Vec<String> = (0..within.len()).map(|n| n.to_string()).collect();
        let annotated = boards.as_ref().and_then(|boards| {
            // Earlier frames may have been measured with the sheet of another object.
            let observations = within
                .iter()
                .zip(&numbers)
                .filter_map(|(measured, number)| {
                    let observation = measured.observation.as_ref()?.as_ref().ok()?;
                    (measured.sheet == boards.hashes.sheet)
                        .then_some((number.as_str(), observation))
                });
            annotation(observations, boards.hashes.clone())
        });
        let boards = boards.map(|boards| boards.texts);
        let Some(Annotation { mut record, .. }) = annotated else {
            let before: Vec<&Frame> = within
                .iter()
                .map(|measured| &measured.frame)
                .filter(|f| f.driver_time_ns <= initial_ns && initial_file(f).is_none())
                .collect();
            let skipped = before.len().saturating_sub(FRAMES_WITHOUT_POSE);
            let reason =
                |measured: &&MeasuredFrame| measured.observation.as_ref()?.as_ref().err().cloned();
            return PreGraspFrames {
                frames: before[skipped..].iter().map(|f| (*f).clone()).collect(),
                no_pose_reason: within.iter().rev().find_map(reason),
                boards,
                pose: None,
            };
        };
        let mut frames = Vec::new();
        if let Some(quality) = &mut record.quality {
            for name in &mut quality.frames {
                let number: usize = name.parse().unwrap_or_default();
                let frame = &within[number].frame;
                if let Some(file) = initial_file(frame) {
                    *name = file.to_string();
                } else {
                    *name = pre_grasp_name(frames.len(), frame.format).into();
                    frames.push(frame.clone());
                }
            }
        }
        PreGraspFrames {
            frames,
            pose: Some(record),
            boards,
            no_pose_reason: None,
        }
    }
}

fn run(
    slot: &CameraSlot,
    shared: &Mutex<Shared>,
    mut measurer: Option<Measurer>,
    mut decoder: Decoder,
) {
    let mut last_ns = 0;
    while !slot.is_closed() {
        let started = Instant::now();
        let newest = slot.valid_frames().pop();
        if let Some(frame) = newest.filter(|frame| frame.driver_time_ns > last_ns) {
            last_ns = frame.driver_time_ns;
            let object = lock(shared).object.clone();
            let measured = measurer
                .as_mut()
                .map(|measurer| measurer.measure(&mut decoder, &frame, &object));
            let (observation, sheet) = measured.unzip();
            let mut shared = lock(shared);
            if let Some(observation) = &observation {
                shared.newest = Some(MarkerStatus {
                    ok: observation.is_ok(),
                    text: observation.as_ref().map_or_else(Clone::clone, summary),
                });
            }
            shared.ring.push_back(MeasuredFrame {
                frame,
                observation,
                sheet: sheet.unwrap_or_default(),
            });
            thin(&mut shared.ring);
        }
        slot.wait_closed(INTERVAL.saturating_sub(started.elapsed()));
    }
}

/// Removes one frame if there are too many; see [`MAX_FRAMES`].
fn thin(ring: &mut VecDeque<MeasuredFrame>) {
    if ring.len() <= MAX_FRAMES {
        return;
    }
    let time = |i: usize| ring[i].frame.driver_time_ns as f64;
    let newest = time(ring.len() - 1);
    let gap = |i: &usize| (time(i + 1) - time(i - 1)) / (newest - time(*i));
    let dispensable = (1..ring.len() - MAX_FRAMES / 2).min_by(|a, b| gap(a).total_cmp(&gap(b)));
    if let Some(frame) = dispensable {
        ring.remove(frame);
    }
}

fn summary(observation: &Observation) -> String {
    format!(
        "sheet {}, tags {}, {:.2} px{}",
        observation.object.used_markers(),
        observation.gripper.body.used_markers(),
        observation
            .object
            .rms_px
            .max(observation.gripper.body.rms_px),
        if observation.is_ambiguous() {
            ", ambiguous"
        } else {
            ""
        }
    )
}

/// Detects the boards of the current object in frames.
struct Measurer {
    boards: Arc<Boards>,
    intrinsics: Intrinsics,
    annotator: Option<Annotator>,
}

impl Measurer {
    /// Returns the observation or the reason for its absence, and the hash of the expected sheet.
    fn measure(
        &mut self,
        decoder: &mut Decoder,
        frame: &Frame,
        object: &str,
    ) -> (Result<Observation, String>, String) {
        let mut observe = || {
            let annotator = self.annotator(object)?;
            let image = decoder.decode_full(frame)?;
            annotator.observe(&grayscale(&image))
        };
        let observation = observe().map_err(|error: Error| error.what().to_owned());
        let sheet = self.annotator.as_ref().map(|a| a.boards().sheet);
        (observation, sheet.unwrap_or_default())
    }

    /// Returns the annotator for the sheet of an object.
    fn annotator(&mut self, object: &str) -> Result<&mut Annotator> {
        let sheet = self.boards.sheet(object)?;
        let previous = self.annotator.take();
        let sheet = sheet.ok_or_else(|| {
            let what = format!("no sheet found for `{object}`");
            Error::not_found(what)
        })?;
        let annotator = match previous {
            Some(annotator) if annotator.sheet() == &sheet => annotator,
            _ => Annotator::new(
                sheet,
                self.boards.tags.clone(),
                self.intrinsics,
                FullSearch::Never,
            )?,
        };
        Ok(self.annotator.insert(annotator))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_imaging::PixelFormat;

    const MS: u64 = 1_000_000;

    fn measured(time_ns: u64) -> MeasuredFrame {
        MeasuredFrame {
            frame: Frame {
                format: PixelFormat::Grey,
                width: 1,
                height: 1,
                data: vec![0].into(),
                sequence: 0,
                driver_time_ns: time_ns,
                received_ns: time_ns,
            },
            observation: None,
            sheet: String::new(),
        }
    }

    #[test]
    fn long_wait_stays_covered_by_frames() {
        let mut ring = VecDeque::new();
        for n in 1..=1000 {
            ring.push_back(measured(n * 120 * MS));
            thin(&mut ring);
        }
        assert_eq!(ring.len(), MAX_FRAMES);
        let times: Vec<u64> = ring.iter().map(|s| s.frame.driver_time_ns / MS).collect();
        let (old, new) = times.split_at(MAX_FRAMES / 2);
        assert!(
            new.windows(2).all(|pair| pair[1] - pair[0] == 120),
            "{new:?}"
        );
        // Over two minutes, no gap is longer than a third of its age.
        let newest = 1000 * 120;
        assert_eq!((old[0], new.last()), (120, Some(&newest)));
        let are_small = old
            .windows(2)
            .map(|pair| (pair[1] - pair[0]) * 3 <= newest - pair[0]);
        assert!(are_small.into_iter().all(|is_small| is_small), "{old:?}");
    }

    #[test]
    fn last_frames_before_trigger_are_stored_without_boards() {
        let shared = Shared {
            ring: (1..=40).map(|n| measured(n * 100 * MS)).collect(),
            ..Shared::default()
        };
        let times = |taken: &PreGraspFrames| -> Vec<u64> {
            let frames = taken.frames.iter();
            frames.map(|f| f.driver_time_ns / MS).collect()
        };
        let initial = (2000 * MS, "initial.external.png".parse().unwrap());
        let taken = shared.take(2050 * MS, 4000 * MS, Some(&initial), None);
        assert_eq!(times(&taken), [1500, 1600, 1700, 1800, 1900]);
        assert!(taken.pose.is_none() && taken.boards.is_none());
        let nothing = shared.take(9000 * MS, 9500 * MS, None, None);
        assert!(nothing.frames.is_empty());
    }
}
