//! The paper's prompts (A.1), verbatim.

use gripcast_base::error::{Error, Result};

/// Maximum length of category and texture, characters.
const MAX_NAME: usize = 120;
/// Maximum object size, m.
const MAX_M: f64 = 100.0;

/// Returns the paper's prompt for mass and friction (A.1, Mass and Friction Coefficient).
///
/// `texture` may be empty; the paper's *obj* is the category with its texture. `size_m` is the
/// largest side of the oriented bounding box, m.
///
/// # Errors
/// `Input` for an empty or very long category, or a size that is not positive or above 100 m.
pub fn physical_prompt(texture: &str, category: &str, size_m: f64) -> Result<String> {
    let category = name("category", category)?;
    let object = if texture.trim().is_empty() {
        category
    } else {
        format!("{} {category}", name("texture", texture)?)
    };
    if !(size_m > 0.0 && size_m <= MAX_M) {
        return Err(Error::input(format!(
            "the size must be above 0 and at most {MAX_M} m, found {size_m}"
        ))
        .remedy("check the unit of the mesh"));
    }
    Ok(format!(
        "Hi GPT, you are an expert in estimating mass and friction of everyday objects. Please \
         help me to estimate the mass of {object} of roughly {size_m:.2}m in size and its friction \
         coefficient when contacting with a rubber gel under dry condition.\n\
         In a new line, output the result in JSON format where the keys are \"mass\" in kg and \
         \"friction\" within [0.1, 1.5]. For example,\n\
         ```{{ \"mass\": 0.1, \"friction\": 1.2}}.```"
    ))
}

/// Returns the paper's prompt for textures (A.1, Texture), plus the format of the list.
///
/// # Errors
/// As [`physical_prompt`].
pub fn texture_prompt(category: &str) -> Result<String> {
    let category = name("category", category)?;
    Ok(format!(
        "Generate a list of 5 diverse textures / appearances modifiers for {category}, no \
         additional words, no numbers\n\
         Write one per line."
    ))
}

/// Normalises a name to one line.
fn name(kind: &str, text: &str) -> Result<String> {
    let words: Vec<&str> = text.split_whitespace().collect();
    let joined = words.join(" ");
    let length = joined.chars().count();
    if length == 0 || length > MAX_NAME {
        return Err(Error::input(format!(
            "a {kind} must have 1 to {MAX_NAME} characters, found {length}"
        ))
        .remedy("name the object in one or two words, for instance `coffee mug`"));
    }
    Ok(joined)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prompts_match_the_paper() {
        let prompt = physical_prompt("light oak", "salad bowl", 0.1234).unwrap();
        assert_eq!(
            prompt,
            "Hi GPT, you are an expert in estimating mass and friction of everyday objects. Please \
             help me to estimate the mass of light oak salad bowl of roughly 0.12m in size and its \
             friction coefficient when contacting with a rubber gel under dry condition.\nIn a new \
             line, output the result in JSON format where the keys are \"mass\" in kg and \
             \"friction\" within [0.1, 1.5]. For example,\n```{ \"mass\": 0.1, \"friction\": 1.2}.```"
        );
        let list = texture_prompt(" salad\n bowl ").unwrap();
        assert!(list.starts_with(
            "Generate a list of 5 diverse textures / appearances modifiers for salad bowl, no \
             additional words, no numbers"
        ));
        assert!(
            physical_prompt(" ", "mug", 0.1)
                .unwrap()
                .contains("the mass of mug of")
        );
    }

    #[test]
    fn invalid_queries_are_refused() {
        for (category, size) in [("", 0.1), ("mug", 0.0), ("mug", f64::NAN), ("mug", 1e3)] {
            assert!(
                physical_prompt("", category, size).is_err(),
                "{category:?} {size}"
            );
        }
        assert!(texture_prompt(&"mug ".repeat(100)).is_err());
    }
}
