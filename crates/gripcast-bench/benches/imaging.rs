//! Frames to images: what one frame costs.
//!
//! `tactile/<KB>/…` are 3280×2464 4:2:2 frames of a few file sizes. The peer, `whole_resize`, is
//! the plain way with the same library: decode the whole image, then crop and resize it.

#![allow(
    missing_docs,
    clippy::unwrap_used,
    reason = "a bench that cannot set up must stop"
)]

use std::hint::black_box;
use std::time::Duration;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use fast_image_resize::images::{Image, ImageRef};
use fast_image_resize::{FilterType, PixelType, ResizeAlg, ResizeOptions, Resizer};
use gripcast_imaging::jpeg::{JpegScale, inspect};
use gripcast_imaging::{
    CropProfile, Decoder, Depth, DepthImage, DepthView, Frame, JpegDecoder, PixelFormat,
    TactileDifference, crop_and_resize, encode_jpeg, encode_png_rgb, synthetic_gel,
};

const CROP: CropProfile = CropProfile::GSMINI_SEVENTH;

fn frame(format: PixelFormat, width: u32, height: u32, data: Vec<u8>) -> Frame {
    Frame {
        format,
        width,
        height,
        data: data.into(),
        sequence: 0,
        driver_time_ns: 0,
        received_ns: 0,
    }
}

fn tactile(c: &mut Criterion) {
    let gel = synthetic_gel(3280, 2464, 1, 0.7);
    let mut group = c.benchmark_group("tactile");
    for quality in [83, 89, 94, 96] {
        let bytes = encode_jpeg(&gel, quality).unwrap();
        let size = format!("{}KB", bytes.len() / 1000);
        let frame = frame(PixelFormat::Mjpg, 3280, 2464, bytes);
        group.throughput(Throughput::Bytes(frame.data.len() as u64));
        let mut bench = |name: &str, run: &mut dyn FnMut()| {
            group.bench_function(BenchmarkId::new(&size, name), |b| b.iter(&mut *run));
        };
        let mut decoder = Decoder::new().unwrap();
        bench("model_input", &mut || {
            black_box(decoder.decode(&frame, Some(&CROP), 320, 240).unwrap());
        });
        let mut jpeg = JpegDecoder::new().unwrap();
        let window = CROP.window(3280, 2464).unwrap();
        let options = ResizeOptions::new()
            .resize_alg(ResizeAlg::Convolution(FilterType::Bilinear))
            .crop(
                window.left.into(),
                window.top.into(),
                window.width.into(),
                window.height.into(),
            );
        let mut resizer = Resizer::new();
        bench("whole_resize", &mut || {
            let whole = jpeg.decode(&frame.data, JpegScale::Whole).unwrap();
            let from = ImageRef::new(3280, 2464, whole.rgb, PixelType::U8x3).unwrap();
            let mut to = Image::new(320, 240, PixelType::U8x3);
            resizer.resize(&from, &mut to, &options).unwrap();
            black_box(to);
        });
        bench("verify", &mut || decoder.verify(&frame).unwrap());
        bench("inspect", &mut || {
            black_box(inspect(&frame.data).unwrap());
        });
        for (name, scale) in [
            ("scale_1_8", JpegScale::Eighth),
            ("scale_1_4", JpegScale::Quarter),
            ("scale_1_2", JpegScale::Half),
            ("scale_1", JpegScale::Whole),
        ] {
            bench(name, &mut || {
                black_box(jpeg.decode(&frame.data, scale).unwrap().width);
            });
        }
    }
    group.finish();
}

fn colour(c: &mut Criterion) {
    let data: Vec<u8> = (0..1280 * 720 * 2_usize)
        .map(|i| ((i * 37) >> 3) as u8)
        .collect();
    let frame = frame(PixelFormat::Yuyv, 1280, 720, data);
    let mut decoder = Decoder::new().unwrap();
    c.bench_function("colour/yuyv_720p", |b| {
        b.iter(|| decoder.decode_full(&frame).unwrap());
    });
    c.bench_function("colour/yuyv_720p_to_320x180", |b| {
        b.iter(|| decoder.decode(&frame, None, 320, 180).unwrap());
    });
}

fn parts(c: &mut Criterion) {
    let quarter = synthetic_gel(820, 616, 1, 0.7);
    c.bench_function("parts/crop_and_resize_820x616", |b| {
        b.iter(|| crop_and_resize(&quarter, &CROP, 320, 240).unwrap());
    });
    let initial = synthetic_gel(320, 240, 1, 0.0);
    let grasp = synthetic_gel(320, 240, 2, 0.7);
    let mut tensor = vec![0.0; 3 * 240 * 320];
    c.bench_function("parts/difference_to_tensor", |b| {
        b.iter(|| {
            let difference = TactileDifference::between(&initial, &grasp).unwrap();
            difference.write_chw(&mut tensor).unwrap();
            difference.mean_abs()
        });
    });
    c.bench_function("parts/png_320x240", |b| {
        b.iter(|| encode_png_rgb(&grasp).unwrap());
    });
    c.bench_function("parts/synthetic_gel_3280x2464", |b| {
        b.iter(|| synthetic_gel(3280, 2464, 1, 0.7));
    });
}

fn depth(c: &mut Criterion) {
    let codes = (0..848 * 480_u32).map(|i| 1500 + (i * 31 % 1400) as u16);
    let image = DepthImage::from_raw(848, 480, codes.collect()).unwrap();
    let unit_m = 1e-4;
    let depth = Depth { image, unit_m };
    for view in DepthView::ALL {
        let name = format!("depth/{}_848x480_to_320x240", view.name());
        c.bench_function(&name, |b| b.iter(|| depth.in_colour_image(view, 320, 240)));
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default()
        .sample_size(15)
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_secs(1));
    targets = tactile, colour, depth, parts
}
criterion_main!(benches);
