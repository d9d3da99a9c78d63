//! Animals and people, as toys.

use glam::{DQuat, DVec3};

use super::draw::Draw;
use super::solid::{Form, Role, Solid};
use gripcast_base::error::Result;
use gripcast_geometry::TriangleMesh;

pub(super) fn draw(draw: &mut Draw) -> Result<TriangleMesh> {
    let form = draw.form([
        "quadruped",
        "bird",
        "person",
        "fish",
        "bear",
        "rabbit",
        "turtle",
    ]);
    let size = draw.between("size_m", 0.05, 0.1);
    let mut body = Figure {
        solid: Solid::new(0.006),
        size,
    };
    match form {
        "bird" => bird(draw, &mut body),
        "person" => person(draw, &mut body),
        "fish" => fish(draw, &mut body),
        "bear" => bear(draw, &mut body, false),
        "rabbit" => bear(draw, &mut body, true),
        "turtle" => turtle(draw, &mut body),
        _ => quadruped(draw, &mut body),
    }
    Ok(body.solid.mesh())
}

/// A body whose measures are parts of its size.
struct Figure {
    solid: Solid,
    size: f64,
}

impl Figure {
    fn ball(&mut self, at: [f64; 3], half: [f64; 3]) {
        let [at, half] = [at, half].map(|p| DVec3::from_array(p) * self.size);
        self.solid.ball(at, half, 0.04 * self.size);
    }

    /// A limb on the left, and its mirror image on the right unless it lies in the middle.
    fn limb(&mut self, from: [f64; 3], to: [f64; 3], radii: [f64; 2]) {
        let radii = radii.map(|r| (r * self.size).max(0.003));
        let ends = [from, to].map(|p| DVec3::from_array(p) * self.size);
        self.solid.limb(ends, radii, 0.04 * self.size);
        if to[1] != 0.0 {
            let mirror = DVec3::new(1.0, -1.0, 1.0);
            let ends = ends.map(|p| p * mirror);
            self.solid.limb(ends, radii, 0.04 * self.size);
        }
    }

    /// Cuts everything off below a height, so that the figure stands.
    fn stand(&mut self, z: f64) {
        let half = DVec3::new(2.0, 2.0, 0.5) * self.size;
        let at = DVec3::Z * (z - 0.5) * self.size;
        let form = Form::Block(half, 0.0);
        self.solid.put(form, at, DQuat::IDENTITY, Role::Cut(0.0));
    }
}

/// Dogs, horses, pigs, elephants: towards +x.
fn quadruped(draw: &mut Draw, body: &mut Figure) {
    let long = draw.between("body", 0.3, 0.42);
    let fat = draw.between("girth", 0.13, 0.24);
    let leg = draw.between("leg", 0.16, 0.36);
    let thick = draw.between("leg_radius", 0.05, 0.075);
    let neck = draw.between("neck", 0.02, 0.3);
    let head = draw.between("head", 0.1, 0.16);
    let snout = draw.between("snout", 0.05, 0.2);
    let ear = draw.between("ear", 0.04, 0.14);
    let tail = draw.between("tail", 0.1, 0.3);
    let spread = (0.65 * fat).max(thick);
    body.ball([0.0, 0.0, 0.0], [long, fat, 1.05 * fat]);
    for x in [-0.68 * long, 0.68 * long] {
        let foot = -0.6 * fat - leg;
        body.limb(
            [x, spread, -0.3 * fat],
            [x, spread, foot],
            [1.15 * thick, thick],
        );
    }
    let top = [long + 0.3 * neck + 0.05, 0.0, 0.5 * fat + neck];
    body.limb([0.7 * long, 0.0, 0.2 * fat], top, [0.7 * fat, 0.75 * head]);
    body.ball(top, [1.15 * head, head, head]);
    let nose = [top[0] + head + snout, 0.0, top[2] - 0.35 * head];
    body.limb(top, nose, [0.75 * head, 0.5 * head]);
    let tip = [
        top[0] - 0.4 * head,
        0.75 * head + 0.3 * ear,
        top[2] + 0.7 * head + ear,
    ];
    body.limb(
        [top[0] - 0.2 * head, 0.55 * head, top[2] + 0.5 * head],
        tip,
        [0.05, 0.045],
    );
    body.limb(
        [-0.9 * long, 0.0, 0.2 * fat],
        [-long - 0.7 * tail, 0.0, 0.2 * fat + 0.6 * tail],
        [0.05, 0.045],
    );
    body.stand(-0.6 * fat - leg - 0.4 * thick);
}

fn bird(draw: &mut Draw, body: &mut Figure) {
    let fat = draw.between("girth", 0.2, 0.28);
    let head = draw.between("head", 0.13, 0.18);
    let beak = draw.between("beak", 0.08, 0.18);
    let neck = draw.between("neck", 0.05, 0.22);
    let tail = draw.between("tail", 0.15, 0.35);
    body.ball([0.0, 0.0, 0.0], [0.36, fat, 0.95 * fat]);
    let top = [0.26, 0.0, 0.7 * fat + neck];
    body.limb([0.15, 0.0, 0.3 * fat], top, [0.65 * fat, 0.8 * head]);
    body.ball(top, [head; 3]);
    body.limb(
        top,
        [top[0] + head + beak, 0.0, top[2] - 0.03],
        [0.06, 0.042],
    );
    body.limb(
        [-0.25, 0.0, 0.05],
        [-0.36 - tail, 0.0, 0.12 + 0.3 * tail],
        [0.13, 0.07],
    );
    let flat = DVec3::new(0.26, 0.05, 0.13) * body.size;
    for side in [-1.0, 1.0] {
        let at = DVec3::new(-0.06, side * 0.95 * fat, 0.04) * body.size;
        let turn = DQuat::from_rotation_y(-0.25);
        let role = Role::Add(0.03 * body.size);
        body.solid.put(Form::Ellipsoid(flat), at, turn, role);
    }
    body.stand(-0.8 * fat);
}

fn person(draw: &mut Draw, body: &mut Figure) {
    let head = draw.between("head", 0.09, 0.15);
    let wide = draw.between("shoulders", 0.13, 0.19);
    let leg = draw.between("legs", 0.2, 0.36);
    let arm = draw.between("arms", 0.2, 0.3);
    let raise = draw.between("arm_angle_rad", -1.2, 1.0);
    let thick = draw.between("limb_radius", 0.05, 0.065);
    let belly = draw.between("belly", 0.1, 0.17);
    body.ball([0.0, 0.0, 0.1], [belly, wide, 0.22]);
    let (sin, cos) = raise.sin_cos();
    let hand = [0.06, wide + arm * cos, 0.22 + arm * sin];
    body.limb([0.0, 0.8 * wide, 0.22], hand, [thick, 0.9 * thick]);
    let hip = 0.55 * wide;
    let foot = -0.08 - leg;
    body.limb(
        [0.0, hip, -0.02],
        [0.0, 1.15 * hip, foot],
        [1.25 * thick, thick],
    );
    body.limb(
        [0.0, 1.15 * hip, foot],
        [0.1, 1.2 * hip, foot],
        [thick, 0.95 * thick],
    );
    body.limb([0.0, 0.0, 0.28], [0.0, 0.0, 0.32 + head], [0.06, 0.06]);
    body.ball([0.0, 0.0, 0.32 + 1.1 * head], [head, head, 1.1 * head]);
    body.stand(foot - 0.5 * thick);
}

/// A fish that lies on its side.
fn fish(draw: &mut Draw, body: &mut Figure) {
    let high = draw.between("height", 0.15, 0.27);
    let thick = draw.between("thickness", 0.1, 0.15);
    let tail = draw.between("tail", 0.12, 0.24);
    let fin = draw.between("fin", 0.08, 0.18);
    body.ball([0.0, 0.0, 0.0], [0.42, high, thick]);
    body.limb([-0.3, 0.0, 0.0], [-0.5, 0.0, 0.0], [0.6 * thick, 0.05]);
    body.limb(
        [-0.46, 0.01, 0.0],
        [-0.5 - 0.7 * tail, tail, 0.0],
        [0.055, 0.045],
    );
    for x in [0.1, 0.0, -0.1] {
        let root = [x, 0.7 * high, 0.0];
        body.limb(root, [x - 0.1, high + fin * (0.7 - x), 0.0], [0.05, 0.042]);
    }
    body.ball([0.4, 0.0, 0.0], [0.07, 0.07, 0.055]);
}

/// A sitting bear, or with long ears a rabbit.
fn bear(draw: &mut Draw, body: &mut Figure, rabbit: bool) {
    let belly = draw.between("belly", 0.2, 0.27);
    let head = draw.between("head", 0.17, 0.23);
    let limb = draw.between("limb_radius", 0.07, 0.09);
    let reach = draw.between("reach", 0.18, 0.3);
    let ear = if rabbit {
        draw.between("ear", 0.22, 0.38)
    } else {
        draw.between("ear", 0.02, 0.06)
    };
    body.ball([0.0, 0.0, 0.0], [0.9 * belly, belly, 1.15 * belly]);
    let top = 1.1 * belly + 0.8 * head;
    body.ball([0.02, 0.0, top], [head, 1.08 * head, head]);
    body.ball(
        [0.02 + 0.9 * head, 0.0, top - 0.25 * head],
        [0.09, 0.09, 0.075],
    );
    let tip = [0.0, 0.65 * head + 0.25 * ear, top + 0.75 * head + ear];
    body.limb(
        [0.0, 0.55 * head, top + 0.6 * head],
        tip,
        if rabbit { [0.06, 0.05] } else { [0.075, 0.075] },
    );
    body.limb(
        [0.05, 0.75 * belly, 0.5 * belly],
        [0.15 + 0.5 * reach, belly + 0.4 * reach, 0.2 * belly],
        [limb, 0.9 * limb],
    );
    let foot = [0.1 + reach, 0.75 * belly + 0.05, -0.85 * belly];
    body.limb([0.0, 0.6 * belly, -0.8 * belly], foot, [1.2 * limb, limb]);
    body.ball([-0.95 * belly, 0.0, -0.5 * belly], [0.08; 3]);
    body.stand(-1.05 * belly);
}

fn turtle(draw: &mut Draw, body: &mut Figure) {
    let high = draw.between("shell", 0.16, 0.26);
    let wide = draw.between("width", 0.26, 0.34);
    let head = draw.between("head", 0.09, 0.13);
    let neck = draw.between("neck", 0.05, 0.14);
    let leg = draw.between("leg", 0.12, 0.22);
    body.ball([0.0, 0.0, 0.0], [0.36, wide, high]);
    let rim = Form::Drum(
        [0.37, 0.34].map(|r| r * body.size),
        0.045 * body.size,
        0.02 * body.size,
    );
    let role = Role::Add(0.02 * body.size);
    body.solid.put(rim, DVec3::ZERO, DQuat::IDENTITY, role);
    let nose = [0.4 + neck + head, 0.0, 0.05];
    body.limb([0.3, 0.0, 0.0], nose, [0.07, 0.07]);
    body.ball(nose, [1.15 * head, head, 0.95 * head]);
    for x in [-0.24, 0.24] {
        let end = [x * 1.4, wide + 0.3 * leg, -0.08 - 0.6 * leg];
        body.limb([x, 0.75 * wide, 0.0], end, [0.085, 0.075]);
    }
    body.limb([-0.3, 0.0, 0.0], [-0.44, 0.0, -0.04], [0.06, 0.045]);
    body.stand(-0.12 - 0.6 * leg);
}
