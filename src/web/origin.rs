//! Checks of `Host`, `Origin` and `Sec-Fetch-*`. Repeated or malformed headers are rejected, never
//! ignored.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};

use axum::extract::Request;
use axum::http::{HeaderMap, Method, StatusCode, header};

use super::access::is_api;
use super::failure::Failure;

/// Maximum length of a host name, characters (RFC 1035).
const MAX_NAME_CHARS: usize = 253;

/// `NAME`, `1.2.3.4` or `[::1]` with an optional `:PORT`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Authority {
    name: Name,
    port: Option<u16>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Name {
    /// Domain name in lower case.
    Domain(String),
    Address(IpAddr),
}

impl Authority {
    /// Parses an authority strictly: no user names, trailing dots or invalid ports.
    fn parse(text: &str) -> Option<Self> {
        let (name, port) = match text.strip_prefix('[') {
            Some(rest) => {
                let (address, port) = rest.split_once(']')?;
                let address: Ipv6Addr = address.parse().ok()?;
                (Name::Address(address.into()), port)
            }
            None => {
                let end = text.find(':').unwrap_or(text.len());
                (Name::parse(&text[..end])?, &text[end..])
            }
        };
        let port = match port {
            "" => None,
            port => Some(parse_port(port.strip_prefix(':')?)?),
        };
        Some(Self { name, port })
    }

    /// Returns whether the authority names the loopback interface.
    pub(super) fn is_this_machine(&self) -> bool {
        match &self.name {
            Name::Domain(name) => name == "localhost",
            Name::Address(address) => address.is_loopback(),
        }
    }
}

impl Name {
    fn parse(text: &str) -> Option<Self> {
        if let Ok(address) = text.parse::<Ipv4Addr>() {
            return Some(Self::Address(address.into()));
        }
        let is_label = |label: &str| {
            let mut characters = label.chars();
            !label.is_empty()
                && characters.all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '_')
        };
        let is_name = text.len() <= MAX_NAME_CHARS && text.split('.').all(is_label);
        is_name.then(|| Self::Domain(text.to_ascii_lowercase()))
    }
}

fn parse_port(text: &str) -> Option<u16> {
    // `parse` alone would accept a sign.
    let digits = text.chars().all(|c| c.is_ascii_digit());
    text.parse().ok().filter(|port| digits && *port != 0)
}

/// Returns the single value of a header, or `None` if it is missing.
fn single_value(
    headers: &HeaderMap,
    name: impl header::AsHeaderName,
) -> Result<Option<&str>, InvalidHeader> {
    let mut values = headers.get_all(name).iter();
    match (values.next(), values.next()) {
        (None, _) => Ok(None),
        (Some(value), None) => value.to_str().map(Some).map_err(|_| InvalidHeader),
        (Some(_), Some(_)) => Err(InvalidHeader),
    }
}

/// A header that is repeated or not ASCII.
struct InvalidHeader;

/// Checks host and origin of a request and returns the host.
///
/// Files of the page need no `Origin` check, since they are public. Nor do requests that the
/// browser itself marks as same-origin: `Sec-Fetch-Site` compares with the address that the browser
/// sees, which a proxy may have replaced in `Host`, and scripts cannot set it.
///
/// # Errors
/// 400 for a missing, repeated or malformed `Host`; 403 for a cross-site request.
pub(super) fn check(request: &Request) -> Result<Authority, Failure> {
    let host = host(request)?;
    let is_read = matches!(*request.method(), Method::GET | Method::HEAD);
    let is_file = is_read && !is_api(request.uri().path());
    let site = single_value(request.headers(), "sec-fetch-site");
    if !is_file && !matches!(site, Ok(Some("same-origin"))) {
        check_origin(request.headers(), &host)?;
    }
    check_site(request)?;
    Ok(host)
}

fn host(request: &Request) -> Result<Authority, Failure> {
    let invalid = |found: &str| {
        Failure::new(
            StatusCode::BAD_REQUEST,
            format!("expected one `Host: NAME:PORT`, found {found}"),
        )
    };
    let text = single_value(request.headers(), header::HOST)
        .map_err(|_| invalid("several, or one that is not ASCII"))?
        .ok_or_else(|| invalid("none"))?;
    let host = Authority::parse(text).ok_or_else(|| invalid(&format!("`{text:.100}`")))?;
    // The absolute form of the request line repeats the host.
    let line = request
        .uri()
        .authority()
        .map(|authority| authority.as_str());
    match line {
        Some(line) if Authority::parse(line).as_ref() != Some(&host) => Err(invalid(&format!(
            "`{text:.100}` for a request to `{line:.100}`"
        ))),
        _ => Ok(host),
    }
}

fn cross_site(what: String) -> Failure {
    Failure::new(StatusCode::FORBIDDEN, what)
        .remedy("open the page at the address printed by the daemon")
}

/// Rejects scripts and forms of other sites by `Origin`.
fn check_origin(headers: &HeaderMap, host: &Authority) -> Result<(), Failure> {
    let origin = match single_value(headers, header::ORIGIN) {
        Ok(None) => return Ok(()),
        Ok(Some(origin)) => origin,
        Err(InvalidHeader) => return Err(cross_site("invalid `Origin` header".into())),
    };
    let authority = ["http://", "https://"]
        .iter()
        .find_map(|scheme| origin.strip_prefix(scheme));
    if authority.and_then(Authority::parse).as_ref() == Some(host) {
        return Ok(());
    }
    Err(cross_site(format!(
        "requests from {origin:.100} are not allowed"
    ))
    .remedy(
        "open the page at the address printed by the daemon; a proxy must pass the header `Host` \
         (nginx: proxy_set_header Host $http_host)",
    ))
}

/// Rejects images and frames embedded by other sites, which have no `Origin`. Links to the page
/// itself are allowed.
fn check_site(request: &Request) -> Result<(), Failure> {
    let header = |name: &'static str| single_value(request.headers(), name);
    match header("sec-fetch-site") {
        Ok(None | Some("same-origin" | "none")) => return Ok(()),
        Ok(Some("same-site" | "cross-site")) => {}
        Ok(Some(_)) | Err(InvalidHeader) => {
            return Err(cross_site("invalid `Sec-Fetch-Site` header".into()));
        }
    }
    let is_link = matches!(header("sec-fetch-mode"), Ok(Some("navigate")))
        && matches!(header("sec-fetch-dest"), Ok(Some("document")));
    if is_link && request.method() == Method::GET && request.uri().path() == "/" {
        return Ok(());
    }
    Err(cross_site("embedding by other sites is not allowed".into()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hosts_are_parsed_strictly() {
        for text in [
            "localhost",
            "LOCALHOST:7471",
            "127.0.0.1:7471",
            "127.8.9.1",
            "[::1]:7471",
        ] {
            let host = Authority::parse(text).unwrap_or_else(|| panic!("{text}"));
            assert!(host.is_this_machine(), "{text}");
        }
        for text in [
            "lab.example:80",
            "lab_rig-2:8765",
            "192.168.0.7:7471",
            "localhost.evil",
            "127.0.0.1.evil",
            "127.1",
            "[::ffff:127.0.0.1]",
        ] {
            let host = Authority::parse(text).unwrap_or_else(|| panic!("{text}"));
            assert!(!host.is_this_machine(), "{text}");
        }
        for text in [
            "",
            ":7471",
            "localhost.",
            "localhost..",
            ".localhost",
            "evil@localhost",
            "localhost:",
            "localhost:0",
            "localhost:+80",
            "localhost:65536",
            "localhost:80:80",
            "localhost:x",
            "localhost/",
            "local host",
            "loc\u{e4}lhost",
            "[::1",
            "[::1]x",
            "[::1]:",
            "[::1%lo]",
            "[127.0.0.1]",
            "::1",
        ] {
            assert_eq!(Authority::parse(text), None, "{text}");
        }
    }

    #[test]
    fn host_names_compare_case_insensitively() {
        let parse = |text| Authority::parse(text).unwrap();
        assert_eq!(parse("Lab:80"), parse("lab:80"));
        assert_ne!(parse("lab:80"), parse("lab"));
        assert_ne!(parse("lab:80"), parse("lab:81"));
    }
}
