//! API key of an endpoint, which is never printed or stored.

use std::env;
use std::fmt;

use gripcast_base::error::{Error, Result};

/// Default environment variable of the key.
pub const DEFAULT_KEY_VARIABLE: &str = "OPENAI_API_KEY";

/// Replacement for the key in texts.
const HIDDEN: &str = "[key]";

/// API key of an endpoint. `Debug` hides it.
#[derive(Clone, PartialEq, Eq)]
pub struct EndpointKey(String);

impl EndpointKey {
    /// Reads the key from an environment variable; none if it is unset or empty.
    ///
    /// # Errors
    /// `Config` for an invalid key: spaces, control characters, non-ASCII characters.
    pub fn from_env(variable: &str) -> Result<Option<Self>> {
        match env::var_os(variable) {
            None => Ok(None),
            Some(value) => Self::new(&value.to_string_lossy())
                .map_err(|e| e.at(format!("environment variable {variable}"))),
        }
    }

    /// Creates a key; none if the text is empty. Surrounding white space is ignored.
    ///
    /// # Errors
    /// As [`from_env`](Self::from_env).
    pub fn new(text: &str) -> Result<Option<Self>> {
        let key = text.trim();
        if !key.bytes().all(|b| b.is_ascii_graphic()) {
            return Err(Error::config(
                "the key contains spaces, line breaks or non-ASCII characters",
            )
            .remedy("set the variable to the key alone"));
        }
        Ok((!key.is_empty()).then(|| Self(key.to_owned())))
    }

    /// Returns the key, only for the request header.
    pub(super) fn reveal(&self) -> &str {
        &self.0
    }

    /// Removes the key from a text.
    pub(super) fn hide_in(&self, text: &str) -> String {
        text.replace(&self.0, HIDDEN)
    }
}

impl fmt::Debug for EndpointKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(HIDDEN)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn key_is_never_printed() {
        let key = EndpointKey::new(" sk-secret\n").unwrap().unwrap();
        assert_eq!(key.reveal(), "sk-secret");
        assert_eq!(format!("{key:?} {:?}", Some(&key)), "[key] Some([key])");
        assert_eq!(
            key.hide_in("Bearer sk-secret, sk-secret"),
            "Bearer [key], [key]"
        );
        let error = EndpointKey::new("sk secret").unwrap_err();
        assert!(!error.to_string().contains("secret"), "{error}");
    }

    #[test]
    fn empty_key_is_none() {
        assert_eq!(EndpointKey::new(" ").unwrap(), None);
        assert_eq!(
            EndpointKey::from_env("GRIPCAST_TEST_NO_SUCH_VARIABLE").unwrap(),
            None
        );
    }
}
