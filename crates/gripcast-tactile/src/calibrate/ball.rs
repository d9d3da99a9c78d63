//! Analytic depth of a calibration press: a ball in contact over a disc.

use crate::membrane::ball_sink_m;
use crate::{PressDepth, SensorGeometry};

/// Maximum contact radius relative to the ball radius; beyond it the border slope grows without
/// bound.
const MAX_CONTACT: f64 = 0.95;

/// Contact of a ball pressed into the gel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BallContact {
    /// Sensor grid.
    pub geometry: SensorGeometry,
    /// Centre of the contact disc: column and row, px.
    pub centre_px: [f64; 2],
    /// Radius of the contact disc, px.
    pub radius_px: f64,
    /// Radius of the ball, m.
    pub ball_m: f64,
}

impl BallContact {
    /// Depth of the ball below the untouched face of a gel with decay length `sink_length_m` (see
    /// [`ball_sink_m`]).
    pub fn press(&self, sink_length_m: f64) -> PressDepth {
        self.press_sunk_by(ball_sink_m(self.contact_m(), self.ball_m, sink_length_m))
    }

    /// Depth of the ball below the border of its contact (spherical cap), 0 outside the disc.
    pub fn cap(&self) -> PressDepth {
        self.press_sunk_by(0.0)
    }

    /// Depth of the ball below the untouched face, m: √(R² − ρ²) − √(R² − a²) + sink at a distance
    /// ρ from the centre, where positive, with the contact radius a and the ball radius R;
    /// `sink_m` is the depth of the contact border below the untouched face.
    pub(crate) fn press_sunk_by(&self, sink_m: f64) -> PressDepth {
        let geometry = self.geometry;
        let mut press = PressDepth::untouched(geometry);
        let square = |x: f64| x * x;
        let border = (square(self.ball_m) - square(self.contact_m()))
            .max(0.0)
            .sqrt();
        for (i, depth) in press.depth_m.iter_mut().enumerate() {
            let x = ((i % geometry.width) as f64 - self.centre_px[0]) * geometry.pixel_m;
            let y = ((i / geometry.width) as f64 - self.centre_px[1]) * geometry.pixel_m;
            let over = square(self.ball_m) - x * x - y * y;
            if over > 0.0 {
                let deep = (over.sqrt() - border + sink_m).max(0.0);
                *depth = deep.min(geometry.gel_thickness_m) as f32;
            }
        }
        press
    }

    /// Depth of the ball below the border of its contact, m: R − √(R² − a²).
    pub fn indentation_m(&self) -> f64 {
        self.ball_m - (self.ball_m.powi(2) - self.contact_m().powi(2)).sqrt()
    }

    /// Contact radius, m, at most 0.95 of the ball radius.
    fn contact_m(&self) -> f64 {
        (self.radius_px * self.geometry.pixel_m).min(MAX_CONTACT * self.ball_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GEOMETRY: SensorGeometry = SensorGeometry {
        width: 320,
        height: 240,
        pixel_m: 6e-5,
        gel_thickness_m: 4e-3,
    };

    #[test]
    fn cap_ends_at_contact_and_press_extends_beyond() {
        let contact = BallContact {
            geometry: GEOMETRY,
            centre_px: [150.0, 100.0],
            radius_px: 20.0,
            ball_m: 2e-3,
        };
        let at = |press: &PressDepth, x: usize| press.depth_m[100 * 320 + x];
        let cap = contact.cap();
        assert!(at(&cap, 169) > 0.0 && at(&cap, 170) == 0.0);
        let expected = 2e-3 - (4e-6f64 - 1.2e-3 * 1.2e-3).sqrt();
        assert!((f64::from(at(&cap, 150)) - expected).abs() < 1e-9);
        let press = contact.press(1e-3);
        let sink = ball_sink_m(1.2e-3, 2e-3, 1e-3);
        assert!((f64::from(at(&press, 170)) - sink).abs() < 1e-9);
        assert!(at(&press, 172) > 0.0);
    }

    #[test]
    fn contact_as_wide_as_the_ball_stays_finite() {
        let contact = BallContact {
            geometry: GEOMETRY,
            centre_px: [0.0, 0.0],
            radius_px: 60.0,
            ball_m: 2e-3,
        };
        let press = contact.press(1e-3);
        assert!(press.depth_m.iter().all(|d| d.is_finite() && *d <= 4e-3));
        // Counted as a contact of 0.95 of the ball's radius.
        let contact = 0.95 * 2e-3;
        let deep = 2e-3 - (4e-6f64 - contact * contact).sqrt();
        let sink = ball_sink_m(contact, 2e-3, 1e-3);
        assert!((f64::from(press.depth_m[0]) - deep - sink).abs() < 1e-9);
        // The ball itself reaches over 33 pixels.
        assert!(press.depth_m[33] > 0.0 && press.depth_m[34] == 0.0);
    }
}
