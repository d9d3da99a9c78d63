//! Properties of objects from a language model, with the table of materials as a fallback.

use super::answer;
use super::client::{AskError, LlmClient};
use super::prompt::{physical_prompt, texture_prompt};
use crate::properties::appearance::{DescribedAppearance, builtin_appearances};
use crate::properties::material::Material;
use crate::properties::physical::{PhysicalProperties, PropertySource, estimate};
use gripcast_base::error::{Error, Result};

/// Known facts about an object whose properties are estimated.
#[derive(Clone, Copy, Debug)]
pub struct PropertyQuery<'a> {
    /// Unique name.
    pub object: &'a str,
    /// Category, for instance `coffee mug`.
    pub category: &'a str,
    /// Texture or material words before the category; may be empty.
    pub texture: &'a str,
    /// Material in the table.
    pub material: &'static Material,
    /// Longest side of its oriented bounding box, m.
    pub size_m: f64,
    /// Volume inside its mesh, m³.
    pub volume_m3: f64,
    /// Fraction of that volume which is material; none for the default of the category.
    pub fill: Option<f64>,
    /// Random seed.
    pub seed: u64,
}

/// Estimates properties of objects with a language model, one object after the other.
///
/// With `fallback` an object gets its properties from the table if the endpoint does not answer or
/// its answer is unusable; its [`PropertySource`] records that. Once the endpoint failed in all
/// attempts, it is not asked again for the following objects. Requests that the endpoint refuses
/// (an invalid key, an unknown model) are errors even with `fallback`, since retrying does not
/// help.
#[derive(Debug)]
pub struct PropertyEstimator {
    client: LlmClient,
    fallback: bool,
    /// Why the endpoint is considered down.
    down: Option<String>,
}

impl PropertyEstimator {
    /// Creates an estimator; `fallback` allows the table of materials instead of the model.
    pub fn new(client: LlmClient, fallback: bool) -> Self {
        Self {
            client,
            fallback,
            down: None,
        }
    }

    /// Estimates mass and friction of an object. Its material, volume and fill only matter for the
    /// table.
    ///
    /// # Errors
    /// `Input` for an invalid query, or (without fallback) an unusable answer; `Io` if the endpoint
    /// does not answer; `Permission`, `NotFound` if it refuses; errors of writing the cache.
    pub fn physical(&mut self, query: &PropertyQuery<'_>) -> Result<PhysicalProperties> {
        let prompt = physical_prompt(query.texture, query.category, query.size_m)?;
        match self.answer(&prompt, answer::mass_and_friction)? {
            Ok((mass_kg, friction)) => Ok(PhysicalProperties {
                mass_kg,
                friction,
                source: PropertySource::Llm {
                    model: self.client.model().to_owned(),
                },
            }),
            Err(reason) => {
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
                    source: PropertySource::Fallback { reason },
                    ..table
                })
            }
        }
    }

    /// Returns five appearances of an object: descriptions by the model, interpreted for rendering.
    ///
    /// # Errors
    /// As [`physical`](Self::physical).
    pub fn appearances(&mut self, query: &PropertyQuery<'_>) -> Result<Vec<DescribedAppearance>> {
        let prompt = texture_prompt(query.category)?;
        Ok(match self.answer(&prompt, answer::appearances)? {
            Ok(descriptions) => descriptions
                .iter()
                .map(|text| DescribedAppearance::from_words(text, query.material, query.seed))
                .collect(),
            Err(_) => builtin_appearances(query.object, query.material, query.seed),
        })
    }

    /// Returns the answer, or why the table has to be used.
    fn answer<T>(
        &mut self,
        prompt: &str,
        parse: impl Fn(&str) -> Result<T>,
    ) -> Result<Result<T, String>> {
        if let Some(reason) = &self.down {
            let cached = self.client.cached(prompt, parse)?;
            return Ok(cached.ok_or_else(|| reason.clone()));
        }
        let error = match self.client.ask(prompt, parse) {
            Ok(value) => return Ok(Ok(value)),
            Err(error) => error,
        };
        let is_down = matches!(error, AskError::Down(_));
        let may_fall_back = self.fallback && !matches!(error, AskError::Other(_));
        let error = Error::from(error);
        if !may_fall_back {
            return Err(error);
        }
        let reason = error.what().to_owned();
        if is_down {
            self.down = Some(reason.clone());
        }
        Ok(Err(reason))
    }
}
