//! Properties of objects from a language model, or from the table where that is allowed.

use serde::{Deserialize, Serialize};

use super::answer;
use super::client::{LlmClient, Unanswered};
use super::prompt::{physical_prompt, texture_prompt};
use crate::properties::appearance::builtin_appearances;
use crate::properties::look::Modifier;
use crate::properties::material::Material;
use crate::properties::physical::{PhysicalProperties, PropertySource, estimate};
use gripcast_base::error::{Error, Result};

/// What is known of an object before it is asked about.
#[derive(Clone, Copy, Debug)]
pub struct PropertyQuery<'a> {
    /// Its name, which is different for each object.
    pub object: &'a str,
    /// What it is: `coffee mug`.
    pub category: &'a str,
    /// Texture or material words before the category; may be empty.
    pub texture: &'a str,
    /// Its material in the table.
    pub material: &'static Material,
    /// Largest side of its oriented bounding box, m.
    pub size_m: f64,
    /// Volume inside its mesh, m³.
    pub volume_m3: f64,
    /// Fraction of that volume which is material; none for that of the category.
    pub fill: Option<f64>,
    /// Seed of what is drawn by chance.
    pub seed: u64,
}

/// Five appearances of an object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Appearances {
    /// The appearances.
    pub modifiers: Vec<Modifier>,
    /// Where the words come from.
    pub source: PropertySource,
}

/// Asks a language model about objects, one after the other.
///
/// With `fallback` an object gets its properties from the table when the endpoint does not answer
/// or its answer cannot be used, and its [`PropertySource`] says so; once the endpoint did not
/// answer in all attempts, it is not asked again for the objects that follow. Questions that the
/// endpoint refuses (a wrong key, no such model) are errors even then: they do not fix themselves.
#[derive(Debug)]
pub struct PropertyAsker {
    client: LlmClient,
    fallback: bool,
    /// What happened when the endpoint was last asked in vain.
    down: Option<String>,
}

impl PropertyAsker {
    /// Asks `client`; `fallback` allows the table in its place.
    pub fn new(client: LlmClient, fallback: bool) -> Self {
        Self {
            client,
            fallback,
            down: None,
        }
    }

    /// Mass and friction of an object. Its material, volume and fill matter only for the table.
    ///
    /// # Errors
    /// `Input` for an object that cannot be asked about, or (without fallback) an answer that
    /// cannot be used; `Io` for an endpoint that does not answer; `Permission`, `NotFound` for one
    /// that refuses; those of writing the stored answers.
    pub fn physical(&mut self, query: &PropertyQuery<'_>) -> Result<PhysicalProperties> {
        let prompt = physical_prompt(query.texture, query.category, query.size_m)?;
        match self.answer(&prompt, answer::mass_and_friction)? {
            Ok((mass_kg, friction)) => Ok(PhysicalProperties {
                mass_kg,
                friction,
                source: self.model_source(),
            }),
            Err(why) => {
                let PropertyQuery {
                    category,
                    material,
                    volume_m3,
                    fill,
                    seed,
                    ..
                } = *query;
                let table = estimate(category, material, volume_m3, fill, seed)?;
                Ok(PhysicalProperties {
                    source: PropertySource::Fallback { why },
                    ..table
                })
            }
        }
    }

    /// Five appearances: words of the model for the category, looks by these words.
    ///
    /// # Errors
    /// As [`physical`](Self::physical).
    pub fn appearances(&mut self, query: &PropertyQuery<'_>) -> Result<Appearances> {
        let prompt = texture_prompt(query.category)?;
        Ok(match self.answer(&prompt, answer::appearances)? {
            Ok(words) => Appearances {
                modifiers: words
                    .iter()
                    .map(|words| Modifier::from_words(words, query.material, query.seed))
                    .collect(),
                source: self.model_source(),
            },
            Err(why) => Appearances {
                modifiers: builtin_appearances(query.object, query.material, query.seed),
                source: PropertySource::Fallback { why },
            },
        })
    }

    /// The answer, or why the table takes its place.
    fn answer<T>(
        &mut self,
        prompt: &str,
        read: impl Fn(&str) -> Result<T>,
    ) -> Result<Result<T, String>> {
        if let Some(why) = &self.down {
            let known = self.client.recall(prompt, read)?;
            return Ok(known.ok_or_else(|| why.clone()));
        }
        let unanswered = match self.client.ask(prompt, read) {
            Ok(value) => return Ok(Ok(value)),
            Err(unanswered) => unanswered,
        };
        let is_down = matches!(unanswered, Unanswered::Down(_));
        let may_fall_back = self.fallback && !matches!(unanswered, Unanswered::Other(_));
        let error = Error::from(unanswered);
        if !may_fall_back {
            return Err(error);
        }
        let why = error.what().to_owned();
        if is_down {
            self.down = Some(why.clone());
        }
        Ok(Err(why))
    }

    fn model_source(&self) -> PropertySource {
        PropertySource::Llm {
            model: self.client.model().to_owned(),
        }
    }
}
