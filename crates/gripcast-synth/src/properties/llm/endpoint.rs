//! URL of an OpenAI-compatible endpoint.

use std::net::IpAddr;

use ureq::http::Uri;

use gripcast_base::error::{Error, Result};

const PATH: &str = "/chat/completions";

/// A validated URL.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Endpoint {
    /// URL for chat completions.
    pub url: String,
    /// Whether it is on this machine.
    pub local: bool,
    /// Whether the connection is encrypted.
    pub encrypted: bool,
}

impl Endpoint {
    /// Parses a base URL such as `https://api.openai.com/v1` or `http://localhost:11434/v1`.
    ///
    /// # Errors
    /// `Usage` for an invalid URL, or one with credentials, a query or a fragment, which is not
    /// repeated in the error.
    pub(super) fn parse(base: &str) -> Result<Self> {
        let invalid =
            |what: String, remedy: &str| Err(Error::usage(what).remedy(remedy.to_owned()));
        let base = base.trim();
        if base.contains(['@', '?', '#']) {
            return invalid(
                "the endpoint URL must not have a user name, a query or a fragment".to_owned(),
                "use https://HOST/v1, and set the key in an environment variable",
            );
        }
        let base = base.trim_end_matches('/');
        let base = base.strip_suffix(PATH).unwrap_or(base);
        let example = "use for instance https://api.openai.com/v1 or http://localhost:11434/v1";
        let uri: Uri = match base.parse() {
            Ok(uri) => uri,
            Err(_) => return invalid(format!("invalid endpoint URL {base:?}"), example),
        };
        let (Some(scheme), Some(host)) = (uri.scheme_str(), uri.host()) else {
            return invalid(format!("incomplete endpoint URL {base:?}"), example);
        };
        if host.is_empty() || !["http", "https"].contains(&scheme) {
            return invalid(
                format!("endpoint URL {base:?} is not http or https"),
                example,
            );
        }
        Ok(Self {
            url: format!("{base}{PATH}"),
            local: is_local(host),
            encrypted: scheme == "https",
        })
    }
}

fn is_local(host: &str) -> bool {
    let bare = host.trim_start_matches('[').trim_end_matches(']');
    let loopback = bare.parse::<IpAddr>().is_ok_and(|ip| ip.is_loopback());
    loopback || bare.eq_ignore_ascii_case("localhost")
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_base::error::ErrorKind;

    #[test]
    fn path_is_appended_once() {
        for base in [
            "https://api.openai.com/v1",
            " https://api.openai.com/v1/ ",
            "https://api.openai.com/v1/chat/completions",
        ] {
            let endpoint = Endpoint::parse(base).unwrap();
            assert_eq!(endpoint.url, "https://api.openai.com/v1/chat/completions");
            assert!(endpoint.encrypted && !endpoint.local);
        }
        for base in [
            "http://localhost:11434/v1",
            "http://127.0.0.1:8000",
            "http://[::1]:8000/v1",
        ] {
            let endpoint = Endpoint::parse(base).unwrap();
            assert!(endpoint.local && !endpoint.encrypted, "{base}");
        }
        assert!(
            !Endpoint::parse("http://localhost.example.org/v1")
                .unwrap()
                .local
        );
    }

    #[test]
    fn invalid_urls_are_refused_without_their_secrets() {
        for base in [
            "",
            "api.openai.com/v1",
            "ftp://host/v1",
            "/v1",
            "http://",
            "http://a b",
        ] {
            let error = Endpoint::parse(base).unwrap_err();
            assert_eq!(error.kind(), ErrorKind::Usage, "{base:?}");
            assert!(error.remedy_text().is_some());
        }
        for base in [
            "https://me:secret@host/v1",
            "https://host/v1?key=secret",
            "https://h/#secret",
        ] {
            let error = Endpoint::parse(base).unwrap_err();
            assert!(!error.to_string().contains("secret"), "{error}");
        }
    }
}
