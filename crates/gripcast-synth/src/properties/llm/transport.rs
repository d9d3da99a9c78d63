//! One request over HTTP.

use std::io;
use std::time::Duration;

use serde_json::{Value, json};
use ureq::http::HeaderValue;
use ureq::http::header::{AUTHORIZATION, HeaderMap, LOCATION, RETRY_AFTER};
use ureq::{Agent, Body};

use super::answer::quote;
use super::endpoint::Endpoint;
use super::key::EndpointKey;
use gripcast_base::error::{Error, ErrorKind, Result};

/// Maximum length of a reply, bytes.
const MAX_BYTES: u64 = 1 << 20;
/// Maximum quotation of a reply in an error, characters.
const MAX_QUOTE: usize = 200;

/// Why there is no answer.
#[derive(Debug)]
pub(super) enum Failure {
    /// A retry may succeed: no connection, a busy or failing server.
    Transient {
        /// What happened.
        what: String,
        /// How long the server asks to wait.
        retry_after: Option<Duration>,
    },
    /// The reply contains no answer of a model.
    Unusable(Error),
    /// A retry would fail again.
    Permanent(Error),
}

/// Sends requests.
pub(super) struct Transport {
    agent: Agent,
    endpoint: Endpoint,
    key: Option<EndpointKey>,
}

impl Transport {
    /// # Errors
    /// `Usage` for a key that would be sent unencrypted.
    pub(super) fn new(
        endpoint: Endpoint,
        key: Option<EndpointKey>,
        timeout: Duration,
    ) -> Result<Self> {
        if key.is_some() && !endpoint.encrypted && !endpoint.local {
            return Err(Error::usage("the key would be sent unencrypted")
                .at(&endpoint.url)
                .remedy(
                    "use https or a tunnel to localhost (ssh -L), or leave the key variable empty",
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

    /// Sends one message and returns the text of the model's answer.
    pub(super) fn ask(&self, model: &str, prompt: &str) -> Result<String, Failure> {
        let body = json!({
            "model": model,
            "messages": [{"role": "user", "content": prompt}],
        });
        let mut request = self
            .agent
            .post(&self.endpoint.url)
            .header("content-type", "application/json");
        if let Some(key) = &self.key {
            let text = format!("Bearer {}", key.reveal());
            // The error would contain the text.
            let mut value = HeaderValue::from_str(&text)
                .map_err(|_| Failure::Permanent(Error::config("the key cannot be sent")))?;
            value.set_sensitive(true);
            request = request.header(AUTHORIZATION, value);
        }
        let sent = request.send(body.to_string().as_bytes());
        let (parts, body) = sent.map_err(|e| self.failure(&e))?.into_parts();
        let text = self.text(body)?;
        let status = parts.status.as_u16();
        match status {
            200..=299 => self.content(&text),
            408 | 425 | 429 | 500..=599 => Err(Failure::Transient {
                what: format!("status {status}{}", self.explanation(&text)),
                retry_after: parts.headers.get(RETRY_AFTER).and_then(seconds),
            }),
            _ => Err(Failure::Permanent(self.refused(
                status,
                &parts.headers,
                &text,
            ))),
        }
    }

    /// Reads a reply without the key, which some servers echo.
    fn text(&self, mut body: Body) -> Result<String, Failure> {
        let read = body.with_config().limit(MAX_BYTES).read_to_vec();
        let bytes = read.map_err(|error| match error {
            ureq::Error::BodyExceedsLimit(_) => Failure::Unusable(
                Error::input(format!("the reply is longer than {MAX_BYTES} bytes"))
                    .remedy("check that the URL is that of an OpenAI-compatible endpoint"),
            ),
            other => self.failure(&other),
        })?;
        Ok(self.hide(&String::from_utf8_lossy(&bytes)))
    }

    fn content(&self, text: &str) -> Result<String, Failure> {
        let reply: Option<Value> = serde_json::from_str(text).ok();
        let content = reply.as_ref().and_then(|r| {
            let message = r.get("choices")?.get(0)?.get("message")?;
            message.get("content")?.as_str()
        });
        // Again, since JSON may escape characters of the key.
        content.map(|c| self.hide(c)).ok_or_else(|| {
            Failure::Unusable(
                Error::input(format!(
                    "the reply has no choices[0].message.content{}",
                    self.explanation(text)
                ))
                .remedy("check that the URL is that of an OpenAI-compatible endpoint"),
            )
        })
    }

    fn failure(&self, error: &ureq::Error) -> Failure {
        let what = self.hide(&error.to_string());
        match error {
            ureq::Error::BadUri(_) | ureq::Error::Http(_) | ureq::Error::InvalidProxyUrl => {
                Failure::Permanent(Error::usage(what))
            }
            // TLS errors: the server does not speak TLS, or its certificate is not trusted.
            ureq::Error::Io(e) if e.kind() == io::ErrorKind::InvalidData => Failure::Permanent(
                Error::config(format!("no secure connection: {what}")).remedy(
                    "use an endpoint with a public certificate, or http through a tunnel to \
                     localhost (ssh -L)",
                ),
            ),
            _ => Failure::Transient {
                what,
                retry_after: None,
            },
        }
    }

    fn refused(&self, status: u16, headers: &HeaderMap, text: &str) -> Error {
        let (kind, remedy) = match status {
            300..=399 => (ErrorKind::Usage, "use the URL that it redirects to"),
            401 | 403 => (
                ErrorKind::Permission,
                "set the environment variable of the key to a valid key of this endpoint",
            ),
            404 => (
                ErrorKind::NotFound,
                "check the URL (most end with /v1) and the model name",
            ),
            _ => (
                ErrorKind::Input,
                "check the model name and what the endpoint accepts",
            ),
        };
        let explanation = match headers.get(LOCATION).and_then(|l| l.to_str().ok()) {
            Some(address) if kind == ErrorKind::Usage => self.explanation(address),
            _ => self.explanation(text),
        };
        let what = format!("request refused with status {status}{explanation}");
        Error::new(kind, what).remedy(remedy)
    }

    /// Extracts the error message of a reply, to be appended to a message.
    fn explanation(&self, text: &str) -> String {
        let reply: Option<Value> = serde_json::from_str(text).ok();
        let message = reply.as_ref().and_then(|r| {
            let error = r.get("error")?;
            error.get("message").unwrap_or(error).as_str()
        });
        match self.hide(message.unwrap_or(text)).trim() {
            "" => String::new(),
            message => format!(": {}", quote(message, MAX_QUOTE)),
        }
    }

    fn hide(&self, text: &str) -> String {
        self.key
            .as_ref()
            .map_or_else(|| text.to_owned(), |k| k.hide_in(text))
    }
}

/// Parses seconds of a Retry-After header; dates are ignored.
fn seconds(value: &HeaderValue) -> Option<Duration> {
    let seconds: u64 = value.to_str().ok()?.trim().parse().ok()?;
    Some(Duration::from_secs(seconds))
}
