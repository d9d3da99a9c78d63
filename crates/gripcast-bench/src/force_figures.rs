//! The fitted force model and its errors on presses that it has not seen.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use gripcast_base::error::Result;
use gripcast_base::statistics::quantile;
use gripcast_shear::ShearSource;
use gripcast_tactile::force::{ForceCalibration, ForceModel, NormalForce, WeightPress};
use serde::Serialize;

use crate::force_fit::{fit_normal, fit_shear, spread};
use crate::force_presses::Use;
use crate::force_samples::Sample;

/// Thickness of the gel, m.
const THICKNESS_M: f64 = 4e-3;
/// Young's moduli at which figures in newtons are given, Pa.
const YOUNG_PA: [f64; 2] = [0.4e6, 1.0e6];
/// Upper ends of the ranges of load, N.
const LOADS_N: [f64; 4] = [2.0, 8.0, 20.0, 40.0];
/// Ball of the calibration, and its loads, N.
const CALIBRATION_BALL: &str = "ball 10";
const CALIBRATION_N: [f64; 4] = [1.0, 2.5, 5.0, 10.0];
/// Force from which the ratio of a shape counts, N.
const SHAPE_FROM_N: f64 = 1.0;
/// Deviation that counts as within, fraction of the force.
const SHAPE_WITHIN: f64 = 0.1;
/// Kinds of gels: without and with gel markers.
const KINDS: [&str; 2] = ["plain", "markers"];
/// Decrease of the estimate between two states of a rising load that is not noise, fraction.
const DECREASE: f64 = 0.01;

/// Errors of one range of load.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct LoadFigures {
    up_to_n: f64,
    states: usize,
    mean_abs_n: f64,
    p90_n: f64,
    /// Median error, fraction of the force.
    median_fraction: f64,
    /// Fraction of the states within 1 N or 8 %, whichever is more.
    within: f64,
}

/// Errors on one kind of gel.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Figures {
    what: String,
    loads: Vec<LoadFigures>,
}

/// Estimates of one held-out shape by calibrated sensors, above 1 N.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct ShapeFigures {
    shape: String,
    has_markers: bool,
    states: usize,
    /// Median of the estimate over the force of the finite elements.
    median_ratio: f64,
    /// Fraction of the states within 10 %.
    within: f64,
}

/// Errors of the shear force on held-out sheared presses, at the larger modulus.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct ShearFigures {
    source: ShearSource,
    states: usize,
    up_to_n: f64,
    mean_abs_n: f64,
    /// Median error, fraction of the force.
    median_fraction: f64,
    /// Root mean square of the estimate on held-out presses without shear.
    unsheared_rms_n: f64,
}

/// Errors of a model on all samples.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct ModelFigures {
    loads: Vec<Figures>,
    shapes: Vec<ShapeFigures>,
    shear: Vec<ShearFigures>,
    /// Steps of a rising load, and those at which the estimate falls, without and with gel markers.
    decreases: [(usize, usize); 2],
}

/// Fits the model to the samples for fitting; returns its errors on all of them.
///
/// # Errors
/// `Internal` if no product of features explains the forces.
pub(crate) fn fitted(samples: &[Sample]) -> Result<(ForceModel, ModelFigures)> {
    let [plain, markers] = [false, true].map(|has_markers| -> Result<NormalForce> {
        let of = |split: Use| {
            let normal =
                |s: &&Sample| s.split == split && s.has_markers == has_markers && !s.is_sheared;
            samples.iter().filter(normal).collect::<Vec<_>>()
        };
        let mut fitted = fit_normal(&of(Use::Fit))?;
        let unseen = [of(Use::HeldOut), of(Use::Ball)].concat();
        let pairs: Vec<[f64; 2]> = unseen
            .iter()
            .map(|s| [fitted.of(&s.features, s.poisson).value, s.normal])
            .collect();
        fitted.spread = spread(&pairs);
        Ok(fitted)
    });
    let mut model = ForceModel {
        schema: 1,
        provenance: String::new(),
        marker_shear: fit_shear(&[]),
        texture_shear: fit_shear(&[]),
        plain: plain?,
        markers: markers?,
    };
    // With a weight of 1, the model's shear is the motion in its units.
    model.marker_shear.weight = 1.0;
    model.texture_shear.weight = 1.0;
    let motions = |source: ShearSource, is_fit: bool| -> Vec<[f64; 2]> {
        let shear = |s: &Sample| {
            let motion = s.motion.filter(|m| m.source == source)?;
            // The motion of an unsheared press is an error of its shear, too.
            let is_used = (s.split == Use::Fit) == is_fit && (s.is_sheared || !is_fit);
            let [x, _] = model.shear(&motion, &s.features, s.poisson).value;
            is_used.then_some([x, s.shear])
        };
        samples.iter().filter_map(shear).collect()
    };
    let [marker_shear, texture_shear] =
        [ShearSource::Markers, ShearSource::Texture].map(|source| {
            let mut term = fit_shear(&motions(source, true));
            let unseen = motions(source, false);
            let pairs: Vec<[f64; 2]> = unseen
                .iter()
                .map(|[motion, force]| [term.weight * motion, *force])
                .collect();
            term.spread = spread(&pairs);
            term
        });
    model.marker_shear = marker_shear;
    model.texture_shear = texture_shear;
    let figures = figures(&model, samples);
    model.provenance = provenance(&figures);
    Ok((model, figures))
}

fn figures(model: &ForceModel, samples: &[Sample]) -> ModelFigures {
    let mut all = Vec::new();
    let mut shapes = Vec::new();
    let mut decreases = [(0, 0); 2];
    for (kind, has_markers) in [(0, false), (1, true)] {
        let name = KINDS[kind];
        let of = |split: Use| {
            samples
                .iter()
                .filter(move |s| s.split == split && s.has_markers == has_markers && !s.is_sheared)
        };
        for (what, split) in [
            ("fitted shapes", Use::Fit),
            ("held-out shapes", Use::HeldOut),
            ("balls", Use::Ball),
        ] {
            let pairs: Vec<[f64; 2]> = YOUNG_PA
                .iter()
                .flat_map(|young_pa| {
                    let scale_n = young_pa * THICKNESS_M * THICKNESS_M;
                    of(split).map(move |s| {
                        let value = model.normal(&s.features, s.poisson).value;
                        [scale_n * value, scale_n * s.normal]
                    })
                })
                .collect();
            all.push(errors(format!("{name}, {what}, gel known"), &pairs));
        }
        for split in [Use::HeldOut, Use::Ball] {
            let what = if split == Use::Ball {
                "balls"
            } else {
                "held-out shapes"
            };
            let by_shape = calibrated(model, samples, split, has_markers);
            let pairs: Vec<[f64; 2]> = by_shape.values().flatten().copied().collect();
            all.push(errors(format!("{name}, {what}, gel calibrated"), &pairs));
            shapes.extend(by_shape.iter().map(|(shape, pairs)| {
                let above = pairs.iter().filter(|[_, force]| *force > SHAPE_FROM_N);
                let mut ratios: Vec<f64> = above.map(|[e, force]| e / force).collect();
                ratios.sort_by(f64::total_cmp);
                let within = ratios.iter().filter(|r| (*r - 1.0).abs() <= SHAPE_WITHIN);
                ShapeFigures {
                    shape: (*shape).to_owned(),
                    has_markers,
                    states: ratios.len(),
                    median_ratio: quantile(&ratios, 0.5).unwrap_or_default(),
                    within: within.count() as f64 / ratios.len().max(1) as f64,
                }
            }));
        }
        let (found, falls) = &mut decreases[kind];
        for pair in samples.windows(2) {
            let [before, after] = [&pair[0], &pair[1]];
            if before.sequence != after.sequence
                || before.is_sheared
                || before.has_markers != has_markers
                || after.normal <= before.normal
            {
                continue;
            }
            let value = |s: &Sample| model.normal(&s.features, s.poisson).value;
            *found += 1;
            *falls += usize::from(value(after) < (1.0 - DECREASE) * value(before));
        }
    }
    let shear = [ShearSource::Markers, ShearSource::Texture].map(|s| shear(model, samples, s));
    ModelFigures {
        loads: all,
        shapes,
        shear: shear.into(),
        decreases,
    }
}

/// Errors of the shear force along x on held-out presses.
fn shear(model: &ForceModel, samples: &[Sample], source: ShearSource) -> ShearFigures {
    let scale_n = YOUNG_PA[1] * THICKNESS_M * THICKNESS_M;
    let held_out = samples.iter().filter(|s| s.split != Use::Fit);
    let (mut sheared, mut unsheared) = (Vec::new(), Vec::new());
    for sample in held_out {
        let Some(motion) = sample.motion.filter(|m| m.source == source) else {
            continue;
        };
        let [x, y] = model.shear(&motion, &sample.features, sample.poisson).value;
        match sample.is_sheared {
            true => sheared.push([scale_n * x, scale_n * sample.shear]),
            false => unsheared.push(scale_n * x.hypot(y)),
        }
    }
    let mut fractions: Vec<f64> = sheared.iter().map(|[e, n]| (e / n - 1.0).abs()).collect();
    fractions.sort_by(f64::total_cmp);
    let count = sheared.len().max(1) as f64;
    let squares: f64 = unsheared.iter().map(|e| e * e).sum();
    ShearFigures {
        source,
        states: sheared.len(),
        up_to_n: sheared.iter().map(|[_, n]| *n).fold(0.0, f64::max),
        mean_abs_n: sheared.iter().map(|[e, n]| (e - n).abs()).sum::<f64>() / count,
        median_fraction: quantile(&fractions, 0.5).unwrap_or_default(),
        unsheared_rms_n: (squares / unsheared.len().max(1) as f64).sqrt(),
    }
}

/// Estimates and forces of held-out presses by sensors that are calibrated with weights on one ball,
/// by shape.
fn calibrated<'a>(
    model: &ForceModel,
    samples: &'a [Sample],
    split: Use,
    has_markers: bool,
) -> BTreeMap<&'a str, Vec<[f64; 2]>> {
    let mut pairs: BTreeMap<&str, Vec<[f64; 2]>> = BTreeMap::new();
    let of_kind = || {
        samples
            .iter()
            .filter(|s| s.has_markers == has_markers && !s.is_sheared)
    };
    let mut sensors: Vec<u64> = of_kind()
        .filter(|s| s.split == Use::Ball)
        .map(|s| s.sensor)
        .collect();
    sensors.sort_unstable();
    sensors.dedup();
    for sensor in sensors {
        for young_pa in YOUNG_PA {
            let scale_n = young_pa * THICKNESS_M * THICKNESS_M;
            let own = || of_kind().filter(|s| s.sensor == sensor);
            let nearest = |force_n: f64| {
                own()
                    .filter(|s| s.shape == CALIBRATION_BALL)
                    .min_by(|a, b| {
                        let off = |s: &Sample| (scale_n * s.normal / force_n).ln().abs();
                        off(a).total_cmp(&off(b))
                    })
            };
            let presses: Vec<WeightPress> = CALIBRATION_N
                .iter()
                .filter_map(|force_n| nearest(*force_n))
                .map(|s| WeightPress {
                    name: format!("{:.2} N", scale_n * s.normal),
                    features: s.features,
                    force_n: scale_n * s.normal,
                })
                .collect();
            let fit = ForceCalibration::fit(model, THICKNESS_M, "bench", "", &presses);
            let Ok(calibration) = fit else { continue };
            let h2 = THICKNESS_M * THICKNESS_M;
            for s in own().filter(|s| s.split == split) {
                let value = model.normal(&s.features, calibration.poisson).value;
                let pair = [calibration.young_pa * h2 * value, scale_n * s.normal];
                pairs.entry(&s.shape).or_default().push(pair);
            }
        }
    }
    pairs
}

fn errors(what: String, pairs: &[[f64; 2]]) -> Figures {
    let mut from_n = 0.0;
    let loads = LOADS_N.iter().map(|up_to_n| {
        let range = from_n..*up_to_n;
        from_n = *up_to_n;
        let inside: Vec<&[f64; 2]> = pairs.iter().filter(|[_, n]| range.contains(n)).collect();
        let mut off: Vec<f64> = inside.iter().map(|[e, n]| (e - n).abs()).collect();
        let mut fractions: Vec<f64> = inside.iter().map(|[e, n]| (e / n - 1.0).abs()).collect();
        off.sort_by(f64::total_cmp);
        fractions.sort_by(f64::total_cmp);
        let within = inside
            .iter()
            .filter(|[e, n]| (e - n).abs() <= (0.08 * n).max(1.0));
        let count = inside.len().max(1) as f64;
        LoadFigures {
            up_to_n: *up_to_n,
            states: inside.len(),
            mean_abs_n: off.iter().sum::<f64>() / count,
            p90_n: quantile(&off, 0.9).unwrap_or_default(),
            median_fraction: quantile(&fractions, 0.5).unwrap_or_default(),
            within: within.count() as f64 / count,
        }
    });
    Figures {
        loads: loads.collect(),
        what,
    }
}

/// The errors as tables.
pub(crate) fn text(figures: &ModelFigures) -> String {
    let mut out = format!(
        "{:<40} {:>7} {:>7} {:>9} {:>7} {:>8} {:>7}\n",
        "", "up to N", "states", "mean abs", "p90", "median %", "within"
    );
    for figures in &figures.loads {
        for (row, load) in figures.loads.iter().enumerate() {
            let what = if row == 0 { figures.what.as_str() } else { "" };
            let _ = writeln!(
                out,
                "{what:<40} {:>7} {:>7} {:>9.2} {:>7.2} {:>8.1} {:>7.2}",
                load.up_to_n,
                load.states,
                load.mean_abs_n,
                load.p90_n,
                100.0 * load.median_fraction,
                load.within
            );
        }
    }
    let _ = writeln!(
        out,
        "\n{:<40} {:>7} {:>12} {:>11}",
        "gel calibrated, above 1 N", "states", "median ratio", "within 10 %"
    );
    for figures in &figures.shapes {
        let kind = KINDS[usize::from(figures.has_markers)];
        let _ = writeln!(
            out,
            "{:<40} {:>7} {:>12.2} {:>11.2}",
            format!("{kind}, {}", figures.shape),
            figures.states,
            figures.median_ratio,
            figures.within
        );
    }
    for figures in &figures.shear {
        let source = match figures.source {
            ShearSource::Markers => "markers",
            ShearSource::Texture => "texture",
        };
        let _ = writeln!(
            out,
            "shear from {source}: {} states up to {:.1} N, mean abs {:.2} N, median {:.1} %; \
             without shear {:.2} N rms",
            figures.states,
            figures.up_to_n,
            figures.mean_abs_n,
            100.0 * figures.median_fraction,
            figures.unsheared_rms_n
        );
    }
    for (kind, (steps, falls)) in KINDS.iter().zip(figures.decreases) {
        let _ = writeln!(
            out,
            "{kind}: the estimate falls in {falls} of {steps} steps of load"
        );
    }
    out
}

/// Sentence about the model for its file.
fn provenance(figures: &ModelFigures) -> String {
    let of = |figures: &Figures| {
        let loads = figures
            .loads
            .iter()
            .map(|load| format!("{:.2} N up to {} N", load.mean_abs_n, load.up_to_n));
        format!("{}: {}", figures.what, loads.collect::<Vec<_>>().join(", "))
    };
    let unseen = |f: &&Figures| !f.what.contains("fitted");
    let held_out = figures.loads.iter().filter(unseen);
    let held_out: Vec<String> = held_out.map(of).collect();
    let [(plain, plain_falls), (markers, marker_falls)] = figures.decreases;
    format!(
        "Written by `gripcast-bench force-model`. Fitted to finite-element presses of 24 shapes on \
         gels of Poisson's ratio 0.30, 0.40 and 0.48, rendered with GelSight Minis that differ as \
         real ones do; no real newtons. Mean absolute errors on shapes, gels and sensors that are \
         not among them, at 0.4 and 1 MPa: {}. The estimate falls by more than 1 % in {plain_falls} \
         of {plain} (plain) and {marker_falls} of {markers} (markers) steps of rising load.",
        held_out.join("; ")
    )
}
