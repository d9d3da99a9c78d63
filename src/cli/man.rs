//! `gripcast man --out DIR`: writes the manual pages, one per command.
//!
//! The date of the pages is today or `SOURCE_DATE_EPOCH`, for reproducible builds.

use std::path::{Path, PathBuf};

use clap_mangen::Man;
use clap_mangen::roff::{Roff, roman};
use jiff::Timestamp;

use super::{Context, command, create_folder};
use crate::note;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::save;

/// Exit codes and their meaning.
const EXIT_CODES: [(&str, &str); 8] = [
    ("0", "Success."),
    ("1", "Failure; the message states cause and remedy."),
    ("2", "Invalid command line, configuration or rig file."),
    ("3", "Done, but some data was lost or left out."),
    ("4", "A check failed."),
    ("69", "A camera is missing."),
    (
        "75",
        "Stopped at a safe point; rerun the command to resume.",
    ),
    ("130", "Interrupted by the user."),
];

/// Arguments of `man`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Output directory of the pages; created if absent
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// Runs the command.
pub(crate) fn run(context: &Context, args: &Args) -> Result<()> {
    let date = date(std::env::var("SOURCE_DATE_EPOCH").ok().as_deref())?;
    create_folder(&args.out)?;
    let mut command = command().disable_help_subcommand(true);
    command.build();
    let written = write_pages(&command, &date, &args.out)?;
    if !context.quiet {
        note!("{written} pages in {}", args.out.display());
    }
    Ok(())
}

/// Returns the date of the pages; `epoch` in seconds since 1970.
fn date(epoch: Option<&str>) -> Result<String> {
    let time = match epoch {
        None => Timestamp::now(),
        Some(text) => text
            .parse()
            .ok()
            .and_then(|seconds| Timestamp::from_second(seconds).ok())
            .ok_or_else(|| {
                Error::usage(format!(
                    "SOURCE_DATE_EPOCH must be seconds since 1970, found `{text}`"
                ))
            })?,
    };
    Ok(time.strftime("%Y-%m-%d").to_string())
}

/// Writes the pages of a built command and its subcommands; returns their number.
fn write_pages(command: &clap::Command, date: &str, folder: &Path) -> Result<usize> {
    let mut written = 1;
    for below in command.get_subcommands().filter(|c| !c.is_hide_set()) {
        written += write_pages(below, date, folder)?;
    }
    let title = command.get_display_name().unwrap_or("gripcast");
    let page = Man::new(command.clone())
        .title(title.to_uppercase())
        .date(date)
        .source(concat!("gripcast ", env!("CARGO_PKG_VERSION")))
        .manual("gripcast");
    let mut text = Vec::new();
    let rendered = page
        .render(&mut text)
        .and_then(|()| match command.get_name() {
            "gripcast" => exit_codes().to_writer(&mut text),
            _ => Ok(()),
        });
    rendered.map_err(|e| Error::io("cannot render a manual page", e))?;
    let text = without_empty_lines(&String::from_utf8_lossy(&text));
    save(&folder.join(page.get_filename()), text.as_bytes())?;
    Ok(written)
}

/// Replaces empty lines by space requests and trims lines; mandoc warns about both.
fn without_empty_lines(page: &str) -> String {
    let page = page.replace(".br\n\n.br\n", ".sp\n");
    let lines = page.lines().map(str::trim_end);
    let lines = lines.map(|line| if line.is_empty() { ".sp" } else { line });
    lines.flat_map(|line| [line, "\n"]).collect()
}

fn exit_codes() -> Roff {
    let mut section = Roff::new();
    section.control("SH", ["EXIT STATUS"]);
    for (code, meaning) in EXIT_CODES {
        section.control("TP", []);
        section.text([roman(code)]);
        section.text([roman(meaning)]);
    }
    section
}

#[cfg(test)]
mod tests {
    use gripcast_base::error::ErrorKind;
    use std::fs;

    use super::*;

    #[test]
    fn pages_have_no_empty_lines() {
        let shell = clap::Arg::new("shell").value_parser(["bash", "zsh"]);
        let flag = clap::Arg::new("long").long("long").help("One.\n\n.Two");
        let mut command = clap::Command::new("gripcast").args([shell.help("Shell"), flag]);
        command.build();
        let dir = tempfile::tempdir().unwrap();
        assert_eq!(write_pages(&command, "2026-01-01", dir.path()).unwrap(), 1);
        let page = fs::read_to_string(dir.path().join("gripcast.1")).unwrap();
        assert!(
            page.contains("Shell\n.sp\n\\fIPossible values:\\fR\n"),
            "{page}"
        );
        assert!(page.contains("One.\n.sp\n\\&.Two\n"), "{page}");
        assert!(
            page.lines()
                .all(|line| !line.is_empty() && !line.ends_with(' '))
        );
    }

    #[test]
    fn date_reads_epoch_and_refuses_invalid_one() {
        assert_eq!(date(Some("86400")).unwrap(), "1970-01-02");
        for invalid in ["", "tomorrow", "1e9", "99999999999999"] {
            let error = date(Some(invalid)).unwrap_err();
            assert_eq!(error.kind(), ErrorKind::Usage, "{invalid}");
            assert!(error.to_string().contains("SOURCE_DATE_EPOCH"), "{error}");
        }
    }
}
