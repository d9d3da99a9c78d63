//! Client with a cache and retries.

use std::fmt;
use std::path::PathBuf;
use std::thread;
use std::time::Duration;

use super::cache::AnswerCache;
use super::endpoint::Endpoint;
use super::key::EndpointKey;
use super::transport::{Failure, Transport};
use gripcast_base::error::{Error, ErrorKind, Result};

/// First wait of the exponential back-off.
const FIRST_WAIT: Duration = Duration::from_secs(1);
/// Maximum wait of the back-off.
const MAX_WAIT: Duration = Duration::from_secs(30);
/// Maximum wait that a server may request.
const MAX_RETRY_AFTER: Duration = Duration::from_secs(120);
/// Maximum answers that are requested if they are unusable.
const MAX_ANSWERS: u32 = 2;

/// How the client waits between attempts: `Ok` after the duration, or an error (for instance
/// `Stopped`) that ends the request.
pub type Wait = Box<dyn Fn(Duration) -> Result<()> + Send + Sync>;

/// Options of an [`LlmClient`].
#[derive(Clone, Debug)]
pub struct LlmOptions {
    /// Base URL, for instance `https://api.openai.com/v1` or `http://localhost:11434/v1`.
    pub url: String,
    /// Name of the model at the endpoint.
    pub model: String,
    /// API key; none for local servers without one.
    pub key: Option<EndpointKey>,
    /// Folder of cached answers; created with the first one.
    pub cache: PathBuf,
    /// Timeout of one attempt, from the connection to the last byte.
    pub timeout: Duration,
    /// Maximum attempts per answer, at least 1. With 5, the waits add up to 15 s.
    pub attempts: u32,
}

impl LlmOptions {
    /// Creates options with the default timeout and attempts.
    pub fn new(url: &str, model: &str, cache: PathBuf) -> Self {
        Self {
            url: url.to_owned(),
            model: model.to_owned(),
            key: None,
            cache,
            timeout: Duration::from_secs(60),
            attempts: 5,
        }
    }
}

/// Client of a language model; usable answers are cached.
///
/// The key appears neither in `Debug` output nor in errors or files.
pub struct LlmClient {
    transport: Transport,
    model: String,
    cache: AnswerCache,
    attempts: u32,
    wait: Wait,
}

/// Why there is no usable answer.
#[derive(Debug)]
pub(super) enum AskError {
    /// The endpoint failed in all attempts.
    Down(Error),
    /// The answers are unusable.
    Unusable(Error),
    /// Anything else: refused requests, a full disk, stopped.
    Other(Error),
}

impl From<AskError> for Error {
    fn from(error: AskError) -> Self {
        match error {
            AskError::Down(e) | AskError::Unusable(e) | AskError::Other(e) => e,
        }
    }
}

impl LlmClient {
    /// Creates a client; nothing is sent yet.
    ///
    /// # Errors
    /// `Usage` for an invalid URL, an empty model name, or a key that would be sent unencrypted.
    pub fn new(options: LlmOptions) -> Result<Self> {
        let endpoint = Endpoint::parse(&options.url)?;
        let model = options.model.trim().to_owned();
        if model.is_empty() {
            return Err(Error::usage("the model name is empty")
                .remedy("name a model of the endpoint, for instance gpt-4o"));
        }
        Ok(Self {
            transport: Transport::new(endpoint, options.key, options.timeout)?,
            model,
            cache: AnswerCache::new(options.cache),
            attempts: options.attempts.max(1),
            wait: Box::new(|time| {
                thread::sleep(time);
                Ok(())
            }),
        })
    }

    /// Replaces the waiting between attempts.
    #[must_use]
    pub fn waiting(mut self, wait: Wait) -> Self {
        self.wait = wait;
        self
    }

    /// Name of the model.
    pub fn model(&self) -> &str {
        &self.model
    }

    /// Returns the cached answer to a prompt.
    pub(super) fn cached<T>(
        &self,
        prompt: &str,
        parse: impl Fn(&str) -> Result<T>,
    ) -> Result<Option<T>> {
        let stored = self.cache.load(&self.model, prompt)?;
        // An answer that cannot be parsed is requested again.
        Ok(stored.and_then(|answer| parse(&answer).ok()))
    }

    /// Parses the cached answer, or a new one.
    pub(super) fn ask<T>(
        &self,
        prompt: &str,
        parse: impl Fn(&str) -> Result<T>,
    ) -> Result<T, AskError> {
        if let Some(value) = self.cached(prompt, &parse).map_err(AskError::Other)? {
            return Ok(value);
        }
        let mut answers = 1;
        loop {
            let failed = match self.fetch(prompt) {
                Ok(answer) => match parse(&answer) {
                    Ok(value) => {
                        let stored = self.cache.store(&self.model, prompt, &answer);
                        stored.map_err(AskError::Other)?;
                        return Ok(value);
                    }
                    Err(error) => self.located(error),
                },
                Err(AskError::Unusable(error)) => error,
                Err(other) => return Err(other),
            };
            if answers == MAX_ANSWERS {
                return Err(AskError::Unusable(failed));
            }
            answers += 1;
        }
    }

    /// Requests a new answer, with retries.
    fn fetch(&self, prompt: &str) -> Result<String, AskError> {
        let mut attempt = 1;
        loop {
            let (what, retry_after) = match self.transport.ask(&self.model, prompt) {
                Ok(answer) => return Ok(answer),
                Err(Failure::Unusable(e)) => return Err(AskError::Unusable(self.located(e))),
                Err(Failure::Permanent(e)) => return Err(AskError::Other(self.located(e))),
                Err(Failure::Transient { what, retry_after }) => (what, retry_after),
            };
            let pause = retry_after.unwrap_or_else(|| back_off(attempt));
            if attempt >= self.attempts || pause > MAX_RETRY_AFTER {
                return Err(AskError::Down(self.down(&what, attempt, retry_after)));
            }
            (self.wait)(pause).map_err(AskError::Other)?;
            attempt += 1;
        }
    }

    fn down(&self, what: &str, attempts: u32, retry_after: Option<Duration>) -> Error {
        let requested = match retry_after {
            Some(time) if time > MAX_RETRY_AFTER => {
                format!("; the server asks to wait {} s", time.as_secs())
            }
            _ => String::new(),
        };
        let what = format!("no answer in {attempts} attempts: {what}{requested}");
        self.located(Error::new(ErrorKind::Io, what).remedy(
            "run it again when the endpoint is up (answers are cached), or allow the table of \
             materials instead (--llm-fallback)",
        ))
    }

    fn located(&self, error: Error) -> Error {
        error.at(format!("{} ({})", self.transport.url(), self.model))
    }
}

fn back_off(attempt: u32) -> Duration {
    let factor = 1_u32.checked_shl(attempt - 1).unwrap_or(u32::MAX);
    FIRST_WAIT.saturating_mul(factor).min(MAX_WAIT)
}

impl fmt::Debug for LlmClient {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("LlmClient")
            .field("url", &self.transport.url())
            .field("model", &self.model)
            .field("key", &self.transport.key())
            .field("cache", &self.cache)
            .field("attempts", &self.attempts)
            .finish_non_exhaustive()
    }
}
