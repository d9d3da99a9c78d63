//! Cache of answers: one JSON file per prompt.

use std::fs;
use std::io;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, FileKind, FileName, Root, hex};

/// Version of the files.
const SCHEMA: u32 = 1;
/// Maximum size of a file, bytes.
const MAX_BYTES: u64 = 1 << 20;

/// A folder of answers.
#[derive(Clone, Debug)]
pub(super) struct AnswerCache {
    folder: Root,
}

/// An answer with its prompt, so that it can be checked.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    schema: u32,
    model: String,
    prompt: String,
    answer: String,
}

impl AnswerCache {
    pub(super) fn new(folder: PathBuf) -> Self {
        Self {
            folder: Root::new(folder),
        }
    }

    /// File of a prompt: the hash of model and prompt.
    fn path(&self, model: &str, prompt: &str) -> Result<BeneathPath> {
        let mut hash = Sha256::new();
        // The length separates model and prompt.
        hash.update((model.len() as u64).to_le_bytes());
        hash.update(model);
        hash.update(prompt);
        let name = FileName::parse(&format!("{}.json", hex(&hash.finalize())))?;
        Ok(self.folder.top().join(&name))
    }

    /// Loads the answer to a prompt; none if it is missing or damaged.
    ///
    /// # Errors
    /// `Permission` or `Io` if a file cannot be read.
    pub(super) fn load(&self, model: &str, prompt: &str) -> Result<Option<String>> {
        let path = self.path(model, prompt)?;
        let failed = |e| Error::io("cannot read the cached answer", e).at(path.display());
        match path.metadata() {
            Ok(found) if found.bytes > MAX_BYTES => return Ok(None),
            Ok(_) => {}
            Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(e) => return Err(failed(e)),
        }
        let bytes = path.read(FileKind::Record).map_err(failed)?;
        let entry: Option<Entry> = serde_json::from_slice(&bytes).ok();
        let matching =
            entry.filter(|e| e.schema == SCHEMA && e.model == model && e.prompt == prompt);
        Ok(matching.map(|e| e.answer))
    }

    /// Stores an answer.
    ///
    /// # Errors
    /// I/O errors.
    pub(super) fn store(&self, model: &str, prompt: &str, answer: &str) -> Result<()> {
        let entry = Entry {
            schema: SCHEMA,
            model: model.to_owned(),
            prompt: prompt.to_owned(),
            answer: answer.to_owned(),
        };
        let mut text = serde_json::to_string_pretty(&entry)
            .map_err(|e| Error::internal("cannot write the answer as JSON").because(e))?;
        text.push('\n');
        let folder = self.folder.path();
        fs::create_dir_all(folder).map_err(|e| {
            Error::io("cannot create the folder of answers", e).at(folder.display())
        })?;
        let path = self.path(model, prompt)?;
        path.replace(text.as_bytes())
            .map_err(|e| Error::io("cannot write the answer", e).at(path.display()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_belong_to_one_prompt() {
        let folder = tempfile::tempdir().unwrap();
        let cache = AnswerCache::new(folder.path().join("deep/answers"));
        assert_eq!(cache.load("m", "p").unwrap(), None);
        cache.store("m", "p", "first").unwrap();
        cache.store("m", "p", "ünd {}").unwrap();
        assert_eq!(cache.load("m", "p").unwrap().as_deref(), Some("ünd {}"));
        assert_eq!(cache.load("mp", "").unwrap(), None);
        assert_eq!(cache.load("m", "q").unwrap(), None);
    }

    #[test]
    fn damaged_files_are_ignored() {
        let folder = tempfile::tempdir().unwrap();
        let cache = AnswerCache::new(folder.path().to_owned());
        cache.store("m", "p", "answer").unwrap();
        let path = cache.path("m", "p").unwrap().shown();
        let whole = fs::read_to_string(&path).unwrap();
        let other = whole.replace("\"p\"", "\"q\"");
        let newer = whole.replace("\"schema\": 1", "\"schema\": 2");
        let huge = format!("{whole}{}", " ".repeat(2 << 20));
        for text in [
            "",
            &whole[..whole.len() / 2],
            "[]",
            &other,
            &newer,
            &huge,
            "\u{0}",
        ] {
            fs::write(&path, text).unwrap();
            assert_eq!(cache.load("m", "p").unwrap(), None);
        }
        fs::write(&path, &whole).unwrap();
        assert_eq!(cache.load("m", "p").unwrap().as_deref(), Some("answer"));
    }
}
