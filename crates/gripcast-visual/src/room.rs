//! Environment map of a room: lamps, windows, walls and furniture seen from the middle of a table.
//!
//! The walls get a rough estimate of the indirect light (the emitted power spread evenly, darker in
//! the corners), enough for plausible reflections and soft light.

use std::f32::consts::TAU;

use glam::Vec3;

use super::env_map::light_of_kelvin;
use super::linear_image::Image;
use super::sky::map_from_fn;
use gripcast_base::random::SeedStream;

/// Emitting or painted rectangle on a face of the room.
struct Panel {
    face: Face,
    /// Centre in the coordinates of the face, m.
    centre: [f32; 2],
    /// Half extent in the coordinates of the face, m.
    half: [f32; 2],
    /// Radiance of an emitter, albedo of a painted panel.
    colour: [f32; 3],
    emits: bool,
    /// Window panes along both axes; 1 × 1 has no bars.
    panes: [u32; 2],
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Face {
    Floor,
    Ceiling,
    /// Wall at the end of a room axis: +x, +y, −x, −y.
    Wall(u8),
}

/// Box-shaped room around the viewer.
pub(super) struct Room {
    /// Half width along x and y, m.
    half: [f32; 2],
    /// Heights of the viewer (the table) and of the ceiling above the floor, m.
    heights: [f32; 2],
    /// Rotation of the room about z, rad.
    yaw_rad: f32,
    ceiling: [f32; 3],
    walls: [[f32; 3]; 4],
    floor: [f32; 3],
    /// Radiance of a white wall.
    ambient: [f32; 3],
    panels: Vec<Panel>,
}

impl Room {
    /// Room with lamps on the ceiling.
    pub(super) fn with_lamps(stream: &mut SeedStream) -> Self {
        let mut room = Self::bare(stream);
        let light = light_of_kelvin(stream.between(2900.0, 6000.0) as f32);
        let level = stream.between_log(12.0, 45.0) as f32;
        let [columns, rows] = [stream.pick([1, 2, 3]), stream.pick([1, 2])];
        // Square panels, long tubes, or small spots.
        let half = stream.pick([[0.3, 0.3], [0.6, 0.08], [0.6, 0.15], [0.12, 0.12]]);
        let shift = [
            stream.between(-0.6, 0.6) as f32,
            stream.between(-0.6, 0.6) as f32,
        ];
        let has_dead_lamp = stream.uniform() < 0.3;
        let dead_lamp = stream.index(columns * rows);
        for k in 0..columns * rows {
            let cell = |k: usize, count: usize| (k as f32 + 0.5) / count as f32 - 0.5;
            let position = [cell(k % columns, columns), cell(k / columns, rows)];
            let emits = !(has_dead_lamp && columns * rows > 1 && k == dead_lamp);
            room.panels.push(Panel {
                face: Face::Ceiling,
                centre: [0, 1].map(|a| 1.6 * room.half[a] * position[a] + shift[a]),
                half,
                colour: if emits {
                    light.map(|l| level * l)
                } else {
                    [0.85; 3]
                },
                emits,
                panes: [1, 1],
            });
        }
        room.furnish(stream);
        room.set_ambient(light, 0.35);
        room
    }

    /// Room with windows in one or two walls, lamps off or dim.
    pub(super) fn with_windows(stream: &mut SeedStream) -> Self {
        let mut room = Self::bare(stream);
        let daylight = light_of_kelvin(stream.between(5500.0, 8500.0) as f32);
        let level = stream.between_log(6.0, 30.0) as f32;
        let wall = stream.index(4) as u8;
        let is_corner = stream.uniform() < 0.4;
        let walls = if is_corner {
            vec![wall, (wall + 1) % 4]
        } else {
            vec![wall]
        };
        for wall in walls {
            let count = stream.pick([1_usize, 2, 3]);
            let width = 2.0 * room.half[usize::from(wall % 2 == 0)];
            let pitch = width / count as f32;
            let half = [pitch * stream.between(0.25, 0.42) as f32, 0.65];
            let panes = [stream.pick([1, 2, 3]), stream.pick([1, 2])];
            for k in 0..count {
                room.panels.push(Panel {
                    face: Face::Wall(wall),
                    centre: [pitch * (k as f32 + 0.5) - 0.5 * width, 1.55],
                    half,
                    colour: daylight.map(|l| level * l),
                    emits: true,
                    panes,
                });
            }
        }
        room.furnish(stream);
        room.set_ambient(daylight, 0.3);
        room
    }

    fn bare(stream: &mut SeedStream) -> Self {
        let paint = |stream: &mut SeedStream, low: f64, high: f64, tint: f64| {
            let grey = stream.between(low, high);
            [0; 3].map(|_| (grey * (1.0 + stream.between(-tint, tint))) as f32)
        };
        let wall = paint(stream, 0.45, 0.8, 0.08);
        let mut walls = [wall; 4];
        if stream.uniform() < 0.35 {
            walls[stream.index(4)] = paint(stream, 0.15, 0.6, 0.4);
        }
        Self {
            half: [
                stream.between(1.6, 4.5) as f32,
                stream.between(1.6, 4.5) as f32,
            ],
            heights: [
                stream.between(0.7, 0.95) as f32,
                stream.between(2.4, 3.4) as f32,
            ],
            yaw_rad: stream.between(0.0, f64::from(TAU)) as f32,
            ceiling: paint(stream, 0.7, 0.88, 0.03),
            walls,
            floor: paint(stream, 0.1, 0.45, 0.2),
            ambient: [0.0; 3],
            panels: Vec::new(),
        }
    }

    /// Adds cupboards, shelves, doors and pictures: dark and coloured rectangles on the walls.
    fn furnish(&mut self, stream: &mut SeedStream) {
        for wall in 0..4_u8 {
            let half_width = self.half[usize::from(wall % 2 == 0)];
            for _ in 0..stream.pick([1_usize, 2, 3]) {
                let height = stream.pick([0.45, 0.6, 1.0]) as f32;
                let half = [stream.between(0.2, 0.8) as f32, height];
                let grey = stream.between_log(0.04, 0.7);
                let colour = [0; 3].map(|_| (grey * (1.0 + stream.between(-0.35, 0.35))) as f32);
                self.panels.push(Panel {
                    face: Face::Wall(wall),
                    centre: [
                        stream.between(-0.8, 0.8) as f32 * half_width,
                        // On the floor or at eye level.
                        if stream.uniform() < 0.7 { height } else { 1.6 },
                    ],
                    half: if half[1] > 0.9 { [0.45, 1.0] } else { half },
                    colour: colour.map(|c| c.min(0.85)),
                    emits: false,
                    panes: [1, 1],
                });
            }
        }
    }

    /// Sets the radiance of a white wall: the emitted power spread over all faces, plus multiple
    /// reflections.
    fn set_ambient(&mut self, light: [f32; 3], fraction: f32) {
        let [a, b] = self.half;
        let height = self.heights[1];
        let area = 8.0 * a * b + 4.0 * (a + b) * height;
        let emitted: f32 = self
            .panels
            .iter()
            .filter(|panel| panel.emits)
            .map(|panel| 4.0 * panel.half[0] * panel.half[1] * panel.colour[1])
            .sum();
        // A wall reflects about half of the light: twice the first reflection.
        let level = 2.0 * emitted / area + 0.02 * fraction;
        self.ambient = light.map(|l| level * (0.85 + 0.15 * l));
    }

    /// Renders the environment map of the room with `height` rows.
    pub(super) fn env_map(&self, height: usize) -> Image {
        map_from_fn(height, |direction| self.radiance(direction))
    }

    /// Returns the radiance from a world direction.
    fn radiance(&self, direction: Vec3) -> [f32; 3] {
        let (sin, cos) = self.yaw_rad.sin_cos();
        let d = Vec3::new(
            cos * direction.x + sin * direction.y,
            cos * direction.y - sin * direction.x,
            direction.z,
        );
        let (face, position, edge_distance) = self.hit(d);
        let paint = match face {
            Face::Floor => self.floor,
            Face::Ceiling => self.ceiling,
            Face::Wall(wall) => self.walls[usize::from(wall)],
        };
        let corner = 1.0 - 0.35 * (-edge_distance / 0.25).exp();
        let lit: [f32; 3] = std::array::from_fn(|c| paint[c] * self.ambient[c] * corner);
        // Later panels occlude earlier ones; windows and lamps occlude all others.
        let mut radiance = lit;
        for panel in self.panels.iter().filter(|panel| panel.face == face) {
            let Some(is_frame) = panel.coverage(position) else {
                continue;
            };
            if panel.emits && !is_frame {
                return panel.colour;
            }
            let colour = if is_frame { [0.7; 3] } else { panel.colour };
            radiance = std::array::from_fn(|c| colour[c] * self.ambient[c] * corner);
        }
        radiance
    }

    /// Returns the face that a ray hits, the position on it (along the wall, above the floor; m)
    /// and the distance from its nearest edge, m.
    fn hit(&self, d: Vec3) -> (Face, [f32; 2], f32) {
        let [eye, ceiling] = self.heights;
        let reach = |half: f32, along: f32| half / along.abs().max(1e-6);
        let (tx, ty) = (reach(self.half[0], d.x), reach(self.half[1], d.y));
        let tz = if d.z > 0.0 {
            (ceiling - eye) / d.z.max(1e-6)
        } else {
            eye / (-d.z).max(1e-6)
        };
        let t = tx.min(ty).min(tz);
        let p = d * t;
        let inset = |half: f32, at: f32| (half - at.abs()).max(0.0);
        if t == tz {
            let edge = inset(self.half[0], p.x).min(inset(self.half[1], p.y));
            let face = if d.z > 0.0 {
                Face::Ceiling
            } else {
                Face::Floor
            };
            return (face, [p.x, p.y], edge);
        }
        let above_floor = p.z + eye;
        let vertical = above_floor.min(ceiling - above_floor).max(0.0);
        let (wall, along, half) = match (t == tx, d.x > 0.0, d.y > 0.0) {
            (true, true, _) => (0, p.y, self.half[1]),
            (true, false, _) => (2, p.y, self.half[1]),
            (false, _, true) => (1, p.x, self.half[0]),
            (false, _, false) => (3, p.x, self.half[0]),
        };
        (
            Face::Wall(wall),
            [along, above_floor],
            vertical.min(inset(half, along)),
        )
    }
}

impl Panel {
    /// Whether a position lies on the frame or bars of the panel; `None` outside the panel.
    fn coverage(&self, position: [f32; 2]) -> Option<bool> {
        let offset = [0, 1].map(|a| position[a] - self.centre[a]);
        if (0..2).any(|a| offset[a].abs() > self.half[a]) {
            return None;
        }
        if !self.emits || self.panes == [1, 1] {
            return Some(false);
        }
        let is_bar = |a: usize| {
            let pane = 2.0 * self.half[a] / self.panes[a] as f32;
            let from_edge = (offset[a] + self.half[a]).rem_euclid(pane);
            from_edge.min(pane - from_edge) < 0.03
        };
        Some(is_bar(0) || is_bar(1))
    }
}
