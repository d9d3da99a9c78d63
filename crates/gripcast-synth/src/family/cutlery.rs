//! Spoons, forks, knives, spatulas, lying along x.

use glam::{DVec2, DVec3};

use super::draw::Draw;
use super::outline::{Knot, closed_line, even, rounded};
use super::plate::Plate;
use super::shape::{eased, sized_within};
use gripcast_base::error::Result;
use gripcast_geometry::TriangleMesh;

/// Measures that all have.
struct Handle {
    length: f64,
    /// Half width at the end and at the neck.
    half: [f64; 2],
    thick: f64,
    /// Height of the neck over the ends.
    lift: f64,
}

pub(super) fn draw(draw: &mut Draw) -> Result<TriangleMesh> {
    let form = draw.form(["spoon", "fork", "knife", "spatula", "ladle"]);
    let handle = Handle {
        length: draw.between("handle_m", 0.05, 0.085),
        half: [
            draw.between("end_m", 0.0045, 0.0095),
            draw.between("neck_m", 0.0024, 0.004),
        ],
        thick: draw.between("thickness_m", 0.0024, 0.0045),
        lift: draw.between("lift_m", 0.0, 0.008),
    };
    match form {
        "fork" => fork(draw, &handle),
        "knife" => knife(draw, &handle),
        "spatula" => spatula(draw, &handle),
        _ => spoon(draw, &handle, form == "ladle"),
    }
}

impl Handle {
    /// Corners of one side from the neck (x = 0) to the middle of the end.
    fn side(&self) -> [Knot; 3] {
        let [end, neck] = self.half;
        [
            rounded(0.0, neck, 0.01),
            rounded(-0.75 * self.length, end, 0.02),
            rounded(-self.length, 0.8 * end, 0.6 * end),
        ]
    }

    /// Closed outline of a head that starts at the neck, given by the knots of its upper side from
    /// the tip on.
    fn outline(&self, head: &[Knot]) -> Vec<Knot> {
        let upper: Vec<Knot> = head.iter().copied().chain(self.side()).collect();
        let mirrored = upper
            .iter()
            .rev()
            .map(|k| rounded(k.at.x, -k.at.y, k.fillet));
        let lower: Vec<Knot> = mirrored.filter(|k| k.at.y < -1e-9).collect();
        upper.into_iter().chain(lower).collect()
    }

    /// Height of the middle surface: a bow over the handle.
    fn height(&self, x: f64) -> f64 {
        let share = (x / self.length).clamp(-1.0, 0.0);
        self.lift * (1.0 - share * share) * (1.0 + share * share)
    }
}

/// A head that is an ellipse with a hollow.
fn spoon(draw: &mut Draw, handle: &Handle, ladle: bool) -> Result<TriangleMesh> {
    let half = draw.between("bowl_half_length_m", 0.016, 0.026);
    let wide = half * draw.between("bowl_width", 0.6, if ladle { 1.0 } else { 0.8 });
    let deep = half
        * if ladle {
            draw.between("depth", 0.4, 0.6)
        } else {
            draw.between("depth", 0.2, 0.4)
        };
    let neck = handle.half[1];
    let start = (neck / wide).asin();
    sized_within(2.6e-3, |edge| {
        let dense: Vec<DVec2> = (0..=100)
            .map(|k| {
                let angle = (std::f64::consts::PI - start) * f64::from(k) / 100.0;
                let center = half * start.cos();
                DVec2::new(center + half * angle.cos(), wide * angle.sin())
            })
            .collect();
        let head: Vec<Knot> = even(&dense, edge)
            .iter()
            .map(|p| rounded(p.x, p.y, 0.0))
            .collect();
        let mut knots = handle.outline(&head);
        // The neck is the last point of the head.
        knots.retain(|k| k.at.x.abs() > 1e-9);
        let center = DVec2::new(half * start.cos(), 0.0);
        Plate {
            outline: closed_line(&knots, edge),
            holes: Vec::new(),
            heights: &|p, _| {
                let out = ((p - center) / DVec2::new(half, wide))
                    .length_squared()
                    .min(1.0);
                let middle = handle.height(p.x) - deep * (1.0 - out).powf(0.8);
                [middle - 0.5 * handle.thick, middle + 0.5 * handle.thick]
            },
            edge,
        }
        .mesh()
    })
}

/// Tines behind a curved head.
fn fork(draw: &mut Draw, handle: &Handle) -> Result<TriangleMesh> {
    let tines = draw.count("tines", 2, 4);
    let tine = draw.between("tine_m", 0.0026, 0.0036);
    let gap = draw.between("gap_m", 0.0024, 0.0036);
    let long = draw.between("tine_length_m", 0.02, 0.034);
    let palm = draw.between("palm_m", 0.014, 0.022);
    let curve = draw.between("curve_m", 0.002, 0.008);
    let wide = 0.5 * (tines as f64 * tine + (tines - 1) as f64 * gap);
    sized_within(2.6e-3, |edge| {
        let tip = palm + long;
        let mut knots: Vec<Knot> = handle.side().into_iter().collect();
        let lower = knots.clone().into_iter().rev();
        knots.extend(lower.map(|k| rounded(k.at.x, -k.at.y, k.fillet)));
        knots.push(rounded(0.7 * palm, -wide, 0.012));
        for k in 0..tines {
            let from = -wide + k as f64 * (tine + gap);
            knots.push(rounded(tip, from + 0.2 * tine, 0.0));
            knots.push(rounded(tip, from + 0.8 * tine, 0.0));
            if k + 1 < tines {
                knots.push(rounded(palm, from + tine, 0.0));
                knots.push(rounded(palm, from + tine + gap, 0.0));
            }
        }
        knots.push(rounded(0.7 * palm, wide, 0.012));
        Plate {
            outline: closed_line(&knots, edge),
            holes: Vec::new(),
            heights: &|p, _| {
                let along = (p.x / tip).clamp(0.0, 1.0);
                let middle = handle.height(p.x) - curve * (std::f64::consts::PI * along).sin();
                let half = 0.5 * handle.thick * (1.0 - 0.25 * along);
                [middle - half, middle + half]
            },
            edge,
        }
        .mesh()
    })
}

/// A blade that is thinner at its edge (−y), and a grip.
fn knife(draw: &mut Draw, handle: &Handle) -> Result<TriangleMesh> {
    let blade = draw.between("blade_m", 0.035, 0.06);
    let wide = draw.between("blade_width_m", 0.012, 0.022);
    let point = draw.between("point", 0.2, 0.9);
    let grip = handle.half[0].max(0.006);
    let thick = handle.thick.max(0.003) * draw.between("grip", 1.2, 3.0);
    let long = handle.length;
    sized_within(2.8e-3, |edge| {
        let knots = [
            rounded(-long, grip, 0.005),
            rounded(-long, -grip, 0.005),
            rounded(-0.4 * long, -0.75 * grip, 0.02),
            rounded(0.0, -grip, 0.001),
            rounded(0.002, grip - wide, 0.001),
            rounded(0.8 * blade, grip - wide, 0.02),
            rounded(blade, grip - (1.0 - point) * wide - 0.003, 0.002),
            rounded(0.7 * blade + 0.3 * blade * (1.0 - point), grip, 0.01),
        ];
        Plate {
            outline: closed_line(&knots, edge),
            holes: Vec::new(),
            heights: &|p, depth| {
                let share = ((p.y - grip + wide) / wide).clamp(0.0, 1.0);
                let thin = 0.5 * (0.0014 + 0.0014 * share);
                let crown = (depth / grip).clamp(0.0, 1.0).sqrt();
                let half = 0.5 * thick * (0.6 + 0.4 * crown);
                let half = half + (thin - half) * eased(p.x / 0.012 + 0.6);
                [-half, half]
            },
            edge,
        }
        .mesh()
    })
}

/// A blade, perhaps with slots, that is set lower than the handle.
fn spatula(draw: &mut Draw, handle: &Handle) -> Result<TriangleMesh> {
    let blade = draw.between("blade_m", 0.035, 0.055);
    let wide = draw.between("blade_half_width_m", 0.014, 0.028);
    let tip = wide * draw.between("tip", 0.85, 1.15);
    let drop = draw.between("drop_m", 0.0, 0.014);
    let slots = draw.count("slots", 0, 4);
    sized_within(3.0e-3, |edge| {
        let head = [
            rounded(blade, tip, 0.004),
            rounded(0.18 * blade, wide, 0.006),
        ];
        let knots = handle.outline(&head);
        let pitch = 2.0 * wide.min(tip) / (slots as f64 + 1.0);
        let width = (0.3 * pitch).min(0.003);
        let holes = (0..if width > 0.0015 { slots } else { 0 }).map(|k| {
            let y = -wide.min(tip) + (k as f64 + 1.0) * pitch;
            let (from, to) = (0.35 * blade, 0.82 * blade);
            let corners = [
                (from, y - width),
                (to, y - width),
                (to, y + width),
                (from, y + width),
            ];
            closed_line(&corners.map(|(x, y)| rounded(x, y, 0.0012)), edge)
        });
        let mut mesh = Plate {
            outline: closed_line(&knots, edge),
            holes: holes.collect(),
            heights: &|p, _| {
                let half = 0.5
                    * if p.x > 0.0 {
                        handle.thick.min(0.003)
                    } else {
                        handle.thick
                    };
                [-half, half]
            },
            edge,
        }
        .mesh()?;
        for v in &mut mesh.vertices {
            let share = ((v.x + 0.2 * blade) / (0.4 * blade)).clamp(0.0, 1.0);
            *v += DVec3::Z * (handle.height(v.x) - drop * eased(share));
        }
        Ok(mesh)
    })
}
