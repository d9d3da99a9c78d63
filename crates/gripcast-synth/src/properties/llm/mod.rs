//! Property estimates from a language model behind an OpenAI-compatible endpoint.

mod answer;
mod cache;
mod client;
#[cfg(test)]
mod client_test;
mod endpoint;
mod estimator;
mod key;
mod prompt;
#[cfg(test)]
mod test_server;
mod transport;

pub use client::{LlmClient, LlmOptions, Wait};
pub use estimator::{PropertyEstimator, PropertyQuery};
pub use key::{DEFAULT_KEY_VARIABLE, EndpointKey};
pub use prompt::{physical_prompt, texture_prompt};
