//! Bodies from the files in `shapes`.
//!
//! `forms` draws the form and `section` selects the cross section. Then a block builds the body:
//!
//! | block | body | commands in it |
//! | --- | --- | --- |
//! | `lathe`, `ring` | a profile, from axis to axis or closed, turned about z | `knot`, `circle`, `smooth`, `fraction` of the section |
//! | `plate` | an outline with holes and a thickness | `knot`, `circle`, `curve`, `curve_back`, `corners`, `mirror`, `hole`, `slot`, `thickness`, `heights` |
//! | `box` | a box with rounded edges | |
//! | `solid` | blended primitives | `ellipsoid`, `rounded_box`, `frustum`, `capsule`, `capsules`; before them `cut`, `rotate_x` …; `units` |
//!
//! All but the last are executed again for each edge length, the variable `edge`; the first
//! argument of `lathe`, `ring` and `plate` is its maximum. `vertex` transforms each vertex.

use glam::{DQuat, DVec2, DVec3};

use super::draw::Draw;
use super::lathe::{Lathe, Section};
use super::outline::{Knot, circle, closed_line, even, open_line, rounded, smooth};
use super::plate::{Plate, bent};
use super::rounded_box::rounded_box;
use super::script::{Formula, Scope, Step, parse};
use super::shape::{EDGE_M, with_max_edge};
use super::solid::{Operation, Primitive, Solid};
use gripcast_base::error::{Error, Result};
use gripcast_geometry::TriangleMesh;

/// Draws a shape of a file.
///
/// # Errors
/// `Internal` for a syntax error or a file without a body.
pub(super) fn draw(text: &'static str, draw: &mut Draw) -> Result<TriangleMesh> {
    let steps = parse(text)?;
    let mut section = Section::circle();
    let body_mesh = Scope::new(draw).run(&steps, &mut |scope, step| {
        match step.command {
            "forms" => scope.draw_form(&step.arguments),
            "section" => section = section_of(step, scope),
            "solid" => return Some(Ok(solid(step, scope))),
            "lathe" | "ring" | "plate" | "box" => return Some(body(step, &section, scope)),
            _ => {}
        }
        None
    });
    body_mesh.unwrap_or_else(|| Err(Error::internal("the shape has no body")))
}

fn section_of(step: &Step, scope: &mut Scope<'_>) -> Section {
    let Some(Formula::Call(kind, arguments)) = step.arguments.first() else {
        return Section::circle();
    };
    let numbers: Vec<f64> = arguments.iter().map(|f| scope.evaluate(f)).collect();
    match (*kind, &numbers[..]) {
        ("polygon", [sides]) => Section::polygon(*sides as usize),
        ("lobes", [count, depth]) => Section::lobes(*count as usize, *depth),
        ("oblong", [aspect, power]) => Section::oblong(*aspect, *power),
        _ => Section::circle(),
    }
}

/// Contents of a body's block.
#[derive(Default)]
struct BodyBlock<'s> {
    knots: Vec<Knot>,
    /// Points that replace the knots.
    points: Vec<DVec2>,
    holes: Vec<Vec<DVec2>>,
    thickness: f64,
    /// Weight of the section at a radius `x` and a height `y`.
    fraction: Option<&'s Formula>,
    /// Computes the height of the `middle` and `half` the thickness at `x` and `y`, at a distance
    /// `depth` from the rim.
    heights: &'s [Step],
    /// Transforms each vertex `x`, `y`, `z`.
    vertex: &'s [Step],
}

fn body(step: &Step, section: &Section, scope: &mut Scope<'_>) -> Result<TriangleMesh> {
    let numbers = scope.arguments(step);
    let max_edge = match step.command {
        "box" => EDGE_M.1,
        _ => numbers.first().copied().unwrap_or(EDGE_M.1),
    };
    with_max_edge(max_edge, |edge| {
        let mut scope = scope.with([("edge", edge)]);
        let mut block = BodyBlock::default();
        let mut act = |scope: &mut Scope<'_>, step| {
            block.read(step, scope);
            None::<()>
        };
        scope.run(&step.block, &mut act);
        let edge = scope.get("edge");
        let mut mesh = match (step.command, &numbers[..]) {
            ("box", &[x, y, z, fillet]) => rounded_box(DVec3::new(x, y, z), fillet, edge),
            ("plate", _) => block.plate(&scope, edge)?,
            (command, _) => block.lathe(section, command == "ring", &scope, edge),
        };
        for v in &mut mesh.vertices {
            *v = transformed(*v, block.vertex, &scope);
        }
        Ok(mesh)
    })
}

impl<'s> BodyBlock<'s> {
    fn read(&mut self, step: &'s Step, scope: &mut Scope<'_>) {
        let edge = scope.get("edge");
        match (step.command, &step.arguments[..]) {
            ("vertex", _) => self.vertex = &step.block,
            ("fraction", [fraction]) => self.fraction = Some(fraction),
            ("heights", _) => self.heights = &step.block,
            ("curve" | "curve_back" | "corners", [Formula::Name(name), pieces]) => {
                let pieces = scope.evaluate(pieces) as usize;
                let mut dense = Vec::with_capacity(pieces + 1);
                for k in 0..=pieces {
                    scope.set(name, k as f64);
                    scope.run(&step.block, &mut |_, _| None::<()>);
                    dense.push(DVec2::new(scope.get("x"), scope.get("y")));
                }
                let mut points = even(&dense, edge);
                match step.command {
                    "corners" => {
                        // The neck, where the curve ends, is not a corner.
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
            ("thickness", [thickness]) => self.thickness = scope.evaluate(thickness),
            _ => match (step.command, &scope.arguments(step)[..]) {
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

    /// Returns the points of the outline or profile.
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

    fn plate(&self, scope: &Scope<'_>, edge: f64) -> Result<TriangleMesh> {
        Plate {
            outline: self.line(true, edge),
            holes: self.holes.clone(),
            heights: &|point, depth| {
                if self.heights.is_empty() {
                    return [-0.5 * self.thickness, 0.5 * self.thickness];
                }
                let position = [("x", point.x), ("y", point.y), ("depth", depth)];
                let mut scope = scope.with(position);
                scope.set("middle", 0.0);
                scope.run(self.heights, &mut |_, _| None::<()>);
                let (middle, half) = (scope.get("middle"), scope.get("half"));
                [middle - half, middle + half]
            },
            edge,
        }
        .mesh()
    }

    fn lathe(&self, section: &Section, closed: bool, scope: &Scope<'_>, edge: f64) -> TriangleMesh {
        Lathe {
            profile: &self.line(closed, edge),
            closed,
            section,
            fraction: &|point| {
                let position = [("x", point.x), ("y", point.y)];
                let fraction = |fraction| scope.with(position).evaluate(fraction);
                self.fraction.map_or(1.0, fraction)
            },
            edge,
        }
        .mesh()
    }
}

/// Transforms a vertex by the steps of a block.
fn transformed(v: DVec3, steps: &[Step], scope: &Scope<'_>) -> DVec3 {
    if steps.is_empty() {
        return v;
    }
    let mut scope = scope.with([("x", v.x), ("y", v.y), ("z", v.z)]);
    let vertex = |scope: &Scope<'_>| DVec3::from_array(["x", "y", "z"].map(|n| scope.get(n)));
    scope.run(steps, &mut |scope, step| {
        let v = vertex(scope);
        let v = match (step.command, &scope.arguments(step)[..]) {
            ("bend", &[start, radius, angle]) => bent(v, start, radius, angle),
            ("upright", &[]) => DVec3::new(v.x, -v.z, v.y),
            ("lie", &[]) => DVec3::new(v.z, v.x, v.y),
            ("swap", &[]) => DVec3::new(v.z, v.y, v.x),
            (command, &[angle]) => rotation_about(command, angle) * v,
            _ => DVec3::NAN,
        };
        for (name, value) in ["x", "y", "z"].into_iter().zip(v.to_array()) {
            scope.set(name, value);
        }
        None::<()>
    });
    vertex(&scope)
}

fn rotation_about(command: &str, angle: f64) -> DQuat {
    match command {
        "rotate_x" => DQuat::from_rotation_x(angle),
        "rotate_y" => DQuat::from_rotation_y(angle),
        _ => DQuat::from_rotation_z(angle),
    }
}

/// Builds a body of primitives; `cut` and `rotate_…` apply to the next one. Lengths are multiples
/// of the first argument of `units`; the second is the minimum radius of capsules, m.
fn solid(step: &Step, scope: &mut Scope<'_>) -> TriangleMesh {
    let mut solid = Solid::new(scope.arguments(step).first().copied().unwrap_or(f64::NAN));
    let (mut unit, mut min_radius) = (1.0, 0.0);
    let (mut rotation, mut is_cut) = (DQuat::IDENTITY, false);
    scope.run(&step.block, &mut |scope, step| {
        let numbers = scope.arguments(step);
        let lengths: Vec<f64> = numbers.iter().map(|n| n * unit).collect();
        let operation = match is_cut {
            true => Operation::Difference,
            false => Operation::Union,
        };
        match (step.command, &lengths[..]) {
            ("units", _) => (unit, min_radius) = (numbers[0], numbers[1]),
            ("cut", []) => {
                is_cut = true;
                return None;
            }
            ("rotate_x" | "rotate_y" | "rotate_z", _) => {
                rotation = rotation_about(step.command, numbers[0]);
                return None;
            }
            ("ellipsoid", &[x, y, z, a, b, c, width]) => {
                let primitive = Primitive::Ellipsoid(DVec3::new(a, b, c));
                solid.add(primitive, DVec3::new(x, y, z), rotation, operation(width));
            }
            ("rounded_box", &[x, y, z, a, b, c, round, width]) => {
                let primitive = Primitive::Box(DVec3::new(a, b, c), round);
                solid.add(primitive, DVec3::new(x, y, z), rotation, operation(width));
            }
            ("frustum", &[x, y, z, bottom, top, half, round, width]) => {
                let primitive = Primitive::Frustum([bottom, top], half, round);
                solid.add(primitive, DVec3::new(x, y, z), rotation, operation(width));
            }
            ("capsule" | "capsules", &[a, b, c, x, y, z, from, to, width]) => {
                let radii = [from, to].map(|r| r.max(min_radius));
                let ends = [DVec3::new(a, b, c), DVec3::new(x, y, z)];
                solid.capsule(ends, radii, width);
                // A capsule on the left has a mirror image on the right.
                if step.command == "capsules" && y != 0.0 {
                    let mirror = DVec3::new(1.0, -1.0, 1.0);
                    solid.capsule(ends.map(|p| p * mirror), radii, width);
                }
            }
            _ => {}
        }
        (rotation, is_cut) = (DQuat::IDENTITY, false);
        None::<()>
    });
    solid.mesh()
}
