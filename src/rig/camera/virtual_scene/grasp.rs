//! What is grasped, and how well.

use super::random::{mixed, signed_unit, unit};

/// Objects of the virtual table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VirtualObject {
    /// A ribbed cup.
    Mug,
    /// A roll of tape, lying.
    TapeRoll,
    /// A small carton.
    Carton,
    /// A ball.
    Ball,
    /// A bottle, held at its knurled cap.
    Bottle,
    /// A large bolt, standing on its head.
    Bolt,
}

impl VirtualObject {
    /// All objects, in the order in which a session meets them first.
    pub const ALL: [Self; 6] = [
        Self::Mug,
        Self::TapeRoll,
        Self::Carton,
        Self::Ball,
        Self::Bottle,
        Self::Bolt,
    ];

    /// Name as an operator would type it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Mug => "mug",
            Self::TapeRoll => "tape-roll",
            Self::Carton => "carton",
            Self::Ball => "ball",
            Self::Bottle => "bottle",
            Self::Bolt => "bolt",
        }
    }

    /// Half of the width between the fingers, m.
    pub(super) fn half_width_m(self) -> f64 {
        match self {
            Self::Mug => 0.030,
            Self::TapeRoll => 0.036,
            Self::Carton => 0.024,
            Self::Ball => 0.030,
            Self::Bottle => 0.026,
            Self::Bolt => 0.012,
        }
    }

    /// Height of the surface that meets the gel above its nearest point, mm; `x` along the
    /// finger's width, `y` along its length, mm.
    pub(super) fn relief_mm(self, x: f64, y: f64) -> f64 {
        let wave = |at: f64, pitch: f64| 0.5 - 0.5 * (std::f64::consts::TAU * at / pitch).cos();
        let barrel = |at: f64, radius: f64| {
            let inside = radius * radius - at * at;
            if inside > 0.0 {
                radius - inside.sqrt()
            } else {
                radius + 2.0 * (at.abs() - radius)
            }
        };
        match self {
            Self::Mug => barrel(x, 10.0) + 0.14 * wave(y, 4.2),
            Self::TapeRoll => {
                barrel(x, 24.0) + 2.2 * (y.abs() - 4.6).max(0.0) + 0.03 * wave(x, 1.1)
            }
            Self::Carton => {
                let (dx, dy) = ((x.abs() - 4.6).max(0.0), (y.abs() - 3.4).max(0.0));
                1.8 * dx.hypot(dy) + 0.10 * wave(x + y, 1.9)
            }
            Self::Ball => barrel(x.hypot(y), 10.0),
            Self::Bottle => barrel(x, 12.0) + 0.42 * wave(x, 1.8) + 1.5 * (-y - 4.5).max(0.0),
            Self::Bolt => barrel(x, 5.5) + 0.75 * wave(y + 0.12 * x, 1.9),
        }
    }
}

/// How well an object is held.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Grip {
    /// Both gels firmly in contact.
    Firm,
    /// Held at the rim of the gels.
    OffCentre,
    /// One gel barely touches.
    OneSided,
    /// Both gels barely touch.
    Shallow,
}

impl Grip {
    /// Whether the object would stay in the hand.
    pub fn holds(self) -> bool {
        self == Self::Firm
    }
}

/// How an object meets one gel when the hand is closed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct GelContact {
    /// Deepest indentation, mm.
    pub(super) depth_mm: f64,
    /// Where the object's nearest point meets the gel, mm from its centre.
    pub(super) offset_mm: [f64; 2],
    /// Turn of the object in the gel's plane, rad.
    pub(super) angle_rad: f64,
}

/// One grasp of the virtual hand; a function of seed and number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VirtualGrasp {
    /// Number of the grasp, from 0.
    pub number: u64,
    /// What is grasped.
    pub object: VirtualObject,
    /// How well.
    pub grip: Grip,
    pub(super) left: GelContact,
    pub(super) right: GelContact,
    /// Sideways distance of the object from the middle of the hand, m.
    pub(super) aside_m: f64,
}

impl VirtualGrasp {
    /// Grasp `number` of the session with `seed`. The first three are firm, bad, firm, so that a
    /// short demonstration shows both.
    pub fn new(seed: u64, number: u64) -> Self {
        let pick = |what: u64| unit(seed, what, number);
        let around = |what: u64| signed_unit(seed, what, number);
        let count = VirtualObject::ALL.len() as u64;
        let object = VirtualObject::ALL[(number % count) as usize];
        let bad = match number {
            0 | 2 => false,
            1 => true,
            _ => pick(1) < 0.45,
        };
        let grip = match (bad, mixed(seed, 2, number) % 3) {
            (false, _) => Grip::Firm,
            (true, 0) => Grip::OffCentre,
            (true, 1) => Grip::OneSided,
            (true, _) => Grip::Shallow,
        };
        let lean = if pick(3) < 0.5 { -1.0 } else { 1.0 };
        let (left_mm, right_mm) = match grip {
            Grip::Firm | Grip::OffCentre => (1.35 + 0.2 * pick(4), 1.35 + 0.2 * pick(5)),
            Grip::OneSided if lean < 0.0 => (1.0 + 0.2 * pick(4), 0.22),
            Grip::OneSided => (0.22, 1.0 + 0.2 * pick(5)),
            Grip::Shallow => (0.36 + 0.1 * pick(4), 0.36 + 0.1 * pick(5)),
        };
        let offset_mm = match grip {
            Grip::OffCentre => [lean * (6.5 + 1.0 * pick(6)), 4.6 + 1.0 * pick(7)],
            _ => [2.0 * around(6), 1.6 * around(7)],
        };
        let angle_rad = 0.35 * around(8);
        let aside_m = match grip {
            Grip::OneSided => lean * 0.004,
            _ => 0.001 * around(9),
        };
        Self {
            number,
            object,
            grip,
            left: GelContact {
                depth_mm: left_mm,
                offset_mm,
                angle_rad,
            },
            // The gels face each other: what is right of one is left of the other.
            right: GelContact {
                depth_mm: right_mm,
                offset_mm: [
                    -offset_mm[0] + 0.4 * around(10),
                    offset_mm[1] + 0.4 * around(11),
                ],
                angle_rad: -angle_rad + 0.05 * around(12),
            },
            aside_m,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_demonstration_begins_firm_bad_firm() {
        for seed in 0..20 {
            let holds = [0, 1, 2].map(|number| VirtualGrasp::new(seed, number).grip.holds());
            assert_eq!(holds, [true, false, true]);
        }
        assert_eq!(VirtualGrasp::new(3, 0).object, VirtualObject::Mug);
        assert_eq!(VirtualGrasp::new(3, 7).object, VirtualObject::TapeRoll);
    }

    #[test]
    fn later_grasps_are_mixed_and_repeatable() {
        let firm = (3..203)
            .filter(|number| VirtualGrasp::new(1, *number).grip.holds())
            .count();
        assert!((80..140).contains(&firm), "{firm} of 200 firm");
        assert_eq!(VirtualGrasp::new(1, 50), VirtualGrasp::new(1, 50));
    }

    #[test]
    fn reliefs_touch_at_zero_and_rise_outwards() {
        for object in VirtualObject::ALL {
            let nearest = object.relief_mm(0.0, 0.0);
            assert!(nearest.abs() < 1e-12, "{}", object.name());
            assert!(object.relief_mm(14.0, 0.0) > 3.0, "{}", object.name());
        }
    }
}
