use std::collections::BTreeSet;

use super::super::facts::*;
use super::super::results::plan_facts;
use super::super::sample::{Sample, labelled};
use super::super::{balance::balance, contact::contact, costs::costs, unlabelled::unlabelled};
use super::page;
use gripcast_report::image::data_uri;

/// A report without contact, a dataset or examples.
fn sample_report() -> SynthReport {
    let sample = Sample::new(8);
    let mut plan_results = labelled(&sample, &[true, true, false, true, false, false, true]);
    plan_results.open = 1;
    plan_results.damaged = vec!["<damaged>".to_owned()];
    plan_results.done[6].result.stable = None;
    plan_results.done[6].result.outcome = "<i>odd".to_owned();
    SynthReport {
        format: SYNTH_REPORT_FORMAT.to_owned(),
        version: SYNTH_REPORT_VERSION,
        software: "gripcast 0".to_owned(),
        seed: 0,
        plan: plan_facts(&sample.plan),
        progress: plan_results.progress(),
        categories: plan_results.categories(&sample.plan),
        dataset: None,
        balance: balance(&plan_results, None),
        contact: contact(&[]),
        costs: costs(&plan_results),
        unlabelled: unlabelled(&plan_results),
        examples: Vec::new(),
    }
}

fn example(stable: bool) -> Example {
    let image = data_uri(&image::RgbImage::new(16, 12)).unwrap();
    Example {
        simulation: format!("mug-{stable}"),
        object: "mug <script>".to_owned(),
        category: "mug".to_owned(),
        material: "wood".to_owned(),
        fault: Some("tilted".to_owned()),
        stop_force_n: 40.0,
        friction: 0.456,
        mass_kg: 0.1234,
        lifted_m: 0.0501,
        outcome: if stable { "success" } else { "eject" }.to_owned(),
        stable,
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
fn tags_are_closed_and_strings_escaped() {
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
fn page_needs_no_network_or_script() {
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
fn links_have_targets() {
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
fn summary_warns_about_open_and_simulated_results() {
    let mut report = sample_report();
    let unfinished = page(&report).unwrap();
    assert!(unfinished.contains("<b>7 of 8</b> planned simulations"));
    assert!(unfinished.contains("<b>3</b> stable, <b>3</b> slip (50\u{a0}% stable)"));
    assert!(unfinished.contains("Simulations without a result: 1."));
    assert!(unfinished.contains("Everything here is simulated"));
    report.progress.open = 0;
    report.progress.damaged.clear();
    assert_eq!(count(&page(&report).unwrap(), "class=\"warning\""), 0);
}

#[test]
fn examples_are_grouped_by_label() {
    let mut report = sample_report();
    report.examples = [true, true, false].map(example).to_vec();
    let page = page(&report).unwrap();
    let (stable, slip) = page.split_once("<h3>Slip").unwrap();
    assert_eq!(count(stable, "class=\"of-stable\""), 2);
    assert_eq!(
        (
            count(slip, "class=\"of-slip\""),
            count(slip, "class=\"of-stable\"")
        ),
        (1, 0)
    );
    assert!(slip.contains("40\u{a0}N, tilted, friction 0.46, 123\u{a0}g"));
    assert!(slip.contains("ejected; rose 50.1\u{a0}mm"));
}

#[test]
fn bars_have_the_length_of_their_counts() {
    let page = page(&sample_report()).unwrap();
    let row = page.split("<tr><th scope=\"row\">box</th>").nth(1).unwrap();
    let row = row.split("</tr>").next().unwrap();
    // One stable grasp and two slips of the boxes; the maximum of a category is three.
    assert!(
        row.contains("class=\"stable\" style=\"width:33.33%\""),
        "{row}"
    );
    assert!(
        row.contains("class=\"slip\" style=\"width:66.67%\""),
        "{row}"
    );
}

#[test]
fn other_version_is_refused() {
    let mut report = sample_report();
    report.version += 1;
    let error = page(&report).unwrap_err().to_string();
    assert!(
        error.contains("expected gripcast-synth-report version 2"),
        "{error}"
    );
}
