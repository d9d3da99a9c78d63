//! Questions to a language model behind an OpenAI-compatible endpoint.

mod answer;
mod asker;
mod cache;
mod client;
#[cfg(test)]
mod client_test;
mod endpoint;
mod key;
mod prompt;
#[cfg(test)]
mod test_server;
mod transport;

pub use asker::{Appearances, PropertyAsker, PropertyQuery};
pub use client::{LlmClient, LlmOptions, Wait};
pub use key::{DEFAULT_KEY_VARIABLE, EndpointKey};
pub use prompt::{physical_prompt, texture_prompt};
