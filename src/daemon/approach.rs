//! The external camera's last frames, each measured as it comes: where the gripper is before it
//! closes.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use image::imageops::grayscale;

use super::hub::{CameraSlot, Hub};
use super::sheets::Boards;
use super::status::MarkerStatus;
use super::thread::spawn;
use gripcast_annotate::{Annotation, Annotator, BoardHashes, Observation, annotation};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::FileName;
use gripcast_dataset::{PoseRecord, pre_grasp_name};
use gripcast_imaging::{Decoder, Frame, Intrinsics, Role};

/// Time between two frames that are kept.
const PAUSE: Duration = Duration::from_millis(120);
/// Most frames that are kept. The newest half is kept whole; of the older ones those go that leave
/// the smallest hole for their age, so that any time since the initial frame stays covered.
const MAX: usize = 48;
/// Frames from this long before the initial trigger count: the operator holds still to press.
const BEFORE_TRIGGER_NS: u64 = 700_000_000;
/// Frames that are stored where no board tells which are the right ones.
const STORED_UNSEEN: usize = 5;

/// A frame, and what it shows.
#[derive(Clone)]
struct Seen {
    frame: Frame,
    observation: Option<Result<Observation, String>>,
    /// Hash of the sheet that was looked for.
    sheet: String,
}

/// What the engine tells the thread, and what it is told.
#[derive(Default)]
struct Shared {
    object: String,
    ring: VecDeque<Seen>,
    /// What the newest frame shows.
    newest: Option<MarkerStatus>,
}

/// The boards of the object that is labelled.
struct CurrentBoards {
    hashes: BoardHashes,
    /// Text of the board files: sheet, tags.
    texts: [String; 2],
}

/// Frames to be stored with a grasp, and its pose.
#[derive(Default)]
pub(super) struct Approach {
    /// Frames by time, none of which is that of the initial stage.
    pub(super) frames: Vec<Frame>,
    /// The pose; it names the files that the frames will have.
    pub(super) pose: Option<PoseRecord>,
    /// Text of the board files: sheet, tags.
    pub(super) boards: Option<[String; 2]>,
    /// Why there is no pose.
    pub(super) absence: Option<String>,
}

/// Watches the external camera.
pub(super) struct ApproachWatch {
    shared: Arc<Mutex<Shared>>,
    boards: Option<Arc<Boards>>,
    thread: JoinHandle<()>,
}

impl ApproachWatch {
    /// Starts the thread; none without an external camera. Without boards or intrinsics frames are
    /// only kept.
    ///
    /// # Errors
    /// When the thread cannot be had.
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
        let (slot, theirs) = (Arc::clone(slot), Arc::clone(&shared));
        let decoder = Decoder::new()?;
        let thread = spawn("approach".into(), move || {
            run(&slot, &theirs, measurer, decoder);
        })?;
        Ok(Some(Self {
            shared,
            boards,
            thread,
        }))
    }

    /// The object that is labelled.
    pub(super) fn set_object(&self, object: &str) {
        object.clone_into(&mut lock(&self.shared).object);
    }

    /// What the newest frame shows.
    pub(super) fn newest(&self) -> Option<MarkerStatus> {
        lock(&self.shared).newest.clone()
    }

    /// What is stored with a grasp whose initial frame was triggered at `initial_ns`, until
    /// `until_ns`; `initial` is the external camera's frame of the initial stage: driver time and
    /// file.
    pub(super) fn take(
        &self,
        initial_ns: u64,
        until_ns: u64,
        initial: Option<&(u64, FileName)>,
    ) -> Approach {
        let shared = lock(&self.shared);
        let current = self.current(&shared.object);
        shared.take(initial_ns, until_ns, initial, current)
    }

    fn current(&self, object: &str) -> Option<CurrentBoards> {
        let boards = self.boards.as_ref()?;
        // A sheet that cannot be read was told of when it was looked for.
        let sheet = boards.sheet(object).ok()??;
        Some(CurrentBoards {
            hashes: BoardHashes {
                sheet: sheet.board.hash(),
                tags: boards.tags.board.hash(),
            },
            texts: [sheet.to_toml(), boards.tags.to_toml()],
        })
    }

    /// Ends with the hub.
    pub(super) fn join(self) {
        // A thread that panicked has nothing left to give back.
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
    ) -> Approach {
        let from_ns = initial_ns.saturating_sub(BEFORE_TRIGGER_NS);
        let file_of_initial = |frame: &Frame| {
            let (time_ns, file) = initial?;
            (*time_ns == frame.driver_time_ns).then_some(file)
        };
        let within: Vec<&Seen> = self
            .ring
            .iter()
            .filter(|seen| (from_ns..until_ns).contains(&seen.frame.driver_time_ns))
            .collect();
        let numbers: Vec<String> = (0..within.len()).map(|n| n.to_string()).collect();
        let found = boards.as_ref().and_then(|boards| {
            // Before the object was changed another sheet was looked for.
            let seen = within.iter().zip(&numbers).filter_map(|(seen, number)| {
                let observation = seen.observation.as_ref()?.as_ref().ok()?;
                (seen.sheet == boards.hashes.sheet).then_some((number.as_str(), observation))
            });
            annotation(seen, boards.hashes.clone())
        });
        let boards = boards.map(|boards| boards.texts);
        let Some(Annotation { mut record, .. }) = found else {
            let before: Vec<&Frame> = within
                .iter()
                .map(|seen| &seen.frame)
                .filter(|f| f.driver_time_ns <= initial_ns && file_of_initial(f).is_none())
                .collect();
            let skipped = before.len().saturating_sub(STORED_UNSEEN);
            let why = |seen: &&Seen| seen.observation.as_ref()?.as_ref().err().cloned();
            return Approach {
                frames: before[skipped..].iter().map(|f| (*f).clone()).collect(),
                absence: within.iter().rev().find_map(why),
                boards,
                pose: None,
            };
        };
        let mut frames = Vec::new();
        if let Some(quality) = &mut record.quality {
            for name in &mut quality.frames {
                let number: usize = name.parse().unwrap_or_default();
                let frame = &within[number].frame;
                if let Some(file) = file_of_initial(frame) {
                    *name = file.to_string();
                } else {
                    *name = pre_grasp_name(frames.len(), frame.format).into();
                    frames.push(frame.clone());
                }
            }
        }
        Approach {
            frames,
            pose: Some(record),
            boards,
            absence: None,
        }
    }
}

fn lock(shared: &Mutex<Shared>) -> MutexGuard<'_, Shared> {
    // Entries are whole before they are put there.
    shared.lock().unwrap_or_else(PoisonError::into_inner)
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
        let newest = slot.sound_frames().pop();
        if let Some(frame) = newest.filter(|frame| frame.driver_time_ns > last_ns) {
            last_ns = frame.driver_time_ns;
            let object = lock(shared).object.clone();
            let measured = measurer
                .as_mut()
                .map(|measurer| measurer.measure(&mut decoder, &frame, &object));
            let mut shared = lock(shared);
            let seen = match measured {
                None => Seen {
                    frame,
                    observation: None,
                    sheet: String::new(),
                },
                Some((observation, sheet)) => {
                    shared.newest = Some(MarkerStatus {
                        ok: observation.is_ok(),
                        text: observation.as_ref().map_or_else(Clone::clone, told),
                    });
                    Seen {
                        frame,
                        observation: Some(observation),
                        sheet,
                    }
                }
            };
            shared.ring.push_back(seen);
            thin(&mut shared.ring);
        }
        slot.wait_closed(PAUSE.saturating_sub(started.elapsed()));
    }
}

/// Takes one frame out if there are too many; see [`MAX`].
fn thin(ring: &mut VecDeque<Seen>) {
    if ring.len() <= MAX {
        return;
    }
    let time = |i: usize| ring[i].frame.driver_time_ns as f64;
    let newest = time(ring.len() - 1);
    let hole = |i: &usize| (time(i + 1) - time(i - 1)) / (newest - time(*i));
    let dispensable = (1..ring.len() - MAX / 2).min_by(|a, b| hole(a).total_cmp(&hole(b)));
    if let Some(frame) = dispensable {
        ring.remove(frame);
    }
}

fn told(seen: &Observation) -> String {
    format!(
        "sheet {}, tags {}, {:.2} px{}",
        seen.object.used_markers(),
        seen.gripper.body.used_markers(),
        seen.object.rms_px.max(seen.gripper.body.rms_px),
        if seen.is_ambiguous() {
            ", ambiguous"
        } else {
            ""
        }
    )
}

/// Measures frames with the boards of the object that is labelled.
struct Measurer {
    boards: Arc<Boards>,
    intrinsics: Intrinsics,
    annotator: Option<Annotator>,
}

impl Measurer {
    /// What a frame shows, or why it cannot be measured; and the hash of the sheet.
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

    /// The annotator for the sheet of an object.
    fn annotator(&mut self, object: &str) -> Result<&mut Annotator> {
        let sheet = self.boards.sheet(object)?;
        let kept = self.annotator.take();
        let sheet = sheet.ok_or_else(|| {
            let what = format!("there is no sheet for `{object}`");
            Error::not_found(what)
        })?;
        let annotator = match kept {
            Some(annotator) if annotator.sheet() == &sheet => annotator,
            _ => Annotator::new(sheet, self.boards.tags.clone(), self.intrinsics)?,
        };
        Ok(self.annotator.insert(annotator))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_imaging::PixelFormat;

    const MS: u64 = 1_000_000;

    fn seen(time_ns: u64) -> Seen {
        Seen {
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
    fn a_long_wait_stays_covered() {
        let mut ring = VecDeque::new();
        for n in 1..=1000 {
            ring.push_back(seen(n * 120 * MS));
            thin(&mut ring);
        }
        assert_eq!(ring.len(), MAX);
        let times: Vec<u64> = ring.iter().map(|s| s.frame.driver_time_ns / MS).collect();
        let (old, new) = times.split_at(MAX / 2);
        assert!(
            new.windows(2).all(|pair| pair[1] - pair[0] == 120),
            "{new:?}"
        );
        // Of two minutes, whatever happened is seen within a third of its age.
        let newest = 1000 * 120;
        assert_eq!((old[0], new.last()), (120, Some(&newest)));
        let holes = old
            .windows(2)
            .map(|pair| (pair[1] - pair[0]) * 3 <= newest - pair[0]);
        assert!(holes.into_iter().all(|is_small| is_small), "{old:?}");
    }

    #[test]
    fn without_boards_the_last_frames_before_the_trigger_are_stored() {
        let shared = Shared {
            ring: (1..=40).map(|n| seen(n * 100 * MS)).collect(),
            ..Shared::default()
        };
        let times = |approach: &Approach| -> Vec<u64> {
            let frames = approach.frames.iter();
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
