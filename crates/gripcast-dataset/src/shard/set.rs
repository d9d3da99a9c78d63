//! A directory of shards by split.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use super::reader::ShardReader;
use super::row::{ShardFacts, ShardRow};
use gripcast_base::error::{Error, Result, unknown_name};
use gripcast_base::files::{BeneathPath, FileName, Printable, Root};

/// Directory of the shards in that of a dataset.
const DATA: &str = "data";
/// File extension of shards.
const EXTENSION: &str = ".parquet";
/// Digits of the numbers in names of shards.
const DIGITS: usize = 5;
/// Maximum number of shards of a split.
const MAX_SHARDS: usize = 99_999;
/// File that identifies a dataset of collected grasps.
const DATASET_TOML: &str = "dataset.toml";
/// Remedy where no shards are found.
const GIVE_SHARDS: &str =
    "give a directory written by `synth merge`, `dataset import` or `dataset export --to training`";

/// Returns the name of a shard in its dataset, as Hugging Face `datasets` expects it:
/// `data/train-00000-of-00003.parquet`. `index` counts from 0.
///
/// # Errors
/// `Usage`: invalid name of a split, or index out of range.
pub fn shard_name(split: &str, index: usize, count: usize) -> Result<String> {
    Ok(format!("{DATA}/{}", file_name(split, index, count)?))
}

/// Returns the path of a shard in its dataset.
///
/// # Errors
/// As [`shard_name`].
pub fn shard_path(root: &Root, split: &str, index: usize, count: usize) -> Result<BeneathPath> {
    let name = file_name(split, index, count)?;
    Ok(root.top().join(DATA).join(&name))
}

fn file_name(split: &str, index: usize, count: usize) -> Result<FileName> {
    if !is_split(split) {
        let what = format!("invalid split name {split:?}");
        let error = Error::usage(what);
        return Err(error.remedy("use letters, digits and _, as in train, validation, test"));
    }
    if index >= count || count > MAX_SHARDS {
        let what =
            format!("invalid shard {index} of {count}, at most {MAX_SHARDS} shards are supported");
        return Err(Error::usage(what));
    }
    FileName::parse(&format!(
        "{split}-{index:0DIGITS$}-of-{count:0DIGITS$}{EXTENSION}"
    ))
}

/// The complete shards of a dataset, by split.
#[derive(Clone, Debug)]
pub struct ShardSet {
    root: Root,
    splits: BTreeMap<String, Vec<BeneathPath>>,
}

impl ShardSet {
    /// Lists the shards in `root/data` without opening them; checks that none is missing.
    ///
    /// # Errors
    /// `NotFound`: the directory is missing or has no shard. `Input`: a shard is missing, or a
    /// Parquet file has an invalid name. `Permission`, `Io`: the directory.
    pub fn open(root: impl Into<PathBuf>) -> Result<Self> {
        let root = Root::new(root);
        match list(&root) {
            Ok(splits) => Ok(Self { root, splits }),
            Err(error) => Err(error.at(root.path().display())),
        }
    }

    /// Names of the splits, sorted.
    pub fn splits(&self) -> impl Iterator<Item = &str> {
        self.splits.keys().map(String::as_str)
    }

    /// Files of a split in order.
    ///
    /// # Errors
    /// `Usage`: unknown split.
    pub fn shards(&self, split: &str) -> Result<&[BeneathPath]> {
        let found = self.splits.get(split);
        found.map(Vec::as_slice).ok_or_else(|| {
            let known: Vec<&str> = self.splits().collect();
            unknown_name("split", split, &known).at(self.root.path().display())
        })
    }

    /// Number of rows of a split.
    ///
    /// # Errors
    /// `Usage`: unknown split. Those of [`ShardReader::open`] for any of its files.
    pub fn num_rows(&self, split: &str) -> Result<usize> {
        let shards = self.shards(split)?.iter();
        shards
            .map(|path| Ok(ShardReader::open_beneath(path)?.num_rows()))
            .sum()
    }

    /// Reads the rows of a split, one open file at a time; ends at the first error.
    ///
    /// # Errors
    /// `Usage`: unknown split. Items: as [`ShardReader::rows`].
    pub fn rows(
        &self,
        split: &str,
    ) -> Result<impl Iterator<Item = Result<ShardRow>> + Send + use<>> {
        let shards = self.shards(split)?.to_vec();
        Ok(chain(shards, |shard| shard.rows()))
    }

    /// Reads the rows of a split without their images.
    ///
    /// # Errors
    /// As [`rows`](Self::rows).
    pub fn facts(
        &self,
        split: &str,
    ) -> Result<impl Iterator<Item = Result<ShardFacts>> + Send + use<>> {
        let shards = self.shards(split)?.to_vec();
        Ok(chain(shards, |shard| shard.facts()))
    }

    /// Checks hashes, values and unique ids of all rows; returns the number of rows by split.
    ///
    /// # Errors
    /// `Input`: duplicate ids; as [`ShardReader::rows`].
    pub fn verify(&self) -> Result<BTreeMap<String, usize>> {
        let mut split_of: BTreeMap<String, &str> = BTreeMap::new();
        let mut counts = BTreeMap::new();
        for split in self.splits() {
            let mut count = 0;
            for row in self.rows(split)? {
                count += 1;
                let id = row?.facts.id;
                if let Some(other) = split_of.get(&id) {
                    let what = format!("duplicate sample id {id:?} in {other} and {split}");
                    return Err(Error::input(what).at(self.root.path().display()));
                }
                split_of.insert(id, split);
            }
            counts.insert(split.to_owned(), count);
        }
        Ok(counts)
    }
}

/// Chains the samples of files, up to the first error.
fn chain<T, I>(
    shards: Vec<BeneathPath>,
    samples: impl Fn(&ShardReader) -> I + Send,
) -> impl Iterator<Item = Result<T>> + Send
where
    T: Send,
    I: Iterator<Item = Result<T>> + Send,
{
    let mut shards = shards.into_iter();
    let mut open: Option<I> = None;
    let mut failed = false;
    std::iter::from_fn(move || {
        while !failed {
            if let Some(sample) = open.as_mut().and_then(Iterator::next) {
                failed = sample.is_err();
                return Some(sample);
            }
            match ShardReader::open_beneath(&shards.next()?) {
                Ok(shard) => open = Some(samples(&shard)),
                Err(error) => {
                    failed = true;
                    return Some(Err(error));
                }
            }
        }
        None
    })
}

fn list(root: &Root) -> Result<BTreeMap<String, Vec<BeneathPath>>> {
    let folder = root.top().join(DATA);
    if !folder.is_dir() && root.top().join(DATASET_TOML).is_file() {
        let what = "expected shards of samples, found a dataset of collected grasps";
        let remedy =
            "run `gripcast dataset export FOLDER --to training --out SHARDS` and give SHARDS";
        return Err(Error::input(what).remedy(remedy));
    }
    let unreadable = |e: std::io::Error| {
        let is_absent = e.kind() == std::io::ErrorKind::NotFound;
        let error = Error::io(format!("cannot list the directory {DATA}"), e);
        if is_absent {
            error.remedy(GIVE_SHARDS)
        } else {
            error
        }
    };
    let mut found: BTreeMap<String, BTreeSet<(usize, usize)>> = BTreeMap::new();
    for entry in folder.entries().map_err(unreadable)? {
        let name = entry.name();
        // Leftovers of a killed process are hidden.
        if name.starts_with('.') || !name.ends_with(EXTENSION) {
            continue;
        }
        let Some((split, index, count)) = parse(&name) else {
            let what = format!("invalid shard name {DATA}/{}", Printable(&name));
            let remedy = "name shards SPLIT-00000-of-00003.parquet, counted from 0";
            return Err(Error::input(what).remedy(remedy));
        };
        let shards = found.entry(split.to_owned()).or_default();
        shards.insert((index, count));
    }
    if found.is_empty() {
        let what = format!("no shard found in the directory {DATA}");
        return Err(Error::not_found(what).remedy(GIVE_SHARDS));
    }
    let complete = |(split, shards): (String, BTreeSet<(usize, usize)>)| {
        let files = files(root, &split, &shards)?;
        Ok((split, files))
    };
    found.into_iter().map(complete).collect()
}

/// All files of a split. `shards`: index and count in the name of each.
fn files(root: &Root, split: &str, shards: &BTreeSet<(usize, usize)>) -> Result<Vec<BeneathPath>> {
    let count = shards.first().map_or(0, |&(_, count)| count);
    if let Some((_, other)) = shards.iter().find(|&&(_, other)| other != count) {
        let what =
            format!("the split {split} has shards of two sets, of {count} and {other} shards");
        return Err(Error::input(what).remedy("remove the shards of the older set"));
    }
    let missing: Vec<usize> = (0..count)
        .filter(|index| !shards.contains(&(*index, count)))
        .collect();
    if let Some(&first) = missing.first() {
        let name = shard_name(split, first, count)?;
        let what = match missing.len() {
            1 => format!("{name} is missing"),
            several => format!("{name} and {} more are missing", several - 1),
        };
        return Err(Error::input(what).remedy("create or download it again"));
    }
    let path = |index| shard_path(root, split, index, count);
    (0..count).map(path).collect()
}

/// Parses split, index and count in the name of a shard.
fn parse(name: &str) -> Option<(&str, usize, usize)> {
    let (split, numbers) = name.strip_suffix(EXTENSION)?.split_once('-')?;
    let (index, count) = numbers.split_once("-of-")?;
    let number = |text: &str| {
        let digits = text.len() == DIGITS && text.bytes().all(|b| b.is_ascii_digit());
        digits.then(|| text.parse::<usize>().ok()).flatten()
    };
    let (index, count) = (number(index)?, number(count)?);
    (is_split(split) && index < count).then_some((split, index, count))
}

fn is_split(split: &str) -> bool {
    let word = |b: u8| b.is_ascii_alphanumeric() || b == b'_';
    !split.is_empty() && split.bytes().all(word)
}

#[cfg(test)]
mod tests {
    use gripcast_base::error::ErrorKind;
    use std::fs;
    use std::os::unix::fs::symlink;
    use std::path::Path;

    use super::super::sample_rows::sample_rows;
    use super::super::writer::to_bytes;
    use super::*;

    fn write(root: &Path, name: &str, first: u64, count: usize) {
        fs::create_dir_all(root.join(DATA)).unwrap();
        let bytes = to_bytes(sample_rows(first, count), "{}").unwrap();
        fs::write(root.join(name), bytes).unwrap();
    }

    #[test]
    fn rows_of_a_split_are_read_in_order() {
        let root = tempfile::tempdir().unwrap();
        let root = root.path();
        for (index, rows) in [4, 0, 3].into_iter().enumerate() {
            let name = shard_name("train", index, 3).unwrap();
            write(root, &name, 100 * index as u64, rows);
        }
        write(root, "data/test-00000-of-00001.parquet", 900, 2);
        fs::write(root.join("data/.gripcast-0.partial"), b"torn").unwrap();
        fs::write(root.join("data/notes.txt"), b"").unwrap();
        let set = ShardSet::open(root).unwrap();
        assert_eq!(set.splits().collect::<Vec<_>>(), ["test", "train"]);
        assert_eq!(set.num_rows("train").unwrap(), 7);
        assert_eq!(set.shards("train").unwrap().len(), 3);
        let rows: Vec<ShardRow> = set.rows("train").unwrap().map(Result::unwrap).collect();
        let mut expected = sample_rows(0, 4);
        expected.extend(sample_rows(200, 3));
        assert_eq!(rows, expected);
        let facts: Vec<ShardFacts> = set.facts("train").unwrap().map(Result::unwrap).collect();
        assert!(facts.iter().eq(expected.iter().map(|row| &row.facts)));
        let counts = [("test", 2), ("train", 7)].map(|(split, rows)| (split.to_owned(), rows));
        assert_eq!(set.verify().unwrap(), counts.into());
        write(root, "data/test-00000-of-00001.parquet", 3, 1);
        let error = set.verify().unwrap_err().to_string();
        assert!(error.contains("\"000003-r0\" in test and train"), "{error}");
        let error = set.num_rows("tain").unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Usage);
        assert!(error.to_string().contains("did you mean train"), "{error}");
    }

    #[test]
    fn error_names_the_file_and_ends_the_rows() {
        let root = tempfile::tempdir().unwrap();
        let root = root.path();
        write(root, "data/train-00000-of-00002.parquet", 0, 2);
        fs::write(root.join("data/train-00001-of-00002.parquet"), b"PAR1").unwrap();
        let set = ShardSet::open(root).unwrap();
        let rows: Vec<_> = set.rows("train").unwrap().collect();
        assert_eq!(rows.len(), 3);
        let error = rows[2].as_ref().unwrap_err().to_string();
        assert!(
            error.contains("train-00001-of-00002.parquet: the Parquet file is truncated"),
            "{error}"
        );
    }

    #[test]
    fn links_out_of_the_dataset_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let [root, secret] = ["set", "secret"].map(|name| dir.path().join(name));
        write(&secret, "data/train-00000-of-00001.parquet", 0, 2);
        let shard = "data/train-00000-of-00001.parquet";
        let refused = |set: Result<ShardSet>| {
            let error = set.and_then(|set| set.num_rows("train")).unwrap_err();
            assert_eq!(error.kind(), ErrorKind::Input, "{error}");
        };
        fs::create_dir_all(root.join(DATA)).unwrap();
        symlink(secret.join(shard), root.join(shard)).unwrap();
        refused(ShardSet::open(&root));
        assert!(
            ShardSet::open(&root)
                .unwrap()
                .rows("train")
                .unwrap()
                .all(|row| row.is_err())
        );
        fs::remove_dir_all(root.join(DATA)).unwrap();
        symlink(secret.join(DATA), root.join(DATA)).unwrap();
        refused(ShardSet::open(&root));
        fs::remove_file(root.join(DATA)).unwrap();
        fs::create_dir_all(root.join(shard)).unwrap();
        refused(ShardSet::open(&root));
    }

    #[test]
    fn missing_shard_is_reported() {
        let root = tempfile::tempdir().unwrap();
        let root = root.path();
        let refused = || ShardSet::open(root).unwrap_err();
        assert_eq!(refused().kind(), ErrorKind::NotFound);
        assert!(refused().to_string().contains("synth merge"));
        fs::write(root.join("dataset.toml"), "").unwrap();
        assert_eq!(refused().kind(), ErrorKind::Input);
        assert!(refused().to_string().contains("--to training"));
        fs::create_dir(root.join(DATA)).unwrap();
        assert_eq!(refused().kind(), ErrorKind::NotFound);
        write(root, "data/train-00000-of-00003.parquet", 0, 0);
        let error = refused().to_string();
        assert!(
            error.contains("data/train-00001-of-00003.parquet and 1 more are missing"),
            "{error}"
        );
        write(root, "data/train-00001-of-00003.parquet", 0, 0);
        let error = refused().to_string();
        assert!(
            error.contains("data/train-00002-of-00003.parquet is missing"),
            "{error}"
        );
        write(root, "data/train-00001-of-00002.parquet", 0, 0);
        let error = refused().to_string();
        assert!(error.contains("two sets"), "{error}");
    }

    #[test]
    fn shard_names_match_hugging_face_datasets() {
        assert_eq!(
            shard_name("train", 7, 12).unwrap(),
            "data/train-00007-of-00012.parquet"
        );
        for (split, index, count) in [("a-b", 0, 1), ("", 0, 1), ("a", 1, 1), ("a", 0, 100_000)] {
            assert!(
                shard_name(split, index, count).is_err(),
                "{split} {index} {count}"
            );
        }
        for name in [
            "train.parquet",
            "train-0-of-1.parquet",
            "train-00002-of-00002.parquet",
        ] {
            assert_eq!(parse(name), None, "{name}");
        }
    }
}
