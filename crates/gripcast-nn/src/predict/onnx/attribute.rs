//! Attributes of ONNX nodes.

use tract_onnx::pb::{AttributeProto, attribute_proto::AttributeType};

/// A named attribute of a node.
#[derive(Clone, Debug, PartialEq)]
pub struct Attribute(AttributeProto);

impl Attribute {
    /// An integer, for instance `axis`.
    pub fn int(name: &str, value: i64) -> Self {
        Self(AttributeProto {
            i: value,
            ..Self::empty(name, AttributeType::Int)
        })
    }

    /// A list of integers, for instance `kernel_shape`.
    pub fn ints(name: &str, values: &[i64]) -> Self {
        Self(AttributeProto {
            ints: values.to_vec(),
            ..Self::empty(name, AttributeType::Ints)
        })
    }

    pub(super) fn into_proto(self) -> AttributeProto {
        self.0
    }

    fn empty(name: &str, kind: AttributeType) -> AttributeProto {
        AttributeProto {
            name: name.to_owned(),
            r#type: kind as i32,
            ..AttributeProto::default()
        }
    }
}
