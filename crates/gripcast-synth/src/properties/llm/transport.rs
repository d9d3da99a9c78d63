//! One question over HTTP.

use std::io;
use std::time::Duration;

use serde_json::{Value, json};
use ureq::http::HeaderValue;
use ureq::http::header::{AUTHORIZATION, HeaderMap, LOCATION, RETRY_AFTER};
use ureq::{Agent, Body};

use super::endpoint::Endpoint;
use super::key::EndpointKey;
use gripcast_base::error::{Error, ErrorKind, Result};

/// Longest reply that is read, bytes.
const MAX_BYTES: u64 = 1 << 20;
/// Longest text of a reply that an error repeats, characters.
const MAX_QUOTE: usize = 200;

/// Why there is no answer.
#[derive(Debug)]
pub(super) enum Failure {
    /// It may work later: no connection, a busy or failing server.
    Passing {
        /// What happened.
        what: String,
        /// How long the server asks to wait.
        retry_after: Option<Duration>,
    },
    /// The server answers, but not with an answer of a model.
    Unusable(Error),
    /// It fails again however often it is tried.
    Final(Error),
}

/// Posts questions.
pub(super) struct Transport {
    agent: Agent,
    endpoint: Endpoint,
    key: Option<EndpointKey>,
}

impl Transport {
    /// # Errors
    /// `Usage` for a key that would go over the network unencrypted.
    pub(super) fn new(
        endpoint: Endpoint,
        key: Option<EndpointKey>,
        timeout: Duration,
    ) -> Result<Self> {
        if key.is_some() && !endpoint.encrypted && !endpoint.local {
            return Err(Error::usage("the key would go over the network unencrypted")
            .at(&endpoint.url)
            .remedy(
                "use https, a tunnel to localhost (ssh -L), or leave the variable of the key empty",
            ));
        }
        let mut config = Agent::config_builder()
            .timeout_global(Some(timeout))
            .http_status_as_error(false)
            // A redirected POST loses its body; the error names the new address.
            .max_redirects(0)
            .user_agent(concat!("gripcast/", env!("CARGO_PKG_VERSION")));
        if endpoint.local {
            config = config.proxy(None);
        }
        Ok(Self {
            agent: config.build().new_agent(),
            endpoint,
            key,
        })
    }

    pub(super) fn url(&self) -> &str {
        &self.endpoint.url
    }

    pub(super) fn key(&self) -> Option<&EndpointKey> {
        self.key.as_ref()
    }

    /// The text of a model's answer to one message.
    pub(super) fn ask(&self, model: &str, prompt: &str) -> Result<String, Failure> {
        let question = json!({
            "model": model,
            "messages": [{"role": "user", "content": prompt}],
        });
        let mut request = self
            .agent
            .post(&self.endpoint.url)
            .header("content-type", "application/json");
        if let Some(key) = &self.key {
            let text = format!("Bearer {}", key.reveal());
            // The error would have the text in it.
            let mut value = HeaderValue::from_str(&text)
                .map_err(|_| Failure::Final(Error::config("the key cannot be sent")))?;
            value.set_sensitive(true);
            request = request.header(AUTHORIZATION, value);
        }
        let sent = request.send(question.to_string().as_bytes());
        let (parts, body) = sent.map_err(|e| self.unsent(&e))?.into_parts();
        let text = self.text(body)?;
        let status = parts.status.as_u16();
        match status {
            200..=299 => self.content(&text),
            408 | 425 | 429 | 500..=599 => Err(Failure::Passing {
                what: format!("it answers {status}{}", self.explained(&text)),
                retry_after: parts.headers.get(RETRY_AFTER).and_then(seconds),
            }),
            _ => Err(Failure::Final(self.refused(status, &parts.headers, &text))),
        }
    }

    /// A reply as text without the key, which some servers repeat.
    fn text(&self, mut body: Body) -> Result<String, Failure> {
        let read = body.with_config().limit(MAX_BYTES).read_to_vec();
        let bytes = read.map_err(|error| match error {
            ureq::Error::BodyExceedsLimit(_) => Failure::Unusable(
                Error::input(format!("the reply is longer than {MAX_BYTES} bytes"))
                    .remedy("check that the address is that of an OpenAI-compatible endpoint"),
            ),
            other => self.unsent(&other),
        })?;
        Ok(self.hide(&String::from_utf8_lossy(&bytes)))
    }

    fn content(&self, text: &str) -> Result<String, Failure> {
        let reply: Option<Value> = serde_json::from_str(text).ok();
        let content = reply.as_ref().and_then(|r| {
            let message = r.get("choices")?.get(0)?.get("message")?;
            message.get("content")?.as_str()
        });
        // Once more: in JSON the key may be written with escapes.
        content.map(|c| self.hide(c)).ok_or_else(|| {
            Failure::Unusable(
                Error::input(format!(
                    "the reply has no choices[0].message.content{}",
                    self.explained(text)
                ))
                .remedy("check that the address is that of an OpenAI-compatible endpoint"),
            )
        })
    }

    fn unsent(&self, error: &ureq::Error) -> Failure {
        let what = self.hide(&error.to_string());
        match error {
            ureq::Error::BadUri(_) | ureq::Error::Http(_) | ureq::Error::InvalidProxyUrl => {
                Failure::Final(Error::usage(what))
            }
            // Of the encryption: what comes is no TLS, or its certificate is not trusted.
            ureq::Error::Io(e) if e.kind() == io::ErrorKind::InvalidData => Failure::Final(
                Error::config(format!("no secure connection: {what}")).remedy(
                    "use an endpoint with a public certificate, or http through a tunnel to \
                     localhost (ssh -L)",
                ),
            ),
            _ => Failure::Passing {
                what,
                retry_after: None,
            },
        }
    }

    fn refused(&self, status: u16, headers: &HeaderMap, text: &str) -> Error {
        let (kind, remedy) = match status {
            300..=399 => (ErrorKind::Usage, "give the address that it redirects to"),
            401 | 403 => (
                ErrorKind::Permission,
                "set the environment variable of the key to a valid key of this endpoint",
            ),
            404 => (
                ErrorKind::NotFound,
                "check the address (most end with /v1) and the name of the model",
            ),
            _ => (
                ErrorKind::Input,
                "check the name of the model and what the endpoint accepts",
            ),
        };
        let explained = match headers.get(LOCATION).and_then(|l| l.to_str().ok()) {
            Some(address) if kind == ErrorKind::Usage => self.explained(address),
            _ => self.explained(text),
        };
        let what = format!("it refuses the question with {status}{explained}");
        Error::new(kind, what).remedy(remedy)
    }

    /// What a reply says about an error, to be put behind a message.
    fn explained(&self, text: &str) -> String {
        let reply: Option<Value> = serde_json::from_str(text).ok();
        let told = reply.as_ref().and_then(|r| {
            let error = r.get("error")?;
            error.get("message").unwrap_or(error).as_str()
        });
        let said = self.hide(told.unwrap_or(text));
        let said = said.trim();
        if said.is_empty() {
            return String::new();
        }
        let start: String = said.chars().take(MAX_QUOTE).collect();
        let more = if start.len() < said.len() { " …" } else { "" };
        format!(": {start:?}{more}")
    }

    fn hide(&self, text: &str) -> String {
        self.key
            .as_ref()
            .map_or_else(|| text.to_owned(), |k| k.hide_in(text))
    }
}

/// Whole seconds of a Retry-After header; the form with a date is left to the usual back-off.
fn seconds(value: &HeaderValue) -> Option<Duration> {
    let seconds: u64 = value.to_str().ok()?.trim().parse().ok()?;
    Some(Duration::from_secs(seconds))
}
