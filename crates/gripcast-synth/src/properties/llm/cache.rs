//! Answers on the disk: one JSON file per question.

use std::fs;
use std::io;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, FileKind, FileName, Root, hex};

/// Version of the files.
const SCHEMA: u32 = 1;
/// Largest file that is read, bytes.
const MAX_BYTES: u64 = 1 << 20;

/// A folder of answers.
#[derive(Clone, Debug)]
pub(super) struct AnswerCache {
    folder: Root,
}

/// An answer with its question, so that it can be checked and read by people.
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

    /// The file of a question: the hash of model and prompt.
    fn place(&self, model: &str, prompt: &str) -> Result<BeneathPath> {
        let mut hash = Sha256::new();
        // The length keeps model and prompt apart.
        hash.update((model.len() as u64).to_le_bytes());
        hash.update(model);
        hash.update(prompt);
        let name = FileName::parse(&format!("{}.json", hex(&hash.finalize())))?;
        Ok(self.folder.top().join(&name))
    }

    /// The answer, if there is one that is whole and belongs to the question.
    ///
    /// # Errors
    /// `Permission` or `Io` if there is a file that cannot be read.
    pub(super) fn load(&self, model: &str, prompt: &str) -> Result<Option<String>> {
        let place = self.place(model, prompt)?;
        let failed = |e| Error::io("cannot read the stored answer", e).at(place.display());
        match place.metadata() {
            Ok(found) if found.bytes > MAX_BYTES => return Ok(None),
            Ok(_) => {}
            Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(e) => return Err(failed(e)),
        }
        let bytes = place.read(FileKind::Record).map_err(failed)?;
        let entry: Option<Entry> = serde_json::from_slice(&bytes).ok();
        let fitting =
            entry.filter(|e| e.schema == SCHEMA && e.model == model && e.prompt == prompt);
        Ok(fitting.map(|e| e.answer))
    }

    /// Stores an answer in place of another.
    ///
    /// # Errors
    /// Those of the operating system.
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
        fs::create_dir_all(folder)
            .map_err(|e| Error::io("cannot make the folder of answers", e).at(folder.display()))?;
        let place = self.place(model, prompt)?;
        place
            .replace(text.as_bytes())
            .map_err(|e| Error::io("cannot write the answer", e).at(place.display()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_come_back_for_their_question_alone() {
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
    fn damaged_files_are_no_answers() {
        let folder = tempfile::tempdir().unwrap();
        let cache = AnswerCache::new(folder.path().to_owned());
        cache.store("m", "p", "answer").unwrap();
        let path = cache.place("m", "p").unwrap().shown();
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
