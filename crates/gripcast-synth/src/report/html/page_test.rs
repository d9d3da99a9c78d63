use std::collections::BTreeSet;

use super::super::facts::*;
use super::super::gather::plan_facts;
use super::super::sample::{Sample, labelled};
use super::super::{balance::balance, contact::contact, costs::costs, unlabelled::unlabelled};
use super::page;
use gripcast_report::image::data_uri;

/// A report without contact, a dataset or examples.
fn sample_report() -> SynthReport {
    let sample = Sample::new(8);
    let mut gathered = labelled(&sample, &[true, true, false, true, false, false, true]);
    gathered.open = 1;
    gathered.damaged = vec!["<damaged>".to_owned()];
    gathered.done[6].result.stable = None;
    gathered.done[6].result.outcome = "<i>odd".to_owned();
    SynthReport {
        format: SYNTH_REPORT_FORMAT.to_owned(),
        version: SYNTH_REPORT_VERSION,
        software: "gripcast 0".to_owned(),
        seed: 0,
        plan: plan_facts(&sample.plan),
        progress: gathered.progress(),
        categories: gathered.categories(&sample.plan),
        dataset: None,
        balance: balance(&gathered, None),
        contact: contact(&[]),
        costs: costs(&gathered),
        unlabelled: unlabelled(&gathered),
        examples: Vec::new(),
    }
}

fn example(held: bool) -> Example {
    let image = data_uri(&image::RgbImage::new(16, 12)).unwrap();
    Example {
        simulation: format!("mug-{held}"),
        object: "mug <script>".to_owned(),
        category: "mug".to_owned(),
        material: "wood".to_owned(),
        fault: Some("tilted".to_owned()),
        stop_force_n: 40.0,
        friction: 0.456,
        mass_kg: 0.1234,
        lifted_m: 0.0501,
        outcome: if held { "success" } else { "eject" }.to_owned(),
        held,
        rendering: 0,
        appearance: "\"red\"".to_owned(),
        images: ExampleImages {
            colour: image.clone(),
            grasp: [image.clone(), "https://example.org".to_owned()],
            change: [image.clone(), image],
        },
    }
}

fn count(page: &str, text: &str) -> usize {
    page.matches(text).count()
}

#[test]
fn every_tag_is_closed_and_every_string_escaped() {
    let mut report = sample_report();
    report.examples = [true, false].map(example).to_vec();
    let page = page(&report).unwrap();
    for tag in [
        "section", "table", "thead", "tbody", "tfoot", "tr", "td", "th", "div", "svg", "dl", "dt",
        "dd", "p", "ul", "li", "span", "h3", "i", "b", "main", "body",
    ] {
        let opened = count(&page, &format!("<{tag} ")) + count(&page, &format!("<{tag}>"));
        assert_eq!(opened, count(&page, &format!("</{tag}>")), "{tag}");
    }
    assert!(page.contains("ring &lt;b&gt;") && page.contains("&lt;damaged&gt;"));
    assert!(page.contains("&lt;i&gt;odd") && !page.contains("mug <script>"));
    assert!(!page.contains("NaN") && !page.contains(">inf"));
}

#[test]
fn nothing_is_fetched_and_nothing_needs_a_script() {
    let mut report = sample_report();
    report.examples = vec![example(true)];
    let page = page(&report).unwrap();
    for word in [
        "http://", "https://", "url(", "<link", "src=", "<script", "<iframe",
    ] {
        assert!(!page.contains(word), "{word}");
    }
    assert!(page.contains("default-src 'none'") && !page.contains("script-src"));
    assert_eq!(count(&page, "class=\"nopic\""), 1, "an address");
}

#[test]
fn links_have_their_places() {
    let page = page(&sample_report()).unwrap();
    let after = |mark: &str| -> Vec<String> {
        let found = page.match_indices(mark);
        let found = found.filter_map(|(at, _)| page[at + mark.len()..].split('"').next());
        found.map(str::to_owned).collect()
    };
    let ids = after(" id=\"");
    let unique: BTreeSet<&String> = ids.iter().collect();
    assert_eq!(ids.len(), unique.len(), "an id twice");
    let links = after("href=\"#");
    assert_eq!(links.len(), 8);
    assert!(links.iter().all(|link| unique.contains(link)));
}

#[test]
fn the_summary_says_what_is_not_finished_and_that_all_is_simulated() {
    let mut report = sample_report();
    let unfinished = page(&report).unwrap();
    assert!(unfinished.contains("<b>7 of 8</b> planned simulations"));
    assert!(unfinished.contains("<b>3</b> held, <b>3</b> were lost (50\u{a0}% held)"));
    assert!(unfinished.contains("Simulations without a result: 1."));
    assert!(unfinished.contains("Everything here is simulated"));
    report.progress.open = 0;
    report.progress.damaged.clear();
    assert_eq!(count(&page(&report).unwrap(), "class=\"warning\""), 0);
}

#[test]
fn examples_are_in_their_halves() {
    let mut report = sample_report();
    report.examples = [true, true, false].map(example).to_vec();
    let page = page(&report).unwrap();
    let (held, lost) = page.split_once("<h3>Lost").unwrap();
    assert_eq!(count(held, "class=\"of-held\""), 2);
    assert_eq!(
        (
            count(lost, "class=\"of-lost\""),
            count(lost, "class=\"of-held\"")
        ),
        (1, 0)
    );
    assert!(lost.contains("40\u{a0}N, tilted, friction 0.46, 123\u{a0}g"));
    assert!(lost.contains("squeezed out; rose 50.1\u{a0}mm"));
}

#[test]
fn bars_are_as_long_as_their_counts() {
    let page = page(&sample_report()).unwrap();
    let row = page.split("<tr><th scope=\"row\">box</th>").nth(1).unwrap();
    let row = row.split("</tr>").next().unwrap();
    // One held, two lost of the boxes; the most of a category is three.
    assert!(
        row.contains("class=\"held\" style=\"width:33.33%\""),
        "{row}"
    );
    assert!(
        row.contains("class=\"lost\" style=\"width:66.67%\""),
        "{row}"
    );
}

#[test]
fn another_version_is_refused() {
    let mut report = sample_report();
    report.version += 1;
    let error = page(&report).unwrap_err().to_string();
    assert!(
        error.contains("expected gripcast-synth-report version 1"),
        "{error}"
    );
}
