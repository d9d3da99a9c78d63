//! Fruit and vegetables.

use std::f64::consts::{PI, TAU};

use glam::{DQuat, DVec2, DVec3};

use super::draw::Draw;
use super::lathe::{Lathe, Section};
use super::outline::even;
use super::plate::bent;
use super::shape::sized;
use gripcast_base::error::Result;
use gripcast_geometry::TriangleMesh;

/// Radius over height, as parts of the widest radius: points of a smooth profile from the bottom.
type Profile = &'static [(f64, f64)];

const APPLE: Profile = &[
    (0.0, -0.72),
    (0.25, -0.8),
    (0.55, -0.72),
    (0.88, -0.3),
    (1.0, 0.15),
    (0.88, 0.6),
    (0.5, 0.8),
    (0.2, 0.66),
    (0.08, 0.55),
    (0.07, 0.9),
    (0.0, 0.92),
];
const PEAR: Profile = &[
    (0.0, -0.95),
    (0.3, -1.0),
    (0.75, -0.7),
    (1.0, -0.1),
    (0.85, 0.5),
    (0.55, 0.95),
    (0.45, 1.35),
    (0.3, 1.6),
    (0.1, 1.66),
    (0.07, 1.9),
    (0.0, 1.92),
];
const LEMON: Profile = &[
    (0.0, -1.4),
    (0.16, -1.35),
    (0.3, -1.2),
    (0.75, -0.8),
    (1.0, 0.0),
    (0.78, 0.78),
    (0.3, 1.15),
    (0.2, 1.3),
    (0.0, 1.38),
];
const EGG: Profile = &[
    (0.0, -1.1),
    (0.5, -0.95),
    (0.88, -0.5),
    (1.0, 0.0),
    (0.86, 0.65),
    (0.52, 1.15),
    (0.0, 1.42),
];
const ORANGE: Profile = &[
    (0.0, -0.95),
    (0.4, -0.9),
    (0.8, -0.58),
    (1.0, 0.0),
    (0.82, 0.55),
    (0.4, 0.88),
    (0.0, 0.9),
];
const PUMPKIN: Profile = &[
    (0.0, -0.55),
    (0.35, -0.66),
    (0.75, -0.52),
    (1.0, 0.0),
    (0.8, 0.5),
    (0.4, 0.62),
    (0.16, 0.5),
    (0.12, 0.85),
    (0.0, 0.88),
];
const CARROT: Profile = &[
    (0.0, -3.6),
    (0.12, -3.4),
    (0.4, -2.0),
    (0.75, 0.0),
    (1.0, 1.4),
    (0.8, 1.75),
    (0.3, 1.72),
    (0.25, 2.2),
    (0.0, 2.25),
];
const BANANA: Profile = &[
    (0.0, -3.6),
    (0.22, -3.5),
    (0.35, -3.1),
    (0.85, -2.0),
    (1.0, 0.0),
    (0.88, 1.8),
    (0.42, 2.9),
    (0.25, 3.3),
    (0.25, 3.9),
    (0.0, 3.95),
];
const MUSHROOM: Profile = &[
    (0.0, -1.2),
    (0.4, -1.18),
    (0.45, -0.9),
    (0.36, -0.3),
    (0.4, -0.1),
    (0.85, -0.2),
    (1.0, 0.02),
    (0.85, 0.42),
    (0.45, 0.7),
    (0.0, 0.78),
];
const STRAWBERRY: Profile = &[
    (0.0, -1.35),
    (0.25, -1.2),
    (0.65, -0.6),
    (0.98, 0.15),
    (0.85, 0.55),
    (0.45, 0.7),
    (0.15, 0.66),
    (0.1, 0.95),
    (0.0, 0.97),
];
const PEPPER: Profile = &[
    (0.0, -1.15),
    (0.3, -1.25),
    (0.7, -1.1),
    (0.85, -0.4),
    (1.0, 0.4),
    (0.85, 0.85),
    (0.45, 0.92),
    (0.18, 0.78),
    (0.15, 1.2),
    (0.0, 1.22),
];

pub(super) fn draw(draw: &mut Draw) -> Result<TriangleMesh> {
    let forms = [
        "apple",
        "pear",
        "lemon",
        "egg",
        "orange",
        "pumpkin",
        "carrot",
        "banana",
        "mushroom",
        "strawberry",
        "pepper",
    ];
    let form = draw.form(forms);
    let (profile, low, high, waves, depth) = match form {
        "apple" => (APPLE, 0.024, 0.038, 5, 0.02),
        "pear" => (PEAR, 0.02, 0.034, 3, 0.015),
        "lemon" => (LEMON, 0.018, 0.03, 4, 0.01),
        "egg" => (EGG, 0.014, 0.026, 2, 0.0),
        "pumpkin" => (PUMPKIN, 0.028, 0.042, 9, 0.06),
        "carrot" => (CARROT, 0.01, 0.017, 3, 0.02),
        "banana" => (BANANA, 0.011, 0.016, 5, 0.03),
        "mushroom" => (MUSHROOM, 0.018, 0.034, 3, 0.01),
        "strawberry" => (STRAWBERRY, 0.013, 0.024, 3, 0.02),
        "pepper" => (PEPPER, 0.022, 0.036, 4, 0.07),
        _ => (ORANGE, 0.022, 0.038, 3, 0.01),
    };
    let radius = draw.between("radius_m", low, high);
    let tall = draw.between("height", 0.9, 1.12);
    let ridges = Section::lobes(waves, depth * draw.between("ridges", 0.3, 1.0));
    let lean = draw.between("lean", -0.08, 0.08);
    let squash = draw.between("squash", 0.92, 1.0);
    let curl = draw.between("curl_rad", 0.7, 1.3);
    let lying = matches!(form, "carrot" | "banana" | "lemon" | "egg");
    sized(|edge| {
        let dense = smooth(profile).map(|p| p * radius * DVec2::new(1.0, tall));
        let points = even(&dense.collect::<Vec<_>>(), edge);
        let lathe = Lathe {
            profile: &points,
            closed: false,
            section: &ridges,
            share: &|at| (at.x / radius).clamp(0.0, 1.0),
            edge,
        };
        let mut mesh = lathe.mesh();
        for v in &mut mesh.vertices {
            v.y *= squash;
            v.x += lean * v.z * (1.0 - 0.2 * (v.y / radius));
            if lying {
                *v = DQuat::from_rotation_y(0.5 * PI) * *v;
            }
            if form == "banana" {
                *v = curled(*v, radius, curl);
            }
        }
        Ok(mesh)
    })
}

/// A fruit along x, curled to both sides of its middle.
fn curled(p: DVec3, radius: f64, curl: f64) -> DVec3 {
    let side = if p.x < 0.0 { -1.0 } else { 1.0 };
    let bow = 7.5 * radius / curl;
    // In the plane of the table: bent in z, then laid down.
    let up = bent(DVec3::new(side * p.x, p.y, p.z), 0.0, bow, 0.5 * TAU);
    DVec3::new(side * up.x, -up.z, up.y)
}

/// A dense smooth line through the points of a profile (Catmull and Rom, 1974), off the axis only
/// at its ends.
fn smooth(profile: Profile) -> impl Iterator<Item = DVec2> {
    const PIECES: usize = 16;
    let at = |k: isize| {
        let last = profile.len() as isize - 1;
        let (x, y) = profile[k.clamp(0, last) as usize];
        // Beyond the ends the line goes on as its mirror image.
        let mirrored = k < 0 || k > last;
        let inner = profile[if k < 0 { 1 } else { profile.len() - 2 }];
        if mirrored {
            DVec2::new(-inner.0, inner.1)
        } else {
            DVec2::new(x, y)
        }
    };
    let count = (profile.len() - 1) * PIECES;
    (0..=count).map(move |n| {
        let (k, t) = ((n / PIECES) as isize, (n % PIECES) as f64 / PIECES as f64);
        let [a, b, c, d] = [-1, 0, 1, 2].map(|step| at(k + step));
        let bend = 2.0 * a - 5.0 * b + 4.0 * c - d;
        let twist = 3.0 * (b - c) + d - a;
        let p = b + 0.5 * t * ((c - a) + t * (bend + t * twist));
        DVec2::new(
            if n == 0 || n == count {
                0.0
            } else {
                p.x.max(4e-3)
            },
            p.y,
        )
    })
}
