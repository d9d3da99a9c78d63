//! `gripcast-bench render`: rendering times.
//!
//! ```text
//! gripcast-bench render --baseline taxim --json
//! ```
//!
//! Tactile: the depth of an object of 99,904 triangles pressed 1 mm into a Mini's gel, by z-buffer
//! and by ray casting, and complete 320×240 images from mesh to 8 bits; one thread. Visual: the
//! built-in mug in a grasp, 320×240, on all threads. `--baseline taxim` runs taxim on the same
//! depths; it starts from the height map, and its CPU time is measured.
//!
//! Exit codes: 0 measured · 2 usage.

use std::time::Instant;

use gripcast::cli::Context;
use gripcast::cli::bench::Report;
use gripcast::cli::working::interruptible;
use gripcast_base::error::Result;
use gripcast_geometry::{Pose, builtin};
use gripcast_sim::grasp::{Placement, resting_pose};
use gripcast_tactile::{ObjectDepthRenderer, SensorProfile};
use gripcast_visual::{
    GraspState, RenderControl, RenderSettings, Renderer, View, VisualRandomisation, demo_model,
    grasp_scene,
};
use serde_json::{Value, json};

use crate::baseline::Baseline;
use crate::depth_scene::{DepthScene, DepthTiming};
use crate::timing::Timing;

/// Minimum for a usable median.
const MIN_RUNS: u64 = 10;
const TAXIM: Baseline = Baseline {
    name: "taxim",
    packages: "taxim jax",
    script: include_str!("../peers/taxim_tactile.py"),
};

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Number of images of each kind
    #[arg(long, value_name = "N", default_value_t = 40, value_parser = clap::value_parser!(u64).range(MIN_RUNS..))]
    runs: u64,
    /// Samples per pixel of the visual image
    #[arg(long, value_name = "N", default_value_t = 64,
        value_parser = clap::value_parser!(u32).range(1..=4096))]
    spp: u32,
    /// Baseline to compare against (PyPI)
    #[arg(long, value_parser = [TAXIM.name])]
    baseline: Option<String>,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

struct Measured {
    pixels: [usize; 2],
    depth: DepthTiming,
    tactile: Timing,
    visual_s: f64,
    prepare_s: f64,
}

/// Runs the benchmark.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    let given = args.clone();
    let measured = interruptible(context, "rendering", move |_| measure(&given))??;
    let params = json!({
        "triangles": measured.depth.triangles,
        "pixels": measured.pixels,
        "runs": args.runs,
        "spp": args.spp,
        "tactile_threads": 1,
        "visual_threads": rayon::current_num_threads(),
    });
    let text = text(&measured, args.spp);
    let mut report = Report::new("render", params, figures(&measured), text);
    if args.baseline.is_some() {
        let press = press_for_baseline()?.to_string();
        if let Some(mut baseline) = TAXIM.measure(context, args.runs, press.as_bytes())? {
            let theirs = baseline["tactile_ms"]["min"].as_f64().unwrap_or(f64::NAN);
            let ratio = measured.tactile.min / theirs;
            baseline["ratio"] = json!(ratio);
            report.text += &format!(
                "\ntaxim        {theirs:.1} ms from height map to image; ratio {ratio:.2}"
            );
            report.baselines.insert("taxim".to_owned(), baseline);
        }
    }
    report.print(args.json)
}

fn measure(args: &Args) -> Result<Measured> {
    let runs = args.runs as usize;
    let profile = SensorProfile::gelsight_mini()?;
    let press = DepthScene::new(profile.geometry);
    let depth = press.measure(runs)?;
    let tactile = press.measure_images(&mut ObjectDepthRenderer::new(&profile)?, runs)?;
    let mug = builtin("mug")?;
    let t_world_object: Pose = resting_pose(&mug, None)?.1.t_world_object;
    let placed = Placement::default().place(&mug, &t_world_object)?;
    let state = GraspState {
        t_world_object,
        t_world_gripper: placed.t_world_gripper,
        opening_m: placed.opening_m,
        gels: None,
    };
    let conditions = VisualRandomisation::default().sample(0);
    let start = Instant::now();
    let model = demo_model("mug", 0)?;
    let scene = grasp_scene(&model, &state, &conditions, View::EyeInHand([320, 240]))?;
    let renderer = Renderer::new(&scene)?;
    let prepare_s = start.elapsed().as_secs_f64();
    let settings = RenderSettings {
        samples_per_pixel: args.spp,
        ..RenderSettings::default()
    };
    let start = Instant::now();
    renderer.render(&scene.camera, &settings, &RenderControl::default())?;
    Ok(Measured {
        pixels: [profile.geometry.width, profile.geometry.height],
        depth,
        tactile,
        visual_s: start.elapsed().as_secs_f64(),
        prepare_s,
    })
}

/// Returns the input of the baseline.
fn press_for_baseline() -> Result<Value> {
    let press = DepthScene::new(SensorProfile::gelsight_mini()?.geometry).depth()?;
    Ok(json!({
        "width": press.geometry.width,
        "height": press.geometry.height,
        "depth_m": press.depth_m,
    }))
}

fn figures(m: &Measured) -> Value {
    json!({
        "depth_ms": m.depth.depth_ms.min,
        "depth_ms_median": m.depth.depth_ms.median,
        "depth_whole_object_ms": m.depth.whole_object_ms.min,
        "depth_rays_ms": m.depth.rays_ms.min,
        "depth_rays_tree_ms": m.depth.tree_ms,
        "depth_largest_difference_m": m.depth.largest_difference_m,
        "tactile_ms": m.tactile.min,
        "tactile_ms_median": m.tactile.median,
        "visual_s": m.visual_s,
        "visual_prepare_s": m.prepare_s,
    })
}

fn text(m: &Measured, spp: u32) -> String {
    let depth = &m.depth;
    format!(
        "depth        {:.2} ms by z-buffer, {:.1} ms by rays and {:.0} ms for their tree\n\
         tactile      {:.2} ms per image, from mesh to 8 bits\n\
         visual       {:.2} s at {spp} spp, {:.2} s to prepare the scene",
        depth.depth_ms.min,
        depth.rays_ms.min,
        depth.tree_ms,
        m.tactile.min,
        m.visual_s,
        m.prepare_s
    )
}
