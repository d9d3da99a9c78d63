//! Questions with a memory and with patience.

use std::fmt;
use std::path::PathBuf;
use std::thread;
use std::time::Duration;

use super::cache::AnswerCache;
use super::endpoint::Endpoint;
use super::key::EndpointKey;
use super::transport::{Failure, Transport};
use gripcast_base::error::{Error, ErrorKind, Result};

/// First wait of the back-off; each following one is twice as long.
const FIRST_WAIT: Duration = Duration::from_secs(1);
/// Longest wait of the back-off.
const MAX_WAIT: Duration = Duration::from_secs(30);
/// Longest wait that a server may ask for.
const MAX_RETRY_AFTER: Duration = Duration::from_secs(120);
/// How often a model is asked in all when its answers cannot be used.
const ANSWERS: u32 = 2;

/// How the client waits between attempts: `Ok` after the time, or an error (as `Stopped`) that ends
/// the waiting and is handed on.
pub type Wait = Box<dyn Fn(Duration) -> Result<()> + Send + Sync>;

/// Which endpoint is asked, and how.
#[derive(Clone, Debug)]
pub struct LlmOptions {
    /// Base address, for instance `https://api.openai.com/v1` or `http://localhost:11434/v1`.
    pub url: String,
    /// Name of the model at the endpoint.
    pub model: String,
    /// Key; none for local servers that want none.
    pub key: Option<EndpointKey>,
    /// Folder of the answers; made with the first one.
    pub cache: PathBuf,
    /// Longest time for one attempt, from the connection to the last byte. 60 s leave a model
    /// time to think.
    pub timeout: Duration,
    /// Attempts per answer, at least 1. With 5 a failing server is waited for 15 s.
    pub attempts: u32,
}

impl LlmOptions {
    /// The usual time and attempts.
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

/// Asks a language model; answers that could be used are stored and not asked for again.
///
/// Neither `Debug` nor any error shows the key, and no file holds it.
pub struct LlmClient {
    transport: Transport,
    model: String,
    cache: AnswerCache,
    attempts: u32,
    wait: Wait,
}

/// Why a question has no answer.
#[derive(Debug)]
pub(super) enum Unanswered {
    /// The endpoint did not answer in all attempts.
    Down(Error),
    /// What it answered cannot be used.
    Unusable(Error),
    /// Anything else: refused questions, no room for the answers, stopped.
    Other(Error),
}

impl From<Unanswered> for Error {
    fn from(unanswered: Unanswered) -> Self {
        match unanswered {
            Unanswered::Down(e) | Unanswered::Unusable(e) | Unanswered::Other(e) => e,
        }
    }
}

impl LlmClient {
    /// A client; nothing is sent yet.
    ///
    /// # Errors
    /// `Usage` for an address that is none, an empty model name, or a key that would go over the
    /// network unencrypted.
    pub fn new(options: LlmOptions) -> Result<Self> {
        let endpoint = Endpoint::parse(&options.url)?;
        let model = options.model.trim().to_owned();
        if model.is_empty() {
            return Err(Error::usage("the name of the model is empty")
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

    /// The same client waiting in another way between attempts.
    #[must_use]
    pub fn waiting(mut self, wait: Wait) -> Self {
        self.wait = wait;
        self
    }

    /// Name of the model.
    pub fn model(&self) -> &str {
        &self.model
    }

    /// The stored answer to a question, or none.
    pub(super) fn recall<T>(
        &self,
        prompt: &str,
        read: impl Fn(&str) -> Result<T>,
    ) -> Result<Option<T>> {
        let stored = self.cache.load(&self.model, prompt)?;
        // What cannot be read any more is asked again.
        Ok(stored.and_then(|answer| read(&answer).ok()))
    }

    /// What `read` makes of the stored answer, or else of a new one.
    pub(super) fn ask<T>(
        &self,
        prompt: &str,
        read: impl Fn(&str) -> Result<T>,
    ) -> Result<T, Unanswered> {
        if let Some(known) = self.recall(prompt, &read).map_err(Unanswered::Other)? {
            return Ok(known);
        }
        let mut answers = 1;
        loop {
            let failed = match self.fetch(prompt) {
                Ok(answer) => match read(&answer) {
                    Ok(value) => {
                        let stored = self.cache.store(&self.model, prompt, &answer);
                        stored.map_err(Unanswered::Other)?;
                        return Ok(value);
                    }
                    Err(error) => self.placed(error),
                },
                Err(Unanswered::Unusable(error)) => error,
                Err(other) => return Err(other),
            };
            if answers == ANSWERS {
                return Err(Unanswered::Unusable(failed));
            }
            answers += 1;
        }
    }

    /// A new answer, with attempts as long as there is hope.
    fn fetch(&self, prompt: &str) -> Result<String, Unanswered> {
        let mut attempt = 1;
        loop {
            let (what, retry_after) = match self.transport.ask(&self.model, prompt) {
                Ok(answer) => return Ok(answer),
                Err(Failure::Unusable(e)) => return Err(Unanswered::Unusable(self.placed(e))),
                Err(Failure::Final(e)) => return Err(Unanswered::Other(self.placed(e))),
                Err(Failure::Passing { what, retry_after }) => (what, retry_after),
            };
            let pause = retry_after.unwrap_or_else(|| back_off(attempt));
            if attempt >= self.attempts || pause > MAX_RETRY_AFTER {
                return Err(Unanswered::Down(self.down(&what, attempt, retry_after)));
            }
            (self.wait)(pause).map_err(Unanswered::Other)?;
            attempt += 1;
        }
    }

    fn down(&self, what: &str, attempts: u32, retry_after: Option<Duration>) -> Error {
        let asked = match retry_after {
            Some(time) if time > MAX_RETRY_AFTER => {
                format!("; it asks to wait {} s", time.as_secs())
            }
            _ => String::new(),
        };
        let what = format!("no answer in {attempts} attempts: {what}{asked}");
        self.placed(Error::new(ErrorKind::Io, what).remedy(
            "run it again when the endpoint is up (answers are kept), or allow the table of \
             materials in its place (--llm-fallback)",
        ))
    }

    fn placed(&self, error: Error) -> Error {
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
