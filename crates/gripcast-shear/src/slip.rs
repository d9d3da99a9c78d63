//! Slip ratio: how much of a contact moves against the rigid motion of its centre.
//!
//! While a contact sticks, the skin below it moves as one with the object: a translation and a
//! rotation, and evenly outwards while the load grows. Slip begins at the rim, where the pressure
//! is lowest (Cattaneo 1938, Mindlin 1949), and the skin there stays behind. As in Dong, Ma, Donlon
//! and Rodriguez, Maintaining Grasps within Slipping Bounds by Monitoring Incipient Slip (ICRA
//! 2019), the rigid motion is fitted to the gel markers in the middle of the contact, and a gel
//! marker slips where its displacement differs from it. Displacements count from the frame in which the contact last grew, because a growing contact
//! stretches the skin without any slip; a contact that loses much of its area counts anew, too.
//!
//! Gross slip does not move the skin at all: the ratio then stays where it was.

use gripcast_base::linear::NormalEquations;

use crate::contact::ContactArea;
use crate::dots::distance;
use crate::lattice::median;
use crate::{GelMarker, MarkerField};

/// Growth of the contact from which displacements count anew, fraction.
const GROWTH: f32 = 1.1;
/// Area below which it is another contact, fraction.
const SHRUNK: f32 = 0.6;
/// Minimum gel markers in contact.
const MIN_MARKERS: usize = 5;
/// Minimum deviation of a gel marker that slips, fraction of the rigid motion.
const MIN_DEVIATION: f32 = 0.1;
/// Minimum deviation of a gel marker that slips, standard deviations of the positions.
const NOISE_DEVIATIONS: f32 = 4.0;
/// Standard deviation of the positions where no open gripper was seen, and its minimum, px.
const DEFAULT_NOISE_PX: f32 = 0.15;
const MIN_NOISE_PX: f32 = 0.05;
/// Fraction by which a frame without contact changes the noise.
const NOISE_GAIN: f32 = 0.1;
/// Steps of the robust fit.
const FIT_STEPS: usize = 5;

/// Measures the slip ratio of one gel.
#[derive(Clone, Debug)]
pub(crate) struct SlipMeter {
    /// Displacements when the contact last grew, and its area then.
    reference: Option<(Vec<Option<[f32; 2]>>, f32)>,
    noise_px: f32,
    /// Displacements in the last frame without contact.
    open: Option<Vec<Option<[f32; 2]>>>,
}

impl Default for SlipMeter {
    fn default() -> Self {
        Self {
            reference: None,
            noise_px: DEFAULT_NOISE_PX,
            open: None,
        }
    }
}

impl SlipMeter {
    /// Slip ratio of a frame; `None` without contact, or with too few gel markers in it.
    pub(crate) fn measure(
        &mut self,
        field: &MarkerField,
        contact: Option<&ContactArea>,
    ) -> Option<f32> {
        let displacements: Vec<Option<[f32; 2]>> = (0..field.markers.len())
            .map(|at| field.tracked(at).map(GelMarker::displacement_px))
            .collect();
        let Some(contact) = contact else {
            self.reference = None;
            self.learn_noise(displacements);
            return None;
        };
        let area = contact.fraction();
        let is_other = |(_, before): &(_, f32)| area > GROWTH * before || area < SHRUNK * before;
        if self.reference.as_ref().is_none_or(is_other) {
            self.reference = Some((displacements.clone(), area));
        }
        let (reference, _) = self.reference.as_ref()?;
        let moved: Vec<([f32; 2], [f32; 2])> = (0..displacements.len())
            .filter_map(|at| {
                let marker = field
                    .tracked(at)
                    .filter(|m| contact.contains(m.position_px))?;
                let (now, before) = (displacements[at]?, reference[at]?);
                Some((marker.rest_px, [0, 1].map(|a| now[a] - before[a])))
            })
            .collect();
        let rigid = RigidMotion::of_middle(&moved)?;
        let slips = moved.iter().filter(|(position, motion)| {
            let expected = rigid.at(*position);
            let limit = MIN_DEVIATION * expected[0].hypot(expected[1]);
            distance(*motion, expected) > limit.max(NOISE_DEVIATIONS * self.noise_px)
        });
        Some(slips.count() as f32 / moved.len() as f32)
    }

    fn learn_noise(&mut self, displacements: Vec<Option<[f32; 2]>>) {
        if let Some(before) = &self.open {
            let pairs = displacements.iter().zip(before);
            let steps: Vec<f32> = pairs
                .filter_map(|(now, before)| Some(distance((*now)?, (*before)?)))
                .collect();
            // The median of a step of two positions in two dimensions is 1.67 standard deviations.
            if let Some(step) = median(steps) {
                let noise = (step / 1.67).clamp(MIN_NOISE_PX, DEFAULT_NOISE_PX);
                self.noise_px += NOISE_GAIN * (noise - self.noise_px);
            }
        }
        self.open = Some(displacements);
    }
}

/// Translation, small rotation and even stretch about a centre.
struct RigidMotion {
    centre: [f32; 2],
    translation: [f32; 2],
    rotation: f32,
    /// Relative growth: pressing harder stretches the skin in contact without any slip.
    stretch: f32,
}

impl RigidMotion {
    /// Fits the half of the positions that is nearest to their centre.
    fn of_middle(moved: &[([f32; 2], [f32; 2])]) -> Option<Self> {
        if moved.len() < MIN_MARKERS {
            return None;
        }
        let centre =
            [0, 1].map(|a| moved.iter().map(|(p, _)| p[a]).sum::<f32>() / moved.len() as f32);
        let mut middle: Vec<_> = moved.to_vec();
        middle.sort_by(|a, b| distance(a.0, centre).total_cmp(&distance(b.0, centre)));
        middle.truncate(moved.len().div_ceil(2).max(MIN_MARKERS - 1));
        let mut motion = Self {
            centre,
            translation: [0.0; 2],
            rotation: 0.0,
            stretch: 0.0,
        };
        let mut weights = vec![1.0; middle.len()];
        for _ in 0..FIT_STEPS {
            let mut system = NormalEquations::<4>::zero();
            system.matrix[2][2] = 1e-6;
            system.matrix[3][3] = 1e-6;
            for ((position, moved), weight) in middle.iter().zip(&weights) {
                let [x, y] = [0, 1].map(|a| f64::from(position[a] - centre[a]));
                system.add(&[1.0, 0.0, -y, x], f64::from(moved[0]), *weight);
                system.add(&[0.0, 1.0, x, y], f64::from(moved[1]), *weight);
            }
            let [x, y, rotation, stretch] = system.solve()?;
            motion.translation = [x as f32, y as f32];
            motion.rotation = rotation as f32;
            motion.stretch = stretch as f32;
            let errors = middle.iter().map(|(p, m)| distance(motion.at(*p), *m));
            let errors: Vec<f32> = errors.collect();
            let scale = median(errors.clone())?.max(MIN_NOISE_PX);
            let weight = |error: &f32| 1.0 / (1.0 + f64::from(error / scale).powi(2));
            weights = errors.iter().map(weight).collect();
        }
        Some(motion)
    }

    fn at(&self, position: [f32; 2]) -> [f32; 2] {
        let [x, y] = [0, 1].map(|a| position[a] - self.centre[a]);
        [
            self.translation[0] - self.rotation * y + self.stretch * x,
            self.translation[1] + self.rotation * x + self.stretch * y,
        ]
    }
}
