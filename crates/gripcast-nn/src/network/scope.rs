//! Settings of a training step: dropout and the parameters that it changes.

use crate::architecture::{EncoderKind, HeadParams, Layout, Param};
use crate::predict::contract::Modality;

/// Inputs of a training step besides the data.
#[derive(Clone, Debug, Default)]
pub struct Step {
    /// Number of previous steps.
    pub number: u64,
    /// Dropout factors of the hidden units of each sample; empty for no dropout.
    pub dropout: Vec<f32>,
    /// What the step changes.
    pub scope: Scope,
}

impl Step {
    /// Dropout factors of a hidden layer; none for one that reads the extents, whose units stand
    /// for a quantity each.
    pub(super) fn dropout_of(&self, hidden: &[f32]) -> &[f32] {
        match self.dropout.len() == hidden.len() {
            true => &self.dropout,
            false => &[],
        }
    }
}

/// What training changes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scope {
    /// All parameters and the running statistics; normalises with the statistics of the batch.
    #[default]
    All,
    /// All parameters; normalises with the running statistics, which stay as they are.
    FixedStats,
    /// The hidden and the output layer; the encoders and their statistics stay as they are.
    Head,
    /// The encoders of camera images, for the geometry alone.
    Geometry,
    /// The encoder of tactile differences, for the contact maps alone.
    Contact,
    /// The encoder of tactile differences, for the labels and contact maps, and the head that reads
    /// it alone.
    Touch,
}

impl Scope {
    /// Returns the parameters that training changes.
    pub fn params(self, layout: &Layout) -> impl Iterator<Item = &Param> {
        let encoders = layout.encoders.iter();
        let encoders = encoders.filter(move |encoder| self.trains(encoder.kind));
        let heads = layout.heads.iter();
        let heads = heads.filter(move |head| self.trains_head(head));
        let heads = heads.flat_map(HeadParams::params);
        let contact = layout.contact.iter().filter(move |_| self.trains_contact());
        // The contact maps are read before the projection.
        let reads_all = self != Self::Contact;
        let encoders = encoders.flat_map(move |encoder| {
            let projection = encoder.projection.iter().filter(move |_| reads_all);
            encoder.convolutions.iter().flatten().chain(projection)
        });
        encoders.chain(heads).chain(contact.flatten())
    }

    /// Whether it changes what reads the contact maps.
    pub(super) fn trains_contact(self) -> bool {
        matches!(self, Self::All | Self::Contact | Self::Touch)
    }

    /// Whether it changes a head.
    pub(super) fn trains_head(self, head: &HeadParams) -> bool {
        match self {
            Self::Geometry | Self::Contact => false,
            Self::All => !head.reads_extents,
            Self::Touch => head.modality == Modality::T,
            Self::FixedStats | Self::Head => true,
        }
    }

    /// Whether it changes an encoder.
    pub(super) fn trains(self, kind: EncoderKind) -> bool {
        match self {
            Self::All | Self::FixedStats => true,
            Self::Head => false,
            Self::Geometry => kind != EncoderKind::Touch,
            Self::Contact | Self::Touch => kind == EncoderKind::Touch,
        }
    }

    /// Whether it normalises an encoder with the statistics of the batch.
    pub(super) fn is_of_batch(self, kind: EncoderKind) -> bool {
        self.trains(kind) && self != Self::FixedStats
    }

    /// Whether it runs an encoder.
    pub(super) fn uses(self, kind: EncoderKind) -> bool {
        match self {
            Self::All | Self::FixedStats | Self::Head => true,
            Self::Geometry | Self::Contact | Self::Touch => self.trains(kind),
        }
    }
}
