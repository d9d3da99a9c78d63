//! Tests of the black box with in-memory directories of limited size.

use std::collections::BTreeMap;
use std::io::{self, Cursor, Seek, SeekFrom, Write};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use mcap::records::Record;
use mcap::{Message, MessageStream, Summary};
use prost::Message as _;
use serde_json::Value;

use super::clock::WallClock;
use super::log_dir::{DiskLogDir, LogDir, LogFile, LogName};
use super::queue::{Content, Next, Queue, Tap};
use super::writer::Writer;
use super::{BlackBox, BlackBoxReport, BlackBoxSettings, Provenance, Topic};
use gripcast_imaging::{Frame, PixelFormat, Role};
use gripcast_interop::black_box::{CompressedImage, RawImage, camera_channel};

const CLOCK: WallClock = WallClock {
    offset_ns: 1_795_000_000_000_000_000,
};

fn frame(format: PixelFormat, sequence: u32, bytes: usize) -> Frame {
    let mut data = vec![sequence as u8; bytes];
    data[0] = 0xff;
    Frame {
        format,
        width: 4,
        height: 2,
        data: data.into(),
        sequence,
        driver_time_ns: 40_000_000 * u64::from(sequence),
        received_ns: 0,
    }
}

fn jpeg(sequence: u32, bytes: usize) -> Frame {
    frame(PixelFormat::Mjpg, sequence, bytes)
}

fn settings() -> BlackBoxSettings {
    BlackBoxSettings {
        directory: "box".into(),
        file_bytes: 1 << 30,
        total_bytes: 20 << 30,
        reserve_bytes: 0,
        queue_bytes: 1 << 30,
    }
}

/// In-memory directory; its contents are what a killed program leaves.
#[derive(Clone, Default)]
struct MemoryDir {
    files: Arc<Mutex<BTreeMap<String, Vec<u8>>>>,
    /// Free space, bytes.
    room: Arc<Mutex<Option<u64>>>,
}

impl MemoryDir {
    fn names(&self) -> Vec<String> {
        self.files.lock().unwrap().keys().cloned().collect()
    }

    fn file(&self, name: &str) -> Vec<u8> {
        self.files.lock().unwrap()[name].clone()
    }
}

struct MemoryFile {
    disk: MemoryDir,
    name: String,
    at: u64,
}

impl Write for MemoryFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut count = bytes.len();
        if let Some(room) = self.disk.room.lock().unwrap().as_mut() {
            count = count.min(*room as usize);
            if count == 0 && !bytes.is_empty() {
                return Err(io::ErrorKind::StorageFull.into());
            }
            *room -= count as u64;
        }
        let mut files = self.disk.files.lock().unwrap();
        let mut file = Cursor::new(files.get_mut(&self.name).unwrap());
        file.set_position(self.at);
        file.write_all(&bytes[..count])?;
        self.at += count as u64;
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Seek for MemoryFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let length = self.disk.files.lock().unwrap()[&self.name].len() as u64;
        self.at = match to {
            SeekFrom::Start(at) => at,
            SeekFrom::End(by) => length.checked_add_signed(by).unwrap(),
            SeekFrom::Current(by) => self.at.checked_add_signed(by).unwrap(),
        };
        Ok(self.at)
    }
}

impl LogDir for MemoryDir {
    fn create(&mut self, name: &str) -> io::Result<Box<dyn LogFile>> {
        let before = self.files.lock().unwrap().insert(name.into(), Vec::new());
        assert!(before.is_none(), "{name} exists");
        Ok(Box::new(MemoryFile {
            disk: self.clone(),
            name: name.into(),
            at: 0,
        }))
    }

    fn rename(&mut self, from: &str, to: &str) -> io::Result<()> {
        let mut files = self.files.lock().unwrap();
        let file = files.remove(from).unwrap();
        files.insert(to.into(), file);
        Ok(())
    }

    fn list(&mut self) -> io::Result<Vec<(String, u64)>> {
        let files = self.files.lock().unwrap();
        let sizes = files
            .iter()
            .map(|(name, file)| (name.clone(), file.len() as u64));
        Ok(sizes.collect())
    }

    fn remove(&mut self, name: &str) -> io::Result<()> {
        self.files.lock().unwrap().remove(name).unwrap();
        Ok(())
    }

    fn free_bytes(&mut self) -> Option<u64> {
        *self.room.lock().unwrap()
    }
}

/// Writes the entries added by `fill` without a thread.
fn written(
    log_dir: Box<dyn LogDir>,
    settings: BlackBoxSettings,
    fill: impl FnOnce(&Tap),
) -> (BlackBoxReport, Arc<Queue>) {
    let queue = Arc::new(Queue::new(settings.queue_bytes, CLOCK));
    let report = Arc::new(Mutex::new(BlackBoxReport::default()));
    let origin = Provenance::from([("dataset".to_owned(), "kitchen".to_owned())]);
    fill(&Tap::new(&queue));
    queue.close();
    let ends = (Arc::clone(&queue), Arc::clone(&report));
    Writer::new(log_dir, settings, origin, ends.0, ends.1).run();
    let report = Arc::into_inner(report).unwrap().into_inner().unwrap();
    (report, queue)
}

/// Reads all messages up to the end or the first damage.
fn messages(file: &[u8]) -> Vec<Message<'static>> {
    let options = mcap::read::Options::IgnoreEndMagic.into();
    let stream = MessageStream::new_with_options(file, options).unwrap();
    stream.map_while(Result::ok).collect()
}

fn json(message: &Message<'_>) -> Value {
    serde_json::from_slice(&message.data).unwrap()
}

fn events(found: &[Message<'_>], event: &str) -> Vec<Value> {
    let events = found
        .iter()
        .filter(|m| m.channel.topic == "/session/events");
    let events = events.map(json).filter(|line| line["event"] == event);
    events.collect()
}

fn taken(queue: &Queue) -> Vec<Content> {
    let mut taken = Vec::new();
    while let Next::Entry(entry) = queue.next(Duration::ZERO) {
        taken.push(entry.content);
    }
    taken
}

#[test]
fn full_queue_drops_newest_frames_and_logs_the_gap() {
    let queue = Arc::new(Queue::new(250, CLOCK));
    let tap = Tap::new(&queue);
    for sequence in 0..6 {
        tap.frame(Role::Left, &jpeg(sequence, 100));
    }
    tap.frame(Role::Right, &jpeg(70, 10));
    assert!(matches!(queue.next(Duration::ZERO), Next::Entry(_)));
    tap.frame(Role::Left, &jpeg(6, 100));
    assert_eq!(queue.dropped(), BTreeMap::from([(Role::Left, 4)]));

    let order: Vec<_> = taken(&queue)
        .into_iter()
        .map(|content| match content {
            Content::Frame { role, frame } => format!("{role} {}", frame.sequence),
            Content::Json { text, .. } => {
                let line: Value = serde_json::from_slice(&text).unwrap();
                let what = &line["what"];
                assert_eq!(line["event"], "black_box_gap");
                format!(
                    "{} dropped {}, {} to {}",
                    what["role"].as_str().unwrap(),
                    what["frames"],
                    what["first_sequence"],
                    what["last_sequence"]
                )
            }
        })
        .collect();
    let expected = ["left 1", "right 70", "left dropped 4, 2 to 5", "left 6"];
    assert_eq!(order, expected);
}

#[test]
fn open_gap_is_logged_at_close() {
    let queue = Arc::new(Queue::new(50, CLOCK));
    let tap = Tap::new(&queue);
    tap.frame(Role::Depth, &frame(PixelFormat::Z16, 1, 16));
    tap.frame(Role::Depth, &frame(PixelFormat::Z16, 2, 64));
    queue.close();
    tap.frame(Role::Depth, &frame(PixelFormat::Z16, 3, 16));
    let taken = taken(&queue);
    assert_eq!(taken.len(), 2);
    let Content::Json { text, .. } = &taken[1] else {
        panic!("{:?}", taken[1]);
    };
    let line: Value = serde_json::from_slice(text).unwrap();
    assert_eq!(line["what"]["frames"], 1);
    assert!(matches!(queue.next(Duration::ZERO), Next::Closed));
}

#[test]
fn messages_have_a_bounded_reserve_in_a_full_queue() {
    let queue = Arc::new(Queue::new(100, CLOCK));
    let tap = Tap::new(&queue);
    tap.frame(Role::Left, &jpeg(0, 100));
    let long = "x".repeat(600_000);
    for _ in 0..3 {
        tap.json(Topic::Events, || serde_json::json!({ "event": long }));
    }
    assert_eq!(taken(&queue).len(), 2);
    assert_eq!(queue.dropped_messages(), 2);
}

#[test]
fn default_tap_does_not_build_messages() {
    let called = std::cell::Cell::new(false);
    Tap::default().json(Topic::Events, || called.set(true));
    assert!(!called.get());
}

#[test]
fn log_preserves_order_bytes_and_times() {
    let disk = MemoryDir::default();
    let (report, _) = written(Box::new(disk.clone()), settings(), |tap| {
        tap.frame(Role::Left, &jpeg(3, 1000));
        tap.json(Topic::Events, || serde_json::json!({"event": "command"}));
        tap.frame(Role::Depth, &frame(PixelFormat::Z16, 9, 16));
        tap.frame(Role::Rgb, &frame(PixelFormat::Yuyv, 8, 16));
        tap.frame(Role::External, &frame(PixelFormat::Grey, 7, 8));
        tap.frame(Role::Left, &jpeg(4, 1000));
        tap.json(Topic::Cameras, || serde_json::json!({"left": {}}));
        tap.json(Topic::Prediction, || serde_json::json!({"p_stable": 0.5}));
        tap.json(Topic::Stored, || serde_json::json!({"reply": "done"}));
    });
    assert_eq!(report.stopped, None);
    let [name] = &disk.names()[..] else {
        panic!("{:?}", disk.names());
    };
    assert!(LogName::parse(name).is_some() && !name.contains("partial"));
    let file = disk.file(name);
    assert_eq!(report.bytes, file.len() as u64);

    let found = messages(&file);
    let topics: Vec<_> = found.iter().map(|m| m.channel.topic.as_str()).collect();
    let expected = [
        "/camera/left",
        "/session/events",
        "/camera/depth",
        "/camera/rgb",
        "/camera/external",
        "/camera/left",
        "/cameras",
        "/prediction",
        "/session/stored",
    ];
    assert_eq!(topics, expected);
    assert!(found.is_sorted_by_key(|message| message.log_time));

    let left = CompressedImage::decode(&*found[5].data).unwrap();
    assert_eq!((&*left.data, found[5].sequence), (&*jpeg(4, 1000).data, 4));
    assert_eq!((&*left.format, &*left.frame_id), ("jpeg", "left"));
    let driver_ns = i128::from(found[5].publish_time) - CLOCK.offset_ns;
    assert_eq!(driver_ns, 160_000_000);
    let stamp = left.timestamp.unwrap();
    assert_eq!((stamp.seconds, stamp.nanos), (1_795_000_000, 160_000_000));
    for (index, encoding, step, bytes) in
        [(2, "16UC1", 8, 16), (3, "yuyv", 8, 16), (4, "mono8", 4, 8)]
    {
        let raw = RawImage::decode(&*found[index].data).unwrap();
        assert_eq!((&*raw.encoding, raw.step), (encoding, step));
        assert_eq!((raw.width, raw.height, raw.data.len()), (4, 2, bytes));
    }

    let summary = Summary::read(&file).unwrap().unwrap();
    let statistics = summary.stats.unwrap();
    assert_eq!((statistics.message_count, statistics.channel_count), (9, 8));
    let origin = mcap::read::metadata(&file, &summary.metadata_indexes[0]).unwrap();
    assert_eq!(origin.metadata["dataset"], "kitchen");
    let offset = &origin.metadata["wall_minus_monotonic_ns"];
    assert_eq!(offset.parse(), Ok(CLOCK.offset_ns));
}

#[test]
fn rotated_files_are_complete() {
    let disk = MemoryDir::default();
    let small = BlackBoxSettings {
        file_bytes: 10_000,
        ..settings()
    };
    let (report, _) = written(Box::new(disk.clone()), small, |tap| {
        for sequence in 0..50 {
            tap.frame(Role::Left, &jpeg(sequence, 1000));
            tap.frame(Role::Depth, &frame(PixelFormat::Z16, sequence, 1000));
        }
    });
    let names = disk.names();
    assert_eq!(report.files, names.len() as u64);
    assert!(names.len() >= 8, "{names:?}");
    let mut sequences = BTreeMap::<String, Vec<u32>>::new();
    for name in &names {
        let file = disk.file(name);
        assert!(file.len() < 16_000, "{}", file.len());
        assert!(Summary::read(&file).unwrap().unwrap().stats.is_some());
        for message in messages(&file) {
            let topic = message.channel.topic.clone();
            sequences.entry(topic).or_default().push(message.sequence);
        }
    }
    let all: Vec<u32> = (0..50).collect();
    assert_eq!(sequences["/camera/left"], all);
    assert_eq!(sequences["/camera/depth"], all);
    assert_eq!(report.frames[&Role::Left].written, 50);
    let bytes: usize = names.iter().map(|name| disk.file(name).len()).sum();
    assert_eq!(report.bytes, bytes as u64);
}

#[test]
fn oldest_logs_are_removed_and_other_files_stay() {
    let disk = MemoryDir::default();
    for (name, bytes) in [
        ("2026-01-02T00-00-00Z-00001.mcap", 9_000),
        ("2026-01-01T00-00-00Z-00002.partial.mcap", 9_000),
        ("2026-01-01T00-00-00Z-00001.mcap", 9_000),
        ("unrelated.mcap", 50_000),
    ] {
        disk.files
            .lock()
            .unwrap()
            .insert(name.into(), vec![0; bytes]);
    }
    let small = BlackBoxSettings {
        file_bytes: 10_000,
        total_bytes: 30_000,
        ..settings()
    };
    let (report, _) = written(Box::new(disk.clone()), small, |tap| {
        tap.frame(Role::Left, &jpeg(1, 1000));
    });
    let names = disk.names();
    assert_eq!(report.removed_files, 1);
    assert_eq!(names.len(), 4, "{names:?}");
    assert!(!names.contains(&"2026-01-01T00-00-00Z-00001.mcap".to_owned()));
    assert!(names.contains(&"unrelated.mcap".to_owned()));
    let newest = names.iter().rfind(|name| LogName::parse(name).is_some());
    let removals = events(&messages(&disk.file(newest.unwrap())), "black_box_removed");
    let expected = serde_json::json!(["2026-01-01T00-00-00Z-00001.mcap"]);
    assert_eq!(removals[0]["what"]["files"], expected);
}

#[test]
fn full_disk_ends_the_log_with_one_message() {
    let disk = MemoryDir::default();
    *disk.room.lock().unwrap() = Some(10_000_000);
    let log_dir = Box::new(disk.clone());
    let (report, queue) = written(log_dir, settings(), |tap| {
        for sequence in 0..20 {
            tap.frame(Role::Left, &jpeg(sequence, 1_500_000));
        }
    });
    let stopped = report.stopped.unwrap();
    assert!(stopped.contains("cannot write the black box"), "{stopped}");
    assert!(stopped.contains("-00001.partial.mcap"), "{stopped}");
    Tap::new(&queue).frame(Role::Left, &jpeg(99, 100));
    assert_eq!(taken(&queue).len(), 0);

    let names = disk.names();
    assert!(names.len() == 1 && names[0].ends_with(".partial.mcap"));
    // Only complete chunks count as written.
    let file = disk.file(&names[0]);
    let (_, whole) = *chunk_ends(&file).last().unwrap();
    assert_eq!(report.frames[&Role::Left].written, whole as u64);
    assert!((1..7).contains(&whole), "{whole}");
    assert!(messages(&file).len() >= whole);
}

#[test]
fn log_stops_at_the_disk_reserve() {
    let disk = MemoryDir::default();
    *disk.room.lock().unwrap() = Some(12_000_000);
    let reserving = BlackBoxSettings {
        reserve_bytes: 5_000_000,
        ..settings()
    };
    let (report, _) = written(Box::new(disk.clone()), reserving, |tap| {
        for sequence in 0..20 {
            tap.frame(Role::Left, &jpeg(sequence, 1_500_000));
        }
    });
    let stopped = report.stopped.unwrap();
    assert!(stopped.contains("MB free, 5 MB"), "{stopped}");
    let names = disk.names();
    assert!(!names[0].contains("partial"), "{names:?}");
    let summary = Summary::read(&disk.file(&names[0])).unwrap().unwrap();
    let frames = summary.stats.unwrap().message_count;
    assert_eq!(report.frames[&Role::Left].written, frames);
    // The reserve is checked after each chunk of at most three frames.
    assert!((5..=7).contains(&frames), "{frames}");
}

#[test]
fn truncated_file_keeps_all_complete_chunks() {
    let disk = MemoryDir::default();
    written(Box::new(disk.clone()), settings(), |tap| {
        for sequence in 0..14 {
            tap.frame(Role::Left, &jpeg(sequence, 1_500_000));
            tap.json(Topic::Events, || serde_json::json!({"event": "command"}));
        }
    });
    let file = disk.file(&disk.names()[0]);
    let whole = messages(&file);
    assert_eq!(whole.len(), 28);
    let ends = chunk_ends(&file);
    let (_, count) = *ends.last().unwrap();
    assert!(ends.len() >= 4, "{ends:?}");
    assert_eq!(count, 28);
    let cuts = (0..file.len()).step_by(file.len() / 31);
    for cut in cuts.chain(ends.iter().flat_map(|(end, _)| [end - 1, *end, end + 1])) {
        if cut <= 200 {
            continue;
        }
        let (_, expected) = ends.iter().rfind(|(end, _)| *end <= cut).unwrap_or(&(0, 0));
        let found = messages(&file[..cut]);
        assert!(
            found.len() >= *expected,
            "{} of {expected} at {cut}",
            found.len()
        );
        for (found, whole) in found.iter().zip(&whole) {
            assert_eq!((&found.data, found.log_time), (&whole.data, whole.log_time));
        }
    }
}

/// Returns the end of each complete chunk and the number of messages up to it.
fn chunk_ends(file: &[u8]) -> Vec<(usize, usize)> {
    let options = mcap::read::Options::IgnoreEndMagic.into();
    let records = mcap::read::LinearReader::new_with_options(file, options).unwrap();
    let mut ends = Vec::new();
    let (mut end, mut count) = (mcap::MAGIC.len(), 0);
    for record in records.map_while(Result::ok) {
        let body = file[end + 1..end + 9].try_into().unwrap();
        end += 9 + u64::from_le_bytes(body) as usize;
        if let Record::Chunk { header, data } = record {
            let inside = mcap::read::ChunkReader::new(header, &data).unwrap();
            let is_message = |r: &_| matches!(r, Ok(Record::Message { .. }));
            count += inside.filter(is_message).count();
            ends.push((end, count));
        }
    }
    ends
}

#[test]
fn unusable_directory_ends_the_log_only() {
    let dir = tempfile::tempdir().unwrap();
    let occupied = dir.path().join("file");
    std::fs::write(&occupied, "").unwrap();
    let settings = BlackBoxSettings {
        directory: occupied.join("box"),
        ..settings()
    };
    let black_box = BlackBox::start(settings, dir.path().into(), Provenance::new()).unwrap();
    black_box.tap().frame(Role::Left, &jpeg(0, 10));
    let report = black_box.stop();
    let stopped = report.stopped.unwrap();
    assert!(
        stopped.contains("cannot use the directory of the black box"),
        "{stopped}"
    );
    assert_eq!((report.files, report.bytes), (0, 0));
}

#[test]
fn thread_writes_to_disk_and_reports() {
    let dir = tempfile::tempdir().unwrap();
    let settings = BlackBoxSettings {
        directory: dir.path().join("a/blackbox"),
        ..settings()
    };
    let directory = settings.directory.clone();
    let black_box = BlackBox::start(settings, dir.path().into(), Provenance::new()).unwrap();
    for sequence in 0..5 {
        black_box.tap().frame(Role::Right, &jpeg(sequence, 10));
    }
    let report = black_box.stop();
    assert_eq!(report.stopped, None);
    assert_eq!(report.frames[&Role::Right].written, 5);
    let mut log_dir = DiskLogDir::new(directory.clone(), dir.path().into());
    let [(name, bytes)] = &log_dir.list().unwrap()[..] else {
        panic!("more than one file");
    };
    assert_eq!((report.files, report.bytes), (1, *bytes));
    assert_eq!(
        messages(&std::fs::read(directory.join(name)).unwrap()).len(),
        5
    );
    assert!(log_dir.free_bytes().unwrap() > 0);
}

#[test]
fn image_channels_have_protobuf_descriptors() {
    let channel = camera_channel(Role::Depth, PixelFormat::Z16);
    assert_eq!(
        (&*channel.topic, channel.schema),
        ("/camera/depth", "foxglove.RawImage")
    );
    let set = prost_types::FileDescriptorSet::decode(&*channel.schema_data).unwrap();
    let image = &set.file[1].message_type[0];
    let fields: Vec<_> = image.field.iter().map(|f| (f.number(), f.name())).collect();
    let expected = [
        "timestamp",
        "width",
        "height",
        "encoding",
        "step",
        "data",
        "frame_id",
    ];
    assert_eq!(fields, (1..).zip(expected).collect::<Vec<_>>());
    assert_eq!(set.file[1].dependency, [set.file[0].name()]);
}
