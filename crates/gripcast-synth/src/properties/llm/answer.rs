//! Parses answers of a language model.

use serde_json::{Deserializer, Map, Value};

use crate::properties::appearance::APPEARANCES;
use crate::properties::physical::{FRICTION_RANGE, is_mass};
use gripcast_base::error::{Error, Result};

/// Maximum length of an answer, bytes; expected answers have about a hundred.
const MAX_BYTES: usize = 64 << 10;
/// Maximum quotation of an answer in an error, characters.
const MAX_QUOTE: usize = 160;
/// Maximum length of a description, characters.
const MAX_DESCRIPTION: usize = 80;

/// Parses mass (kg) and friction: the last JSON object in the text that has both.
///
/// # Errors
/// `Input` for a missing object, a mass that is not positive, a friction outside [0.1, 1.5], or
/// numbers written as text.
pub(super) fn mass_and_friction(text: &str) -> Result<(f64, f64)> {
    let object = last_object(without_reasoning(text)?).ok_or_else(|| {
        unusable(format!(
            "no JSON object with \"mass\" and \"friction\" in {}",
            quote(text, MAX_QUOTE)
        ))
    })?;
    let number = |key: &str| {
        let value = object.get(key).unwrap_or(&Value::Null);
        value.as_f64().filter(|v| v.is_finite()).ok_or_else(|| {
            unusable(format!(
                "\"{key}\" must be a number, found {}",
                quote(&value.to_string(), MAX_QUOTE)
            ))
        })
    };
    let (mass, friction) = (number("mass")?, number("friction")?);
    if !is_mass(mass) {
        return Err(unusable(format!(
            "the mass must be above 0 kg, found {mass}"
        )));
    }
    let [low, high] = FRICTION_RANGE;
    if !(low..=high).contains(&friction) {
        return Err(unusable(format!(
            "the friction must be from {low} to {high}, found {friction}"
        )));
    }
    Ok((mass, friction))
}

/// Parses a list of five descriptions: a JSON array, one per line, or separated by commas; bullets,
/// numbers and quotation marks are removed.
///
/// # Errors
/// `Input` unless there are exactly five different ones.
pub(super) fn appearances(text: &str) -> Result<Vec<String>> {
    let list = without_reasoning(text)?;
    let mut found: Vec<String> = Vec::new();
    for entry in entries(list) {
        let entry = undecorated(&entry);
        let is_duplicate = found.iter().any(|f| f.eq_ignore_ascii_case(&entry));
        if !entry.is_empty() && !is_duplicate {
            found.push(entry);
        }
    }
    let fits = |m: &String| m.chars().count() <= MAX_DESCRIPTION;
    if found.len() == APPEARANCES && found.iter().all(fits) {
        return Ok(found);
    }
    Err(unusable(format!(
        "expected {APPEARANCES} different appearances of at most {MAX_DESCRIPTION} characters, \
         found {} in {}",
        found.len(),
        quote(text, MAX_QUOTE)
    )))
}

/// Removes the reasoning in front of an answer.
fn without_reasoning(text: &str) -> Result<&str> {
    if text.len() > MAX_BYTES {
        return Err(unusable(format!(
            "the answer must have at most {MAX_BYTES} bytes, found {}",
            text.len()
        )));
    }
    Ok(text.rsplit("</think>").next().unwrap_or(text))
}

fn last_object(text: &str) -> Option<Map<String, Value>> {
    let starts = text.rmatch_indices('{');
    starts.map(|(start, _)| &text[start..]).find_map(|rest| {
        let first = Deserializer::from_str(rest).into_iter::<Value>().next();
        match first {
            Some(Ok(Value::Object(map)))
                if map.contains_key("mass") && map.contains_key("friction") =>
            {
                Some(map)
            }
            _ => None,
        }
    })
}

fn entries(text: &str) -> Vec<String> {
    let array = text.find('[').and_then(|start| {
        let mut values = Deserializer::from_str(&text[start..]).into_iter::<Vec<String>>();
        values.next().and_then(std::result::Result::ok)
    });
    if let Some(array) = array {
        return array;
    }
    let is_entry = |line: &&str| {
        let line = line.trim();
        // Skips code fences and a sentence before the list.
        !line.is_empty() && !line.starts_with("```") && !line.ends_with(':')
    };
    let lines: Vec<&str> = text.lines().filter(is_entry).collect();
    match lines.as_slice() {
        [one] => one.split([',', ';']).map(str::to_owned).collect(),
        lines => lines.iter().map(|&l| l.to_owned()).collect(),
    }
}

/// Removes bullet, number, quotation marks and full stop.
fn undecorated(entry: &str) -> String {
    let decoration = |c: char| {
        c.is_whitespace() || c.is_control() || c.is_ascii_digit() || "-*•.,;)(\"'`_".contains(c)
    };
    let words: Vec<&str> = entry.trim_matches(decoration).split_whitespace().collect();
    words.join(" ")
}

/// Quotes at most `max` characters of a text.
pub(super) fn quote(text: &str, max: usize) -> String {
    let start: String = text.chars().take(max).collect();
    let more = if start.len() < text.len() { " …" } else { "" };
    format!("{start:?}{more}")
}

fn unusable(what: String) -> Error {
    Error::input(format!("unusable answer: {what}")).remedy(
        "use another model, or allow the table of materials instead of its answers \
         (--llm-fallback)",
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_base::error::ErrorKind;

    #[test]
    fn json_is_found_anywhere_in_the_text() {
        for text in [
            r#"{"mass": 0.25, "friction": 0.8}"#,
            "A mug of that size weighs …\n```json\n{ \"mass\": 0.25, \"friction\": 0.8}.\n```\n",
            r#"Sure {not json}! {"result": {"friction": 0.8, "mass": 0.25, "unit": "kg"}} Bye}"#,
            r#"As in {"mass": 0.1, "friction": 1.2}, so {"mass": 0.25, "friction": 0.8}."#,
            r#"<think>{"mass": 9, "friction": 1}</think>{"mass": 2.5e-1, "friction": 0.80}"#,
        ] {
            assert_eq!(mass_and_friction(text).unwrap(), (0.25, 0.8), "{text}");
        }
    }

    #[test]
    fn unusable_numbers_are_refused() {
        for (text, found) in [
            ("I cannot say.", "I cannot say."),
            ("", "no JSON object"),
            ("{\"mass\": 0.1", "no JSON object"),
            ("{\"mass\": 0.1}", "no JSON object"),
            ("[0.1, 1.2]", "no JSON object"),
            (r#"{"mass": 0, "friction": 1}"#, "found 0"),
            (r#"{"mass": -2, "friction": 1}"#, "found -2"),
            (r#"{"mass": 1, "friction": 0.05}"#, "found 0.05"),
            (r#"{"mass": 1, "friction": 1.6}"#, "found 1.6"),
            (r#"{"mass": "1 kg", "friction": 1}"#, "1 kg"),
            (r#"{"mass": null, "friction": 1}"#, "null"),
            (r#"{"mass": 1e999, "friction": 1}"#, "no JSON object"),
        ] {
            let error = mass_and_friction(text).unwrap_err();
            assert_eq!(error.kind(), ErrorKind::Input);
            assert!(error.to_string().contains(found), "{text}: {error}");
        }
        let long = mass_and_friction(&"x".repeat(MAX_BYTES + 1)).unwrap_err();
        assert!(long.to_string().contains("65537"), "{long}");
        assert!(mass_and_friction(&"{".repeat(MAX_BYTES)).is_err());
        assert!(mass_and_friction(&"{\"a\":[".repeat(9_000)).is_err());
    }

    #[test]
    fn lists_are_parsed_in_any_form() {
        let expected = [
            "Glossy red",
            "Matte black",
            "Light oak",
            "Brushed steel",
            "Blue-white",
        ];
        for text in [
            "Glossy red\nMatte black\nLight oak\nBrushed steel\nBlue-white\n",
            "- Glossy red\n- Matte black\n- Light oak\n- Brushed steel\n- Blue-white",
            "Here are five:\n\n1. Glossy red\n2. Matte black\n3) Light oak\n4. \"Brushed steel\",\n\
             5. *Blue-white*.",
            "Glossy red, Matte black, Light oak, Brushed steel, Blue-white",
            "```json\n[\"Glossy red\", \"Matte black\",\n\"Light oak\", \"Brushed steel\",\
             \"Blue-white\"]\n```",
        ] {
            assert_eq!(appearances(text).unwrap(), expected, "{text}");
        }
    }

    #[test]
    fn unexpected_lists_are_refused() {
        let long = format!("a\nb\nc\nd\n{}", "e".repeat(81));
        for text in [
            "",
            "Red",
            "a\nb\nc\nd",
            "a\nb\nc\nd\ne\nf",
            "a\nA\nb\nc\nd",
            &long,
        ] {
            let error = appearances(text).unwrap_err();
            assert!(error.to_string().contains("expected 5"), "{text}: {error}");
        }
    }
}
