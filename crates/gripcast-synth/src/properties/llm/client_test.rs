//! Tests of the client against a scripted server.

use std::fs;
use std::io::{Read as _, Write as _};
use std::net::TcpListener;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;

use tempfile::TempDir;

use super::test_server::{Reply, TestServer};
use super::*;
use crate::properties::{Material, PropertySource, builtin_appearances};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_visual::FinishClass;

const KEY: &str = "sk-very-secret-42";
const GOOD: &str = r#"{"mass": 0.25, "friction": 0.8}"#;

/// A cache folder and the waits that clients requested.
struct Bench {
    folder: TempDir,
    waits: Arc<Mutex<Vec<u64>>>,
}

impl Bench {
    fn new() -> Self {
        Self {
            folder: tempfile::tempdir().unwrap(),
            waits: Arc::default(),
        }
    }

    fn client(&self, url: &str) -> LlmClient {
        let mut options = LlmOptions::new(url, "test-model", self.folder.path().to_owned());
        options.key = EndpointKey::new(KEY).unwrap();
        let waits = Arc::clone(&self.waits);
        let wait = move |time: Duration| {
            waits.lock().unwrap().push(time.as_secs());
            Ok(())
        };
        LlmClient::new(options).unwrap().waiting(Box::new(wait))
    }

    fn estimator(&self, url: &str, fallback: bool) -> PropertyEstimator {
        PropertyEstimator::new(self.client(url), fallback)
    }

    fn waits(&self) -> Vec<u64> {
        self.waits.lock().unwrap().clone()
    }

    fn files(&self) -> Vec<std::path::PathBuf> {
        let entries = fs::read_dir(self.folder.path()).unwrap();
        entries.map(|e| e.unwrap().path()).collect()
    }
}

fn query() -> PropertyQuery<'static> {
    PropertyQuery {
        object: "mug-1",
        category: "coffee mug",
        texture: "glossy red",
        material: Material::named("ceramic").unwrap(),
        size_m: 0.1,
        volume_m3: 1e-4,
        fill: None,
        seed: 1,
    }
}

fn ask(script: Vec<Reply>) -> (Result<(f64, f64)>, Vec<u64>, Vec<String>) {
    let bench = Bench::new();
    let server = TestServer::new(script);
    let found = bench.estimator(&server.url, false).physical(&query());
    if let Err(error) = &found {
        assert!(!format!("{error} {error:?}").contains(KEY), "{error}");
        assert!(bench.files().is_empty());
    }
    let numbers = found.map(|p| (p.mass_kg, p.friction));
    (numbers, bench.waits(), server.requests())
}

fn failure(script: Vec<Reply>) -> Error {
    ask(script).0.unwrap_err()
}

fn refused_url() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    format!("http://{}/v1", listener.local_addr().unwrap())
}

#[test]
fn usable_answer_is_parsed_and_prompt_matches_the_paper() {
    let (found, waits, requests) = ask(vec![Reply::answer(GOOD)]);
    assert_eq!(found.unwrap(), (0.25, 0.8));
    assert!(waits.is_empty());
    let (head, body) = requests[0].split_once("\r\n\r\n").unwrap();
    assert!(
        head.starts_with("POST /v1/chat/completions HTTP/1.1\r\n"),
        "{head}"
    );
    assert!(head.contains(&format!("Bearer {KEY}")), "{head}");
    let body: serde_json::Value = serde_json::from_str(body).unwrap();
    assert_eq!(body["model"], "test-model");
    let message = body["messages"][0]["content"].as_str().unwrap();
    assert_eq!(
        message,
        physical_prompt("glossy red", "coffee mug", 0.1).unwrap()
    );
}

#[test]
fn fences_and_prose_are_skipped() {
    for text in [
        format!("```json\n{GOOD}\n```"),
        format!("A mug of glazed clay weighs 250 g.\n\n{GOOD}\nAsk me more!"),
    ] {
        let (found, _, _) = ask(vec![Reply::answer(&text)]);
        assert_eq!(found.unwrap(), (0.25, 0.8), "{text}");
    }
}

#[test]
fn unusable_answer_is_requested_once_more() {
    let (found, waits, requests) = ask(vec![Reply::answer("No idea."), Reply::answer(GOOD)]);
    assert_eq!(found.unwrap(), (0.25, 0.8));
    assert_eq!((waits.len(), requests.len()), (0, 2));
    for (text, expected) in [
        ("I would say a quarter of a kilogram.", "a quarter of"),
        (r#"{"mass": 0.25, "friction": 7.5}"#, "found 7.5"),
        (r#"{"mass": -1, "friction": 0.5}"#, "found -1"),
    ] {
        let error = failure(vec![Reply::answer(text), Reply::answer(text)]);
        assert_eq!(error.kind(), ErrorKind::Input);
        assert!(error.to_string().contains(expected), "{error}");
        assert!(error.to_string().contains("test-model"), "{error}");
    }
}

#[test]
fn replies_without_an_answer_are_refused() {
    let page = "<html>Hello</html>";
    let no_content = r#"{"choices": [{"message": {"content": null}}]}"#;
    for body in [page, no_content, r#"{"choices": []}"#, "", "[1, 2]"] {
        let reply = || Reply::status("200 OK", "", body);
        let error = failure(vec![reply(), reply()]);
        assert!(
            error.to_string().contains("choices[0].message.content"),
            "{error}"
        );
    }
}

#[test]
fn busy_server_is_retried_as_requested() {
    let busy = |after: &str| Reply::status("429 Too Many Requests", after, "slow down");
    let (found, waits, requests) = ask(vec![
        busy("Retry-After: 7\r\n"),
        busy("Retry-After: Wed, 21 Oct 2015 07:28:00 GMT\r\n"),
        Reply::Hangup,
        Reply::answer(GOOD),
    ]);
    assert_eq!(found.unwrap(), (0.25, 0.8));
    assert_eq!(waits, [7, 2, 4]);
    assert_eq!(requests.len(), 4);
    let (found, waits, _) = ask(vec![busy("Retry-After: 3600\r\n")]);
    let error = found.unwrap_err();
    assert!(error.to_string().contains("asks to wait 3600 s"), "{error}");
    assert!(error.to_string().contains("slow down"), "{error}");
    assert!(waits.is_empty());
}

#[test]
fn failing_server_is_given_up() {
    let failing = || Reply::status("503 Unavailable", "", r#"{"error": {"message": "down"}}"#);
    let (found, waits, requests) = ask((0..5).map(|_| failing()).collect());
    let error = found.unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Io);
    assert!(
        error
            .to_string()
            .contains("in 5 attempts: status 503: \"down\""),
        "{error}"
    );
    assert_eq!(waits, [1, 2, 4, 8]);
    assert_eq!(requests.len(), 5);
}

#[test]
fn refused_connection_is_given_up() {
    let bench = Bench::new();
    let error = bench
        .estimator(&refused_url(), false)
        .physical(&query())
        .unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Io);
    assert!(error.to_string().contains("refused"), "{error}");
    assert!(error.remedy_text().unwrap().contains("table"), "{error}");
    assert_eq!(bench.waits(), [1, 2, 4, 8]);
}

#[test]
fn server_without_tls_fails_at_once() {
    let bench = Bench::new();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("https://{}/v1", listener.local_addr().unwrap());
    thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let _ = stream.read(&mut [0; 4096]).unwrap();
        stream
            .write_all(b"HTTP/1.1 400 Bad Request\r\n\r\n")
            .unwrap();
    });
    let error = bench.estimator(&url, true).physical(&query()).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Config, "{error}");
    assert!(
        error.to_string().contains("no secure connection"),
        "{error}"
    );
    assert!(bench.waits().is_empty());
}

#[test]
fn silent_server_times_out() {
    let bench = Bench::new();
    let server = TestServer::new(vec![Reply::Silence]);
    let mut options = LlmOptions::new(&server.url, "m", bench.folder.path().to_owned());
    options.timeout = Duration::from_millis(20);
    options.attempts = 1;
    let client = LlmClient::new(options).unwrap();
    let error = PropertyEstimator::new(client, false)
        .physical(&query())
        .unwrap_err();
    assert!(error.to_string().contains("timeout"), "{error}");
}

#[test]
fn endless_reply_is_cut_off() {
    let error = failure(vec![Reply::Endless, Reply::Endless]);
    assert!(
        error.to_string().contains("longer than 1048576 bytes"),
        "{error}"
    );
}

#[test]
fn refusals_are_not_repeated_and_hide_the_key() {
    for (status, kind) in [
        ("401 Unauthorized", ErrorKind::Permission),
        ("404 Not Found", ErrorKind::NotFound),
        ("400 Bad Request", ErrorKind::Input),
        ("308 Permanent Redirect", ErrorKind::Usage),
    ] {
        let body =
            format!(r#"{{"error": {{"message": "Incorrect key {KEY}: \u0073k-very-secret-42"}}}}"#);
        let (found, waits, requests) = ask(vec![Reply::status(status, "", &body)]);
        let error = found.unwrap_err();
        assert_eq!(error.kind(), kind);
        assert!(
            error.to_string().contains("Incorrect key [key]: [key]"),
            "{error}"
        );
        assert_eq!((waits.len(), requests.len()), (0, 1), "{status}");
    }
}

#[test]
fn redirect_is_reported_and_not_followed() {
    let to = "Location: https://elsewhere.example/v1/chat/completions\r\n";
    let error = failure(vec![Reply::status("307 Temporary Redirect", to, "moved")]);
    assert!(
        error.to_string().contains("https://elsewhere.example/v1"),
        "{error}"
    );
}

#[test]
fn key_never_leaks() {
    let bench = Bench::new();
    let server = TestServer::new(vec![Reply::answer(&format!("{KEY} {GOOD}"))]);
    let mut estimator = bench.estimator(&server.url, false);
    estimator.physical(&query()).unwrap();
    assert!(!format!("{estimator:?}").contains(KEY), "{estimator:?}");
    let files = bench.files();
    assert_eq!(files.len(), 1);
    let text = fs::read_to_string(&files[0]).unwrap();
    assert!(text.contains("[key]") && !text.contains("secret"), "{text}");
    let mut options = LlmOptions::new("http://example.org/v1", "m", "answers".into());
    options.key = EndpointKey::new(KEY).unwrap();
    assert!(!format!("{options:?}").contains(KEY), "{options:?}");
    let error = LlmClient::new(options).unwrap_err();
    assert!(error.to_string().contains("unencrypted"), "{error}");
    assert!(!error.to_string().contains(KEY));
}

#[test]
fn cached_answer_is_not_requested_again() {
    let bench = Bench::new();
    let server = TestServer::new(vec![Reply::answer(GOOD)]);
    let first = bench
        .estimator(&server.url, false)
        .physical(&query())
        .unwrap();
    let again = bench
        .estimator(&refused_url(), false)
        .physical(&query())
        .unwrap();
    assert_eq!(first, again);
    assert_eq!(server.requests().len(), 1);
    let other = PropertyQuery {
        size_m: 0.2,
        ..query()
    };
    assert!(
        bench
            .estimator(&refused_url(), false)
            .physical(&other)
            .is_err()
    );
}

#[test]
fn damaged_answer_is_requested_again() {
    let bench = Bench::new();
    let server = TestServer::new(vec![
        Reply::answer(GOOD),
        Reply::answer(GOOD),
        Reply::answer(GOOD),
    ]);
    let mut estimator = bench.estimator(&server.url, false);
    let first = estimator.physical(&query()).unwrap();
    let file = bench.files().remove(0);
    let whole = fs::read_to_string(&file).unwrap();
    for damaged in [whole[..40].to_owned(), whole.replace("0.8", "80")] {
        fs::write(&file, damaged).unwrap();
        assert_eq!(estimator.physical(&query()).unwrap(), first);
        assert_eq!(fs::read_to_string(&file).unwrap(), whole);
    }
    assert_eq!(server.requests().len(), 3);
}

#[test]
fn cache_failure_is_an_error_even_with_fallback() {
    let bench = Bench::new();
    let server = TestServer::new(vec![Reply::answer(GOOD)]);
    let taken = bench.folder.path().join("taken");
    fs::write(&taken, "").unwrap();
    let options = LlmOptions::new(&server.url, "m", taken.join("answers"));
    let mut estimator = PropertyEstimator::new(LlmClient::new(options).unwrap(), true);
    assert!(estimator.physical(&query()).is_err());
}

#[test]
fn table_is_used_only_with_fallback() {
    let bench = Bench::new();
    let server = TestServer::new(vec![Reply::answer(GOOD)]);
    let known = bench
        .estimator(&server.url, false)
        .physical(&query())
        .unwrap();
    let mut estimator = bench.estimator(&refused_url(), true);
    let bowl = PropertyQuery {
        category: "bowl",
        ..query()
    };
    let found = estimator.physical(&bowl).unwrap();
    let PropertySource::Fallback { reason } = &found.source else {
        panic!("{found:?}");
    };
    assert!(reason.contains("refused"), "{reason}");
    assert!((0.1..0.3).contains(&found.mass_kg), "{found:?}");
    assert_eq!(bench.waits().len(), 4);
    // Cached answers are still used, and nobody waits for the endpoint again.
    assert_eq!(estimator.physical(&query()).unwrap(), known);
    let expected = builtin_appearances(bowl.object, bowl.material, bowl.seed);
    assert_eq!(estimator.appearances(&bowl).unwrap(), expected);
    assert_eq!(bench.waits().len(), 4);
}

#[test]
fn unusable_answer_falls_back_for_one_object() {
    let bench = Bench::new();
    let server = TestServer::new(vec![
        Reply::answer("?"),
        Reply::answer("?"),
        Reply::answer(GOOD),
    ]);
    let mut estimator = bench.estimator(&server.url, true);
    let first = estimator.physical(&query()).unwrap();
    assert!(
        matches!(first.source, PropertySource::Fallback { .. }),
        "{first:?}"
    );
    let second = estimator.physical(&query()).unwrap();
    let model = "test-model".to_owned();
    assert_eq!(second.source, PropertySource::Llm { model });
}

#[test]
fn refusal_is_an_error_even_with_fallback() {
    let bench = Bench::new();
    let server = TestServer::new(vec![Reply::status("401 Unauthorized", "", "")]);
    let error = bench
        .estimator(&server.url, true)
        .physical(&query())
        .unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Permission);
}

#[test]
fn appearances_are_described_and_interpreted() {
    let bench = Bench::new();
    let list = "Scratched blue enamel\nPolished walnut\nBrushed steel\nFrosted glass\nPlain white";
    let server = TestServer::new(vec![Reply::answer(list)]);
    let found = bench
        .estimator(&server.url, false)
        .appearances(&query())
        .unwrap();
    let finishes: Vec<_> = found.iter().map(|m| m.appearance.finish).collect();
    use FinishClass::{Ceramic, Glass, Metal, Wood};
    assert_eq!(finishes, [Ceramic, Wood, Metal, Glass, Ceramic]);
    assert_eq!(found[0].description, "Scratched blue enamel");
}

#[test]
fn stop_ends_the_waiting() {
    let bench = Bench::new();
    let stop = |_| Err(Error::new(ErrorKind::Stopped, "stopped"));
    let client = bench.client(&refused_url()).waiting(Box::new(stop));
    let error = PropertyEstimator::new(client, true)
        .physical(&query())
        .unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Stopped);
}

#[test]
fn client_needs_a_url_and_a_model() {
    let client = |url: &str, model: &str| {
        LlmClient::new(LlmOptions::new(url, model, Path::new("a").to_owned()))
    };
    assert!(client("http://localhost:1/v1", "m").is_ok());
    assert_eq!(
        client("localhost", "m").unwrap_err().kind(),
        ErrorKind::Usage
    );
    assert_eq!(
        client("http://localhost:1/v1", " ").unwrap_err().kind(),
        ErrorKind::Usage
    );
}
