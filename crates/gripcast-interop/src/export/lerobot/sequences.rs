//! The sequence of a grasp in the black box: approach, grasp and lift at a fixed rate.
//!
//! A grasp is read twice: first every frame is checked and the frames of the sequence are chosen,
//! then they are decoded one after the other, so that no sequence is ever whole in memory.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use jiff::Timestamp;

use super::super::plan::SequencePlan;
use super::super::source::Grasp;
use super::features::Features;
use super::ticks::{CameraTimes, MAX_AGE_NS, Tick, Window, slowest_rate, ticks};
use crate::black_box::{BlackBoxLog, Collection, LoggedMessage, ShearMessage};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::Root;
use gripcast_dataset::{GraspRecord, Stage};
use gripcast_imaging::{Decoder, Frame, PixelFormat, Role, decode_png_grey16};

/// Size of a frame beside its images, bytes, generously.
const ROW_BYTES: usize = 8 << 10;

/// The black box of a dataset, and how sequences are cut from it.
pub(super) struct Sequences<'a> {
    plan: &'a SequencePlan,
    log: BlackBoxLog,
    decoder: Decoder,
    /// Frames per second, once known.
    fps: Option<u32>,
    notes: Vec<String>,
    /// Damaged frames by role.
    damaged: BTreeMap<Role, usize>,
}

/// The sequence of a grasp, not yet decoded.
pub(super) struct Sequence {
    pub(super) ticks: Vec<Tick>,
    /// Cameras in the order of the ticks' frames.
    pub(super) roles: Vec<Role>,
    /// Estimated size, bytes.
    pub(super) bytes: usize,
    shear: BTreeMap<(Role, u64), ShearMessage>,
    chunks: BTreeSet<usize>,
}

/// One moment of a sequence with the frames of all cameras.
pub(super) struct Moment<'a> {
    /// Index in the sequence.
    pub(super) index: usize,
    pub(super) tick: &'a Tick,
    /// Frames in the order of the roles.
    pub(super) frames: Vec<&'a Frame>,
}

impl Sequence {
    /// Shear of a gel in a frame.
    pub(super) fn shear(&self, role: Role, frame_ns: u64) -> Option<&ShearMessage> {
        self.shear.get(&(role, frame_ns))
    }

    pub(super) fn len(&self) -> usize {
        self.ticks.len()
    }

    /// Whether it is the last frame.
    pub(super) fn is_last(&self, index: usize) -> bool {
        index + 1 == self.ticks.len()
    }
}

/// What the first reading of a grasp has found.
#[derive(Default)]
struct Checked {
    /// Size in the export of each usable frame, bytes.
    bytes: BTreeMap<(Role, u64), usize>,
    /// Damage of the others.
    damage: BTreeMap<(Role, u64), Error>,
    shear: BTreeMap<(Role, u64), ShearMessage>,
}

impl<'a> Sequences<'a> {
    /// Scans the black box. `dataset` is the folder of the dataset, which has it unless the plan
    /// names another one.
    ///
    /// # Errors
    /// Those of [`BlackBoxLog::open`].
    pub(super) fn open(plan: &'a SequencePlan, dataset: &std::path::Path) -> Result<Self> {
        let directory = match &plan.black_box {
            Some(directory) => Root::new(directory).top(),
            None => Root::new(dataset).top().join("blackbox"),
        };
        let log = BlackBoxLog::open(&directory)?;
        Ok(Self {
            plan,
            notes: log.notes().to_vec(),
            log,
            decoder: Decoder::new()?,
            fps: plan.fps,
            damaged: BTreeMap::new(),
        })
    }

    /// Frames per second; 1 where no grasp had a sequence.
    pub(super) fn fps(&self) -> u32 {
        self.fps.unwrap_or(1)
    }

    /// Notes for the report.
    pub(super) fn notes(&self) -> impl Iterator<Item = String> {
        let damaged = self.damaged.iter();
        let damaged = damaged.map(|(role, n)| format!("damaged frames of {role} skipped: {n}"));
        self.notes.iter().cloned().chain(damaged)
    }

    /// Finds and checks the sequence of a grasp.
    ///
    /// # Errors
    /// Why the grasp has none.
    pub(super) fn find(&mut self, grasp: &Grasp, features: &Features) -> Result<Sequence> {
        let record = &grasp.record;
        let cameras = stored_frames(record, features)?;
        let collection = self.collection(&cameras)?;
        let window = window(record, &cameras, collection.clock_offset_ns, self.plan)?;
        let range = window.start_ns.saturating_sub(MAX_AGE_NS)..=window.end_ns;
        let mut frames: BTreeMap<Role, BTreeMap<u64, usize>> = BTreeMap::new();
        let mut shear = BTreeSet::new();
        for (role, _) in &cameras {
            let of_role = collection.frames.get(role).into_iter();
            let of_role = of_role.flat_map(|of_role| of_role.range(range.clone()));
            frames.insert(
                *role,
                of_role.map(|(time, chunk)| (*time, *chunk)).collect(),
            );
            let of_role = collection
                .shear
                .range((*role, *range.start())..=(*role, *range.end()));
            shear.extend(of_role.map(|(_, chunk)| *chunk));
        }
        let all = || {
            frames
                .iter()
                .flat_map(|(role, f)| f.keys().map(|time| (*role, *time)))
        };
        let mut chunks: BTreeSet<usize> = frames
            .values()
            .flat_map(|of_role| of_role.values().copied())
            .collect();
        chunks.extend(shear);
        let wanted: BTreeSet<(Role, u64)> = all().collect();
        let mut checked = Checked::default();
        let decoder = &mut self.decoder;
        self.log.read(&chunks, |message| {
            checked.add(message, &wanted, grasp, &cameras, features, decoder)
        })?;
        let mut times = Vec::new();
        for (role, grasp_ns) in &cameras {
            if let Some(damage) = checked.damage.remove(&(*role, *grasp_ns)) {
                return Err(damage.at(format!("grasp frame of {role} in the black box")));
            }
            let usable = checked.bytes.keys().filter(|(of, _)| of == role);
            times.push(CameraTimes {
                role: *role,
                times_ns: usable.map(|(_, time)| *time).collect(),
                grasp_ns: *grasp_ns,
            });
        }
        let (fps, slowest) = match self.fps {
            Some(fps) => (fps, None),
            None => {
                let (fps, role) = slowest_rate(&times)?;
                (fps, Some(role))
            }
        };
        let ticks = ticks(&window, fps, &times)?;
        self.fps = Some(fps);
        let id = &record.id;
        let rate = slowest.map(|role| format!("{fps} frames per second, as {role} of {id}"));
        self.notes.extend(rate);
        for (role, _) in checked.damage.keys() {
            *self.damaged.entry(*role).or_default() += 1;
        }
        let roles: Vec<Role> = cameras.into_iter().map(|(role, _)| role).collect();
        let chosen = |tick: &Tick| -> Vec<(Role, u64)> {
            roles
                .iter()
                .copied()
                .zip(tick.frames_ns.iter().copied())
                .collect()
        };
        let sizes = ticks.iter().flat_map(chosen);
        let sizes = sizes.filter_map(|key| checked.bytes.get(&key));
        let fields = features
            .fields
            .iter()
            .map(|f| 4 * f.shape.iter().product::<usize>());
        let row = ROW_BYTES + fields.sum::<usize>();
        let bytes = sizes.sum::<usize>() + row * ticks.len();
        let used: BTreeSet<(Role, u64)> = ticks.iter().flat_map(chosen).collect();
        let chunks = used
            .iter()
            .filter_map(|(role, time)| frames.get(role)?.get(time).copied());
        Ok(Sequence {
            chunks: chunks.collect(),
            ticks,
            roles,
            bytes,
            shear: checked.shear,
        })
    }

    /// The collection with the stored frames of a grasp.
    fn collection(&self, cameras: &[(Role, u64)]) -> Result<&Collection> {
        let has = |collection: &Collection, (role, time): &(Role, u64)| {
            let of_role = collection.frames.get(role);
            of_role.is_some_and(|frames| frames.contains_key(time))
        };
        let found =
            |collection: &&Collection| cameras.iter().filter(|c| has(collection, c)).count();
        let best = self.log.collections().iter().max_by_key(found);
        let Some(best) = best.filter(|best| found(best) > 0) else {
            return Err(Error::input("the black box has none of its grasp frames"));
        };
        match cameras.iter().find(|camera| !has(best, camera)) {
            None => Ok(best),
            Some((role, time)) => {
                let what = format!("the black box lacks its grasp frame of {role} at {time} ns");
                Err(Error::input(what))
            }
        }
    }

    /// Reads the frames of a sequence again and gives `each` its moments, one after the other.
    ///
    /// # Errors
    /// The first error of `each`; the black box was changed.
    pub(super) fn moments(
        &self,
        sequence: &Sequence,
        mut each: impl FnMut(&Moment<'_>) -> Result<()>,
    ) -> Result<()> {
        let mut used: BTreeMap<Role, BTreeSet<u64>> = BTreeMap::new();
        for tick in &sequence.ticks {
            for (role, time) in sequence.roles.iter().zip(&tick.frames_ns) {
                used.entry(*role).or_default().insert(*time);
            }
        }
        let mut waiting: BTreeMap<Role, VecDeque<Frame>> = BTreeMap::new();
        let mut next = 0;
        self.log.read(&sequence.chunks, |message| {
            let LoggedMessage::Frame(message) = message else {
                return Ok(());
            };
            let of_role = used.get_mut(&message.role);
            // Removed, so that the copy of a file is not read twice.
            if !of_role.is_some_and(|times| times.remove(&message.driver_time_ns)) {
                return Ok(());
            }
            let queue = waiting.entry(message.role).or_default();
            queue.push_back(message.frame()?);
            while let Some(tick) = sequence.ticks.get(next) {
                let cameras = sequence.roles.iter().zip(&tick.frames_ns);
                for (role, time) in cameras.clone() {
                    let queue = waiting.entry(*role).or_default();
                    while queue
                        .front()
                        .is_some_and(|frame| frame.driver_time_ns < *time)
                    {
                        queue.pop_front();
                    }
                }
                let frames = cameras.map(|(role, time)| {
                    let front = waiting.get(role)?.front()?;
                    (front.driver_time_ns == *time).then_some(front)
                });
                let Some(frames) = frames.collect::<Option<Vec<&Frame>>>() else {
                    return Ok(());
                };
                each(&Moment {
                    index: next,
                    tick,
                    frames,
                })?;
                next += 1;
            }
            Ok(())
        })?;
        match next == sequence.ticks.len() {
            true => Ok(()),
            false => Err(Error::input("the black box was changed during the export")),
        }
    }
}

impl Checked {
    fn add(
        &mut self,
        message: LoggedMessage<'_>,
        wanted: &BTreeSet<(Role, u64)>,
        grasp: &Grasp,
        cameras: &[(Role, u64)],
        features: &Features,
        decoder: &mut Decoder,
    ) -> Result<()> {
        match message {
            LoggedMessage::Shear(shear) => {
                let key = (shear.role, shear.frame_time_ns);
                if wanted.contains(&key) {
                    self.shear.entry(key).or_insert(shear);
                }
            }
            LoggedMessage::Frame(message) => {
                let key = (message.role, message.driver_time_ns);
                if !wanted.contains(&key) || self.bytes.contains_key(&key) {
                    return Ok(());
                }
                let frame = message.frame();
                let checked = frame.and_then(|frame| {
                    let bytes = checked_size(&frame, message.role, features, decoder)?;
                    if cameras.contains(&key) {
                        check_stored(&frame, message.role, grasp, decoder)?;
                    }
                    Ok(bytes)
                });
                match checked {
                    Ok(bytes) => drop(self.bytes.insert(key, bytes)),
                    Err(error) => drop(self.damage.insert(key, error)),
                }
            }
        }
        Ok(())
    }
}

/// Role and driver time of the stored grasp frames of all cameras of the export.
fn stored_frames(record: &GraspRecord, features: &Features) -> Result<Vec<(Role, u64)>> {
    let stored = features.roles().into_iter().map(|role| {
        let camera = record.grasp.cameras.get(&role);
        let camera = camera
            .ok_or_else(|| Error::input(format!("the grasp has no grasp frame of {role}")))?;
        Ok((role, camera.driver_time_ns))
    });
    stored.collect()
}

/// From the initial trigger, or later, to the end of the lift or the label.
fn window(
    record: &GraspRecord,
    cameras: &[(Role, u64)],
    clock_offset_ns: i128,
    plan: &SequencePlan,
) -> Result<Window> {
    let newest = cameras.iter().map(|(_, time)| *time).max();
    let grasp_ns = newest.ok_or_else(|| Error::input("the grasp has no cameras"))?;
    let nanoseconds = |d: std::time::Duration| u64::try_from(d.as_nanos()).unwrap_or(u64::MAX);
    let mut start_ns = record.initial.trigger_time_ns;
    if start_ns > grasp_ns {
        return Err(Error::input(
            "the initial trigger is after the grasp frames",
        ));
    }
    if let Some(approach) = plan.approach {
        start_ns = start_ns.max(grasp_ns.saturating_sub(nanoseconds(approach)));
    }
    let mut end_ns = grasp_ns.saturating_add(nanoseconds(plan.lift));
    let labelled_at = record.labelled_at.as_deref();
    if let Some(at) = labelled_at.and_then(|at| at.parse::<Timestamp>().ok()) {
        let labelled_ns = u64::try_from(at.as_nanosecond() - clock_offset_ns).ok();
        // A label may be older than the frames where another program wrote the grasp.
        if let Some(labelled_ns) = labelled_ns.filter(|labelled| *labelled > grasp_ns) {
            end_ns = end_ns.min(labelled_ns);
        }
    }
    Ok(Window {
        start_ns,
        grasp_ns,
        end_ns,
    })
}

/// Checks that a frame decodes and has the size of the export; returns its size in the export, at
/// most, bytes.
fn checked_size(
    frame: &Frame,
    role: Role,
    features: &Features,
    decoder: &mut Decoder,
) -> Result<usize> {
    let expected = features.size(role);
    if expected != Some((frame.width, frame.height)) {
        let (width, height) = expected.unwrap_or_default();
        return Err(Error::input(format!(
            "expected {width}×{height} px, found {}×{}",
            frame.width, frame.height
        )));
    }
    if (frame.format == PixelFormat::Z16) != (role == Role::Depth) {
        let what = format!("unexpected format {} of {role}", frame.format);
        return Err(Error::input(what));
    }
    decoder.verify(frame)?;
    let pixels = frame.width as usize * frame.height as usize;
    Ok(match frame.format {
        PixelFormat::Mjpg => frame.data.len() + ROW_BYTES,
        PixelFormat::Z16 => 4 * pixels + ROW_BYTES,
        PixelFormat::Yuyv | PixelFormat::Grey | PixelFormat::Rgb => 3 * pixels + ROW_BYTES,
    })
}

/// Checks that a frame has the pixels of the stored grasp image.
fn check_stored(frame: &Frame, role: Role, grasp: &Grasp, decoder: &mut Decoder) -> Result<()> {
    let Some(stored) = grasp.images.get(&(Stage::Grasp, role)) else {
        return Ok(());
    };
    let is_equal = match role {
        Role::Depth => decode_png_grey16(&stored.bytes)? == decoder.depth(frame)?,
        _ => decoder.stored_image(&stored.bytes)? == decoder.decode_full(frame)?,
    };
    match is_equal {
        true => Ok(()),
        false => Err(Error::input("it differs from the stored image")),
    }
}
