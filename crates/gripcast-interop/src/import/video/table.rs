//! The list of clips: a table in JSON or CSV, or a folder with one folder a clip.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use serde_json::Value;

use crate::left_out::LeftOut;
use gripcast_base::error::{Error, Result, nearest_name};
use gripcast_base::files::{BeneathPath, FileKind, Label, ObjectName, Root, read_text};
use gripcast_dataset::Outcome;

/// Suffixes of videos.
const SUFFIXES: [&str; 8] = ["avi", "mp4", "mkv", "mov", "webm", "mjpeg", "m4v", "mpg"];
/// Columns that are read; others are only used by patterns.
const COLUMNS: [&str; 9] = [
    "id",
    "left",
    "right",
    "object",
    "outcome",
    "initial_frame",
    "grasp_frame",
    "begins",
    "label_conflict",
];

/// How a clip begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Begins {
    /// With the gripper open.
    Open,
    /// In contact.
    Contact,
}

/// One clip.
#[derive(Clone, Debug)]
pub struct ClipRow {
    /// Id, unique in the list.
    pub id: Label,
    /// Videos of the left and the right sensor.
    pub videos: [BeneathPath; 2],
    /// Object to grasp.
    pub object: ObjectName,
    /// Outcome; one that the list calls conflicting is not used.
    pub outcome: Outcome,
    /// Frame of the open gripper.
    pub initial_frame: Option<usize>,
    /// Frame of the closed gripper.
    pub grasp_frame: Option<usize>,
    /// How the clip begins, where the list says it.
    pub begins: Option<Begins>,
}

/// Values of a row by column.
type Row = BTreeMap<String, String>;

/// Reads a list of clips, and what of it has to be left out. `patterns` give the videos of a row of a
/// table without the columns `left` and `right`; `{column}` stands for a value of the row.
///
/// # Errors
/// `NotFound`, `Io`; `Input` for an invalid table, with the row; `Usage` for patterns with a folder.
pub fn clips_of(
    source: &Path,
    patterns: [Option<&str>; 2],
    object: Option<&ObjectName>,
) -> Result<(Vec<ClipRow>, Vec<LeftOut>)> {
    let (clips, left_out) = if source.is_dir() {
        if patterns.iter().any(Option::is_some) {
            return Err(Error::usage("`--left` and `--right` need a table of clips")
                .at(source.display())
                .remedy("give a table in JSON or CSV, or leave them out"));
        }
        clips_of_folder(source, object)?
    } else {
        (clips_of_table(source, patterns, object)?, Vec::new())
    };
    if clips.is_empty() && left_out.is_empty() {
        return Err(Error::input("there are no clips")
            .at(source.display())
            .remedy("give a table with a row a clip, or a folder with a folder a clip"));
    }
    let mut ids = BTreeSet::new();
    for clip in &clips {
        if !ids.insert(clip.id.as_str()) {
            let what = format!("the id `{}` is there twice", clip.id);
            return Err(Error::input(what).at(source.display()));
        }
    }
    Ok((clips, left_out))
}

fn clips_of_folder(
    source: &Path,
    object: Option<&ObjectName>,
) -> Result<(Vec<ClipRow>, Vec<LeftOut>)> {
    let top = Root::new(source).top();
    let cannot = |e| Error::io("cannot read the folder", e).at(source.display());
    let (mut clips, mut left_out) = (Vec::new(), Vec::new());
    for folder in top.directories().map_err(cannot)? {
        let mut videos = folder.entries().map_err(cannot)?;
        videos.retain(|file| is_video(&file.name()));
        let id = Label::nearest(&folder.name());
        match <[BeneathPath; 2]>::try_from(videos) {
            Ok(videos) => clips.push(ClipRow {
                id,
                videos,
                object: object.cloned().unwrap_or_default(),
                outcome: Outcome::Unlabelled,
                initial_frame: None,
                grasp_frame: None,
                begins: None,
            }),
            Err(videos) if videos.is_empty() => {}
            Err(videos) => left_out.push(LeftOut {
                id: id.to_string(),
                reason: format!("expected two videos, found {}", videos.len()),
            }),
        }
    }
    Ok((clips, left_out))
}

fn is_video(name: &str) -> bool {
    let suffix = name.rsplit_once('.').map_or("", |(_, suffix)| suffix);
    SUFFIXES.iter().any(|s| suffix.eq_ignore_ascii_case(s))
}

fn clips_of_table(
    source: &Path,
    patterns: [Option<&str>; 2],
    object: Option<&ObjectName>,
) -> Result<Vec<ClipRow>> {
    let text = read_text(source, FileKind::List)
        .map_err(|e| Error::io("cannot read the table", e).at(source.display()))?;
    let is_json = text.trim_start().starts_with('[');
    let rows = match is_json {
        true => json_rows(&text),
        false => csv_rows(&text),
    };
    let rows = rows.map_err(|e| e.at(source.display()))?;
    let folder = Root::new(
        source
            .parent()
            .filter(|p| !p.as_os_str().is_empty())
            .unwrap_or(Path::new(".")),
    );
    let clip = |(number, row): (usize, &Row)| {
        clip(row, number, &folder, patterns, object)
            .map_err(|e| e.at(format!("{}, row {}", source.display(), number + 1)))
    };
    rows.iter().enumerate().map(clip).collect()
}

fn clip(
    row: &Row,
    number: usize,
    folder: &Root,
    patterns: [Option<&str>; 2],
    object: Option<&ObjectName>,
) -> Result<ClipRow> {
    let value = |column: &str| {
        row.get(column)
            .map(|text| text.trim())
            .filter(|text| !text.is_empty())
    };
    let video = |column: &str, pattern: Option<&str>| {
        let path = match (pattern, value(column)) {
            (Some(pattern), _) => filled(pattern, row)?,
            (None, Some(path)) => path.to_owned(),
            (None, None) => {
                let known: Vec<&str> = row.keys().map(String::as_str).collect();
                let what = format!("no column `{column}`; there are {}", known.join(", "));
                return Err(Error::input(what)
                    .remedy(format!("add it, or give `--{column} 'FOLDER/{{id}}/FILE'`")));
            }
        };
        folder
            .resolve(&path)
            .map_err(|e| Error::io("cannot use the path of the video", e).at(path))
    };
    let frame = |column: &str| {
        let parsed = |text: &str| {
            text.parse::<usize>().map_err(|_| {
                Error::input(format!(
                    "expected a frame number from 0 in `{column}`, found `{text}`"
                ))
            })
        };
        value(column).map(parsed).transpose()
    };
    let is_conflicting = matches!(value("label_conflict"), Some("true" | "True" | "1"));
    let outcome = match value("outcome") {
        _ if is_conflicting => Outcome::Unlabelled,
        None => Outcome::Unlabelled,
        Some(name) => Outcome::by_name(name).ok_or_else(|| {
            let what = format!("expected stable, slip or unlabelled in `outcome`, found `{name}`");
            Error::input(what)
        })?,
    };
    let begins = match value("begins").or(value("clip")) {
        None => None,
        Some("open" | "from_open") => Some(Begins::Open),
        Some("contact" | "from_contact") => Some(Begins::Contact),
        Some(other) => {
            let what = format!("expected open or contact in `begins`, found `{other}`");
            return Err(Error::input(what));
        }
    };
    let object = match (value("object"), object) {
        (Some(name), _) => ObjectName::parse(name).map_err(|e| e.at("column `object`"))?,
        (None, given) => given.cloned().unwrap_or_default(),
    };
    let id = match value("id") {
        Some(id) => Label::parse(id).map_err(|e| e.at("column `id`"))?,
        None => Label::nearest(&format!("{:04}", number + 1)),
    };
    Ok(ClipRow {
        id,
        videos: [video("left", patterns[0])?, video("right", patterns[1])?],
        object,
        outcome,
        initial_frame: frame("initial_frame")?,
        grasp_frame: frame("grasp_frame")?,
        begins,
    })
}

/// Replaces `{column}` by the value of the row.
fn filled(pattern: &str, row: &Row) -> Result<String> {
    let mut text = String::new();
    let mut rest = pattern;
    while let Some((before, after)) = rest.split_once('{') {
        let Some((column, after)) = after.split_once('}') else {
            break;
        };
        let Some(value) = row.get(column) else {
            let what = format!(
                "the pattern `{pattern}` names the column `{column}`, which the table lacks"
            );
            let hint = nearest_name(column, row.keys().map(String::as_str));
            let hint = hint.map_or_else(
                || "name one of its columns".to_owned(),
                |near| format!("did you mean `{near}`?"),
            );
            return Err(Error::usage(what).remedy(hint));
        };
        text.push_str(before);
        text.push_str(value);
        rest = after;
    }
    text.push_str(rest);
    Ok(text)
}

fn json_rows(text: &str) -> Result<Vec<Row>> {
    let rows: Vec<serde_json::Map<String, Value>> = serde_json::from_str(text)
        .map_err(|e| Error::input(format!("expected a list of objects, one a clip: {e}")))?;
    let value = |(column, value): (String, Value)| {
        let text = match value {
            Value::Null => return None,
            Value::String(text) => text,
            other => other.to_string(),
        };
        Some((column, text))
    };
    Ok(rows
        .into_iter()
        .map(|row| row.into_iter().filter_map(value).collect())
        .collect())
}

/// Rows of a CSV file with a header: commas, fields in quotes as by RFC 4180.
fn csv_rows(text: &str) -> Result<Vec<Row>> {
    let mut lines = csv_lines(text)?.into_iter();
    let header = lines.next().unwrap_or_default();
    if !header.iter().any(|column| COLUMNS.contains(&column.trim())) {
        let what = format!(
            "expected a JSON list or a CSV table whose first line has some of the columns {}",
            COLUMNS.join(", ")
        );
        return Err(Error::input(what));
    }
    let mut rows = Vec::new();
    for (number, fields) in lines.enumerate() {
        if fields.len() != header.len() {
            let what = format!(
                "expected {} fields in row {}, found {}",
                header.len(),
                number + 1,
                fields.len()
            );
            return Err(Error::input(what));
        }
        let columns = header.iter().map(|column| column.trim().to_owned());
        rows.push(columns.zip(fields).collect());
    }
    Ok(rows)
}

fn csv_lines(text: &str) -> Result<Vec<Vec<String>>> {
    let (mut lines, mut fields, mut field) = (Vec::new(), Vec::new(), String::new());
    let mut is_quoted = false;
    let mut chars = text.chars().peekable();
    while let Some(c) = chars.next() {
        match c {
            '"' if is_quoted && chars.peek() == Some(&'"') => {
                chars.next();
                field.push('"');
            }
            '"' => is_quoted = !is_quoted,
            ',' if !is_quoted => fields.push(std::mem::take(&mut field)),
            '\r' if !is_quoted && chars.peek() == Some(&'\n') => {}
            '\n' if !is_quoted => {
                fields.push(std::mem::take(&mut field));
                lines.push(std::mem::take(&mut fields));
            }
            other => field.push(other),
        }
    }
    if is_quoted {
        return Err(Error::input("a quoted field does not end"));
    }
    if !field.is_empty() || !fields.is_empty() {
        fields.push(field);
        lines.push(fields);
    }
    // Empty lines are no rows.
    lines.retain(|fields| fields.len() > 1 || fields.iter().any(|field| !field.trim().is_empty()));
    Ok(lines)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(text: &str, patterns: [Option<&str>; 2]) -> Result<Vec<ClipRow>> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("clips");
        std::fs::write(&path, text).unwrap();
        Ok(clips_of(&path, patterns, None)?.0)
    }

    #[test]
    fn csv_and_json_give_the_same_clips() {
        let csv = "id,left,right,object,outcome,initial_frame,grasp_frame,begins\r\n\
                   a,a/0.avi,a/1.avi,\"mug, blue\",slip,3,9,\r\n\
                   b,b/0.avi,b/1.avi,cup,,,,contact\r\n\r\n";
        let json = r#"[
            {"id":"a","left":"a/0.avi","right":"a/1.avi","object":"mug, blue","outcome":"slip","initial_frame":3,"grasp_frame":9},
            {"id":"b","left":"b/0.avi","right":"b/1.avi","object":"cup","outcome":null,"clip":"from_contact"}
        ]"#;
        for text in [csv, json] {
            let clips = table(text, [None; 2]).unwrap();
            assert_eq!(clips.len(), 2);
            assert_eq!(clips[0].object.as_str(), "mug, blue");
            assert_eq!(clips[0].outcome, Outcome::Slip);
            assert_eq!(
                (clips[0].initial_frame, clips[0].grasp_frame),
                (Some(3), Some(9))
            );
            assert_eq!(clips[1].outcome, Outcome::Unlabelled);
            assert_eq!(clips[1].begins, Some(Begins::Contact));
            assert!(clips[1].videos[1].shown().ends_with("b/1.avi"));
        }
    }

    #[test]
    fn patterns_take_values_of_the_row() {
        let json = r#"[{"id":"002","object":"ball","outcome":"slip","label_conflict":true}]"#;
        let patterns = [
            Some("grasps/{id}/camera_0.avi"),
            Some("grasps/{id}/camera_2.avi"),
        ];
        let clips = table(json, patterns).unwrap();
        assert!(
            clips[0].videos[0]
                .shown()
                .ends_with("grasps/002/camera_0.avi")
        );
        assert_eq!(
            clips[0].outcome,
            Outcome::Unlabelled,
            "the label is contradicted"
        );
        let error = table(json, [Some("{ID}/a"), Some("{id}/b")]).unwrap_err();
        assert!(error.to_string().contains("`ID`"), "{error}");
    }

    #[test]
    fn invalid_tables_name_row_and_column() {
        for (text, expected) in [
            (
                "id,left,right\na,x.avi\n",
                "expected 3 fields in row 1, found 2",
            ),
            ("id,left\na,x.avi\n", "no column `right`"),
            ("id,left,right\na,/x.avi,y.avi\n", "x.avi"),
            ("id,left,right\na,../x.avi,y.avi\n", "x.avi"),
            (
                "id,left,right,outcome\na,x.avi,y.avi,lost\n",
                "found `lost`",
            ),
            (
                "id,left,right,grasp_frame\na,x.avi,y.avi,-1\n",
                "found `-1`",
            ),
            ("id,left,right,begins\na,x.avi,y.avi,half\n", "found `half`"),
            (
                "id,left,right\na,x.avi,y.avi\na,x.avi,y.avi\n",
                "`a` is there twice",
            ),
            ("RIFF....", "expected a JSON list or a CSV table"),
            ("[1]", "expected a list of objects"),
            ("[]", "there are no clips"),
            ("id,left\na,\"x\n", "does not end"),
        ] {
            let error = table(text, [None; 2]).unwrap_err().to_string();
            assert!(error.contains(expected), "{text}: {error}");
        }
    }
}
