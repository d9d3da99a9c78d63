//! What packages bring along: manual pages, udev rules, the service's settings.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use gripcast_capture::device::udev_rule;
use gripcast_capture::trigger::pedal_udev_rule;

use crate::program::{gripcast, json, stderr, succeed};
use gripcast_testing::{Needs, skip};

fn repository_file(path: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(path);
    fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// A file without comments and empty lines.
fn settings(text: &str) -> Vec<&str> {
    let lines = text.lines().map(str::trim);
    lines
        .filter(|line| !line.is_empty() && !line.starts_with('#'))
        .collect()
}

/// `0c45:636d` and the like in a text.
fn usb_ids(text: &str) -> BTreeSet<(u16, u16)> {
    text.split(|c: char| !(c.is_ascii_hexdigit() || c == ':'))
        .filter(|word| word.len() == 9)
        .filter_map(|word| {
            let (vendor, product) = word.split_once(':')?;
            let id = |text| u16::from_str_radix(text, 16).ok();
            Some((id(vendor)?, id(product)?))
        })
        .collect()
}

/// The verbs that `--help` lists below a command.
fn verbs(command: &[&str]) -> Vec<String> {
    let help = succeed(gripcast().args(command).arg("--help"));
    let help = String::from_utf8(help.stdout).unwrap();
    let listed = help.lines().skip_while(|line| *line != "Commands:").skip(1);
    listed
        .take_while(|line| !line.is_empty())
        .filter(|line| line.starts_with("  ") && !line.starts_with("   "))
        .filter_map(|line| line.split_whitespace().next())
        .filter(|verb| *verb != "help")
        .map(str::to_owned)
        .collect()
}

fn man_pages(folder: &Path) -> Vec<PathBuf> {
    let mut command = gripcast();
    command
        .args(["man", "--out"])
        .arg(folder)
        .env("SOURCE_DATE_EPOCH", "1767225600");
    succeed(&mut command);
    let mut pages: Vec<PathBuf> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    pages.sort();
    pages
}

#[test]
fn every_verb_has_a_manual_page() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("a/man");
    let pages = man_pages(&folder);
    let verbs_of_program = verbs(&[]);
    assert!(verbs_of_program.len() >= 19, "{verbs_of_program:?}");
    let mut expected = vec!["gripcast.1".to_owned()];
    for verb in &verbs_of_program {
        expected.push(format!("gripcast-{verb}.1"));
        let below = verbs(&[verb]);
        expected.extend(
            below
                .iter()
                .map(|below| format!("gripcast-{verb}-{below}.1")),
        );
    }
    for page in expected {
        let text = fs::read_to_string(folder.join(&page))
            .unwrap_or_else(|error| panic!("{page}: {error}"));
        assert!(text.contains(".SH NAME"), "{page}");
    }
    let program = fs::read_to_string(folder.join("gripcast.1")).unwrap();
    assert!(program.contains(".TH GRIPCAST 1 2026-01-01"), "{program}");
    assert!(program.contains(".SH \"EXIT STATUS\""), "{program}");

    let again = man_pages(&dir.path().join("b"));
    assert_eq!(pages.len(), again.len());
    for (page, again) in pages.iter().zip(&again) {
        assert_eq!(fs::read(page).unwrap(), fs::read(again).unwrap());
    }
}

/// With mandoc or with groff's warnings.
#[test]
fn manual_pages_have_no_mistakes() {
    let dir = tempfile::tempdir().unwrap();
    let pages = man_pages(dir.path());
    let mut checked = false;
    let checks: [(&str, &[&str]); 2] = [
        ("mandoc", &["-Tlint", "-Wwarning"]),
        ("groff", &["-Kutf8", "-man", "-Tutf8", "-ww", "-z"]),
    ];
    for (tool, arguments) in checks {
        match Command::new(tool).args(arguments).args(&pages).output() {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
            output => {
                let output = output.unwrap();
                let said = String::from_utf8_lossy(&output.stdout).into_owned() + &stderr(&output);
                assert!(said.is_empty() && output.status.success(), "{tool}: {said}");
                checked = true;
            }
        }
    }
    if !checked {
        skip(
            Needs::Mandoc,
            "neither mandoc nor groff is installed (apt-get install mandoc)",
        );
    }
}

#[test]
fn pages_that_cannot_be_written_are_explained() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("file");
    fs::write(&file, "").unwrap();
    let output = gripcast().args(["man", "--out"]).arg(&file).output();
    let output = output.unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("cannot create the folder"));

    let mut command = gripcast();
    command.args(["man", "--out"]).arg(dir.path().join("man"));
    let output = command.env("SOURCE_DATE_EPOCH", "now").output().unwrap();
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
}

/// Every rule of the packaged file is the one that `doctor` would print for its device, and every
/// device of the notes has one.
#[test]
fn packaged_udev_rules_are_those_that_doctor_prints() {
    let rules = repository_file("packaging/70-gripcast.rules");
    let rules: BTreeSet<&str> = settings(&rules).into_iter().collect();
    let cameras = ["gelsight-mini", "d435"].map(|name| {
        let notes = repository_file(&format!("firmware-notes/{name}.md"));
        let row = notes.lines().find(|line| line.starts_with("| USB id |"));
        usb_ids(row.unwrap())
    });
    let pedals = usb_ids(&repository_file("firmware-notes/pedals.md"));
    assert_eq!((cameras[0].len(), cameras[1].len()), (1, 2));
    assert!(pedals.len() >= 8, "{pedals:?}");
    let cameras = cameras.into_iter().flatten();
    let expected: BTreeSet<String> = cameras
        .map(|(vendor, product)| udev_rule(vendor, product))
        .chain(pedals.into_iter().map(|(v, p)| pedal_udev_rule(v, p)))
        .collect();
    assert_eq!(rules, expected.iter().map(String::as_str).collect());
}

fn config_show(text: &str) -> serde_json::Value {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("config.toml");
    fs::write(&file, text).unwrap();
    let mut command = gripcast();
    command.args(["config", "show", "--json", "--config"]);
    json(&succeed(command.arg(&file)))
}

/// Packaged settings with everything that is commented out switched on, as their comments say.
fn switched_on(packaged: &str) -> String {
    let is_setting = |line: &str| line.starts_with('#') && !line.starts_with("# ");
    packaged
        .lines()
        .filter(|line| *line != "listen = \"none\"")
        .map(|line| if is_setting(line) { &line[1..] } else { line })
        .flat_map(|line| [line, "\n"])
        .collect()
}

/// The packaged settings are accepted, name every key, and those that are commented out are the
/// defaults, except where they are examples.
#[test]
fn packaged_settings_show_the_defaults() {
    let packaged = repository_file("packaging/config.toml");
    assert_eq!(
        config_show(&packaged)["collect.dataset"]["value"],
        "/var/lib/gripcast/dataset"
    );
    let defaults = config_show("");
    let shown = config_show(&switched_on(&packaged));
    for (key, default) in defaults.as_object().unwrap() {
        // Sound and graphics are of the screen, which a service has none of.
        if ["collect.sound", "collect.graphics"].contains(&key.as_str()) {
            continue;
        }
        let here = &shown[key];
        assert_ne!(here["origin"], "default", "{key} is not in the file");
        if !["collect.rig", "collect.dataset", "daemon.token_file"].contains(&key.as_str()) {
            assert_eq!(here["value"], default["value"], "{key}");
        }
    }
}

/// Any user of a machine can reach its loopback: the packaged service listens there only with a
/// token, and only after the administrator has said so.
#[test]
fn packaged_service_opens_no_port_without_token() {
    let packaged = repository_file("packaging/config.toml");
    let installed = config_show(&packaged);
    assert_eq!(installed["daemon.listen"]["value"], "none");
    let page_on = config_show(&switched_on(&packaged));
    assert_eq!(page_on["daemon.listen"]["value"], "127.0.0.1:7471");
    let token = page_on["daemon.token_file"]["value"].as_str().unwrap();
    let postinst = repository_file("packaging/deb/postinst");
    assert!(postinst.contains(&format!("token={token}\n")), "{postinst}");

    let unit = repository_file("packaging/gripcast.service");
    for line in [
        "RuntimeDirectoryMode=0750",
        "Group=gripcast",
        "MemoryMax=2G",
        "TasksMax=512",
    ] {
        assert!(settings(&unit).contains(&line), "{line}");
    }
}
