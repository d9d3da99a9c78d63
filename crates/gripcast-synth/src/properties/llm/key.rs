//! The key of an endpoint, which nothing prints or stores.

use std::env;
use std::fmt;

use gripcast_base::error::{Error, Result};

/// Environment variable that the key is read from when none is named.
pub const DEFAULT_KEY_VARIABLE: &str = "OPENAI_API_KEY";

/// What stands in texts where a key was.
const HIDDEN: &str = "[key]";

/// The key of an endpoint. It can be sent, but not printed: `Debug` hides it.
#[derive(Clone, PartialEq, Eq)]
pub struct EndpointKey(String);

impl EndpointKey {
    /// The key in an environment variable; none if it is unset or empty, as for local servers.
    ///
    /// # Errors
    /// `Config` for a value that cannot be a key: spaces, control characters, no ASCII.
    pub fn from_env(variable: &str) -> Result<Option<Self>> {
        match env::var_os(variable) {
            None => Ok(None),
            Some(value) => Self::new(&value.to_string_lossy())
                .map_err(|e| e.at(format!("environment variable {variable}"))),
        }
    }

    /// A key; none if the text is empty. White space around it is no part of it.
    ///
    /// # Errors
    /// As [`from_env`](Self::from_env).
    pub fn new(text: &str) -> Result<Option<Self>> {
        let key = text.trim();
        if !key.bytes().all(|b| b.is_ascii_graphic()) {
            return Err(Error::config(
                "the key has characters that no key has (spaces, line breaks or no ASCII)",
            )
            .remedy("set the variable to the key alone"));
        }
        Ok((!key.is_empty()).then(|| Self(key.to_owned())))
    }

    /// The key itself, for the request header alone.
    pub(super) fn reveal(&self) -> &str {
        &self.0
    }

    /// A text without the key.
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
    fn a_key_is_never_printed() {
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
    fn no_key_is_none() {
        assert_eq!(EndpointKey::new(" ").unwrap(), None);
        assert_eq!(
            EndpointKey::from_env("GRIPCAST_TEST_NO_SUCH_VARIABLE").unwrap(),
            None
        );
    }
}
