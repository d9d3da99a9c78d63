use std::collections::BTreeSet;

use super::page;
use crate::report::{Curves, Reality, Report, Setting};
use crate::sample_report::{HOSTILE, IMAGE, sample_report};

const STATEMENT: &str = "Reality is simulated here";

fn rendered(report: &Report) -> String {
    page(report).unwrap()
}

fn count(page: &str, text: &str) -> usize {
    page.matches(text).count()
}

#[test]
fn every_string_is_escaped() {
    let page = rendered(&sample_report());
    assert!(!page.contains("<script>alert"));
    assert!(!page.contains("alert(\""));
    let escaped = "&lt;script&gt;alert(&quot;1&quot;)&lt;/script&gt;&amp;' ";
    assert!(count(&page, escaped) > 100);
    assert!(!page.contains(HOSTILE) && !page.contains(['\u{1}', '\u{202e}']));
    assert_eq!(count(&page, "<script>"), 1);
}

#[test]
fn every_tag_is_closed() {
    let page = rendered(&sample_report());
    for tag in [
        "section", "article", "table", "thead", "tbody", "tr", "td", "th", "div", "svg", "g", "dl",
        "dt", "dd", "p", "figure", "text", "ol", "ul", "li", "small", "span", "h3", "details",
    ] {
        let opened = count(&page, &format!("<{tag} ")) + count(&page, &format!("<{tag}>"));
        assert_eq!(opened, count(&page, &format!("</{tag}>")), "{tag}");
    }
}

#[test]
fn simulated_reality_is_stated_in_every_section() {
    let mut report = sample_report();
    let page = rendered(&report);
    assert_eq!(count(&page, STATEMENT), count(&page, "<section "));
    assert!(page.contains("class=\"spine\"") && page.contains("class=\"flag\""));
    assert!(!page.contains(">real: <b>"));
    report.dataset.reality = Reality::Real;
    let page = rendered(&report);
    assert_eq!(count(&page, STATEMENT), 0);
    for word in [
        "class=\"spine\"",
        "class=\"flag\"",
        "as if real",
        "simulated reality",
    ] {
        assert!(!page.contains(word), "{word}");
    }
}

#[test]
fn heat_map_has_one_cell_per_setting() {
    let mut report = sample_report();
    let page = rendered(&report);
    assert_eq!(count(&page, "<g class=\"cell\""), 2 * 2 * 9);
    assert_eq!(count(&page, "class=\"chosen\" x="), 4);
    assert_eq!(count(&page, "class=\"one\" x="), 4);
    // A setting that only the scores contain gets a row and a column.
    let scores = &mut report.engines[0].scores;
    scores.cells[0].setting = Setting {
        friction: 1.6,
        force_n: 20.0,
    };
    assert_eq!(
        count(&rendered(&report), "<g class=\"cell\""),
        2 * 12 + 2 * 9
    );
}

#[test]
fn empty_or_non_finite_curves_are_not_drawn() {
    let mut report = sample_report();
    for (i, grasp) in report.grasps.iter_mut().enumerate() {
        for replay in &mut grasp.replays {
            replay.case.cpu_s = f64::NAN;
            replay.disagreement = f64::NAN;
            let bad = [f64::NAN, f64::INFINITY, -1e300, 0.0];
            replay.curves = match i {
                0 => Some(Curves::default()),
                1 => Some(Curves {
                    t_s: vec![f64::NAN],
                    ..Curves::default()
                }),
                2 => Some(Curves {
                    t_s: bad.to_vec(),
                    left_n: bad.to_vec(),
                    right_n: vec![1.0],
                    lifted_m: bad.to_vec(),
                    min_height_m: Vec::new(),
                    stages_s: [f64::NAN, -3.0],
                    success_height_m: f64::NAN,
                }),
                _ => continue,
            };
        }
    }
    report.engines[0].scores.paper.mean = f64::NAN;
    report.engines[0].scores.paper.all.low = f64::NAN;
    let page = rendered(&report);
    assert!(!page.contains("NaN"));
    assert!(!page.contains(">inf") && !page.contains("\"inf") && !page.contains("-inf"));
    assert!(page.contains("No forces recorded."));
}

#[test]
fn page_loads_no_external_resource() {
    let mut report = sample_report();
    report.objects[0].image = Some("https://example.org/a.jpg".to_owned());
    let page = rendered(&report);
    for word in [
        "http://", "https://", "@import", "url(\"", "<link", "<iframe", "src=",
    ] {
        assert!(!page.contains(word), "{word}");
    }
    assert!(page.contains("default-src 'none'"));
    for (at, _) in page.match_indices("href=\"") {
        let target = &page[at + 6..];
        assert!(target.starts_with('#') || target.starts_with("data:image/"));
    }
}

#[test]
fn ids_are_unique_and_link_targets_exist() {
    let page = rendered(&sample_report());
    let after = |mark: &str| -> Vec<String> {
        page.match_indices(mark)
            .filter_map(|(at, _)| page[at + mark.len()..].split('"').next())
            .map(str::to_owned)
            .collect()
    };
    let ids = after(" id=\"");
    let unique: BTreeSet<&String> = ids.iter().collect();
    assert_eq!(ids.len(), unique.len(), "duplicate id");
    for target in after("href=\"#") {
        assert!(unique.contains(&target), "{target}");
    }
}

#[test]
fn images_are_embedded_once() {
    let page = rendered(&sample_report());
    // Two objects; two views and two sensors with three images for five grasps.
    assert_eq!(count(&page, IMAGE), 2 + 5 * 8);
}

#[test]
fn gallery_starts_with_the_clearest_disagreement() {
    let page = rendered(&sample_report());
    let gallery = page.split("<section id=\"failures\">").nth(1).unwrap();
    let gallery = gallery.split("</section>").next().unwrap();
    let links: Vec<&str> = gallery
        .match_indices("href=\"#g")
        .map(|(at, mark)| &gallery[at + mark.len()..at + mark.len() + 2])
        .filter(|id| id.ends_with('"'))
        .collect();
    assert_eq!(links, ["3\"", "2\""]);
    assert!(page.contains("7 of 10 drawn poses stable: the pose error explains the disagreement"));
}

#[test]
fn summary_states_agreement_and_p_value() {
    let page = rendered(&sample_report());
    assert!(page.contains("<b>6 of 6</b> grasps (1.00"), "fem");
    assert!(page.contains("<b>4 of 6</b> grasps (0.67"), "rigid");
    assert!(page.contains("exact McNemar p = 0.50"));
}

#[test]
fn empty_report_is_rendered() {
    let mut report = sample_report();
    report.engines.clear();
    report.objects.clear();
    report.grasps.clear();
    report.left_out.clear();
    report.comparison = None;
    report.changes = None;
    let page = rendered(&report);
    assert!(page.contains("No engine was run.") && !page.contains("NaN"));
    assert!(!page.contains("id=\"changes\""));
}

#[test]
fn page_is_deterministic_and_checks_the_version() {
    let mut report = sample_report();
    assert_eq!(rendered(&report), rendered(&report));
    report.version += 1;
    let error = page(&report).unwrap_err().to_string();
    assert!(
        error.contains("expected gripcast-replay-report version 2"),
        "{error}"
    );
}

#[test]
fn page_of_100_grasps_is_below_4_mb_without_images() {
    let mut report = sample_report();
    let wave = |k: usize| 40.0 + 3.0 * (0.7 * k as f64).sin() * (0.11 * k as f64).cos();
    let mut grasp = report.grasps[2].clone();
    for replay in &mut grasp.replays {
        let n = 250;
        replay.curves = Some(Curves {
            t_s: (0..n).map(|k| 0.01 * k as f64).collect(),
            left_n: (0..n).map(wave).collect(),
            right_n: (0..n).map(|k| wave(k + 9)).collect(),
            lifted_m: (0..n).map(|k| 2e-4 * k as f64).collect(),
            min_height_m: (0..n).map(|k| 1e-3 * wave(k)).collect(),
            stages_s: [0.5, 1.0],
            success_height_m: 0.02,
        });
    }
    report.grasps = vec![grasp; 100];
    let page = rendered(&report);
    let images = count(&page, IMAGE) * IMAGE.len();
    let size = page.len() - images;
    assert!(size < 4_000_000, "{size} bytes");
}
