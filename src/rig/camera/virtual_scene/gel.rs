//! What a GelSight Mini sees: coloured light from the sides on a gel that an object indents.

use std::sync::Arc;

use super::grasp::{GelContact, VirtualGrasp};
use super::hand::SceneMoment;
use super::random::{NoiseTable, mixed, plane_noise, signed_unit, unit};
use crate::imaging::Role;

/// Field of view of the whole sensor picture, mm (crop of a seventh on each side: 20.7 × 15.5).
const FIELD_MM: [f64; 2] = [29.0, 21.75];
/// Cells of the height map.
const GRID: [usize; 2] = [192, 144];
const CELLS: usize = GRID[0] * GRID[1];
/// Closure at which the object meets the gels.
const TOUCH: f64 = 0.80;
/// Grey levels per unit of tilt of the gel surface, for red, green and blue.
const GAIN: [f32; 3] = [165.0, 125.0, 150.0];
/// Direction in the picture in which the surface has to fall off to catch each colour's light.
const LIGHT: [[f32; 2]; 3] = [[0.45, 0.89], [-0.97, 0.10], [0.42, -0.90]];

/// Paints one sensor's pictures at a fixed size.
pub(in crate::rig::camera) struct GelPainter {
    side: Role,
    seed: u64,
    width: usize,
    height: usize,
    background: Vec<u8>,
    noise: Arc<NoiseTable>,
    relief: Option<(u64, Vec<f32>)>,
    shading: Vec<[f32; 3]>,
    /// How much of the light reaches each cell: 1 on the pad, less beyond its rim.
    pad: Vec<f32>,
}

impl GelPainter {
    /// A painter of `width` × `height` pictures of the gel on `side`.
    pub(in crate::rig::camera) fn new(
        side: Role,
        seed: u64,
        width: usize,
        height: usize,
        noise: Arc<NoiseTable>,
    ) -> Self {
        let seed = mixed(seed, 0x67_656C, side as u64);
        Self {
            side,
            seed,
            width,
            height,
            background: background(seed, width, height),
            noise,
            relief: None,
            shading: vec![[0.0; 3]; CELLS],
            pad: pad_map(),
        }
    }

    /// The picture at `moment` as RGB rows; `frame` picks the noise.
    pub(in crate::rig::camera) fn paint(&mut self, moment: &SceneMoment, frame: u64) -> Vec<u8> {
        let contact = match self.side {
            Role::Right => moment.grasp.right,
            _ => moment.grasp.left,
        };
        let pressed = ((moment.closure - TOUCH) / (1.0 - TOUCH)).clamp(0.0, 1.0);
        // Nobody holds a hand perfectly still.
        let tremor = 1.0 + 0.015 * (moment.time_s * 7.3).sin() + 0.01 * (moment.time_s * 2.1).sin();
        let depth_mm = contact.depth_mm * pressed * pressed * (3.0 - 2.0 * pressed) * tremor;

        let mut picture = vec![0_u8; self.background.len()];
        if depth_mm > 0.0 {
            self.shade(&moment.grasp, contact, depth_mm);
            self.paint_touched(&mut picture, frame);
        } else {
            self.paint_untouched(&mut picture, frame);
        }
        picture
    }

    fn paint_untouched(&self, picture: &mut [u8], frame: u64) {
        let row_bytes = 3 * self.width;
        let rows = picture
            .chunks_exact_mut(row_bytes)
            .zip(self.background.chunks_exact(row_bytes));
        for (row, (out, base)) in rows.enumerate() {
            let noise = self.noise.row(self.seed, frame, row, row_bytes);
            for ((out, base), noise) in out.iter_mut().zip(base).zip(noise) {
                *out = base.saturating_add_signed(*noise);
            }
        }
    }

    fn paint_touched(&self, picture: &mut [u8], frame: u64) {
        let row_bytes = 3 * self.width;
        let columns: Vec<(usize, f32)> = (0..self.width)
            .map(|column| grid_place(column, self.width, GRID[0]))
            .collect();
        let mut line = vec![[0.0_f32; 3]; GRID[0]];
        let rows = picture
            .chunks_exact_mut(row_bytes)
            .zip(self.background.chunks_exact(row_bytes));
        for (row, (out, base)) in rows.enumerate() {
            let (above, share) = grid_place(row, self.height, GRID[1]);
            let first = &self.shading[above * GRID[0]..][..GRID[0]];
            let second = &self.shading[(above + 1) * GRID[0]..][..GRID[0]];
            for ((mixed, a), b) in line.iter_mut().zip(first).zip(second) {
                for channel in 0..3 {
                    mixed[channel] = a[channel] + share * (b[channel] - a[channel]);
                }
            }
            let noise = self.noise.row(self.seed, frame, row, row_bytes);
            let pixels = out
                .chunks_exact_mut(3)
                .zip(base.chunks_exact(3))
                .zip(noise.chunks_exact(3));
            for (((out, base), noise), (cell, share)) in pixels.zip(&columns) {
                let (a, b) = (&line[*cell], &line[cell + 1]);
                for channel in 0..3 {
                    let shading = a[channel] + share * (b[channel] - a[channel]);
                    let value = f32::from(base[channel]) + f32::from(noise[channel]) + shading;
                    out[channel] = (value + 0.5) as u8;
                }
            }
        }
    }

    /// Colour change of each cell when the object is pressed `depth_mm` into the gel.
    fn shade(&mut self, grasp: &VirtualGrasp, contact: GelContact, depth_mm: f64) {
        let relief = match self.relief.take() {
            Some((number, relief)) if number == grasp.number => relief,
            _ => relief_map(grasp, contact),
        };
        let depth = depth_mm as f32;
        let indented: Vec<f32> = relief.iter().map(|rise| (depth - rise).max(0.0)).collect();
        self.relief = Some((grasp.number, relief));

        // The membrane rounds off edges and is drawn down around the contact.
        let near = blurred(&blurred(&indented, 1), 1);
        let skirt = blurred(&blurred(&indented, 10), 10);
        let height: Vec<f32> = near
            .iter()
            .zip(&skirt)
            .map(|(near, skirt)| 0.80 * near + 0.20 * skirt)
            .collect();

        let per_mm = (GRID[0] as f64 / FIELD_MM[0]) as f32;
        for row in 0..GRID[1] {
            let (up, down) = (row.saturating_sub(1), (row + 1).min(GRID[1] - 1));
            for column in 0..GRID[0] {
                let (left, right) = (column.saturating_sub(1), (column + 1).min(GRID[0] - 1));
                let at = |row: usize, column: usize| height[row * GRID[0] + column];
                let slope_x = 0.5 * per_mm * (at(row, right) - at(row, left));
                let slope_y = 0.5 * per_mm * (at(down, column) - at(up, column));
                let steep = slope_x * slope_x + slope_y * slope_y;
                let scale = 1.0 / (1.0 + steep).sqrt();
                let (tilt_x, tilt_y) = (slope_x * scale, slope_y * scale);
                let pressed = at(row, column).min(1.0);
                let inside = self.pad[row * GRID[0] + column];
                let darker = 22.0 * steep * scale * scale;
                let cell = &mut self.shading[row * GRID[0] + column];
                for channel in 0..3 {
                    let toward = tilt_x * LIGHT[channel][0] + tilt_y * LIGHT[channel][1];
                    // Facing the light gives more than turning away takes.
                    let lit = if toward > 0.0 { toward } else { 0.62 * toward };
                    cell[channel] = inside * (GAIN[channel] * lit - darker + 5.0 * pressed);
                }
            }
        }
    }
}

/// Cell left of (above) a pixel centre and the share of the next one.
fn grid_place(pixel: usize, pixels: usize, cells: usize) -> (usize, f32) {
    let at = (pixel as f32 + 0.5) * cells as f32 / pixels as f32 - 0.5;
    let at = at.clamp(0.0, (cells - 1) as f32 - 1e-3);
    (at as usize, at.fract())
}

/// Rise of the object's surface over each cell, mm.
fn relief_map(grasp: &VirtualGrasp, contact: GelContact) -> Vec<f32> {
    let (sin, cos) = contact.angle_rad.sin_cos();
    let mut relief = Vec::with_capacity(CELLS);
    for row in 0..GRID[1] {
        let y = ((row as f64 + 0.5) / GRID[1] as f64 - 0.5) * FIELD_MM[1] - contact.offset_mm[1];
        for column in 0..GRID[0] {
            let x =
                ((column as f64 + 0.5) / GRID[0] as f64 - 0.5) * FIELD_MM[0] - contact.offset_mm[0];
            let (along, across) = (cos * x + sin * y, cos * y - sin * x);
            relief.push(grasp.object.relief_mm(along, across) as f32);
        }
    }
    relief
}

/// Light on the pad at `crop` (0–1 inside the crop of a seventh), and distance beyond that crop
/// in parts of its rim.
fn pad_light(crop: [f64; 2]) -> (f64, f64) {
    let [x, y] = crop.map(|at| ((at - 0.5).abs() - 0.5).max(0.0));
    let rim = x.hypot(y) / 0.2;
    (1.0 - 0.62 * ease((rim - 0.25) / 0.75), rim)
}

fn pad_map() -> Vec<f32> {
    let crop = |cell: usize, cells: usize| ((cell as f64 + 0.5) / cells as f64 * 7.0 - 1.0) / 5.0;
    (0..CELLS)
        .map(|cell| {
            let at = [crop(cell % GRID[0], GRID[0]), crop(cell / GRID[0], GRID[1])];
            let rim = pad_light(at).1;
            (1.0 - ease((rim - 0.15) / 0.7)) as f32
        })
        .collect()
}

/// Rises smoothly from 0 at 0 to 1 at 1.
fn ease(t: f64) -> f64 {
    let t = t.clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Box blur of `radius` cells in both directions; the rim repeats.
fn blurred(map: &[f32], radius: usize) -> Vec<f32> {
    let mut rows = vec![0.0; CELLS];
    for (from, to) in map
        .chunks_exact(GRID[0])
        .zip(rows.chunks_exact_mut(GRID[0]))
    {
        slide(GRID[0], radius, |at| from[at], |at, mean| to[at] = mean);
    }
    let mut both = vec![0.0; CELLS];
    for column in 0..GRID[0] {
        slide(
            GRID[1],
            radius,
            |at| rows[at * GRID[0] + column],
            |at, mean| both[at * GRID[0] + column] = mean,
        );
    }
    both
}

fn slide(
    length: usize,
    radius: usize,
    get: impl Fn(usize) -> f32,
    mut put: impl FnMut(usize, f32),
) {
    let last = length - 1;
    let share = 1.0 / (2 * radius + 1) as f32;
    let mut sum: f32 = radius as f32 * get(0);
    sum += (0..=radius).map(|at| get(at.min(last))).sum::<f32>();
    for at in 0..length {
        put(at, sum * share);
        sum += get((at + radius + 1).min(last)) - get(at.saturating_sub(radius));
    }
}

/// The untouched gel: teal above, violet in the middle, olive below; a dark rim outside the
/// pad, a few specks of dust, and colours of its own for each sensor.
fn background(seed: u64, width: usize, height: usize) -> Vec<u8> {
    const TOP: [[f64; 3]; 2] = [[34.0, 98.0, 92.0], [42.0, 97.0, 110.0]];
    const MIDDLE: [[f64; 3]; 2] = [[66.0, 106.0, 118.0], [136.0, 110.0, 152.0]];
    const BOTTOM: [[f64; 3]; 2] = [[54.0, 88.0, 70.0], [76.0, 93.0, 82.0]];
    let own: Vec<f64> = (0..3).map(|n| 5.0 * signed_unit(seed, 1, n)).collect();
    let specks: Vec<[f64; 3]> = (0..7)
        .map(|n| {
            [
                unit(seed, 2, n),
                unit(seed, 3, n),
                0.0015 + 0.003 * unit(seed, 4, n),
            ]
        })
        .collect();
    let mut picture = Vec::with_capacity(3 * width * height);
    for row in 0..height {
        let v = (row as f64 + 0.5) / height as f64;
        let crop_v = (v * 7.0 - 1.0) / 5.0;
        for column in 0..width {
            let u = (column as f64 + 0.5) / width as f64;
            let crop_u = (u * 7.0 - 1.0) / 5.0;
            let inward = ease(1.0 - ((crop_u - 0.47) / 0.62).abs());
            let (pad, rim) = pad_light([crop_u, crop_v]);
            let glow = 0.09 * (-((rim - 0.62) / 0.10).powi(2)).exp();
            let speck: f64 = specks
                .iter()
                .map(|[x, y, radius]| {
                    let distance = (u - x).hypot((v - y) * 0.75) / radius;
                    -0.16 * (-distance * distance).exp()
                })
                .sum();
            let cloud = 1.0 + 0.02 * plane_noise(seed, u * 6.0, v * 6.0);
            let light = (pad + glow + speck) * cloud;
            for channel in 0..3 {
                let mix = |pair: &[[f64; 3]; 2]| {
                    pair[0][channel] + inward * (pair[1][channel] - pair[0][channel])
                };
                let value = if crop_v < 0.48 {
                    let t = ease(crop_v / 0.48);
                    mix(&TOP) + t * (mix(&MIDDLE) - mix(&TOP))
                } else {
                    let t = ease((crop_v - 0.48) / 0.52);
                    mix(&MIDDLE) + t * (mix(&BOTTOM) - mix(&MIDDLE))
                };
                picture.push(((value + own[channel]) * light).round().clamp(0.0, 255.0) as u8);
            }
        }
    }
    picture
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::camera::virtual_scene::Grip;

    const WIDTH: usize = 640;
    const HEIGHT: usize = 480;

    fn painter(side: Role) -> GelPainter {
        GelPainter::new(side, 1, WIDTH, HEIGHT, Arc::new(NoiseTable::new(1, 1.5)))
    }

    fn moment(number: u64, closure: f64) -> SceneMoment {
        SceneMoment {
            closure,
            grasp: VirtualGrasp::new(1, number),
            placed_for_s: 10.0,
            time_s: 1.0,
        }
    }

    /// Mean |difference|, share above 10 levels, and peak inside the crop of a seventh.
    fn difference(a: &[u8], b: &[u8]) -> (f64, f64, u8) {
        let (mut sum, mut over, mut peak, mut count) = (0_u64, 0_usize, 0_u8, 0_usize);
        for row in HEIGHT / 7..HEIGHT - HEIGHT / 7 {
            for column in WIDTH / 7..WIDTH - WIDTH / 7 {
                let at = 3 * (row * WIDTH + column);
                let levels = (0..3).map(|c| a[at + c].abs_diff(b[at + c]));
                sum += levels.clone().map(u64::from).sum::<u64>();
                let most = levels.max().unwrap();
                over += usize::from(most > 10);
                peak = peak.max(most);
                count += 1;
            }
        }
        (
            sum as f64 / (3 * count) as f64,
            over as f64 / count as f64,
            peak,
        )
    }

    #[test]
    fn untouched_gels_differ_by_noise_only() {
        let mut painter = painter(Role::Left);
        let a = painter.paint(&moment(0, 0.0), 1);
        let b = painter.paint(&moment(0, 0.7), 2);
        let (mean, over, _) = difference(&a, &b);
        assert!((1.0..2.2).contains(&mean), "mean {mean}");
        assert!(over < 0.001, "share {over}");
        assert_ne!(a, b);
    }

    #[test]
    fn firm_grips_measure_like_real_presses_on_both_sides() {
        for side in [Role::Left, Role::Right] {
            let mut painter = painter(side);
            let open = painter.paint(&moment(0, 0.0), 1);
            for number in (0..40).filter(|n| VirtualGrasp::new(1, *n).grip == Grip::Firm) {
                let closed = painter.paint(&moment(number, 1.0), 2);
                let (mean, over, peak) = difference(&open, &closed);
                let name = VirtualGrasp::new(1, number).object.name();
                println!("{side} {number} {name}: mean {mean:.1} over {over:.2} peak {peak}");
                assert!((6.0..20.0).contains(&mean), "{side} {name} mean {mean}");
                assert!((0.11..0.6).contains(&over), "{side} {name} share {over}");
                assert!(peak >= 50, "{side} {name} peak {peak}");
            }
        }
    }

    #[test]
    fn bad_grips_are_weaker_on_one_side_at_least() {
        let mut painters = [painter(Role::Left), painter(Role::Right)];
        let open = painters
            .each_mut()
            .map(|painter| painter.paint(&moment(0, 0.0), 1));
        for number in (1..40).filter(|n| !VirtualGrasp::new(1, *n).grip.holds()) {
            let mut weakest = f64::INFINITY;
            for (painter, open) in painters.iter_mut().zip(&open) {
                let closed = painter.paint(&moment(number, 1.0), 2);
                weakest = weakest.min(difference(open, &closed).0);
            }
            let grasp = VirtualGrasp::new(1, number);
            println!(
                "{number} {:?} {}: {weakest:.1}",
                grasp.grip,
                grasp.object.name()
            );
            assert!(weakest < 6.0, "{:?} {weakest}", grasp.grip);
        }
    }

    #[test]
    fn contact_grows_while_the_hand_closes() {
        let mut painter = painter(Role::Left);
        let open = painter.paint(&moment(0, 0.0), 1);
        let means = [0.8, 0.88, 0.94, 1.0]
            .map(|closure| difference(&open, &painter.paint(&moment(0, closure), 2)).0);
        assert!(means.windows(2).all(|pair| pair[0] < pair[1]), "{means:?}");
    }

    #[test]
    fn the_untouched_colours_are_those_of_a_mini() {
        let picture = painter(Role::Left).paint(&moment(0, 0.0), 1);
        let band = |from: usize, to: usize| {
            let mut sum = [0.0; 3];
            let mut count = 0.0;
            for row in from..to {
                for column in 280..360 {
                    for channel in 0..3 {
                        sum[channel] += f64::from(picture[3 * (row * WIDTH + column) + channel]);
                    }
                    count += 1.0;
                }
            }
            sum.map(|value| value / count)
        };
        for (found, wanted) in [
            (band(70, 80), [40.0, 97.0, 108.0]),
            (band(230, 250), [125.0, 120.0, 145.0]),
            (band(400, 410), [68.0, 95.0, 81.0]),
        ] {
            for (value, wanted) in found.iter().zip(wanted) {
                assert!((value - wanted).abs() < 18.0, "{found:?}");
            }
        }
    }

    #[test]
    fn red_light_comes_from_above_and_blue_from_below() {
        let mut painter = painter(Role::Left);
        let ball = moment(3, 1.0);
        let contact = ball.grasp.left;
        painter.shade(
            &ball.grasp,
            GelContact {
                offset_mm: [0.0; 2],
                ..contact
            },
            1.4,
        );
        let cell = |x_mm: f64, y_mm: f64| {
            let column = ((x_mm / FIELD_MM[0] + 0.5) * GRID[0] as f64) as usize;
            let row = ((y_mm / FIELD_MM[1] + 0.5) * GRID[1] as f64) as usize;
            painter.shading[row * GRID[0] + column]
        };
        let (above, below, right) = (cell(0.0, -3.5), cell(0.0, 3.5), cell(3.5, 0.0));
        assert!(above[0] > above[2] && above[0] > above[1], "{above:?}");
        assert!(below[2] > below[0] && below[2] > below[1], "{below:?}");
        assert!(right[1] > right[0] && right[1] > right[2], "{right:?}");
    }
}
