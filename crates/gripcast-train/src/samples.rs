//! The samples of a dataset's part, read as they are needed.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use sha2::{Digest as _, Sha256};

use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, FileKind, hex};
use gripcast_base::random::SeedStream;
use gripcast_dataset::shard::{ShardFacts, ShardReader, ShardRow, ShardSet};

/// What is known of a sample besides its images.
#[derive(Clone, Debug)]
pub struct SampleFacts {
    /// Its id.
    pub id: String,
    /// The simulation or real grasp that it shows; several renderings share it.
    pub lift: String,
    /// What is grasped.
    pub object: String,
    /// Its category.
    pub category: String,
    /// Whether the lift held.
    pub is_stable: bool,
    /// Mean normal force at which the fingers stopped closing, N, where it is known.
    pub stop_force_n: Option<f64>,
}

impl From<ShardFacts> for SampleFacts {
    fn from(facts: ShardFacts) -> Self {
        Self {
            is_stable: facts.outcome.label() == 1,
            id: facts.id,
            lift: facts.simulation,
            object: facts.object,
            category: facts.category,
            stop_force_n: facts.stop_force_n,
        }
    }
}

/// A run of rows in a file that are read together.
#[derive(Clone, Debug)]
struct Group {
    shard: usize,
    group: usize,
    /// Number of its first sample.
    first: usize,
    /// Bytes of its images.
    bytes: usize,
}

/// The samples of one part of a dataset. The images stay in their files.
#[derive(Clone, Debug)]
pub struct Samples {
    root: PathBuf,
    split: String,
    facts: Vec<SampleFacts>,
    shards: Vec<ShardReader>,
    groups: Vec<Group>,
    crop_profile: String,
}

impl Samples {
    /// Opens a part of a dataset and reads everything but the images.
    ///
    /// # Errors
    /// `Input`: there are no samples, or tactile images cropped in several ways. Those of
    /// [`ShardSet::open`] and [`ShardReader::open`].
    pub fn open(root: &Path, split: &str) -> Result<Self> {
        let set = ShardSet::open(root)?;
        let mut samples = Self {
            root: root.to_owned(),
            split: split.to_owned(),
            facts: Vec::new(),
            shards: Vec::new(),
            groups: Vec::new(),
            crop_profile: String::new(),
        };
        let mut crops = BTreeSet::new();
        for place in set.shards(split)? {
            let reader = ShardReader::open_beneath(place)?;
            let size = place.metadata().map_or(0, |found| found.bytes) as usize;
            let shard = samples.shards.len();
            let begun = samples.facts.len();
            for facts in reader.facts() {
                let facts = facts?;
                crops.insert(facts.crop_profile.clone());
                samples.facts.push(facts.into());
            }
            let mut first = begun;
            for group in 0..reader.num_row_groups() {
                let rows = reader.group_rows(group);
                samples.groups.push(Group {
                    shard,
                    group,
                    first,
                    bytes: size * rows / reader.num_rows().max(1),
                });
                first += rows;
            }
            samples.shards.push(reader);
        }
        samples.check(&crops).map_err(|e| e.at(root.display()))?;
        samples.crop_profile = crops.into_iter().next().unwrap_or_default();
        Ok(samples)
    }

    fn check(&self, crops: &BTreeSet<String>) -> Result<()> {
        let input = |what: String| Error::input(what);
        if self.facts.is_empty() {
            return Err(input(format!("the part `{}` has no samples", self.split)));
        }
        if crops.len() > 1 {
            let names: Vec<&str> = crops.iter().map(String::as_str).collect();
            return Err(input(format!(
                "the tactile images of `{}` are cropped in several ways: {}",
                self.split,
                names.join(", ")
            ))
            .remedy("make the dataset of images that are cropped in one way"));
        }
        Ok(())
    }

    /// Folder of the dataset.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Name of the part.
    pub fn split(&self) -> &str {
        &self.split
    }

    /// All samples, in the order of the files.
    pub fn facts(&self) -> &[SampleFacts] {
        &self.facts
    }

    /// Crop profile of the tactile images.
    pub fn crop_profile(&self) -> &str {
        &self.crop_profile
    }

    /// Samples by label: lost, stable.
    pub fn by_label(&self) -> [usize; 2] {
        let stable = self.facts.iter().filter(|facts| facts.is_stable).count();
        [self.facts.len() - stable, stable]
    }

    /// Names of the objects.
    pub fn objects(&self) -> BTreeSet<&str> {
        self.facts.iter().map(|facts| &*facts.object).collect()
    }

    /// Refuses a part that shares objects with this one: what was learned of them would be
    /// measured again.
    ///
    /// # Errors
    /// `Input`, with some of the objects.
    pub fn check_apart(&self, other: &Self) -> Result<()> {
        let ours = self.objects();
        let shared: Vec<&str> = other.objects().intersection(&ours).copied().collect();
        if shared.is_empty() {
            return Ok(());
        }
        let some = shared.iter().take(3).copied().collect::<Vec<_>>();
        Err(Error::input(format!(
            "{} objects are in `{}` as well as in `{}`: {}{}",
            shared.len(),
            self.split,
            other.split,
            some.join(", "),
            if shared.len() > some.len() {
                ", …"
            } else {
                ""
            }
        ))
        .at(self.root.display())
        .remedy("split the dataset by object, as `synth merge` does"))
    }

    /// All images of a sample's group.
    fn read(&self, group: usize) -> Result<Vec<ShardRow>> {
        let group = &self.groups[group];
        self.shards[group.shard].row_group(group.group)
    }

    /// Group of a sample and its place there.
    fn place(&self, sample: usize) -> (usize, usize) {
        let group = self.groups.partition_point(|group| group.first <= sample) - 1;
        (group, sample - self.groups[group].first)
    }

    /// Samples in random order, for a seed. Only as many groups are mixed at a time as fit into
    /// `memory` bytes.
    pub fn shuffled(&self, seed: u64, memory: usize) -> Vec<usize> {
        let mut draw = SeedStream::named(seed, "order");
        let mut groups: Vec<usize> = (0..self.groups.len()).collect();
        shuffle(&mut groups, &mut draw);
        let mut order = Vec::with_capacity(self.facts.len());
        let (mut begun, mut bytes) = (0, 0);
        for (at, &group) in groups.iter().enumerate() {
            let size = self.groups[group].bytes;
            if bytes + size > memory && at > begun {
                self.mix(&groups[begun..at], &mut draw, &mut order);
                (begun, bytes) = (at, 0);
            }
            bytes += size;
        }
        self.mix(&groups[begun..], &mut draw, &mut order);
        order
    }

    fn mix(&self, groups: &[usize], draw: &mut SeedStream, order: &mut Vec<usize>) {
        let begun = order.len();
        for &group in groups {
            let first = self.groups[group].first;
            let next = self.groups.get(group + 1);
            order.extend(first..next.map_or(self.facts.len(), |next| next.first));
        }
        shuffle(&mut order[begun..], draw);
    }
}

fn shuffle<T>(items: &mut [T], draw: &mut SeedStream) {
    for i in (1..items.len()).rev() {
        items.swap(i, draw.index(i + 1));
    }
}

/// Reads samples; keeps the groups that were read last.
#[derive(Debug)]
pub(super) struct SampleReader<'a> {
    samples: &'a Samples,
    memory: usize,
    kept: BTreeMap<usize, (u64, Arc<Vec<ShardRow>>)>,
    clock: u64,
}

impl<'a> SampleReader<'a> {
    /// A reader that keeps about `memory` bytes of images.
    pub(super) fn new(samples: &'a Samples, memory: usize) -> Self {
        Self {
            samples,
            memory,
            kept: BTreeMap::new(),
            clock: 0,
        }
    }

    /// The rows of some samples, each as the group that holds it and its place there.
    ///
    /// # Errors
    /// Those of reading the files.
    pub(crate) fn rows(&mut self, samples: &[usize]) -> Result<Vec<(Arc<Vec<ShardRow>>, usize)>> {
        self.clock += 1;
        let places: Vec<_> = samples.iter().map(|at| self.samples.place(*at)).collect();
        let rows = places.iter().map(|(group, at)| {
            let rows = match self.kept.get(group) {
                Some((_, rows)) => Arc::clone(rows),
                None => Arc::new(self.samples.read(*group)?),
            };
            self.kept.insert(*group, (self.clock, Arc::clone(&rows)));
            Ok((rows, *at))
        });
        let rows = rows.collect::<Result<_>>()?;
        self.forget();
        Ok(rows)
    }

    /// Lets go of the groups that were not asked for the longest.
    fn forget(&mut self) {
        let bytes = |group: &usize| self.samples.groups[*group].bytes;
        // The groups of one mix, and of the next one while a batch has samples of both.
        while self.kept.keys().map(bytes).sum::<usize>() > 2 * self.memory {
            let oldest = self.kept.iter().min_by_key(|(_, (used, _))| *used);
            let Some((&group, (used, _))) = oldest else {
                return;
            };
            if *used == self.clock {
                return;
            }
            self.kept.remove(&group);
        }
    }
}

/// SHA-256 over the names and contents of a dataset's files, lower-case hex.
///
/// # Errors
/// Those of reading the files.
pub fn dataset_sha256(root: &Path) -> Result<String> {
    let set = ShardSet::open(root)?;
    let mut all = Sha256::new();
    for split in set.splits() {
        for place in set.shards(split)? {
            let hash = file_sha256(place)
                .map_err(|e| Error::io("cannot read the shard", e).at(place.display()))?;
            all.update(format!("{hash}  {}\n", place.name()));
        }
    }
    Ok(hex(&all.finalize()))
}

fn file_sha256(place: &BeneathPath) -> io::Result<String> {
    let file = place.open_file(FileKind::Bulk)?;
    let mut reader = BufReader::with_capacity(1 << 20, file);
    let mut hash = Sha256::new();
    loop {
        let bytes = reader.fill_buf()?;
        if bytes.is_empty() {
            return Ok(hex(&hash.finalize()));
        }
        hash.update(bytes);
        let count = bytes.len();
        reader.consume(count);
    }
}
