//! The help texts of all commands, as they print on a terminal of 100 columns.

use std::collections::BTreeSet;
use std::path::Path;

use clap::Command;
use gripcast::cli;

/// Help of a built command and of everything below it.
fn help(command: &mut Command, text: &mut String) {
    let hidden = if command.is_hide_set() {
        " (hidden)"
    } else {
        ""
    };
    let name = command.get_display_name().unwrap_or("gripcast");
    let name = name.replace('-', " ");
    text.push_str(&format!("===== {name}{hidden} =====\n\n"));
    text.push_str(&command.render_long_help().to_string());
    text.push('\n');
    for below in command.get_subcommands_mut() {
        help(below, text);
    }
}

#[test]
fn help_texts_match_snapshots() {
    let mut program = cli::command().term_width(100).disable_help_subcommand(true);
    program.build();
    let mut settings = insta::Settings::clone_current();
    settings.set_snapshot_path("snapshots/help");
    settings.set_prepend_module_to_snapshot(false);
    settings.set_omit_expression(true);
    let own = program.render_long_help().to_string();
    settings.bind(|| insta::assert_snapshot!("gripcast", own));
    let mut expected = BTreeSet::from(["gripcast.snap".to_owned()]);
    for verb in program.get_subcommands_mut() {
        let mut text = String::new();
        help(verb, &mut text);
        settings.bind(|| insta::assert_snapshot!(verb.get_name(), text));
        expected.insert(format!("{}.snap", verb.get_name()));
    }
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/it/snapshots/help");
    let reviewed = std::fs::read_dir(folder).unwrap();
    let reviewed = reviewed.map(|entry| entry.unwrap().file_name().into_string().unwrap());
    assert_eq!(reviewed.collect::<BTreeSet<_>>(), expected);
}
