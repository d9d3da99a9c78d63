//! Bodies from the files in `shapes`.
//!
//! `forms` draws the form and `section` chooses the cross section. Then a block makes the body:
//!
//! | block | body | commands in it |
//! | --- | --- | --- |
//! | `lathe`, `ring` | a profile, from axis to axis or closed, turned about z | `knot`, `circle`, `smooth`, `fraction` of the section |
//! | `plate` | an outline with holes and a thickness | `knot`, `circle`, `curve`, `curve_back`, `corners`, `mirror`, `hole`, `slot`, `thickness`, `heights` |
//! | `box` | a box with rounded edges | |
//! | `solid` | blended parts | `ball`, `block`, `drum`, `limb`, `limbs`; before them `cut`, `turn_x` …; `units` |
//!
//! All but the last are run again for each width of faces, which they know as `edge`; the first
//! argument of `lathe`, `ring` and `plate` is the largest. `vertex` says what happens to each vertex.

use glam::{DQuat, DVec2, DVec3};

use super::draw::Draw;
use super::lathe::{Lathe, Section};
use super::outline::{Knot, circle, closed_line, even, open_line, rounded, smooth};
use super::plate::{Plate, bent};
use super::rounded_box::rounded_box;
use super::script::{Formula, Step, Values, parse};
use super::shape::{EDGE_M, with_max_edge};
use super::solid::{Operation, Primitive, Solid};
use gripcast_base::error::{Error, Result};
use gripcast_geometry::TriangleMesh;

/// Draws a shape of a file.
///
/// # Errors
/// `Internal` for a file that cannot be read or makes no body.
pub(super) fn draw(text: &'static str, draw: &mut Draw) -> Result<TriangleMesh> {
    let steps = parse(text)?;
    let mut section = Section::circle();
    let made = Values::new(draw).run(&steps, &mut |values, step| {
        match step.command {
            "forms" => values.draw_form(&step.arguments),
            "section" => section = section_of(step, values),
            "solid" => return Some(Ok(solid(step, values))),
            "lathe" | "ring" | "plate" | "box" => return Some(body(step, &section, values)),
            _ => {}
        }
        None
    });
    made.unwrap_or_else(|| Err(Error::internal("the shape has no body")))
}

fn section_of(step: &Step, values: &mut Values<'_>) -> Section {
    let Some(Formula::Call(kind, arguments)) = step.arguments.first() else {
        return Section::circle();
    };
    let numbers: Vec<f64> = arguments.iter().map(|f| values.value(f)).collect();
    match (*kind, &numbers[..]) {
        ("polygon", [sides]) => Section::polygon(*sides as usize),
        ("lobes", [count, depth]) => Section::lobes(*count as usize, *depth),
        ("oblong", [aspect, power]) => Section::oblong(*aspect, *power),
        _ => Section::circle(),
    }
}

/// What the block of a body says.
#[derive(Default)]
struct Lines<'s> {
    knots: Vec<Knot>,
    /// Points that are taken as they are, in place of the knots.
    points: Vec<DVec2>,
    holes: Vec<Vec<DVec2>>,
    thickness: f64,
    /// Fraction of the section at a radius `x` and a height `y`.
    fraction: Option<&'s Formula>,
    /// Sets the height of the `middle` and `half` the thickness at `x` and `y`, `depth` away from
    /// the rim.
    heights: &'s [Step],
    /// What happens to each vertex `x`, `y`, `z`.
    vertex: &'s [Step],
}

fn body(step: &Step, section: &Section, values: &mut Values<'_>) -> Result<TriangleMesh> {
    let numbers = values.of(step);
    let most = match step.command {
        "box" => EDGE_M.1,
        _ => numbers.first().copied().unwrap_or(EDGE_M.1),
    };
    with_max_edge(most, |edge| {
        let mut values = values.with([("edge", edge)]);
        let mut lines = Lines::default();
        let mut act = |values: &mut Values<'_>, step| {
            lines.note(step, values);
            None::<()>
        };
        values.run(&step.block, &mut act);
        let edge = values.get("edge");
        let mut mesh = match (step.command, &numbers[..]) {
            ("box", &[x, y, z, fillet]) => rounded_box(DVec3::new(x, y, z), fillet, edge),
            ("plate", _) => lines.plate(&values, edge)?,
            (command, _) => lines.turned(section, command == "ring", &values, edge),
        };
        for v in &mut mesh.vertices {
            *v = moved(*v, lines.vertex, &values);
        }
        Ok(mesh)
    })
}

impl<'s> Lines<'s> {
    fn note(&mut self, step: &'s Step, values: &mut Values<'_>) {
        let edge = values.get("edge");
        match (step.command, &step.arguments[..]) {
            ("vertex", _) => self.vertex = &step.block,
            ("fraction", [fraction]) => self.fraction = Some(fraction),
            ("heights", _) => self.heights = &step.block,
            ("curve" | "curve_back" | "corners", [Formula::Name(name), pieces]) => {
                let pieces = values.value(pieces) as usize;
                let mut dense = Vec::with_capacity(pieces + 1);
                for k in 0..=pieces {
                    values.set(name, k as f64);
                    values.run(&step.block, &mut |_, _| None::<()>);
                    dense.push(DVec2::new(values.get("x"), values.get("y")));
                }
                let mut points = even(&dense, edge);
                match step.command {
                    "corners" => {
                        // The neck, where the curve ends, is no corner.
                        points.retain(|p| p.x.abs() > 1e-9);
                        self.knots
                            .extend(points.iter().map(|p| rounded(p.x, p.y, 0.0)));
                        return;
                    }
                    "curve_back" => points.reverse(),
                    _ => {}
                }
                self.points.extend(points);
            }
            ("thickness", [thickness]) => self.thickness = values.value(thickness),
            _ => match (step.command, &values.of(step)[..]) {
                ("knot", &[x, y]) => self.knots.push(rounded(x, y, 0.0)),
                ("knot", &[x, y, fillet]) => self.knots.push(rounded(x, y, fillet)),
                ("hole", &[x, y, radius]) => {
                    self.holes.push(circle(DVec2::new(x, y), radius, edge));
                }
                ("circle", &[x, y, radius]) => {
                    self.points = circle(DVec2::new(x, y), radius, edge);
                }
                ("slot", &[x, y, to_x, to_y, fillet]) => {
                    let corners = [(x, y), (to_x, y), (to_x, to_y), (x, to_y)];
                    let corners = corners.map(|(x, y)| rounded(x, y, fillet));
                    self.holes.push(closed_line(&corners, edge));
                }
                ("mirror", &[]) => {
                    let upper: Vec<Knot> = self.knots.iter().rev().copied().collect();
                    let upper = upper.iter().filter(|k| k.at.y > 1e-9);
                    let lower = upper.map(|k| rounded(k.at.x, -k.at.y, k.fillet));
                    self.knots.extend(lower);
                }
                ("smooth", &[radius, tall]) => {
                    let size = DVec2::new(1.0, tall);
                    let dense = smooth(&self.knots).map(|p| p * radius * size);
                    self.points = even(&dense.collect::<Vec<_>>(), edge);
                }
                _ => {}
            },
        }
    }

    /// Points of the outline or profile.
    fn line(&self, closed: bool, edge: f64) -> Vec<DVec2> {
        if self.points.is_empty() {
            return if closed {
                closed_line(&self.knots, edge)
            } else {
                open_line(&self.knots, edge)
            };
        }
        let mut points = self.points.clone();
        if points[0].distance(points[points.len() - 1]) < 1e-9 {
            points.pop();
        }
        points
    }

    fn plate(&self, values: &Values<'_>, edge: f64) -> Result<TriangleMesh> {
        Plate {
            outline: self.line(true, edge),
            holes: self.holes.clone(),
            heights: &|at, depth| {
                if self.heights.is_empty() {
                    return [-0.5 * self.thickness, 0.5 * self.thickness];
                }
                let place = [("x", at.x), ("y", at.y), ("depth", depth), ("middle", 0.0)];
                let mut values = values.with(place);
                values.run(self.heights, &mut |_, _| None::<()>);
                let (middle, half) = (values.get("middle"), values.get("half"));
                [middle - half, middle + half]
            },
            edge,
        }
        .mesh()
    }

    fn turned(
        &self,
        section: &Section,
        closed: bool,
        values: &Values<'_>,
        edge: f64,
    ) -> TriangleMesh {
        Lathe {
            profile: &self.line(closed, edge),
            closed,
            section,
            fraction: &|at| {
                let fraction = |fraction| values.with([("x", at.x), ("y", at.y)]).value(fraction);
                self.fraction.map_or(1.0, fraction)
            },
            edge,
        }
        .mesh()
    }
}

/// A vertex after the steps of a block.
fn moved(v: DVec3, steps: &[Step], values: &Values<'_>) -> DVec3 {
    if steps.is_empty() {
        return v;
    }
    let mut values = values.with([("x", v.x), ("y", v.y), ("z", v.z)]);
    let vertex = |values: &Values<'_>| DVec3::from_array(["x", "y", "z"].map(|n| values.get(n)));
    values.run(steps, &mut |values, step| {
        let v = vertex(values);
        let v = match (step.command, &values.of(step)[..]) {
            ("bend", &[start, radius, angle]) => bent(v, start, radius, angle),
            ("upright", &[]) => DVec3::new(v.x, -v.z, v.y),
            ("lie", &[]) => DVec3::new(v.z, v.x, v.y),
            ("swap", &[]) => DVec3::new(v.z, v.y, v.x),
            (turn, &[angle]) => turned_about(turn, angle) * v,
            _ => DVec3::NAN,
        };
        for (name, value) in ["x", "y", "z"].into_iter().zip(v.to_array()) {
            values.set(name, value);
        }
        None::<()>
    });
    vertex(&values)
}

fn turned_about(command: &str, angle: f64) -> DQuat {
    match command {
        "turn_x" => DQuat::from_rotation_x(angle),
        "turn_y" => DQuat::from_rotation_y(angle),
        _ => DQuat::from_rotation_z(angle),
    }
}

/// A body of parts: `cut` and `turn_…` concern the next one. Its lengths are in parts of the first
/// argument of `units`, the second is the least radius of limbs, m.
fn solid(step: &Step, values: &mut Values<'_>) -> TriangleMesh {
    let mut solid = Solid::new(values.of(step).first().copied().unwrap_or(f64::NAN));
    let (mut unit, mut least) = (1.0, 0.0);
    let (mut turn, mut is_cut) = (DQuat::IDENTITY, false);
    values.run(&step.block, &mut |values, step| {
        let numbers = values.of(step);
        let lengths: Vec<f64> = numbers.iter().map(|n| n * unit).collect();
        let role = |width| match is_cut {
            true => Operation::Difference(width),
            false => Operation::Union(width),
        };
        match (step.command, &lengths[..]) {
            ("units", _) => (unit, least) = (numbers[0], numbers[1]),
            ("cut", []) => {
                is_cut = true;
                return None;
            }
            ("turn_x" | "turn_y" | "turn_z", _) => {
                turn = turned_about(step.command, numbers[0]);
                return None;
            }
            ("ball", &[x, y, z, a, b, c, width]) => {
                let form = Primitive::Ellipsoid(DVec3::new(a, b, c));
                solid.add(form, DVec3::new(x, y, z), turn, role(width));
            }
            ("block", &[x, y, z, a, b, c, round, width]) => {
                let form = Primitive::Box(DVec3::new(a, b, c), round);
                solid.add(form, DVec3::new(x, y, z), turn, role(width));
            }
            ("drum", &[x, y, z, bottom, top, half, round, width]) => {
                let form = Primitive::Frustum([bottom, top], half, round);
                solid.add(form, DVec3::new(x, y, z), turn, role(width));
            }
            ("limb" | "limbs", &[a, b, c, x, y, z, from, to, width]) => {
                let radii = [from, to].map(|r| r.max(least));
                let ends = [DVec3::new(a, b, c), DVec3::new(x, y, z)];
                solid.capsule(ends, radii, width);
                // A limb on the left has a mirror image on the right.
                if step.command == "limbs" && y != 0.0 {
                    let mirror = DVec3::new(1.0, -1.0, 1.0);
                    solid.capsule(ends.map(|p| p * mirror), radii, width);
                }
            }
            _ => {}
        }
        (turn, is_cut) = (DQuat::IDENTITY, false);
        None::<()>
    });
    solid.mesh()
}
