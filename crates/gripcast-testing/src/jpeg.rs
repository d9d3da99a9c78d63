//! JPEG frames as real cameras send them: harmless oddities and damage.

use image::RgbImage;

/// Offset of the entropy-coded data.
///
/// # Panics
/// Without a start-of-scan marker.
#[must_use]
pub fn scan_start(jpeg: &[u8]) -> usize {
    let marker = jpeg.windows(2).position(|two| two == [0xff, 0xda]);
    let at = marker.expect("a scan") + 2;
    at + usize::from(u16::from_be_bytes([jpeg[at], jpeg[at + 1]]))
}

/// Encodes an image with a restart marker after each row of coded units of 16×8 pixels (4:2:2), by
/// joining the scans of its rows. The sides must be multiples of 16 and 8.
///
/// # Panics
/// For a JPEG without the expected segments.
#[must_use]
pub fn with_restart_markers(image: &RgbImage, encode: impl Fn(&RgbImage) -> Vec<u8>) -> Vec<u8> {
    let (width, height) = image.dimensions();
    let row = |y| encode(&image::imageops::crop_imm(image, 0, y, width, 8).to_image());
    let rows: Vec<Vec<u8>> = (0..height).step_by(8).map(row).collect();
    let mut file = rows[0][..scan_start(&rows[0])].to_vec();
    let frame_header = file.windows(2).position(|two| two == [0xff, 0xc0]);
    let height_at = frame_header.expect("a frame header") + 5;
    file[height_at..height_at + 2].copy_from_slice(&(height as u16).to_be_bytes());
    let [high, low] = ((width / 16) as u16).to_be_bytes();
    file.splice(2..2, [0xff, 0xdd, 0, 4, high, low]);
    for (number, row) in rows.iter().enumerate() {
        if number > 0 {
            file.extend([0xff, 0xd0 + ((number - 1) % 8) as u8]);
        }
        file.extend_from_slice(&row[scan_start(row)..row.len() - 2]);
    }
    file.extend([0xff, 0xd9]);
    file
}

/// Inserts the bytes that `stray` gives for the number of each restart marker before it.
#[must_use]
pub fn before_restart_markers(jpeg: &[u8], stray: impl Fn(usize) -> Vec<u8>) -> Vec<u8> {
    let (mut file, mut number) = (Vec::new(), 0);
    let start = scan_start(jpeg);
    for (at, byte) in jpeg.iter().enumerate() {
        let next = jpeg.get(at + 1);
        if at >= start && *byte == 0xff && next.is_some_and(|code| (0xd0..=0xd7).contains(code)) {
            file.extend(stray(number));
            number += 1;
        }
        file.push(*byte);
    }
    file
}

/// A few bytes that are no marker and differ with `seed`.
#[must_use]
pub fn stray_bytes(seed: usize, count: usize) -> Vec<u8> {
    let byte = |i: usize| ((seed * 7919 + i * 104_729) % 253 + 1) as u8;
    (0..count).map(byte).collect()
}

/// Frames with the pixels of `plain`, or of `restarts` (with restart markers), and what cameras
/// send around and between them, by name. `previous` is the frame before.
#[must_use]
pub fn harmless_frames(
    plain: &[u8],
    restarts: &[u8],
    previous: &[u8],
) -> Vec<(&'static str, Vec<u8>)> {
    let (without_end, end) = plain.split_at(plain.len() - 2);
    let with_tail = |tail: &[u8]| [plain, tail].concat();
    let every_seventh = |number: usize| match number % 7 {
        0 => stray_bytes(number, 1 + number % 9),
        _ => Vec::new(),
    };
    vec![
        ("tail of one byte", with_tail(b"\n")),
        ("tail of fill bytes", with_tail(&[0xff; 300])),
        ("tail of zeros", with_tail(&[0; 4096])),
        (
            "tail of the previous frame",
            with_tail(&previous[previous.len() / 2..]),
        ),
        ("second whole frame", with_tail(previous)),
        ("tail of megabytes", with_tail(&stray_bytes(3, 3_000_000))),
        ("bytes before the start", [b"\xa8\n\0\x13", plain].concat()),
        ("tail of the previous frame before the start", {
            let tail = &previous[previous.len() / 2..];
            [tail, plain].concat()
        }),
        (
            "bytes before restart markers",
            before_restart_markers(restarts, every_seventh),
        ),
        (
            "zeros before restart markers",
            before_restart_markers(restarts, |_| vec![0, 0]),
        ),
        (
            "bytes before the end marker",
            [without_end, &stray_bytes(1, 5), end].concat(),
        ),
        (
            "two fill bytes before the end marker",
            [without_end, &[0xff, 0xff], end].concat(),
        ),
        ("without end marker", without_end.to_vec()),
        (
            "without end marker, with restart markers",
            restarts[..restarts.len() - 2].to_vec(),
        ),
        ("half an end marker", plain[..plain.len() - 1].to_vec()),
        (
            "zeros instead of the end marker",
            [without_end, &[0; 64]].concat(),
        ),
        (
            "fill bytes instead of the end marker",
            [without_end, &[0xff; 64]].concat(),
        ),
    ]
}

/// Frames that lack image bytes or have wrong ones, by name.
#[must_use]
pub fn damaged_frames(plain: &[u8], restarts: &[u8]) -> Vec<(&'static str, Vec<u8>)> {
    let cut = |share: f64| plain[..(plain.len() as f64 * share) as usize].to_vec();
    let scan = scan_start(restarts);
    let marker = |code: u8| {
        let found = restarts[scan..]
            .windows(2)
            .position(|two| two == [0xff, code]);
        scan + found.expect("a restart marker") + 1
    };
    let mut swapped = restarts.to_vec();
    swapped.swap(marker(0xd1), marker(0xd2));
    let mut lost = restarts.to_vec();
    lost.drain(marker(0xd1)..marker(0xd2));
    let middle = plain.len() / 2;
    let tables = plain
        .windows(2)
        .position(|two| two == [0xff, 0xdb])
        .expect("a table");
    vec![
        ("empty", Vec::new()),
        ("cut", cut(0.6)),
        ("cut and padded", [cut(0.6), vec![0; plain.len()]].concat()),
        ("cut and ended", [&cut(0.6)[..], &[0xff, 0xd9]].concat()),
        (
            "cut and continued by another",
            [&cut(0.6)[..], &plain[plain.len() / 4..]].concat(),
        ),
        ("first part missing", plain[plain.len() / 3..].to_vec()),
        ("hole", [&plain[..middle], &plain[middle + 200..]].concat()),
        ("restart markers out of order", swapped),
        ("lost restart interval", lost),
        ("missing quantisation table", {
            let length = usize::from(u16::from_be_bytes([plain[tables + 2], plain[tables + 3]]));
            [&plain[..tables], &plain[tables + 2 + length..]].concat()
        }),
        ("many bytes before a restart marker", {
            before_restart_markers(restarts, |number| match number {
                3 => stray_bytes(3, 200),
                _ => Vec::new(),
            })
        }),
    ]
}
