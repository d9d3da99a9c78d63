//! `gripcast bench render`: how long the renderers take on this machine.
//!
//! ```text
//! gripcast bench render --peer taxim --json
//! ```
//!
//! Tactile: the depth of an object of 99,904 triangles pressed 1 mm into a Mini's gel, by z-buffer
//! and by rays, and whole 320×240 pictures from mesh to 8 bits; one thread. Visual: the built-in
//! mug in a grasp, 320×240, on all threads. `--peer taxim` runs PyPI's taxim in `python3` on the
//! same depths in the same run; it starts from the height map, so finding the object is not part
//! of its time, and its CPU time is taken.
//!
//! Exit codes: 0 measured · 2 usage.

use std::time::Instant;

use serde_json::{Map, Value, json};

use super::working::interruptible;
use super::{Context, print, print_json, python_peer};
use crate::note;
use gripcast_base::error::Result;
use gripcast_geometry::{Pose, builtin};
use gripcast_sim::grasp::{Placement, resting_pose};
use gripcast_tactile::{
    DepthLoad, DepthMs, DepthTiming, ObjectDepthRenderer, Rasteriser, SensorProfile, object_depth,
};
use gripcast_visual::{
    GraspState, RenderSettings, Renderer, View, VisualRandomisation, Watch, demo_model, grasp_scene,
};

/// Runs below this give no usable median.
const LEAST_RUNS: u64 = 10;
const PEER_SCRIPT: &str = include_str!("../../benches/peers/taxim_tactile.py");

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Pictures of each kind
    #[arg(long, default_value_t = 40, value_parser = clap::value_parser!(u64).range(LEAST_RUNS..))]
    runs: u64,
    /// Paths for each pixel of the visual picture
    #[arg(long, value_name = "N", default_value_t = 64,
        value_parser = clap::value_parser!(u32).range(1..=4096))]
    samples: u32,
    /// Another renderer to measure beside ours
    #[arg(long, value_enum)]
    peer: Option<Peer>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Peer {
    /// PyPI's taxim, through `python3`
    Taxim,
}

struct Measured {
    depth: DepthTiming,
    tactile: DepthMs,
    visual_s: f64,
    prepare_s: f64,
}

/// Runs the bench.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    let given = args.clone();
    let measured = interruptible(context, "rendering", move |_| measure(&given))??;
    let mut peers = Map::new();
    if let Some(Peer::Taxim) = args.peer {
        let input = press_for_peer()?;
        match python_peer::measure("taxim", PEER_SCRIPT, args.runs, input.as_bytes())? {
            Some(mut peer) => {
                let theirs = peer["tactile_ms"]["min"].as_f64().unwrap_or(f64::NAN);
                peer["ratio"] = json!(measured.tactile.min / theirs);
                peers.insert("taxim".to_owned(), peer);
            }
            None if context.quiet => {}
            None => note!(
                "gripcast: taxim is absent, so it was not measured\n  → pip install taxim jax"
            ),
        }
    }
    if args.json {
        return print_json(&json!({
            "figures": figures(&measured),
            "name": "render",
            "params": {
                "triangles": measured.depth.triangles,
                "pixels": measured.depth.pixels,
                "runs": args.runs,
                "samples": args.samples,
                "tactile_threads": 1,
                "visual_threads": rayon::current_num_threads(),
            },
            "peers": peers,
        }));
    }
    print(&text(&measured, &peers, args.samples))
}

fn measure(args: &Args) -> Result<Measured> {
    let runs = args.runs as usize;
    let profile = SensorProfile::gelsight_mini()?;
    let load = DepthLoad::on(profile.geometry);
    let depth = load.measure(runs)?;
    let tactile = load.measure_pictures(&mut ObjectDepthRenderer::new(&profile)?, runs)?;
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
    let began = Instant::now();
    let model = demo_model("mug", 0)?;
    let scene = grasp_scene(&model, &state, &conditions, View::EyeInHand([320, 240]))?;
    let renderer = Renderer::new(&scene)?;
    let prepare_s = began.elapsed().as_secs_f64();
    let settings = RenderSettings {
        samples: args.samples,
        ..RenderSettings::default()
    };
    let began = Instant::now();
    renderer.render(&scene.camera, &settings, &Watch::default())?;
    Ok(Measured {
        depth,
        tactile,
        visual_s: began.elapsed().as_secs_f64(),
        prepare_s,
    })
}

/// The press as the peer reads it.
fn press_for_peer() -> Result<String> {
    let load = DepthLoad::on(SensorProfile::gelsight_mini()?.geometry);
    let press = object_depth(&load.scene()?, load.grid(), &mut Rasteriser::new());
    let press = json!({
        "width": press.geometry.width,
        "height": press.geometry.height,
        "depth_m": press.depth_m,
    });
    Ok(press.to_string())
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

fn text(m: &Measured, peers: &Map<String, Value>, samples: u32) -> String {
    let depth = &m.depth;
    let mut lines = vec![
        format!(
            "depth        {:.2} ms by z-buffer, {:.1} ms by rays and {:.0} ms for their tree",
            depth.depth_ms.min, depth.rays_ms.min, depth.tree_ms
        ),
        format!(
            "tactile      {:.2} ms a picture, from mesh to 8 bits",
            m.tactile.min
        ),
        format!(
            "visual       {:.2} s with {samples} paths a pixel, {:.2} s to prepare the scene",
            m.visual_s, m.prepare_s
        ),
    ];
    if let Some(taxim) = peers.get("taxim") {
        let (ms, ratio) = (&taxim["tactile_ms"]["min"], &taxim["ratio"]);
        lines.push(format!(
            "taxim        {:.1} ms from height map to picture; ours takes {:.2} of it",
            ms.as_f64().unwrap_or(f64::NAN),
            ratio.as_f64().unwrap_or(f64::NAN)
        ));
    }
    lines.join("\n")
}
