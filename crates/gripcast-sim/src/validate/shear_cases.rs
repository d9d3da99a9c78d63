//! A gel pressed by a sphere, then sheared until it slides: the stick region against Cattaneo and
//! Mindlin.
//!
//! For a normal force N, a shear force T and elastic half-spaces, the contact of radius a sticks
//! within `c = a (1 - T/μN)^(1/3)`, and the fraction of the friction limit that is used at its centre
//! is `q/μp = 1 - c/a` (Johnson, *Contact Mechanics*, §7.2). A thin layer on a rigid back, whose
//! pressure is parabolic and whose shear stiffness per area is constant, sticks further out: within
//! `a (1 - T/μN)^(1/4)`. The pad, 4 mm thick against a contact radius of 3 mm, lies between them.

use std::f64::consts::PI;

use super::report::Recorder;
use crate::fem::GelPad;
use crate::fields::{FaceField, FaceMesh, FieldSampling, FieldSeries};
use crate::press::{Indenter, Press, PressPoint, PressTarget, half_pad};
use gripcast_base::error::{Error, Result};

const FRICTION: f64 = 0.4;
const DEPTH_M: f64 = 6e-4;
/// Width of the rings over which tractions are averaged, m.
const RING_M: f64 = 3.5e-4;
/// Fraction of the friction limit from which a ring counts as sliding.
const SLIDING: f64 = 0.95;

/// Mean over a ring of the contact.
#[derive(Clone, Copy, Debug, Default)]
struct Ring {
    radius_m: f64,
    normal_n: f64,
    shear_n: f64,
    area_m2: f64,
}

impl Ring {
    /// Fraction of the friction limit that is used, q/μp.
    fn used(&self) -> f64 {
        self.shear_n / (FRICTION * self.normal_n)
    }
}

/// Contact of the half gel at one target.
#[derive(Debug)]
struct Profile {
    /// Rings that carry a load, from the centre outwards.
    rings: Vec<Ring>,
    /// Radius of the contact, m.
    radius_m: f64,
    /// Fraction of the normal force that sticking nodes carry.
    stick_fraction: f64,
}

impl Profile {
    fn new(mesh: &FaceMesh, field: &FaceField) -> Self {
        let (mut rings, mut total, mut moment) = (Vec::new(), 0.0, 0.0);
        for node in 0..mesh.nodes() {
            let radius = mesh.position(node).truncate().length();
            let ring = (radius / RING_M) as usize;
            if rings.len() <= ring {
                rings.resize(ring + 1, Ring::default());
            }
            let area = mesh.area_m2[node];
            let [shear, _, normal] = field.traction_pa[node].map(|t| f64::from(t) * area);
            rings[ring].area_m2 += area;
            rings[ring].normal_n -= normal;
            rings[ring].shear_n += shear;
            total -= normal;
            moment -= normal * radius * radius;
        }
        for (index, ring) in rings.iter_mut().enumerate() {
            ring.radius_m = (index as f64 + 0.5) * RING_M;
        }
        let peak = rings
            .first()
            .map_or(0.0, |ring| ring.normal_n / ring.area_m2);
        rings.retain(|ring| ring.normal_n > 0.05 * peak * ring.area_m2);
        // For a pressure p0 (1 - r²/a²)^n the force is π a² p0 / (n + 1), and the mean of r²
        // a²/(n + 2). The half gel carries half of the force.
        let (force, spread) = (2.0 * total / (PI * peak), moment / total);
        let exponent = (2.0 * spread - force) / (force - spread);
        Self {
            rings,
            radius_m: (spread * (exponent + 2.0)).sqrt(),
            stick_fraction: field.stick_fraction(mesh).unwrap_or(f64::NAN),
        }
    }

    /// Radius of the stick region, m: where the fraction of the friction limit reaches [`SLIDING`].
    fn stick_radius_m(&self) -> f64 {
        let sliding = self.rings.iter().position(|ring| ring.used() >= SLIDING);
        match sliding {
            Some(0) => 0.0,
            None => self.radius_m,
            Some(index) => {
                let (inner, outer) = (self.rings[index - 1], self.rings[index]);
                let fraction = (SLIDING - inner.used()) / (outer.used() - inner.used());
                inner.radius_m + fraction * (outer.radius_m - inner.radius_m)
            }
        }
    }

    /// Whether friction is used the more, the further out, up to where it slides.
    fn slides_from_the_rim(&self) -> bool {
        let sticking = self.rings.iter().map(Ring::used);
        let sticking: Vec<f64> = sticking.take_while(|used| *used < SLIDING).collect();
        // A hundredth: rings of few nodes.
        sticking.windows(2).all(|pair| pair[1] > pair[0] - 0.01)
    }
}

fn press(is_quick: bool) -> Result<(Vec<PressPoint>, FieldSeries)> {
    let (cells, growth, shifts): (_, _, &[f64]) = if is_quick {
        ([13, 11, 7], [1.14, 1.14, 1.22], &[1e-4, 1.5e-4, 2e-4, 5e-4])
    } else {
        let shifts = &[8e-5, 1e-4, 1.25e-4, 1.5e-4, 1.75e-4, 2e-4, 2.5e-4, 5e-4];
        ([19, 17, 12], [1.1, 1.1, 1.15], shifts)
    };
    let grid = half_pad(&GelPad::default(), cells, growth)?;
    let mut press = Press::new(grid, Indenter::Sphere { radius_m: 0.01 });
    press.symmetric = [false, true];
    press.friction = FRICTION;
    press.d_hat_m = 2e-5;
    let target = |shift_m: &f64| PressTarget {
        depth_m: DEPTH_M,
        shift_m: *shift_m,
    };
    let targets: Vec<_> = [0.0].iter().chain(shifts).map(target).collect();
    let (points, fields) = press.run_with_fields(&targets, Some(FieldSampling::Stages))?;
    let fields = fields.ok_or_else(|| Error::internal("the press recorded no fields"))?;
    Ok((points, fields))
}

/// Sphere of radius 10 mm with friction 0.4: pressed by 0.6 mm, then shifted until it slides.
pub(super) fn stick_region(recorder: &mut Recorder, is_quick: bool) -> Result<()> {
    let (points, series) = press(is_quick)?;
    let profile = |index: usize| {
        let step = &series.steps[index];
        Profile::new(&series.mesh, &step.gels[0])
    };
    let mut earlier = f64::INFINITY;
    for (index, point) in points.iter().enumerate().skip(1) {
        let load = point.shear_n / (FRICTION * point.normal_n);
        let found = profile(index);
        let at = format!("shift {} mm", (point.shift_m * 1e6).round() / 1000.0);
        recorder.require(format!("{at}: converged"), point.converged);
        if load > 0.98 {
            let ratio = point.shear_n / point.normal_n;
            // The contact creeps a little while the shift is corrected.
            recorder.absolute(format!("{at}: T/N"), (0.405, ratio), "", 0.0075);
            recorder.absolute(
                format!("{at}: stick fraction"),
                (0.0, found.stick_fraction),
                "",
                0.05,
            );
            continue;
        }
        let stick = (1.0 - load).cbrt();
        let centre = found.rings.first().map_or(f64::NAN, Ring::used);
        let ratio = found.stick_radius_m() / found.radius_m;
        recorder.absolute(
            format!("{at}: centre q/µp"),
            (1.0 - stick, centre),
            "",
            0.04,
        );
        let limit = if is_quick { 0.15 } else { 0.1 };
        recorder.absolute(format!("{at}: c/a"), (stick, ratio), "", limit);
        let name = format!("{at}: slides from the rim inwards, more than before");
        let shrinks = ratio < earlier && found.slides_from_the_rim();
        recorder.require(name, shrinks);
        earlier = ratio;
    }
    Ok(())
}
