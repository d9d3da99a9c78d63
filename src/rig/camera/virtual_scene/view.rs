//! What the camera between the fingers sees: a wooden table, the object, two fingers.
//!
//! Camera frame: x right, y down, z forward, metres. The object's frame stands on the table:
//! x right, y away from the camera, z up.

use std::sync::Arc;

use super::grasp::{VirtualGrasp, VirtualObject};
use super::hand::SceneMoment;
use super::random::{NoiseTable, mixed, plane_noise};

type Vec3 = [f64; 3];

/// Downward tilt of the optical axis, rad, and its sine and cosine.
const TILT_SIN: f64 = 0.819_152;
const TILT_COS: f64 = 0.573_576;
/// Distance of the table along the optical axis, m.
const TABLE_M: f64 = 0.30;
/// Where the object stands, m along the table from the optical axis.
const STAND_Y_M: f64 = -0.058;
/// Half the opening of the fingers, m.
const OPEN_M: f64 = 0.047;
/// Largest sway of the picture of the table, pixels.
const SWAY: usize = 6;
/// Direction towards the lamp, object frame.
const LAMP: Vec3 = [-0.45, -0.30, 0.84];
/// Pixels between places where shade is computed.
const SHADE_STEP: usize = 4;
/// Time in which a new object is pushed into view, s.
const ARRIVAL_S: f64 = 0.5;

/// RGB rows and the depth of each pixel in m, before noise.
struct View {
    colour: Vec<u8>,
    depth_m: Vec<f32>,
}

/// A layer with its own size, placed over the picture.
struct Sprite {
    left: i64,
    top: i64,
    width: usize,
    /// RGB, opacity 0–1, depth in m (0: casts shade only).
    pixels: Vec<([f32; 3], f32, f32)>,
}

/// Paints the view at a fixed size.
pub(in crate::rig::camera) struct ViewPainter {
    seed: u64,
    width: usize,
    height: usize,
    focal: f64,
    noise: Arc<NoiseTable>,
    table: Vec<u8>,
    table_depth_m: Vec<f32>,
    object: Option<(u64, Sprite)>,
}

impl ViewPainter {
    /// A painter of `width` × `height` pictures; `zoom` 1 is the camera between the fingers.
    pub(in crate::rig::camera) fn new(
        seed: u64,
        width: usize,
        height: usize,
        zoom: f64,
        noise: Arc<NoiseTable>,
    ) -> Self {
        let mut painter = Self {
            seed: mixed(seed, 0x7669_6577, 0),
            width,
            height,
            focal: 0.94 * zoom * (width as f64).min(height as f64 * 4.0 / 3.0),
            noise,
            table: Vec::new(),
            table_depth_m: Vec::new(),
            object: None,
        };
        painter.paint_table();
        painter
    }

    /// The colour picture at `moment` as RGB rows; `frame` picks the noise.
    pub(in crate::rig::camera) fn paint_colour(
        &mut self,
        moment: &SceneMoment,
        frame: u64,
    ) -> Vec<u8> {
        let mut colour = self.compose(moment).colour;
        self.add_colour_noise(&mut colour, frame);
        colour
    }

    /// The depth picture at `moment`, m; 0 where stereo is blind.
    pub(in crate::rig::camera) fn paint_depth_m(
        &mut self,
        moment: &SceneMoment,
        frame: u64,
    ) -> Vec<f32> {
        let mut depth_m = self.compose(moment).depth_m;
        self.add_depth_noise(&mut depth_m, frame);
        depth_m
    }

    fn compose(&mut self, moment: &SceneMoment) -> View {
        let sprite = match self.object.take() {
            Some((number, sprite)) if number == moment.grasp.number => sprite,
            _ => self.object_sprite(&moment.grasp),
        };
        let calm = 1.0 - 0.7 * moment.closure;
        let sway = |rate: f64, phase: f64| {
            let angle = moment.time_s * rate + phase;
            (calm * SWAY as f64 * 0.5 * (angle.sin() + (0.37 * angle).sin())).round() as i64
        };
        let (sway_x, sway_y) = (sway(0.9, 0.0), sway(0.7, 1.3));
        let mut view = self.table_at(sway_x, sway_y);
        let arrival = (1.0 - moment.placed_for_s / ARRIVAL_S)
            .clamp(0.0, 1.0)
            .powi(2);
        let slide = (arrival * self.width as f64).round() as i64;
        self.draw_sprite(&mut view, &sprite, sway_x + slide, sway_y);
        self.object = Some((moment.grasp.number, sprite));
        self.draw_fingers(&mut view, moment);
        view
    }

    fn ray(&self, column: f64, row: f64) -> Vec3 {
        [
            (column + 0.5 - 0.5 * self.width as f64) / self.focal,
            (row + 0.5 - 0.5 * self.height as f64) / self.focal,
            1.0,
        ]
    }

    fn paint_table(&mut self) {
        let (wide, high) = (self.width + 2 * SWAY, self.height + 2 * SWAY);
        self.table = Vec::with_capacity(3 * wide * high);
        self.table_depth_m = Vec::with_capacity(wide * high);
        for row in 0..high {
            for column in 0..wide {
                let ray = self.ray(column as f64 - SWAY as f64, row as f64 - SWAY as f64);
                let (depth_m, [x, y, _]) = on_table(ray);
                let radius = ray[0].hypot(ray[1]);
                let light = (1.0 - 0.22 * radius * radius) * (1.02 - 0.9 * (x + 0.4 * y));
                for level in wood(self.seed, x, y) {
                    self.table
                        .push((level * light).round().clamp(0.0, 255.0) as u8);
                }
                self.table_depth_m.push(depth_m as f32);
            }
        }
    }

    fn table_at(&self, sway_x: i64, sway_y: i64) -> View {
        let wide = self.width + 2 * SWAY;
        let place = |sway: i64| (SWAY as i64 - sway).clamp(0, 2 * SWAY as i64) as usize;
        let (left, top) = (place(sway_x), place(sway_y));
        let mut colour = Vec::with_capacity(3 * self.width * self.height);
        let mut depth_m = Vec::with_capacity(self.width * self.height);
        for row in 0..self.height {
            let start = (row + top) * wide + left;
            colour.extend_from_slice(&self.table[3 * start..3 * (start + self.width)]);
            depth_m.extend_from_slice(&self.table_depth_m[start..start + self.width]);
        }
        View { colour, depth_m }
    }

    /// Marches rays through the object's surroundings; its shade on the table is part of it.
    fn object_sprite(&self, grasp: &VirtualGrasp) -> Sprite {
        let stand: Vec3 = [grasp.aside_m, STAND_Y_M, 0.0];
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for corner in 0..8 {
            let pick =
                |bit: usize, low: f64, high: f64| if corner >> bit & 1 == 0 { low } else { high };
            let point = to_camera([
                stand[0] + pick(0, -0.085, 0.10),
                stand[1] + pick(1, -0.075, 0.09),
                pick(2, 0.0, 0.12),
            ]);
            let centre = [0.5 * self.width as f64, 0.5 * self.height as f64];
            for axis in 0..2 {
                let at = centre[axis] + self.focal * point[axis] / point[2];
                low[axis] = low[axis].min(at);
                high[axis] = high[axis].max(at);
            }
        }
        let clip = |at: f64, size: usize| at.clamp(-0.3 * size as f64, 1.3 * size as f64);
        let left = clip(low[0], self.width).floor() as i64;
        let top = clip(low[1], self.height).floor() as i64;
        let width = (clip(high[0], self.width).ceil() as i64 - left).max(1) as usize;
        let height = (clip(high[1], self.height).ceil() as i64 - top).max(1) as usize;
        // Shade is soft: every fourth pixel is enough.
        let coarse = width / SHADE_STEP + 2;
        let ray = |column: usize, row: usize| {
            self.ray((left + column as i64) as f64, (top + row as i64) as f64)
        };
        let shades: Vec<f32> = (0..coarse * (height / SHADE_STEP + 2))
            .map(|cell| {
                let ray = ray(cell % coarse * SHADE_STEP, cell / coarse * SHADE_STEP);
                table_shade(grasp.object, minus(on_table(ray).1, stand)) as f32
            })
            .collect();
        let shade_at = |column: usize, row: usize| {
            let cell = row / SHADE_STEP * coarse + column / SHADE_STEP;
            let share = |at: usize| (at % SHADE_STEP) as f32 / SHADE_STEP as f32;
            let (right, down) = (share(column), share(row));
            let mix = |a: f32, b: f32, t: f32| a + t * (b - a);
            let upper = mix(shades[cell], shades[cell + 1], right);
            let lower = mix(shades[cell + coarse], shades[cell + coarse + 1], right);
            mix(upper, lower, down)
        };
        let mut pixels = Vec::with_capacity(width * height);
        for row in 0..height {
            for column in 0..width {
                let ray = ray(column, row);
                let (colour, cover, depth_m) = march(grasp.object, stand, ray, 1.0 / self.focal);
                let shade = shade_at(column, row);
                pixels.push(if cover > 0.0 {
                    (colour, cover, depth_m)
                } else {
                    (colour, shade, 0.0)
                });
            }
        }
        Sprite {
            left,
            top,
            width,
            pixels,
        }
    }

    fn draw_sprite(&self, view: &mut View, sprite: &Sprite, shift_x: i64, shift_y: i64) {
        for (row, line) in sprite.pixels.chunks_exact(sprite.width).enumerate() {
            let y = sprite.top + row as i64 + shift_y;
            if y < 0 || y >= self.height as i64 {
                continue;
            }
            for (column, (colour, opacity, depth_m)) in line.iter().enumerate() {
                let x = sprite.left + column as i64 + shift_x;
                if *opacity <= 0.0 || x < 0 || x >= self.width as i64 {
                    continue;
                }
                let at = y as usize * self.width + x as usize;
                blend(&mut view.colour[3 * at..3 * at + 3], *colour, *opacity);
                if *depth_m > 0.0 && *opacity > 0.5 {
                    view.depth_m[at] = *depth_m;
                }
            }
        }
    }

    fn draw_fingers(&self, view: &mut View, moment: &SceneMoment) {
        let closed_m = moment.grasp.object.half_width_m() - 0.001;
        let gap_m = OPEN_M + moment.closure * (closed_m - OPEN_M);
        for side in [-1.0, 1.0] {
            let mut faces = finger_faces(side, gap_m);
            faces.sort_by(|a, b| b.farthest_m().total_cmp(&a.farthest_m()));
            for face in &faces {
                self.draw_face(view, face);
            }
        }
    }

    /// Fills a convex quadrilateral with soft edges; texture coordinates follow its first edge.
    fn draw_face(&self, view: &mut View, face: &Face) {
        let centre = [0.5 * self.width as f64, 0.5 * self.height as f64];
        let spots = face
            .corners
            .map(|point| [0, 1].map(|axis| centre[axis] + self.focal * point[axis] / point[2]));
        let area: f64 = (0..4)
            .map(|n| {
                let (a, b) = (spots[n], spots[(n + 1) % 4]);
                a[0] * b[1] - b[0] * a[1]
            })
            .sum();
        // Only faces that turn towards the camera; their corners run clockwise on screen.
        if area <= 0.0 {
            return;
        }
        let bound = |axis: usize, size: usize| {
            let low = spots
                .iter()
                .map(|spot| spot[axis])
                .fold(f64::INFINITY, f64::min);
            let high = spots
                .iter()
                .map(|spot| spot[axis])
                .fold(f64::NEG_INFINITY, f64::max);
            let clip = |at: f64| at.clamp(0.0, size as f64) as usize;
            clip(low - 1.0)..clip(high + 2.0)
        };
        let edges: Vec<[f64; 3]> = (0..4)
            .map(|n| {
                let (a, b) = (spots[n], spots[(n + 1) % 4]);
                let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
                let length = dx.hypot(dy).max(1e-9);
                let normal = [-dy / length, dx / length];
                [normal[0], normal[1], -(normal[0] * a[0] + normal[1] * a[1])]
            })
            .collect();
        let [origin, along, across] = [
            face.corners[0],
            minus(face.corners[1], face.corners[0]),
            minus(face.corners[3], face.corners[0]),
        ];
        let normal = cross(along, across);
        let reach = dot(normal, origin);
        for row in bound(1, self.height) {
            for column in bound(0, self.width) {
                let (x, y) = (column as f64 + 0.5, row as f64 + 0.5);
                let inside = edges
                    .iter()
                    .map(|edge| edge[0] * x + edge[1] * y + edge[2])
                    .fold(f64::INFINITY, f64::min);
                let cover = (inside + 0.5).clamp(0.0, 1.0);
                if cover <= 0.0 {
                    continue;
                }
                let ray = self.ray(column as f64, row as f64);
                let depth_m = reach / dot(normal, ray);
                let offset = minus(ray.map(|value| value * depth_m), origin);
                let u = dot(offset, along) / dot(along, along);
                let v = dot(offset, across) / dot(across, across);
                let at = row * self.width + column;
                let colour = face.colour(u.clamp(0.0, 1.0), v.clamp(0.0, 1.0));
                blend(&mut view.colour[3 * at..3 * at + 3], colour, cover as f32);
                if cover > 0.5 {
                    view.depth_m[at] = depth_m as f32;
                }
            }
        }
    }

    fn add_colour_noise(&self, colour: &mut [u8], frame: u64) {
        let row_bytes = 3 * self.width;
        for (row, line) in colour.chunks_exact_mut(row_bytes).enumerate() {
            let noise = self.noise.row(self.seed, frame, row, row_bytes);
            for (level, noise) in line.iter_mut().zip(noise) {
                *level = level.saturating_add_signed(*noise);
            }
        }
    }

    /// Stereo depth is noisy by a share of the distance and blind beside nearer edges.
    fn add_depth_noise(&self, depth_m: &mut [f32], frame: u64) {
        for (row, line) in depth_m.chunks_exact_mut(self.width).enumerate() {
            let noise = self.noise.row(self.seed ^ 1, frame, row, self.width);
            let mut blind = 0;
            let mut nearer_m = 0.0;
            for (depth_m, noise) in line.iter_mut().zip(noise).rev() {
                let true_m = *depth_m;
                if nearer_m > 0.0 && true_m > nearer_m + 0.02 {
                    blind = (self.width as f32 * 0.0035 * (true_m / nearer_m)) as usize + 2;
                }
                nearer_m = true_m;
                if blind > 0 {
                    blind -= 1;
                    *depth_m = 0.0;
                } else {
                    *depth_m *= 1.0 + 0.0012 * f32::from(*noise);
                }
            }
        }
    }
}

fn blend(pixel: &mut [u8], colour: [f32; 3], opacity: f32) {
    for (level, colour) in pixel.iter_mut().zip(colour) {
        let below = f32::from(*level);
        *level = (below + opacity * (colour - below) + 0.5) as u8;
    }
}

fn dot(a: Vec3, b: Vec3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn minus(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn cross(a: Vec3, b: Vec3) -> Vec3 {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

fn normalized(v: Vec3) -> Vec3 {
    let length = dot(v, v).sqrt().max(1e-12);
    v.map(|value| value / length)
}

/// Point of the table's frame (origin under the optical axis) in camera coordinates.
fn to_camera([x, y, z]: Vec3) -> Vec3 {
    [
        x,
        -TILT_SIN * y - TILT_COS * z,
        TABLE_M + TILT_COS * y - TILT_SIN * z,
    ]
}

/// Direction of the camera's frame in the table's frame.
fn to_table([x, y, z]: Vec3) -> Vec3 {
    [
        x,
        -TILT_SIN * y + TILT_COS * z,
        -TILT_COS * y - TILT_SIN * z,
    ]
}

/// Camera's place in the table's frame.
fn eye() -> Vec3 {
    to_table([0.0, 0.0, -TABLE_M])
}

/// Depth along the optical axis and point where a ray meets the table.
fn on_table(ray: Vec3) -> (f64, Vec3) {
    let direction = to_table(ray);
    let eye = eye();
    let depth = (-eye[2] / direction[2].min(-0.05)).min(4.0);
    (
        depth,
        [
            eye[0] + depth * direction[0],
            eye[1] + depth * direction[1],
            0.0,
        ],
    )
}

/// Planks along y with grain, joints and knots.
fn wood(seed: u64, x: f64, y: f64) -> [f64; 3] {
    const PLANK_M: f64 = 0.085;
    let plank = (x / PLANK_M + 0.37).floor();
    let inside = x / PLANK_M + 0.37 - plank;
    let own = mixed(seed, 11, plank as i64 as u64);
    let tone = (own >> 40) as f64 / (1_u64 << 24) as f64;
    let bend = 0.006 * plane_noise(own, x * 18.0, y * 5.0);
    let rings = ((x + bend) * 420.0 + 3.0 * plane_noise(own, x * 30.0, y * 3.0)).sin();
    let fibre = plane_noise(own, x * 900.0, y * 28.0);
    let joint = if !(0.012..=0.992).contains(&inside) {
        0.55
    } else {
        1.0
    };
    let level = (0.86 + 0.16 * tone + 0.045 * rings + 0.04 * fibre) * joint;
    [186.0 * level, 146.0 * level, 104.0 * level]
}

/// One pixel of the object: colour, opacity and depth.
fn march(object: VirtualObject, stand: Vec3, ray: Vec3, pixel: f64) -> ([f32; 3], f32, f32) {
    const MIDDLE: Vec3 = [0.0, 0.0, 0.045];
    const REACH_M: f64 = 0.068;
    let direction = to_table(ray);
    let origin = minus(eye(), stand);
    let scale = dot(direction, direction).sqrt();
    let at = |depth: f64| [0, 1, 2].map(|n| origin[n] + depth * direction[n]);
    let table_m = on_table(ray).0;
    let on_table_only = ([18.0, 12.0, 8.0], 0.0, 0.0);
    // Rays that pass the ball around every object need no marching.
    let to_middle = minus(MIDDLE, origin);
    let halfway = dot(to_middle, direction) / (scale * scale);
    let beside = minus(at(halfway), MIDDLE);
    let half_chord = (REACH_M * REACH_M - dot(beside, beside)).max(0.0).sqrt() / scale;
    if half_chord == 0.0 {
        return on_table_only;
    }
    let mut depth = halfway - half_chord;
    let end = table_m.min(halfway + half_chord);
    let mut nearest = (f64::INFINITY, depth);
    let mut hit = false;
    for _ in 0..48 {
        let distance = distance_m(object, at(depth));
        let width = distance / (pixel * depth);
        if width < nearest.0 {
            nearest = (width, depth);
        }
        hit = width < 0.2;
        depth += distance / scale;
        if hit || depth > end {
            break;
        }
    }
    let cover = if hit {
        1.0
    } else {
        (0.75 - nearest.0).clamp(0.0, 1.0)
    };
    if cover <= 0.0 || nearest.1 > table_m {
        return on_table_only;
    }
    let point = at(nearest.1);
    let normal = normal_at(object, point);
    let lit = dot(normal, normalized(LAMP)).max(0.0);
    let half = normalized(minus(normalized(LAMP), normalized(direction)));
    let shine = dot(normal, half).max(0.0).powi(40);
    let sky = 0.5 + 0.5 * normal[2];
    let low = (point[2] / 0.02).clamp(0.0, 1.0);
    let light = (0.34 + 0.20 * sky) * (0.6 + 0.4 * low) + 0.62 * lit;
    let (base, gloss) = paint_of(object, point, normal);
    let colour = base.map(|level| (level * light + gloss * shine).clamp(0.0, 255.0) as f32);
    (colour, cover as f32, nearest.1 as f32)
}

/// Opacity of the object's shade on the table: soft contact shade and a shadow off the lamp.
fn table_shade(object: VirtualObject, ground: Vec3) -> f64 {
    let lifted = [ground[0], ground[1], 0.004];
    let contact = 0.55 * (-distance_m(object, lifted).max(0.0) / 0.009).exp();
    let mut nearest = f64::INFINITY;
    for step in 1..14 {
        let height = 0.008 * f64::from(step);
        let point = [
            ground[0] + LAMP[0] / LAMP[2] * height,
            ground[1] + LAMP[1] / LAMP[2] * height,
            height,
        ];
        nearest = nearest.min(distance_m(object, point) / height.max(0.01));
    }
    let shadow = 0.42 * (1.0 - nearest / 0.22).clamp(0.0, 1.0);
    (contact + shadow * (1.0 - contact)).min(0.8)
}

fn normal_at(object: VirtualObject, point: Vec3) -> Vec3 {
    const STEP_M: f64 = 2e-4;
    let along = |axis: usize| {
        let (mut ahead, mut behind) = (point, point);
        ahead[axis] += STEP_M;
        behind[axis] -= STEP_M;
        distance_m(object, ahead) - distance_m(object, behind)
    };
    normalized([along(0), along(1), along(2)])
}

/// Signed distance to the object's surface, m.
fn distance_m(object: VirtualObject, [x, y, z]: Vec3) -> f64 {
    let radial = x.hypot(y);
    // Upright cylinder from `low` to `high` with rounded edges.
    let cylinder = |radius: f64, low: f64, high: f64, round: f64| {
        let side = radial - radius + round;
        let end = (z - 0.5 * (low + high)).abs() - 0.5 * (high - low) + round;
        side.max(end).min(0.0) + side.max(0.0).hypot(end.max(0.0)) - round
    };
    match object {
        VirtualObject::Mug => {
            let ribs = 0.0006 * (z * 1500.0).sin() * f64::from(u8::from(z < 0.066));
            let body = cylinder(0.030 + ribs, 0.0, 0.078, 0.003);
            let inside = cylinder(0.0265, 0.006, 0.20, 0.002);
            let (hx, hz) = ((y + 0.030).abs(), (z - 0.040) * 0.85);
            let handle = (hx.hypot(hz) - 0.019).hypot(x) - 0.0045;
            body.max(-inside).min(handle.max(0.027 - radial))
        }
        VirtualObject::TapeRoll => {
            cylinder(0.036, 0.0, 0.048, 0.001).max(-cylinder(0.026, -0.1, 0.2, 0.001))
        }
        VirtualObject::Carton => {
            let (dx, dy, dz) = (
                x.abs() - 0.0225,
                y.abs() - 0.0285,
                (z - 0.040).abs() - 0.0385,
            );
            dx.max(dy).max(dz).min(0.0) + dx.max(0.0).hypot(dy.max(0.0)).hypot(dz.max(0.0)) - 0.0015
        }
        VirtualObject::Ball => radial.hypot(z - 0.030) - 0.030,
        VirtualObject::Bottle => {
            let body = cylinder(0.026, 0.0, 0.066, 0.006);
            let knurl = 0.0007 * (y.atan2(x) * 36.0).sin();
            let cap = cylinder(0.017 + knurl, 0.064, 0.090, 0.0015);
            body.min(cap) * 0.8
        }
        VirtualObject::Bolt => {
            let hex = (0..3)
                .map(|n| {
                    let angle = f64::from(n) * std::f64::consts::FRAC_PI_3;
                    (x * angle.cos() + y * angle.sin()).abs() - 0.021
                })
                .fold(f64::NEG_INFINITY, f64::max);
            let head = hex.max((z - 0.008).abs() - 0.008);
            let turn = y.atan2(x) / std::f64::consts::TAU;
            let thread = 0.0011 * ((z / 0.0045 + turn) * std::f64::consts::TAU).sin();
            head.min(cylinder(0.012 + thread, 0.014, 0.082, 0.002) * 0.6)
        }
    }
}

/// Colour (0–255) and strength of the highlight at a point of the surface.
fn paint_of(object: VirtualObject, [x, y, z]: Vec3, normal: Vec3) -> (Vec3, f64) {
    let radial = x.hypot(y);
    match object {
        VirtualObject::Mug if radial < 0.0285 => ([236.0, 232.0, 222.0], 20.0),
        VirtualObject::Mug if (0.050..0.058).contains(&z) => ([240.0, 236.0, 226.0], 80.0),
        VirtualObject::Mug => ([44.0, 96.0, 168.0], 90.0),
        VirtualObject::TapeRoll if radial < 0.0285 => ([158.0, 124.0, 86.0], 5.0),
        VirtualObject::TapeRoll if normal[2] > 0.7 => {
            let layer = 8.0 * (radial * 9000.0).sin();
            ([214.0 + layer, 176.0 + layer, 92.0 + layer], 30.0)
        }
        VirtualObject::TapeRoll => ([222.0, 186.0, 98.0], 90.0),
        VirtualObject::Carton => {
            let label = normal[2] < 0.5 && (0.020..0.052).contains(&z);
            let band = normal[2] > 0.5 && y.abs() < 0.010;
            if label || band {
                ([242.0, 238.0, 228.0], 10.0)
            } else {
                ([196.0, 58.0, 46.0], 12.0)
            }
        }
        VirtualObject::Ball => {
            let seam = (x * 1.4 + 0.012 * (z * 160.0).sin()).abs() < 0.0014;
            if seam {
                ([236.0, 238.0, 214.0], 5.0)
            } else {
                ([176.0, 204.0, 54.0], 8.0)
            }
        }
        VirtualObject::Bottle if z > 0.065 => ([46.0, 132.0, 86.0], 50.0),
        VirtualObject::Bottle if (0.016..0.048).contains(&z) => ([88.0, 172.0, 126.0], 30.0),
        VirtualObject::Bottle => ([238.0, 240.0, 240.0], 90.0),
        VirtualObject::Bolt => ([150.0, 154.0, 160.0], 170.0),
    }
}

/// A flat side of a finger.
struct Face {
    /// Clockwise as the camera sees it.
    corners: [Vec3; 4],
    base: [f64; 3],
    /// Brightness at the far and near end of the first edge.
    light: [f64; 2],
    is_gel: bool,
}

impl Face {
    fn farthest_m(&self) -> f64 {
        self.corners.iter().map(|corner| corner[2]).sum::<f64>() / 4.0
    }

    fn colour(&self, u: f64, v: f64) -> [f32; 3] {
        let light = self.light[0] + u * (self.light[1] - self.light[0]);
        if self.is_gel {
            // The coloured lamps shine through the edge of the gel.
            let glow = [
                92.0 + 70.0 * (1.0 - u) * (1.0 - (2.0 * v - 1.0).powi(2)),
                128.0 + 22.0 * v,
                138.0 + 30.0 * (1.0 - v),
            ];
            return glow.map(|level| (level * light) as f32);
        }
        let bevel = 1.0 + 0.25 * (-(v.min(1.0 - v) / 0.03).powi(2)).exp();
        self.base
            .map(|level| (level * light * bevel).min(255.0) as f32)
    }
}

/// Faces of one finger (`side` −1 left, +1 right) whose gel is `gap_m` from the middle.
fn finger_faces(side: f64, gap_m: f64) -> Vec<Face> {
    const GEL: [f64; 3] = [0.0; 3];
    const HOUSING: [f64; 3] = [74.0, 76.0, 82.0];
    const ARM: [f64; 3] = [112.0, 114.0, 118.0];
    const BRACKET: [f64; 3] = [214.0, 108.0, 40.0];
    let mut faces = Vec::new();
    let mut boxed = |inner: f64, outer: f64, y: [f64; 2], z: [f64; 2], base: [f64; 3]| {
        let (inner, outer) = (side * inner, side * outer);
        let is_gel = base == GEL;
        let (far, near) = (z[1], z[0]);
        let mut quad = |corners: [Vec3; 4], light: [f64; 2]| {
            // Mirrored fingers have mirrored winding.
            let corners = if side < 0.0 {
                corners
            } else {
                [corners[1], corners[0], corners[3], corners[2]]
            };
            faces.push(Face {
                corners,
                base,
                light,
                is_gel,
            });
        };
        // Inner side, facing the object.
        quad(
            [
                [inner, y[0], far],
                [inner, y[0], near],
                [inner, y[1], near],
                [inner, y[1], far],
            ],
            if side < 0.0 {
                [0.72, 0.50]
            } else {
                [0.98, 0.74]
            },
        );
        // Upper side.
        quad(
            [
                [outer, y[0], far],
                [outer, y[0], near],
                [inner, y[0], near],
                [inner, y[0], far],
            ],
            [1.12, 0.98],
        );
        // Back, facing the camera.
        quad(
            [
                [outer, y[0], near],
                [inner, y[0], near],
                [inner, y[1], near],
                [outer, y[1], near],
            ],
            if side < 0.0 {
                [0.80, 0.88]
            } else {
                [0.74, 0.66]
            },
        );
        // Outer side.
        quad(
            [
                [outer, y[0], near],
                [outer, y[0], far],
                [outer, y[1], far],
                [outer, y[1], near],
            ],
            [0.6, 0.5],
        );
    };
    boxed(
        gap_m + 0.022,
        gap_m + 0.034,
        [0.016, 0.046],
        [0.055, 0.214],
        ARM,
    );
    boxed(
        gap_m + 0.004,
        gap_m + 0.026,
        [0.008, 0.042],
        [0.186, 0.226],
        HOUSING,
    );
    boxed(
        gap_m + 0.004,
        gap_m + 0.027,
        [0.008, 0.043],
        [0.178, 0.187],
        BRACKET,
    );
    boxed(gap_m, gap_m + 0.0045, [0.011, 0.039], [0.192, 0.223], GEL);
    faces
}

#[cfg(test)]
mod tests {
    use super::*;

    fn painter() -> ViewPainter {
        ViewPainter::new(1, 320, 240, 1.0, Arc::new(NoiseTable::new(1, 1.5)))
    }

    fn moment(number: u64, closure: f64) -> SceneMoment {
        SceneMoment {
            closure,
            grasp: VirtualGrasp::new(1, number),
            placed_for_s: 5.0,
            time_s: 3.0,
        }
    }

    #[test]
    fn camera_and_table_frames_agree() {
        for ray in [[0.0, 0.0, 1.0], [0.3, -0.2, 1.0], [-0.4, 0.35, 1.0]] {
            let (depth_m, point) = on_table(ray);
            let back = to_camera(point);
            for axis in 0..3 {
                assert!((back[axis] - ray[axis] * depth_m).abs() < 1e-6);
            }
        }
        assert!((on_table([0.0, 0.0, 1.0]).0 - TABLE_M).abs() < 1e-5);
    }

    #[test]
    fn depth_shows_table_object_and_fingers_in_order() {
        let depth_m = painter().paint_depth_m(&moment(0, 0.0), 1);
        let valid: Vec<f32> = depth_m.iter().copied().filter(|m| *m > 0.0).collect();
        assert!(valid.len() > depth_m.len() * 85 / 100, "{}", valid.len());
        let nearest = valid.iter().copied().fold(f32::INFINITY, f32::min);
        let farthest = valid.iter().copied().fold(0.0, f32::max);
        assert!((0.05..0.2).contains(&nearest), "{nearest}");
        assert!((0.3..0.6).contains(&farthest), "{farthest}");
    }

    #[test]
    fn closing_moves_the_fingers_and_another_object_changes_the_picture() {
        let mut painter = painter();
        let changed = |a: &[u8], b: &[u8]| {
            let moved = |(a, b): (&u8, &u8)| a.abs_diff(*b) > 20;
            a.iter().zip(b).filter(|pair| moved(*pair)).count()
        };
        let open = painter.paint_colour(&moment(0, 0.0), 1);
        let again = painter.paint_colour(&moment(0, 0.0), 2);
        let closed = painter.paint_colour(&moment(0, 1.0), 3);
        let other = painter.paint_colour(&moment(2, 0.0), 4);
        assert_eq!(changed(&open, &again), 0);
        assert!(changed(&open, &closed) > 5_000);
        assert!(changed(&open, &other) > 2_000);
    }
}
