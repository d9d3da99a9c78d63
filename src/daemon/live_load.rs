//! Load test of the complete live path for `gripcast bench live`.
//!
//! Capture, hub, decoding and inference are those of `collect`; only the frames come from memory
//! instead of a driver, at the frame rate of the real cameras.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::mpsc::channel;
use std::time::Duration;

use image::{Rgb, RgbImage};

use super::black_box::Tap;
use super::capture::CaptureThreads;
use super::decode;
use super::histogram::LatencyHistogram;
use super::hub::{Decoded, Hub};
use super::infer::{InferRequest, Inference, PredictionRules};
use super::shear::{GelForces, GelScale};
use super::tasks::Tasks;
use super::thread::lock;
use gripcast_base::error::{Error, Result};
use gripcast_base::statistics::median;
use gripcast_base::workers::process_cpu_s;
use gripcast_capture::camera::{
    CameraIdentity, CameraOpener, CaptureError, ControlValues, FrameSource, StreamInfo,
    SupervisionPolicy, monotonic_ns,
};
use gripcast_imaging::{
    CropProfile, Decoder, DepthView, Frame, FrameBytes, FramePool, PixelFormat, Role, draw_line,
    encode_jpeg, synthetic_gel,
};
use gripcast_nn::predict::Model;
use gripcast_tactile::SensorProfile;
use gripcast_tactile::force::ForceEstimator;

/// Frames that a V4L2 queue holds for a late reader; further ones are lost, as with a driver.
const QUEUE_FRAMES: u64 = 4;

/// Size of a GelSight Mini's frame, pixels.
const GEL_SIZE: (u32, u32) = (3280, 2464);

/// Size of the frames of the wrist camera, pixels, and depths in them, mm.
const WRIST_SIZE: (u32, u32) = (1280, 720);
const OBJECT_MM: u16 = 180;
const TABLE_MM: u16 = 250;

/// Pitch, diameter and largest motion of the gel markers in a full frame, px: in the cropped image
/// 31.5 px as in real frames, 12 px and 5 px.
const MARKER_PITCH_PX: f64 = 231.0;
const MARKER_DIAMETER_PX: f64 = 88.0;
const MARKER_MOTION_PX: f64 = 37.0;

/// Number of different frames that each camera repeats.
const DISTINCT_FRAMES: u64 = 6;

/// Warm-up time before the measurement.
const WARM_UP: Duration = Duration::from_secs(2);

/// Parameters of the load test.
#[derive(Clone, Copy, Debug)]
pub struct LoadParams {
    /// Duration of the measurement, s.
    pub seconds: u64,
    /// JPEG quality of the gel frames, 1..100.
    pub quality: u8,
}

/// Results of the load test.
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct LoadFigures {
    /// Lost frames of all cameras: gaps in the sequence numbers.
    pub lost: u64,
    /// Tactile frames skipped because the decoder was busy.
    pub not_decoded: u64,
    /// Received frames of all cameras.
    pub received: u64,
    /// Predictions per second.
    pub predictions_per_s: f64,
    /// Median latency from camera frame to prediction, ms.
    pub latency_p50_ms: f64,
    /// 99th percentile of the latency, ms.
    pub latency_p99_ms: f64,
    /// Verdicts in the lift per second.
    pub lift_verdicts_per_s: f64,
    /// Fraction of them with the motion of the object in depth images.
    pub lift_verdicts_with_depth: f64,
    /// 99th percentile of the latency from the newest frame of a gel to the verdict in the lift, ms.
    pub lift_latency_p99_ms: f64,
    /// Median time to judge a tactile image, ms.
    pub gel_judge_p50_ms: f64,
    /// Median time to measure the shear of a tactile image, ms.
    pub shear_p50_ms: f64,
    /// Mean number of busy CPU cores.
    pub cores: f64,
    /// Peak resident memory of the process, MB.
    pub rss_mb: f64,
    /// Mean size of a gel frame, kB.
    pub gel_frame_kb: f64,
}

/// Runs two 3280×2464 MJPG streams at 25/s and 1280×720 YUYV and Z16 at 30/s through the live path,
/// with a prediction and a verdict in the lift of a saved grasp for every tactile frame.
///
/// # Errors
/// Errors of starting a thread, creating a decoder or loading the model.
pub fn run_load(model: Model, params: LoadParams) -> Result<LoadFigures> {
    let cameras = [
        (Role::Left, gel_frames(1, params.quality)?),
        (Role::Right, gel_frames(2, params.quality)?),
        (Role::Rgb, colour_frames()),
        (Role::Depth, depth_frames()),
    ];
    let gel_bytes: usize = cameras[..2]
        .iter()
        .flat_map(|(_, recording)| recording.frames.iter().map(|f| f.len()))
        .sum();
    let openers = cameras
        .into_iter()
        .map(|(role, recording)| -> Box<dyn CameraOpener> {
            Box::new(MemoryOpener { role, recording })
        })
        .collect();

    let hub = Hub::new(
        [Role::Left, Role::Right, Role::Rgb, Role::Depth],
        Tap::default(),
    );
    let (requests, inbox) = channel();
    let crop = |role: Role| role.is_tactile().then_some(CropProfile::GSMINI_SEVENTH);
    let tasks = Tasks::default();
    let decoders = decode::start(&hub, crop, &requests, &tasks)?;
    let scale = GelScale {
        m_per_px: SensorProfile::gelsight_mini()?.geometry.pixel_m,
        markers: None,
    };
    let scales = BTreeMap::from([(Role::Left, scale.clone()), (Role::Right, scale)]);
    let estimator = Arc::new(ForceEstimator::new(&SensorProfile::gelsight_mini()?, None)?);
    let forces = GelForces::from([Role::Left, Role::Right].map(|r| (r, Arc::clone(&estimator))));
    let inference = Inference::start(
        &hub,
        Some(model),
        PredictionRules {
            limits: None,
            depth_view: Some(DepthView::Colour),
        },
        (scales, forces),
        (requests, inbox),
        &tasks,
    )?;
    // This source repeats its frames by design.
    let policy = SupervisionPolicy {
        freeze_after_ns: None,
        ..SupervisionPolicy::default()
    };
    let mut capture = CaptureThreads::start(openers, &hub, &policy, &tasks)?;

    std::thread::sleep(WARM_UP / 2);
    let initial = |role| {
        let decoded = hub.slot(role).and_then(|slot| slot.latest());
        decoded
            .map(|decoded| decoded.image)
            .ok_or_else(|| Error::internal(format!("{role}: nothing decoded in 1 s")))
    };
    let request = InferRequest::SetInitial {
        revision: 1,
        left: initial(Role::Left)?,
        right: initial(Role::Right)?,
    };
    inference
        .requests
        .send(request)
        .map_err(|_| Error::internal("the inference thread has ended"))?;
    begin_lift(&hub, &inference)?;
    std::thread::sleep(WARM_UP / 2);

    // Reports arrive twice a second; the counters before and after are equally old.
    let before = frame_counts(&hub);
    let predictions_before = {
        let mut state = inference.state();
        state.latency = LatencyHistogram::default();
        state.judge_time = LatencyHistogram::default();
        state.shear_time = LatencyHistogram::default();
        state.lift_latency = LatencyHistogram::default();
        state.lift_verdicts = [0; 2];
        state.predictions
    };
    let (cpu, started) = (process_cpu_s(), monotonic_ns());
    std::thread::sleep(Duration::from_secs(params.seconds));
    let wall_s = monotonic_ns().saturating_sub(started) as f64 * 1e-9;
    let cores = (process_cpu_s() - cpu) / wall_s;
    let after = frame_counts(&hub);
    capture.stop();
    hub.close();
    for decoder in decoders {
        // A panic has been printed; the frames count as not decoded.
        let _ = decoder.join();
    }
    let state = inference.stop();
    let state = lock(&state);
    let quantile = |q| state.latency.quantile_ms(q).unwrap_or(f64::NAN);
    let [verdicts, with_depth] = state.lift_verdicts.map(|count| count as f64);
    Ok(LoadFigures {
        lost: after[0] - before[0],
        not_decoded: after[1] - before[1],
        received: after[2] - before[2],
        predictions_per_s: (state.predictions - predictions_before) as f64 / wall_s,
        latency_p50_ms: quantile(0.5),
        latency_p99_ms: quantile(0.99),
        lift_verdicts_per_s: verdicts / wall_s,
        lift_verdicts_with_depth: with_depth / verdicts,
        lift_latency_p99_ms: state.lift_latency.quantile_ms(0.99).unwrap_or(f64::NAN),
        gel_judge_p50_ms: state.judge_time.quantile_ms(0.5).unwrap_or(f64::NAN),
        shear_p50_ms: state.shear_time.quantile_ms(0.5).unwrap_or(f64::NAN),
        cores,
        rss_mb: peak_rss_mb(),
        gel_frame_kb: gel_bytes as f64 / (2 * DISTINCT_FRAMES) as f64 * 1e-3,
    })
}

/// Saves a grasp of the newest images, so that its lift begins.
fn begin_lift(hub: &Hub, inference: &Inference) -> Result<()> {
    let newest: BTreeMap<Role, Decoded> = hub
        .slots()
        .filter_map(|slot| Some((slot.role, slot.latest()?)))
        .collect();
    let depth = newest
        .get(&Role::Depth)
        .and_then(|d| d.depth.as_deref().cloned());
    let images = newest.into_iter().filter(|(role, _)| *role != Role::Depth);
    let (reply, analysed) = channel();
    let request = InferRequest::Analyse {
        images: images.map(|(role, d)| (role, (*d.image).clone())).collect(),
        depth,
        reply,
    };
    let ended = |_| Error::internal("the inference thread has ended");
    inference.requests.send(request).map_err(|_| ended(()))?;
    analysed.recv().map_err(|_| ended(()))?;
    Ok(())
}

/// Sums lost, not decoded (tactile only) and received frames over all cameras.
fn frame_counts(hub: &Hub) -> [u64; 3] {
    hub.slots().fold([0; 3], |[lost, skipped, received], slot| {
        let is_tactile = u64::from(slot.role.is_tactile());
        slot.with_info(|info| {
            let counters = &info.counters;
            [
                lost + counters.sequence_gaps,
                skipped + is_tactile * info.not_decoded,
                received + counters.received,
            ]
        })
    })
}

/// Returns one tactile frame of the load, without contact.
///
/// # Errors
/// If it cannot be encoded.
pub fn gel_frame(quality: u8) -> Result<Frame> {
    let (width, height) = GEL_SIZE;
    let image = synthetic_gel(width, height, 100, 0.0);
    Ok(Frame {
        format: PixelFormat::Mjpg,
        width,
        height,
        data: encode_jpeg(&image, quality)?.into(),
        sequence: 0,
        driver_time_ns: 0,
        received_ns: 0,
    })
}

/// Returns the median CPU time to decode `frame` to the model's input, ms.
///
/// # Errors
/// `Input` for a damaged frame.
pub fn decode_ms(frame: &Frame, runs: u64) -> Result<f64> {
    let mut decoder = Decoder::new()?;
    let crop = Some(&CropProfile::GSMINI_SEVENTH);
    let times_ms = (0..runs)
        .map(|_| {
            let started = process_cpu_s();
            decode::model_image(&mut decoder, frame, crop)?;
            Ok((process_cpu_s() - started) * 1e3)
        })
        .collect::<Result<Vec<f64>>>()?;
    Ok(median(times_ms).unwrap_or(f64::NAN))
}

/// Frames of one camera.
#[derive(Clone)]
struct Recording {
    info: StreamInfo,
    frames: Arc<Vec<FrameBytes>>,
}

fn recording(
    product: &str,
    format: PixelFormat,
    (width, height): (u32, u32),
    fps: f64,
    frames: Vec<FrameBytes>,
) -> Recording {
    Recording {
        info: StreamInfo {
            identity: CameraIdentity {
                product: product.into(),
                port: "memory".into(),
                ..CameraIdentity::default()
            },
            format,
            width,
            height,
            nominal_fps: fps,
            depth_unit_m: (format == PixelFormat::Z16).then_some(0.001),
        },
        frames: Arc::new(frames),
    }
}

/// Draws the dots of a marker gel, all moved by `shift_px` to the right.
fn draw_gel_markers(image: &mut RgbImage, shift_px: f64) {
    let (columns, rows) = (
        f64::from(image.width()) / MARKER_PITCH_PX,
        f64::from(image.height()) / MARKER_PITCH_PX,
    );
    for row in 0..rows as u32 {
        for column in 0..columns as u32 {
            let x = (f64::from(column) + 0.5) * MARKER_PITCH_PX + shift_px;
            let at = [x, (f64::from(row) + 0.5) * MARKER_PITCH_PX];
            draw_line(image, at, at, MARKER_DIAMETER_PX, Rgb([28, 32, 36]));
        }
    }
}

/// Generates frames of a GelSight Mini's marker gel with a growing and shrinking contact that moves
/// the markers.
fn gel_frames(seed: u64, quality: u8) -> Result<Recording> {
    let size = GEL_SIZE;
    let frames = (0..DISTINCT_FRAMES)
        .map(|i| {
            let contact = (i as f32 / DISTINCT_FRAMES as f32 * std::f32::consts::PI).sin();
            let mut image = synthetic_gel(size.0, size.1, seed * 100 + i, contact);
            draw_gel_markers(&mut image, f64::from(contact) * MARKER_MOTION_PX);
            Ok(encode_jpeg(&image, quality)?.into())
        })
        .collect::<Result<_>>()?;
    Ok(recording(
        "memory gel",
        PixelFormat::Mjpg,
        size,
        25.0,
        frames,
    ))
}

fn colour_frames() -> Recording {
    let (width, height) = WRIST_SIZE;
    let frames = (0..2)
        .map(|i| {
            let bytes = 0..(width * height * 2);
            let data: Vec<u8> = bytes.map(|b| (b / width + i * 16) as u8).collect();
            data.into()
        })
        .collect();
    let format = PixelFormat::Yuyv;
    recording("memory colour", format, WRIST_SIZE, 30.0, frames)
}

/// Generates depth images of an object between the fingers, which moves up and down by 1 mm.
fn depth_frames() -> Recording {
    let (width, height) = WRIST_SIZE;
    let is_middle = |at: u32, side: u32| (side / 3..2 * side / 3).contains(&at);
    let frames = (0..2)
        .map(|i| {
            let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
            let codes = pixels.map(|(x, y)| match is_middle(x, width) && is_middle(y, height) {
                true => OBJECT_MM + i,
                false => TABLE_MM,
            });
            let data: Vec<u8> = codes.flat_map(u16::to_le_bytes).collect();
            data.into()
        })
        .collect();
    let format = PixelFormat::Z16;
    recording("memory depth", format, WRIST_SIZE, 30.0, frames)
}

struct MemoryOpener {
    role: Role,
    recording: Recording,
}

impl CameraOpener for MemoryOpener {
    fn role(&self) -> Role {
        self.role
    }

    fn describe(&self) -> String {
        format!("{} frames in memory", self.recording.frames.len())
    }

    fn open(&mut self) -> Result<Box<dyn FrameSource>> {
        Ok(Box::new(MemorySource {
            recording: self.recording.clone(),
            pool: FramePool::default(),
            started_ns: monotonic_ns(),
            next: 0,
        }))
    }
}

/// Source of frames at the nominal rate; each is copied as from a driver's buffer.
struct MemorySource {
    recording: Recording,
    pool: FramePool,
    started_ns: u64,
    next: u64,
}

impl FrameSource for MemorySource {
    fn info(&self) -> &StreamInfo {
        &self.recording.info
    }

    fn next_frame(&mut self, timeout: Duration) -> Result<Frame, CaptureError> {
        let info = &self.recording.info;
        let interval_ns = (1e9 / info.nominal_fps) as u64;
        let now_ns = monotonic_ns();
        let complete = now_ns.saturating_sub(self.started_ns) / interval_ns;
        if complete > self.next + QUEUE_FRAMES {
            self.next = complete - QUEUE_FRAMES;
        }
        let due_ns = self.started_ns + self.next * interval_ns;
        let wait = Duration::from_nanos(due_ns.saturating_sub(now_ns));
        if wait > timeout {
            std::thread::sleep(timeout);
            return Err(CaptureError::Timeout);
        }
        std::thread::sleep(wait);
        let frames = &self.recording.frames;
        let data = self
            .pool
            .copy(&frames[(self.next % frames.len() as u64) as usize]);
        let sequence = self.next as u32;
        self.next += 1;
        Ok(Frame {
            format: info.format,
            width: info.width,
            height: info.height,
            data,
            sequence,
            driver_time_ns: due_ns,
            received_ns: monotonic_ns(),
        })
    }

    fn controls(&mut self) -> Result<ControlValues> {
        Ok(ControlValues::new())
    }
}

/// Returns the peak resident memory of this process, MB; NaN if /proc is not available.
pub fn peak_rss_mb() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:")?.trim().strip_suffix("kB"))
        .and_then(|kb| kb.trim().parse::<f64>().ok())
        .map_or(f64::NAN, |kb| kb * 1024.0 * 1e-6)
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_imaging::{Depth, DepthImage, ObjectTracker};

    #[test]
    fn depth_images_show_an_object_that_moves() {
        let recording = depth_frames();
        let depths = recording.frames.iter().map(|frame| {
            let codes = frame
                .as_chunks()
                .0
                .iter()
                .map(|code| u16::from_le_bytes(*code));
            let (width, height) = WRIST_SIZE;
            let image = DepthImage::from_vec(width, height, codes.collect()).unwrap();
            Depth {
                image,
                unit_m: 0.001,
            }
        });
        let [before, after]: [Depth; 2] = depths.collect::<Vec<_>>().try_into().unwrap();
        let tracker = ObjectTracker::new(&before, DepthView::Colour).unwrap();
        let moved = tracker.motion(&after, DepthView::Colour).unwrap();
        let [low_mm, _, high_mm] = moved.summary_mm().unwrap();
        assert!(
            low_mm.abs() > 0.3 && (high_mm - low_mm).abs() < 0.5,
            "{moved:?}"
        );
    }
}
