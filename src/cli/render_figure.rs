//! `gripcast render figure`: one image that compares the renderers.
//!
//! ```text
//! gripcast render figure --presses ball --ball-mm 4 --trace mug.bin --out renderers.png
//! ```
//!
//! First row: a held-out ball press: no contact, the real press, and the same press by the
//! calibrated renderer, the gel-surface renderer and Taxim's lookup table, all fitted to the
//! training presses. Second row: one finger of a simulated grasp by the same three, and its depth.
//! Third row: the same grasp path-traced in random scenes.
//!
//! Exit codes: 0 drawn · 1 invalid presses or trace · 2 usage · 130 interrupted.

use std::path::PathBuf;

use image::imageops::{FilterType, resize};
use image::{GrayImage, Rgb, RgbImage};

use super::flags::{BallFlags, suffix};
use super::render_source::SimulatedGrasp;
use super::working::interruptible;
use super::{Context, print};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::save;
use gripcast_imaging::caption::{HEIGHT, write_text};
use gripcast_imaging::{encode_jpeg, encode_png_rgb};
use gripcast_sim::fem::{GelPad, GelResolution};
use gripcast_sim::grasp::Finger;
use gripcast_tactile::calibrate::{self, CalibrateOptions, Split, SplitPresses};
use gripcast_tactile::lookup::fit_to_presses;
use gripcast_tactile::{
    FrameNoise, GelSurfaceRenderer, Moment, ObjectDepthRenderer, PressDepth, Rasteriser,
    SceneRenderer as _, SensorMount, SensorProfile, Smoothing, TactileRenderer, TactileScene,
    faceted, object_depth,
};
use gripcast_visual::{
    ColourSettings, DENOISE_RADIUS_PX, GraspState, RenderControl, RenderSettings, Renderer, View,
    VisualRandomisation, demo_model, denoise, develop, grasp_scene,
};

/// Columns and rows of a tile.
const TILE: (u32, u32) = (320, 240);
/// Pixels between tiles.
const GAP: u32 = 6;
const JPEG_QUALITY: u8 = 88;
/// Height of a caption, px.
const CAPTION: u32 = HEIGHT + 8;
/// Tiles per row.
const COLUMNS: usize = 5;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder of real ball presses, as for `render calibrate`
    #[arg(long, value_name = "DIR")]
    presses: PathBuf,
    #[command(flatten)]
    ball: BallFlags,
    /// Trace of a simulated grasp of a built-in object
    #[arg(long, value_name = "FILE")]
    trace: PathBuf,
    /// Output image
    #[arg(long, value_name = "FILE.png|FILE.jpg")]
    out: PathBuf,
    /// Samples per pixel of the path-traced images
    #[arg(long, value_name = "N", default_value_t = 256,
        value_parser = clap::value_parser!(u32).range(1..=1 << 16))]
    spp: u32,
    /// Random seed of split, noise, light and ground
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    seed: u64,
}

/// Caption and image.
type Tile = (String, RgbImage);

/// Runs the command.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    let out = args.out.clone();
    let image = interruptible(context, "drawing", move |progress| {
        progress.count(0, 3);
        let grasp = SimulatedGrasp::read(&args.trace, None)?;
        let (real, fitted) = real_row(&args)?;
        progress.count(1, 3);
        let simulated = simulated_row(&grasp, &fitted)?;
        progress.count(2, 3);
        let traced = traced_row(&grasp, &args)?;
        Ok::<_, Error>(compose(&[real, simulated, traced]))
    })??;
    let bytes = match &*suffix(&out) {
        "jpg" | "jpeg" => encode_jpeg(&image, JPEG_QUALITY)?,
        _ => encode_png_rgb(&image)?,
    };
    save(&out, &bytes)?;
    print(&out.display().to_string())
}

/// Renderers fitted to the training presses.
struct Fitted {
    profile: SensorProfile,
    lookup: gripcast_tactile::lookup::LookupRenderer,
}

fn real_row(args: &Args) -> Result<(Vec<Tile>, Fitted)> {
    let mut options = CalibrateOptions::from_folder(&args.presses);
    options.read = args.ball.read_options(&args.presses);
    options.read.size = Some(TILE);
    options.split = Split::Random {
        train_fraction: 0.5,
        max_fitted: None,
        seed: args.seed,
    };
    let calibration = calibrate::run(&options)?;
    let profile = calibration.profile;
    let SplitPresses {
        set,
        train,
        held_out,
        ..
    } = calibration.presses;
    let widest = |a: &&usize, b: &&usize| {
        let radius = |i: usize| set.presses[i].radius_px;
        radius(**a).total_cmp(&radius(**b))
    };
    let Some(&shown) = held_out.iter().max_by(widest) else {
        return Err(Error::input("no held-out press to show").at(args.presses.display()));
    };
    let lookup = fit_to_presses(&set, &train)?;
    let press = &set.presses[shown];
    let contact = set.contact(press);
    let depth = contact.press(profile.smoothing.sink_length_m);
    let quiet = FrameNoise::default();
    let ours = TactileRenderer::new(&profile)?.render(&depth, &quiet)?;
    let gel = GelPad::default().grid(GelResolution::Default)?;
    let flat = faceted(&depth, &gel, &mut Rasteriser::new());
    let unsmoothed = SensorProfile {
        smoothing: Smoothing::default(),
        ..profile.clone()
    };
    let gel_surface = TactileRenderer::new(&unsmoothed)?.render(&flat, &quiet)?;
    let tiles = vec![
        ("real, no contact".to_owned(), set.no_contact.clone()),
        (format!("real press, {}", press.file), press.image.clone()),
        ("gripcast, held-out press".to_owned(), ours),
        ("gel-surface, 19 x 16 nodes".to_owned(), gel_surface),
        (
            "lookup (taxim), same fit".to_owned(),
            lookup.image(&contact.cap())?,
        ),
    ];
    Ok((tiles, Fitted { profile, lookup }))
}

fn simulated_row(grasp: &SimulatedGrasp, fitted: &Fitted) -> Result<Vec<Tile>> {
    let touched = grasp.scene(Moment::Grasp, SensorMount::on(Finger::Left))?;
    let mut ours = ObjectDepthRenderer::new(&fitted.profile)?;
    let mut gel = GelSurfaceRenderer::new(&fitted.profile)?;
    let mut lookup = fitted.lookup.clone();
    let name = &grasp.object.name;
    Ok(vec![
        (
            format!("simulated {name}, before"),
            ours.render(&touched.untouched(), None)?,
        ),
        (
            "grasp, depth".to_owned(),
            depth_image(&touched, ours.grid()),
        ),
        ("gripcast".to_owned(), ours.render(&touched, None)?),
        ("gel-surface".to_owned(), gel.render(&touched, None)?),
        ("lookup (taxim)".to_owned(), lookup.render(&touched, None)?),
    ])
}

/// Draws the contact depth; deeper is brighter.
fn depth_image(scene: &TactileScene<'_>, grid: gripcast_tactile::SensorGeometry) -> RgbImage {
    let press: PressDepth = object_depth(scene, &grid, &mut Rasteriser::new());
    let deepest = press.deepest_m().max(1e-9);
    let grey = GrayImage::from_fn(grid.width as u32, grid.height as u32, |x, y| {
        let depth = f64::from(press.depth_m[y as usize * grid.width + x as usize]);
        image::Luma([(255.0 * depth / deepest) as u8])
    });
    image::DynamicImage::ImageLuma8(grey).to_rgb8()
}

fn traced_row(grasp: &SimulatedGrasp, args: &Args) -> Result<Vec<Tile>> {
    let state = match grasp.snapshot(Moment::Grasp)? {
        Some(snapshot) => GraspState::from_snapshot(snapshot, Some(&grasp.gel.grid))?,
        None => return Ok(Vec::new()),
    };
    let size = [TILE.0 as usize, TILE.1 as usize];
    let mut tiles = Vec::new();
    for number in 0..COLUMNS as u64 {
        let seed = args.seed + number;
        let (view, name) = if number == 0 {
            (View::External(size), "path-traced, from outside")
        } else {
            (View::EyeInHand(size), "path-traced, eye in hand")
        };
        let conditions = VisualRandomisation::default().sample(seed);
        let model = demo_model(&grasp.object.name, seed)?;
        let scene = grasp_scene(&model, &state, &conditions, view)?;
        let settings = RenderSettings {
            samples_per_pixel: args.spp,
            seed,
            ..RenderSettings::default()
        };
        let rendering =
            Renderer::new(&scene)?.render(&scene.camera, &settings, &RenderControl::default())?;
        let light = denoise(&rendering, DENOISE_RADIUS_PX);
        let image = develop(&light, &ColourSettings::default(), conditions.sensor_seed);
        tiles.push((format!("{name}, seed {seed}"), image));
    }
    Ok(tiles)
}

fn compose(rows: &[Vec<Tile>]) -> RgbImage {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0) as u32;
    let (step_x, step_y) = (TILE.0 + GAP, TILE.1 + CAPTION + GAP);
    let (width, height) = (columns * step_x + GAP, rows.len() as u32 * step_y + GAP);
    let mut sheet = RgbImage::from_pixel(width, height, Rgb([24; 3]));
    for (row, tiles) in rows.iter().enumerate() {
        for (column, (caption, image)) in tiles.iter().enumerate() {
            let (x, y) = (GAP + column as u32 * step_x, row as u32 * step_y);
            write_text(&mut sheet, x, y + 5, caption, Rgb([225; 3]));
            let tile = if image.dimensions() == TILE {
                image.clone()
            } else {
                resize(image, TILE.0, TILE.1, FilterType::Triangle)
            };
            image::imageops::replace(&mut sheet, &tile, i64::from(x), i64::from(y + CAPTION));
        }
    }
    sheet
}
