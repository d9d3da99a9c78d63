//! Size of a sensor's gel pad.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::grid::{GelGrid, GelResolution};
use gripcast_base::error::{Error, Result};

/// Accepted sizes of the face and of the thickness, m: beyond them a length is in another unit.
const SIZE_M: [f64; 2] = [2e-3, 0.1];
const THICKNESS_M: [f64; 2] = [5e-4, 0.02];

/// Size of a gel pad at rest. The default is that of the GelSight Mini, as in the paper.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GelPad {
    /// Size of the face along the gel frame's x (the approach direction) and y axes, m.
    pub size_m: [f64; 2],
    /// Thickness, m.
    pub thickness_m: f64,
}

impl Default for GelPad {
    fn default() -> Self {
        Self {
            size_m: [0.025, 0.020],
            thickness_m: 0.004,
        }
    }
}

impl GelPad {
    /// Whether this is the default pad.
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }

    /// Checks the range of every length.
    ///
    /// # Errors
    /// `Config`, with the length, its value and its range.
    pub fn validate(&self) -> Result<()> {
        let [x, y] = self.size_m;
        let lengths = [
            ("size_m[0]", x, SIZE_M),
            ("size_m[1]", y, SIZE_M),
            ("thickness_m", self.thickness_m, THICKNESS_M),
        ];
        for (name, found, [min, max]) in lengths {
            // Also rejects NaN.
            if !(found >= min && found <= max) {
                return Err(Error::config(format!(
                    "`{name}` of the gel pad must be from {min} to {max} m, found {found}"
                ))
                .remedy("give the size of the gel in metres, for instance 0.025"));
            }
        }
        Ok(())
    }

    /// Uniform mesh, x and y centred on 0.
    ///
    /// # Errors
    /// As [`Self::validate`].
    pub fn grid(&self, resolution: GelResolution) -> Result<GelGrid> {
        self.validate()?;
        GelGrid::uniform(resolution.nodes(self), self.box_m())
    }

    /// Size along x, y and z of the gel frame, m.
    pub fn box_m(&self) -> [f64; 3] {
        let [x, y] = self.size_m;
        [x, y, self.thickness_m]
    }

    /// Half size of the face along the gel frame's x and y axes, m.
    pub fn half_m(&self) -> [f64; 2] {
        self.size_m.map(|size| 0.5 * size)
    }

    /// Half size, along the gripper's x, y and z axes, of the box around both gels with their faces
    /// `opening_m` apart, m.
    pub fn pair_half_m(&self, opening_m: f64) -> DVec3 {
        let [approach, across] = self.half_m();
        DVec3::new(0.5 * opening_m + self.thickness_m, across, approach)
    }

    /// Half size of one pad along the gripper's x, y and z axes, m.
    pub fn half_in_gripper_m(&self) -> DVec3 {
        let [approach, across] = self.half_m();
        DVec3::new(0.5 * self.thickness_m, across, approach)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A pad of the size of a DIGIT's.
    const DIGIT: GelPad = GelPad {
        size_m: [0.019, 0.016],
        thickness_m: 0.002,
    };

    #[test]
    fn other_sizes_keep_the_node_spacing() {
        let nodes = |pad: &GelPad| {
            use GelResolution::{Coarse, Default, Fine};
            [Coarse, Default, Fine].map(|resolution| resolution.nodes(pad))
        };
        let standard = [[13, 11, 3], [19, 16, 4], [26, 21, 5]];
        assert_eq!(nodes(&GelPad::default()), standard);
        assert_eq!(nodes(&DIGIT), [[10, 9, 3], [15, 13, 3], [20, 17, 3]]);
        let grid = DIGIT.grid(GelResolution::Default).unwrap();
        assert_eq!(grid.pad(), DIGIT);
        let area: f64 = grid.driven_areas().iter().sum();
        assert!((area / (0.019 * 0.016) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn sizes_in_other_units_are_refused() {
        for pad in [
            GelPad {
                size_m: [25.0, 20.0],
                ..DIGIT
            },
            GelPad {
                size_m: [0.0, 0.02],
                ..DIGIT
            },
            GelPad {
                thickness_m: f64::NAN,
                ..DIGIT
            },
            GelPad {
                thickness_m: 4.0,
                ..DIGIT
            },
        ] {
            let error = pad.grid(GelResolution::Coarse).unwrap_err().to_string();
            assert!(error.contains("of the gel pad must be from"), "{error}");
        }
    }
}
