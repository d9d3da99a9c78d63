//! Files of the web page, embedded in the binary.

use axum::extract::Path;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};

use super::failure::Failure;

/// Name, media type and text of a file.
type File = (&'static str, &'static str, &'static str);

const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const JAVASCRIPT: &str = "text/javascript; charset=utf-8";
const SVG: &str = "image/svg+xml";

/// Embeds files of `page/` at build time.
macro_rules! files {
    ($($name:literal => $kind:expr),+ $(,)?) => {
        &[$(($name, $kind, include_str!(concat!("page/", $name)))),+]
    };
}

/// All files of the page.
const FILES: &[File] = files! {
    "index.html" => HTML,
    "style.css" => CSS,
    "icon.svg" => SVG,
    "actions.js" => JAVASCRIPT,
    "api.js" => JAVASCRIPT,
    "app.js" => JAVASCRIPT,
    "bulk.js" => JAVASCRIPT,
    "cameras.js" => JAVASCRIPT,
    "detail.js" => JAVASCRIPT,
    "dom.js" => JAVASCRIPT,
    "gallery.js" => JAVASCRIPT,
    "gauge.js" => JAVASCRIPT,
    "keys.js" => JAVASCRIPT,
    "labels.js" => JAVASCRIPT,
    "link.js" => JAVASCRIPT,
    "login.js" => JAVASCRIPT,
    "images.js" => JAVASCRIPT,
    "recent.js" => JAVASCRIPT,
    "sender.js" => JAVASCRIPT,
    "sound.js" => JAVASCRIPT,
    "theme.js" => JAVASCRIPT,
    "types.js" => JAVASCRIPT,
    "words.js" => JAVASCRIPT,
};

fn response((_, kind, text): File) -> Response {
    // Page and API must be of the same build.
    let headers = [
        (header::CONTENT_TYPE, kind),
        (header::CACHE_CONTROL, "no-cache"),
    ];
    (headers, text).into_response()
}

fn find(name: &str) -> Result<Response, Failure> {
    let file = FILES.iter().find(|file| file.0 == name);
    file.map(|file| response(*file))
        .ok_or_else(|| Failure::new(StatusCode::NOT_FOUND, "not found"))
}

/// `/`
pub(crate) async fn index() -> Result<Response, Failure> {
    find("index.html")
}

/// `/NAME`
pub(crate) async fn file(Path(name): Path<String>) -> Result<Response, Failure> {
    find(&name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::web::access::CONTENT_SECURITY_POLICY;
    use base64::Engine as _;
    use base64::prelude::BASE64_STANDARD;
    use sha2::{Digest as _, Sha256};
    use std::collections::BTreeSet;
    use std::path::Path;

    /// The content security policy allows the inline script of the page, and no other.
    #[test]
    fn policy_has_the_hash_of_the_inline_script() {
        let (_, _, html) = FILES.iter().find(|file| file.0 == "index.html").unwrap();
        let inline = html.split("<script>").skip(1);
        let scripts: Vec<&str> = inline.filter_map(|s| s.split("</script>").next()).collect();
        assert_eq!(scripts.len(), 1, "{scripts:?}");
        let hash = BASE64_STANDARD.encode(Sha256::digest(scripts[0]));
        let allowed = format!("script-src 'self' 'sha256-{hash}';");
        assert!(
            CONTENT_SECURITY_POLICY.contains(&allowed),
            "expected {allowed}"
        );
    }

    /// Without its scripts the page says that it is not connected, and has no enabled button.
    #[test]
    fn first_state_of_the_page_is_not_connected() {
        let (_, _, html) = FILES.iter().find(|file| file.0 == "index.html").unwrap();
        let buttons: Vec<&str> = html
            .split("<button")
            .filter_map(|button| button.split('>').next())
            .filter(|button| button.contains("data-command"))
            .collect();
        assert_eq!(buttons.len(), 7);
        assert!(buttons.iter().all(|button| button.contains(" disabled ")));
        assert!(html.contains("<body class=\"offline\">"));
        assert!(html.contains("<div id=\"link\" role=\"alert\">Not connected"));
    }

    /// Every file of the folder is served, and all referenced files exist.
    #[test]
    fn page_files_are_complete() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/web/page");
        let existing: BTreeSet<String> = std::fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        let served: BTreeSet<String> = FILES.iter().map(|file| file.0.to_owned()).collect();
        assert_eq!(existing, served);
        for (name, _, text) in FILES {
            let quoted = text.split(['"', '\'']);
            for referenced in quoted.filter_map(|part| part.strip_prefix("./")) {
                assert!(served.contains(referenced), "{name} refers to {referenced}");
            }
        }
    }
}
