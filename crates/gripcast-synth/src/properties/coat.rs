//! What the surface of a material can look like: bare, painted, printed.

use super::look::FinishClass::{
    self, Ceramic, Fabric, Glass, Metal, Organic, Paper, Plastic, Print, Rubber, Stone, Wood,
};
use super::look::PatternWord::{
    self, Brushed, Cracked, Dotted, Grain, Knitted, Marbled, Mottled, Plain, Printed, Rusty,
    Scratched, Speckled, Striped, Worn, Woven,
};

/// A kind of surface; each of its states goes with each of its shades.
#[derive(Debug, PartialEq)]
pub(super) struct Coat {
    /// How it reflects light.
    pub finish: FinishClass,
    /// Word after state and shade; empty where the shade names the material.
    pub noun: &'static str,
    /// States: word, pattern, roughness.
    pub states: &'static [(&'static str, PatternWord, f32)],
    /// Shades: word, colour as sRGB 0xRRGGBB.
    pub shades: &'static [Shade],
}

/// A colour word and its colour, sRGB 0xRRGGBB.
pub(super) type Shade = (&'static str, u32);

/// Colours of paint, dye and pigment.
pub(super) const COLOURS: &[Shade] = &[
    ("white", 0xE8E8E4),
    ("cream", 0xE6DAB8),
    ("grey", 0x8A8C8E),
    ("black", 0x1E1E20),
    ("red", 0xB3261E),
    ("dark red", 0x6E1A1A),
    ("orange", 0xD9701E),
    ("yellow", 0xE0B81F),
    ("lime", 0x93B81F),
    ("green", 0x2F7A3A),
    ("olive", 0x6A6B2E),
    ("teal", 0x1F7F7C),
    ("light blue", 0x86B4D6),
    ("blue", 0x2456A6),
    ("navy", 0x1C2A52),
    ("purple", 0x5F3A84),
    ("pink", 0xDB8FA6),
    ("brown", 0x6B4428),
    ("beige", 0xC9B48E),
];

pub(super) const WOOD: Coat = Coat {
    finish: Wood,
    noun: "",
    states: &[
        ("raw", Grain, 0.75),
        ("varnished", Grain, 0.30),
        ("oiled", Grain, 0.50),
        ("weathered", Worn, 0.80),
        ("scratched", Scratched, 0.60),
    ],
    shades: WOODS,
};

/// Kinds of wood.
pub(super) const WOODS: &[Shade] = &[
    ("light oak", 0xC4A26E),
    ("dark oak", 0x7A5634),
    ("beech", 0xD0A878),
    ("pine", 0xD8B882),
    ("walnut", 0x5E4130),
    ("cherry", 0x9A5B3A),
    ("maple", 0xDCC39A),
];

pub(super) const PAINTED_WOOD: Coat = Coat {
    finish: Plastic,
    noun: "painted wood",
    states: &[
        ("glossy", Plain, 0.25),
        ("matte", Plain, 0.65),
        ("chipped", Worn, 0.55),
    ],
    shades: COLOURS,
};

pub(super) const BAMBOO: Coat = Coat {
    finish: Wood,
    noun: "bamboo",
    states: &[
        ("polished", Grain, 0.35),
        ("raw", Grain, 0.65),
        ("worn", Worn, 0.70),
    ],
    shades: &[("pale", 0xD9C48F), ("golden", 0xBF9A56), ("dark", 0x7C5A34)],
};

pub(super) const CORK: Coat = Coat {
    finish: Organic,
    noun: "cork",
    states: &[
        ("fine", Speckled, 0.85),
        ("coarse", Mottled, 0.90),
        ("pressed", Speckled, 0.80),
    ],
    shades: &[("light", 0xC49B6A), ("brown", 0x94683F)],
};

pub(super) const STEEL: Coat = Coat {
    finish: Metal,
    noun: "steel",
    states: &[
        ("polished", Plain, 0.15),
        ("brushed", Brushed, 0.35),
        ("scratched", Scratched, 0.35),
        ("rust-spotted", Rusty, 0.60),
    ],
    shades: &[("bright", 0xC6C6C8), ("grey", 0x9A9C9F), ("dark", 0x6E7074)],
};

pub(super) const IRON: Coat = Coat {
    finish: Metal,
    noun: "iron",
    states: &[
        ("cast", Mottled, 0.65),
        ("rusty", Rusty, 0.80),
        ("oiled", Plain, 0.45),
    ],
    shades: &[("grey", 0x5E6063), ("black", 0x333437)],
};

pub(super) const ALUMINIUM: Coat = Coat {
    finish: Metal,
    noun: "aluminium",
    states: &[
        ("brushed", Brushed, 0.35),
        ("satin", Plain, 0.45),
        ("scratched", Scratched, 0.40),
        ("polished", Plain, 0.18),
    ],
    shades: &[
        ("bare", 0xD2D3D4),
        ("grey anodised", 0x8E9196),
        ("blue anodised", 0x5272A8),
    ],
};

pub(super) const BRASS: Coat = Coat {
    finish: Metal,
    noun: "brass",
    states: &[
        ("polished", Plain, 0.15),
        ("brushed", Brushed, 0.35),
        ("tarnished", Rusty, 0.55),
        ("scratched", Scratched, 0.35),
    ],
    shades: &[("yellow", 0xD9B45E), ("aged", 0xA6813F)],
};

pub(super) const COPPER: Coat = Coat {
    finish: Metal,
    noun: "copper",
    states: &[
        ("polished", Plain, 0.15),
        ("hammered", Mottled, 0.30),
        ("tarnished", Rusty, 0.55),
        ("brushed", Brushed, 0.35),
    ],
    shades: &[("bright", 0xE09A74), ("aged", 0x8C5438)],
};

pub(super) const ENAMEL: Coat = Coat {
    finish: Ceramic,
    noun: "enamel",
    states: &[
        ("glossy", Plain, 0.12),
        ("scratched", Scratched, 0.30),
        ("chipped", Worn, 0.30),
        ("speckled", Speckled, 0.18),
    ],
    shades: COLOURS,
};

pub(super) const POWDER_COAT: Coat = Coat {
    finish: Plastic,
    noun: "powder coat",
    states: &[
        ("matte", Speckled, 0.60),
        ("satin", Plain, 0.40),
        ("worn", Worn, 0.55),
    ],
    shades: COLOURS,
};

pub(super) const PLASTIC: Coat = Coat {
    finish: Plastic,
    noun: "plastic",
    states: &[
        ("glossy", Plain, 0.15),
        ("matte", Plain, 0.55),
        ("scratched", Scratched, 0.40),
        ("grained", Speckled, 0.50),
        ("striped", Striped, 0.40),
    ],
    shades: COLOURS,
};

pub(super) const CLEAR_PLASTIC: Coat = Coat {
    finish: Glass,
    noun: "transparent plastic",
    states: &[
        ("clear", Plain, 0.03),
        ("frosted", Plain, 0.40),
        ("scratched", Scratched, 0.15),
    ],
    shades: TINTS,
};

pub(super) const PTFE: Coat = Coat {
    finish: Plastic,
    noun: "PTFE",
    states: &[
        ("smooth", Plain, 0.35),
        ("machined", Brushed, 0.45),
        ("stained", Mottled, 0.50),
    ],
    shades: &[("white", 0xECECE8), ("ivory", 0xE0DAC6)],
};

pub(super) const GLAZE: Coat = Coat {
    finish: Ceramic,
    noun: "glaze",
    states: &[
        ("glossy", Plain, 0.10),
        ("matte", Plain, 0.50),
        ("speckled", Speckled, 0.25),
        ("crackled", Cracked, 0.15),
        ("striped", Striped, 0.15),
        ("dotted", Dotted, 0.15),
    ],
    shades: COLOURS,
};

/// Colours of clear things.
pub(super) const TINTS: &[Shade] = &[
    ("colourless", 0xF6FAF8),
    ("green", 0x8CC29A),
    ("blue", 0x8FB4DC),
    ("amber", 0xC98A3A),
    ("smoky", 0x8A8580),
];

pub(super) const GLASS: Coat = Coat {
    finish: Glass,
    noun: "glass",
    states: &[
        ("clear", Plain, 0.0),
        ("frosted", Plain, 0.35),
        ("scratched", Scratched, 0.10),
    ],
    shades: TINTS,
};

pub(super) const RUBBER: Coat = Coat {
    finish: Rubber,
    noun: "rubber",
    states: &[
        ("smooth", Plain, 0.55),
        ("matte", Plain, 0.80),
        ("dusty", Mottled, 0.90),
        ("worn", Worn, 0.75),
    ],
    shades: COLOURS,
};

pub(super) const FOAM: Coat = Coat {
    finish: Rubber,
    noun: "foam",
    states: &[
        ("fine", Speckled, 0.95),
        ("coarse", Mottled, 0.95),
        ("crumbled", Worn, 0.95),
    ],
    shades: COLOURS,
};

pub(super) const KRAFT: Coat = Coat {
    finish: Paper,
    noun: "cardboard",
    states: &[
        ("plain", Plain, 0.85),
        ("corrugated", Striped, 0.85),
        ("scuffed", Worn, 0.90),
    ],
    shades: &[("brown", 0xB08D5E), ("grey", 0x9C968C), ("white", 0xDEDAD0)],
};

pub(super) const CARTON: Coat = Coat {
    finish: Print,
    noun: "printed carton",
    states: &[
        ("glossy", Printed, 0.25),
        ("matte", Printed, 0.60),
        ("scuffed", Printed, 0.70),
    ],
    shades: COLOURS,
};

pub(super) const PAPER: Coat = Coat {
    finish: Paper,
    noun: "paper",
    states: &[
        ("smooth", Plain, 0.80),
        ("crumpled", Mottled, 0.90),
        ("recycled", Speckled, 0.90),
    ],
    shades: &[
        ("white", 0xE6E5E0),
        ("cream", 0xE3D8B9),
        ("brown", 0xA98A5F),
    ],
};

pub(super) const CLOTH: Coat = Coat {
    finish: Fabric,
    noun: "cloth",
    states: &[
        ("woven", Woven, 0.90),
        ("knitted", Knitted, 0.95),
        ("striped", Striped, 0.90),
        ("faded", Worn, 0.95),
        ("dotted", Dotted, 0.90),
    ],
    shades: COLOURS,
};

pub(super) const LEATHER: Coat = Coat {
    finish: Organic,
    noun: "leather",
    states: &[
        ("smooth", Plain, 0.45),
        ("grained", Speckled, 0.55),
        ("cracked", Cracked, 0.65),
    ],
    shades: &[
        ("tan", 0xA8703F),
        ("brown", 0x5F3B25),
        ("black", 0x262322),
        ("red", 0x7C2A22),
    ],
};

pub(super) const WAX: Coat = Coat {
    finish: Plastic,
    noun: "wax",
    states: &[
        ("smooth", Plain, 0.40),
        ("marbled", Marbled, 0.45),
        ("dusty", Mottled, 0.65),
    ],
    shades: COLOURS,
};

pub(super) const SOAP: Coat = Coat {
    finish: Plastic,
    noun: "soap",
    states: &[
        ("smooth", Plain, 0.45),
        ("marbled", Marbled, 0.45),
        ("cracked", Cracked, 0.60),
    ],
    shades: &[
        ("white", 0xEAE8DE),
        ("pink", 0xE3B3BC),
        ("green", 0xA9C49A),
        ("honey", 0xCF9F55),
    ],
};

pub(super) const CLAY: Coat = Coat {
    finish: Rubber,
    noun: "modelling clay",
    states: &[
        ("smooth", Plain, 0.70),
        ("mixed", Marbled, 0.70),
        ("dented", Mottled, 0.75),
    ],
    shades: COLOURS,
};

pub(super) const STONE: Coat = Coat {
    finish: Stone,
    noun: "",
    states: &[
        ("polished", Marbled, 0.20),
        ("rough", Speckled, 0.80),
        ("weathered", Mottled, 0.85),
    ],
    shades: &[
        ("grey granite", 0x8B8986),
        ("white marble", 0xDDDAD4),
        ("black slate", 0x3A3D40),
        ("sandstone", 0xC2A47A),
        ("red granite", 0x8E5A4C),
    ],
};

pub(super) const CONCRETE: Coat = Coat {
    finish: Stone,
    noun: "concrete",
    states: &[
        ("smooth", Mottled, 0.70),
        ("porous", Speckled, 0.90),
        ("cracked", Cracked, 0.85),
    ],
    shades: &[
        ("light", 0xB8B5AE),
        ("grey", 0x8D8B86),
        ("stained", 0x7A746A),
    ],
};

pub(super) const PEEL: Coat = Coat {
    finish: Organic,
    noun: "",
    states: &[
        ("ripe", Plain, 0.40),
        ("spotted", Speckled, 0.50),
        ("bruised", Mottled, 0.55),
    ],
    shades: &[
        ("red apple peel", 0xA3241F),
        ("green apple peel", 0x8FAE3A),
        ("orange peel", 0xDC7F1E),
        ("lemon peel", 0xE3C42A),
        ("plum skin", 0x4A2440),
        ("potato skin", 0xA98555),
    ],
};

pub(super) const CHOCOLATE: Coat = Coat {
    finish: Organic,
    noun: "chocolate",
    states: &[
        ("glossy", Plain, 0.30),
        ("bloomed", Mottled, 0.60),
        ("cracked", Cracked, 0.50),
    ],
    shades: &[("dark", 0x3A2318), ("milk", 0x6E4526), ("white", 0xE8DDBE)],
};
