//! Camera files of any structure as a tree: YAML, JSON (a subset of it), and OpenCV's XML.

use std::collections::BTreeMap;
use std::fmt;

use serde::de::{Deserialize, Deserializer, MapAccess, SeqAccess, Visitor};

use gripcast_base::error::{Error, Result};

/// Maximum nesting of XML elements.
const MAX_DEPTH: usize = 16;

/// A value of a file.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Node {
    Null,
    Number(f64),
    Text(String),
    List(Vec<Node>),
    Map(BTreeMap<String, Node>),
}

impl Node {
    /// Entry of a map.
    pub(super) fn get(&self, key: &str) -> Option<&Self> {
        match self {
            Self::Map(entries) => entries.get(key),
            _ => None,
        }
    }

    /// The numbers of nested lists and of texts such as `0.1 -0.2`, row by row; none if it has
    /// anything else.
    pub(super) fn numbers(&self) -> Option<Vec<f64>> {
        match self {
            Self::Number(number) => Some(vec![*number]),
            Self::Text(text) => text
                .split(|c: char| c.is_whitespace() || c == ',')
                .filter(|word| !word.is_empty())
                .map(number)
                .collect(),
            Self::List(items) => {
                let lists: Option<Vec<Vec<f64>>> = items.iter().map(Self::numbers).collect();
                Some(lists?.concat())
            }
            Self::Null | Self::Map(_) => None,
        }
    }

    /// A single number.
    pub(super) fn number(&self) -> Option<f64> {
        match self.numbers()?[..] {
            [number] => Some(number),
            _ => None,
        }
    }

    /// A text; numbers as written by Rust.
    pub(super) fn text(&self) -> Option<String> {
        match self {
            Self::Text(text) => Some(text.trim().to_owned()),
            Self::Number(number) => Some(number.to_string()),
            _ => None,
        }
    }
}

/// A number as YAML and OpenCV write it, `.Nan` and `.Inf` included.
fn number(word: &str) -> Option<f64> {
    match word.to_ascii_lowercase().trim_start_matches(['+', '-']) {
        ".nan" => Some(f64::NAN),
        ".inf" => Some(f64::INFINITY),
        _ => word.parse().ok(),
    }
}

struct NodeVisitor;

impl<'de> Visitor<'de> for NodeVisitor {
    type Value = Node;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a value")
    }

    fn visit_unit<E>(self) -> Result<Node, E> {
        Ok(Node::Null)
    }

    fn visit_none<E>(self) -> Result<Node, E> {
        Ok(Node::Null)
    }

    fn visit_some<D: Deserializer<'de>>(self, deserializer: D) -> Result<Node, D::Error> {
        Node::deserialize(deserializer)
    }

    fn visit_bool<E>(self, value: bool) -> Result<Node, E> {
        Ok(Node::Text(value.to_string()))
    }

    fn visit_i64<E>(self, value: i64) -> Result<Node, E> {
        Ok(Node::Number(value as f64))
    }

    fn visit_u64<E>(self, value: u64) -> Result<Node, E> {
        Ok(Node::Number(value as f64))
    }

    fn visit_f64<E>(self, value: f64) -> Result<Node, E> {
        Ok(Node::Number(value))
    }

    fn visit_str<E>(self, value: &str) -> Result<Node, E> {
        Ok(Node::Text(value.to_owned()))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Node, A::Error> {
        let mut items = Vec::new();
        while let Some(item) = list.next_element()? {
            items.push(item);
        }
        Ok(Node::List(items))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Node, A::Error> {
        let mut entries = BTreeMap::new();
        while let Some((key, value)) = map.next_entry::<Node, Node>()? {
            entries.insert(key.text().unwrap_or_default(), value);
        }
        Ok(Node::Map(entries))
    }
}

impl<'de> Deserialize<'de> for Node {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(NodeVisitor)
    }
}

/// Parses the XML of OpenCV's `FileStorage`: elements without mixed content. Attributes, comments
/// and the declaration are skipped.
///
/// # Errors
/// `Input` for anything else.
pub(super) fn from_xml(text: &str) -> Result<Node> {
    let mut rest = text;
    let mut open: Vec<(String, BTreeMap<String, Node>, String)> = Vec::new();
    let bad = |what: String| Err(Error::input(format!("cannot read the XML: {what}")));
    while let Some((before, tag)) = rest.split_once('<') {
        if let Some((_, _, content)) = open.last_mut() {
            content.push_str(before);
        }
        if let Some(comment) = tag.strip_prefix("!--") {
            rest = comment.split_once("-->").map_or("", |(_, after)| after);
            continue;
        }
        let Some((tag, after)) = tag.split_once('>') else {
            return bad("a tag is not closed".to_owned());
        };
        rest = after;
        if tag.starts_with(['?', '!']) {
            continue;
        }
        let Some(name) = tag.strip_prefix('/') else {
            let name = tag.trim_end_matches('/');
            let name = name
                .split_whitespace()
                .next()
                .unwrap_or_default()
                .to_owned();
            if tag.ends_with('/') {
                let Some((_, entries, _)) = open.last_mut() else {
                    return Ok(Node::Map(BTreeMap::new()));
                };
                entries.insert(name, Node::Null);
            } else if open.len() < MAX_DEPTH {
                open.push((name, BTreeMap::new(), String::new()));
            } else {
                return bad("too many nested elements".to_owned());
            }
            continue;
        };
        let Some((opened, entries, content)) = open.pop() else {
            return bad(format!("`</{name}>` was not opened"));
        };
        if opened != name.trim() {
            return bad(format!("expected `</{opened}>`, found `</{name}>`"));
        }
        let node = if entries.is_empty() {
            Node::Text(content.trim().trim_matches('"').to_owned())
        } else {
            Node::Map(entries)
        };
        match open.last_mut() {
            Some((_, outer, _)) => outer.insert(opened, node),
            None => return Ok(node),
        };
    }
    bad("an element is not closed".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn xml_elements_become_a_tree() {
        let node = from_xml(
            "<?xml version=\"1.0\"?>\n<opencv_storage>\n<!-- a < b -->\n<k type_id=\"m\">\n\
             <rows>1</rows><data>\n 1. -2e-1 .Nan</data></k><s>\"a b\"</s><e/></opencv_storage>",
        )
        .unwrap();
        let data = node
            .get("k")
            .unwrap()
            .get("data")
            .unwrap()
            .numbers()
            .unwrap();
        assert_eq!(data[..2], [1.0, -0.2]);
        assert!(data[2].is_nan());
        assert_eq!(node.get("s").unwrap().text().as_deref(), Some("a b"));
        assert_eq!(node.get("e"), Some(&Node::Null));
        assert_eq!(from_xml("<a/>").unwrap(), Node::Map(BTreeMap::new()));
        for text in ["<a>", "<a></b>", "</a>", "<a", "", &"<a>".repeat(50)] {
            assert!(from_xml(text).is_err(), "{text}");
        }
    }

    #[test]
    fn numbers_are_flattened() {
        let list = Node::List(vec![
            Node::List(vec![Node::Number(1.0), Node::Text("2, 3 4".into())]),
            Node::Number(5.0),
        ]);
        assert_eq!(list.numbers(), Some(vec![1.0, 2.0, 3.0, 4.0, 5.0]));
        assert_eq!(Node::Text("a".into()).numbers(), None);
        assert_eq!(Node::List(vec![Node::Null]).numbers(), None);
    }
}
