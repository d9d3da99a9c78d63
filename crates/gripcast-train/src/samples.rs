//! The samples of a split, read on demand.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use sha2::{Digest as _, Sha256};

use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, FileKind, hex};
use gripcast_base::random::SeedStream;
use gripcast_dataset::shard::{ShardFacts, ShardReader, ShardRow, ShardSet};
use gripcast_geometry::GraspGeometry;
use gripcast_nn::predict::contract::Modality;
use gripcast_shear::{ContactMaps, LiftMotion};

/// Metadata of a sample.
#[derive(Clone, Debug)]
pub struct SampleFacts {
    /// Sample id.
    pub id: String,
    /// Id of the simulation or the real grasp; shared by its renderings.
    pub lift: String,
    /// Object name.
    pub object: String,
    /// Object category.
    pub category: String,
    /// Whether the outcome is stable.
    pub is_stable: bool,
    /// Stopping force (mean normal force per finger), N, if known.
    pub stop_force_n: Option<f64>,
    /// Extents of the object in the gripper frame, if known.
    pub geometry: Option<GraspGeometry>,
    /// What gels and wrist camera show in the lift, if known.
    pub lift_motion: Option<LiftMotion>,
    /// Displacement of the gels' faces before the lift, if known.
    pub contact: Option<ContactMaps>,
    /// First 8 digits of the hash of the plan, if it was simulated.
    pub plan: Option<String>,
}

impl SampleFacts {
    /// Name of the object in its plan: plans number their objects.
    fn object_in_plan(&self) -> String {
        let plan = self.plan.as_ref().map(|plan| format!("@{plan}"));
        match plan {
            Some(plan) if !self.object.ends_with(&plan) => self.object.clone() + &plan,
            _ => self.object.clone(),
        }
    }
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
            geometry: facts.geometry,
            lift_motion: facts.lift,
            contact: facts.contact,
            plan: None,
        }
    }
}

/// A row group of a shard.
#[derive(Clone, Debug)]
struct Group {
    shard: usize,
    group: usize,
    /// Index of its first sample.
    first: usize,
    /// Size of its images.
    bytes: usize,
}

/// The samples of one split of a dataset, or of several datasets. Images are read on demand.
#[derive(Clone, Debug)]
pub struct Samples {
    location: String,
    split: String,
    facts: Vec<SampleFacts>,
    shards: Vec<ShardReader>,
    groups: Vec<Group>,
    crop_profile: String,
}

impl Samples {
    /// Opens a split of a dataset and reads everything but the images.
    ///
    /// # Errors
    /// `Input`: no samples, or tactile images with different crop profiles. Those of
    /// [`ShardSet::open`] and [`ShardReader::open`].
    pub fn open(root: &Path, split: &str) -> Result<Self> {
        Self::open_all(&[root.to_owned()], split)
    }

    /// Opens a split of several datasets as one; some may lack it. Plans number their objects, so
    /// objects, grasps and samples of a plan are named `NAME@PLAN` then, with 8 digits of its hash.
    /// Elsewhere equal names are the same object.
    ///
    /// # Errors
    /// Those of [`Self::open`]; `Input`: a sample is in two of the datasets.
    pub fn open_all(roots: &[PathBuf], split: &str) -> Result<Self> {
        let mut samples = Self {
            location: location(roots),
            split: split.to_owned(),
            facts: Vec::new(),
            shards: Vec::new(),
            groups: Vec::new(),
            crop_profile: String::new(),
        };
        let mut crops = BTreeSet::new();
        let mut missing = None;
        for root in roots {
            match ShardSet::open(root)?.shards(split) {
                Ok(files) => samples.add(files, roots.len() > 1, &mut crops)?,
                Err(error) => missing = Some(error),
            }
        }
        if let (true, Some(error)) = (samples.shards.is_empty(), missing) {
            return Err(error);
        }
        samples
            .check(&crops)
            .map_err(|e| e.at(samples.location.clone()))?;
        samples.crop_profile = crops.into_iter().next().unwrap_or_default();
        Ok(samples)
    }

    fn add(
        &mut self,
        files: &[BeneathPath],
        is_one_of_several: bool,
        crops: &mut BTreeSet<String>,
    ) -> Result<()> {
        for file in files {
            let reader = ShardReader::open_beneath(file)?;
            let plan = reader.info().and_then(plan);
            let size = file.metadata().map_or(0, |metadata| metadata.bytes) as usize;
            let shard = self.shards.len();
            let mut first = self.facts.len();
            for facts in reader.facts() {
                let mut facts = facts?;
                crops.insert(facts.crop_profile.clone());
                if let Some(plan) = plan.as_ref().filter(|_| is_one_of_several) {
                    for name in [&mut facts.id, &mut facts.simulation, &mut facts.object] {
                        *name = format!("{name}@{plan}");
                    }
                }
                self.facts.push(SampleFacts {
                    plan: plan.clone(),
                    ..facts.into()
                });
            }
            for group in 0..reader.num_row_groups() {
                let rows = reader.group_rows(group);
                self.groups.push(Group {
                    shard,
                    group,
                    first,
                    bytes: size * rows / reader.num_rows().max(1),
                });
                first += rows;
            }
            self.shards.push(reader);
        }
        Ok(())
    }

    fn check(&self, crops: &BTreeSet<String>) -> Result<()> {
        if self.facts.is_empty() {
            let what = format!("the split `{}` has no samples", self.split);
            return Err(Error::input(what));
        }
        if crops.len() > 1 {
            let names: Vec<&str> = crops.iter().map(String::as_str).collect();
            return Err(Error::input(format!(
                "the tactile images of `{}` have different crop profiles: {}",
                self.split,
                names.join(", ")
            ))
            .remedy("build the dataset from images with one crop profile"));
        }
        let mut ids = BTreeSet::new();
        match self.facts.iter().find(|facts| !ids.insert(&facts.id)) {
            Some(facts) => Err(Error::input(format!(
                "the sample `{}` occurs twice in `{}`",
                facts.id, self.split
            ))
            .remedy("give each dataset once; `gripcast dataset verify` checks one of them")),
            None => Ok(()),
        }
    }

    /// Folders of the datasets, for messages.
    pub fn location(&self) -> &str {
        &self.location
    }

    /// Name of the split.
    pub fn split(&self) -> &str {
        &self.split
    }

    /// Metadata of all samples, in the order of the files.
    pub fn facts(&self) -> &[SampleFacts] {
        &self.facts
    }

    /// Crop profile of the tactile images.
    pub fn crop_profile(&self) -> &str {
        &self.crop_profile
    }

    /// Returns the inputs of the samples, as the first one of each file tells: touch, colour and
    /// perhaps depth.
    ///
    /// # Errors
    /// Errors of reading the files.
    pub fn modality(&self) -> Result<Modality> {
        let mut reader = SampleReader::new(self, 0);
        for group in self.groups.iter().filter(|group| group.group == 0) {
            let rows = reader.rows(&[group.first])?;
            let has_depth =
                |(rows, row): &(Arc<Vec<ShardRow>>, usize)| rows[*row].images.grasp_depth.is_some();
            if rows.iter().any(has_depth) {
                return Ok(Modality::Vtd);
            }
        }
        Ok(Modality::Vt)
    }

    /// Returns the number of samples per label: slip, stable.
    pub fn by_label(&self) -> [usize; 2] {
        let stable = self.facts.iter().filter(|facts| facts.is_stable).count();
        [self.facts.len() - stable, stable]
    }

    /// Returns the names of the objects.
    pub fn objects(&self) -> BTreeSet<&str> {
        self.facts.iter().map(|facts| &*facts.object).collect()
    }

    /// Returns the names of the objects, those of plans as `NAME@PLAN`.
    pub(super) fn objects_in_plans(&self) -> BTreeSet<String> {
        self.facts.iter().map(SampleFacts::object_in_plan).collect()
    }

    /// Counts the objects with one of these names, as far as names tell.
    pub fn count_named(&self, names: &BTreeSet<String>) -> usize {
        let is_named = |object: &String| names.iter().any(|name| is_same_object(name, object));
        self.objects_in_plans()
            .iter()
            .filter(|o| is_named(o))
            .count()
    }

    /// Checks that another split shares no object with this one (no leakage).
    ///
    /// # Errors
    /// `Input`, with some of the shared objects.
    pub fn check_disjoint(&self, other: &Self) -> Result<()> {
        let ours = self.objects();
        let shared: Vec<&str> = other.objects().intersection(&ours).copied().collect();
        if shared.is_empty() {
            return Ok(());
        }
        let more = if shared.len() > 3 { ", …" } else { "" };
        Err(Error::input(format!(
            "{} objects are in both `{}` and `{}`: {}{more}",
            shared.len(),
            self.split,
            other.split,
            shared[..shared.len().min(3)].join(", "),
        ))
        .at(self.location())
        .remedy("split the dataset by object, as `synth merge` does"))
    }

    /// Number of row groups of all files.
    pub(super) fn num_groups(&self) -> usize {
        self.groups.len()
    }

    /// Reads all rows of a group.
    pub(super) fn read(&self, group: usize) -> Result<Vec<ShardRow>> {
        let group = &self.groups[group];
        self.shards[group.shard].row_group(group.group)
    }

    /// Returns the group of a sample and its index there.
    fn locate(&self, sample: usize) -> (usize, usize) {
        let group = self.groups.partition_point(|group| group.first <= sample) - 1;
        (group, sample - self.groups[group].first)
    }

    /// Returns the samples in random order. Groups are shuffled within buffers of `buffer_bytes`.
    pub fn shuffled(&self, seed: u64, buffer_bytes: usize) -> Vec<usize> {
        let mut draw = SeedStream::named(seed, "order");
        let mut groups: Vec<usize> = (0..self.groups.len()).collect();
        shuffle(&mut groups, &mut draw);
        let mut order = Vec::with_capacity(self.facts.len());
        let (mut first, mut bytes) = (0, 0);
        for (i, &group) in groups.iter().enumerate() {
            let size = self.groups[group].bytes;
            if bytes + size > buffer_bytes && i > first {
                self.shuffle_groups(&groups[first..i], &mut draw, &mut order);
                (first, bytes) = (i, 0);
            }
            bytes += size;
        }
        self.shuffle_groups(&groups[first..], &mut draw, &mut order);
        order
    }

    /// Appends the samples of some groups in random order.
    fn shuffle_groups(&self, groups: &[usize], draw: &mut SeedStream, order: &mut Vec<usize>) {
        let start = order.len();
        for &group in groups {
            let first = self.groups[group].first;
            let next = self.groups.get(group + 1);
            order.extend(first..next.map_or(self.facts.len(), |next| next.first));
        }
        shuffle(&mut order[start..], draw);
    }
}

fn shuffle<T>(items: &mut [T], draw: &mut SeedStream) {
    for i in (1..items.len()).rev() {
        items.swap(i, draw.index(i + 1));
    }
}

/// Reads samples and caches the groups that were read last.
#[derive(Debug)]
pub(super) struct SampleReader<'a> {
    samples: &'a Samples,
    memory: usize,
    /// Last use and rows by group.
    cache: BTreeMap<usize, (u64, Arc<Vec<ShardRow>>)>,
    clock: u64,
}

impl<'a> SampleReader<'a> {
    /// Creates a reader with a cache of about `memory` bytes of images.
    pub(super) fn new(samples: &'a Samples, memory: usize) -> Self {
        Self {
            samples,
            memory,
            cache: BTreeMap::new(),
            clock: 0,
        }
    }

    /// Reads some samples, each as its group of rows and its index there.
    ///
    /// # Errors
    /// Errors of reading the files.
    pub(crate) fn rows(&mut self, samples: &[usize]) -> Result<Vec<(Arc<Vec<ShardRow>>, usize)>> {
        self.clock += 1;
        let rows = samples.iter().map(|sample| {
            let (group, index) = self.samples.locate(*sample);
            let rows = match self.cache.get(&group) {
                Some((_, rows)) => Arc::clone(rows),
                None => Arc::new(self.samples.read(group)?),
            };
            self.cache.insert(group, (self.clock, Arc::clone(&rows)));
            Ok((rows, index))
        });
        let rows = rows.collect::<Result<_>>()?;
        self.evict();
        Ok(rows)
    }

    /// Evicts the least recently used groups.
    fn evict(&mut self) {
        let bytes = |group: &usize| self.samples.groups[*group].bytes;
        // A batch may have samples of two shuffle buffers.
        while self.cache.keys().map(bytes).sum::<usize>() > 2 * self.memory {
            let oldest = self.cache.iter().min_by_key(|(_, (used, _))| *used);
            let Some((&group, (used, _))) = oldest else {
                return;
            };
            if *used == self.clock {
                return;
            }
            self.cache.remove(&group);
        }
    }
}

/// Lists folders for a message.
pub(super) fn location(roots: &[PathBuf]) -> String {
    let roots: Vec<String> = roots
        .iter()
        .map(|root| root.display().to_string())
        .collect();
    roots.join(", ")
}

/// Returns 8 digits of the hash of the plan that a shard was made from.
fn plan(info: &str) -> Option<String> {
    let info: serde_json::Value = serde_json::from_str(info).ok()?;
    info["plan_sha256"].as_str()?.get(..8).map(str::to_owned)
}

/// Returns whether two names may be of the same object: of different plans they are not, without a
/// plan only the names are known.
fn is_same_object(a: &str, b: &str) -> bool {
    let parts = |name| match str::rsplit_once(name, '@') {
        Some((name, plan)) if plan.len() == 8 => (name, Some(plan)),
        _ => (name, None),
    };
    let ((a, plan_a), (b, plan_b)) = (parts(a), parts(b));
    a == b && (plan_a == plan_b || plan_a.is_none() || plan_b.is_none())
}

/// Computes the SHA-256 over names and contents of the files of one or more datasets, lower-case
/// hex.
///
/// # Errors
/// Errors of reading the files.
pub fn dataset_sha256(roots: &[PathBuf]) -> Result<String> {
    let mut all = Sha256::new();
    for root in roots {
        let set = ShardSet::open(root)?;
        for split in set.splits() {
            for file in set.shards(split)? {
                let hash = file_sha256(file)
                    .map_err(|e| Error::io("cannot read the shard", e).at(file.display()))?;
                all.update(format!("{hash}  {}\n", file.name()));
            }
        }
    }
    Ok(hex(&all.finalize()))
}

fn file_sha256(file: &BeneathPath) -> io::Result<String> {
    let mut reader = BufReader::with_capacity(1 << 20, file.open_file(FileKind::Bulk)?);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample_dataset::{row, write_split_with_info};

    #[test]
    fn objects_of_two_plans_are_different_ones() {
        let dir = tempfile::tempdir().unwrap();
        let roots = ["a", "b"].map(|name| dir.path().join(name));
        for (root, digit) in roots.iter().zip(["1", "2"]) {
            let info = format!("{{\"plan_sha256\":\"{}\"}}", digit.repeat(64));
            let rows = (0..6).map(|n| {
                let mut row = row("train", n);
                if digit == "1" {
                    row.images.grasp_depth = None;
                }
                row
            });
            write_split_with_info(root, "train", &info, rows);
        }
        let rows = (0..4).map(|n| row("train", n));
        write_split_with_info(&roots[1], "validation", "{}", rows);
        let one = Samples::open(&roots[0], "train").unwrap();
        let both = Samples::open_all(&roots, "train").unwrap();
        assert_eq!(both.facts().len(), 12);
        assert_eq!(one.modality().unwrap(), Modality::Vt);
        assert_eq!(both.modality().unwrap(), Modality::Vtd);
        assert_eq!(both.objects().len(), 2 * one.objects().len());
        assert!(
            both.objects()
                .iter()
                .all(|name| !one.objects().contains(name))
        );
        let rows = SampleReader::new(&both, 0).rows(&[0, 11]).unwrap();
        for ((rows, row), sample) in rows.iter().zip([0, 11]) {
            let id = &rows[*row].facts.id;
            assert!(both.facts()[sample].id.starts_with(&format!("{id}@")));
        }
        // Only one of them has it; its objects have no plan and may be those of training.
        let validation = Samples::open_all(&roots, "validation").unwrap();
        assert_eq!(validation.facts().len(), 4);
        let trained = both.objects_in_plans();
        assert_eq!(validation.count_named(&trained), validation.objects().len());
        // Alone, too, its objects are those of its plan.
        let other = Samples::open(&roots[1], "train").unwrap();
        assert_eq!(
            one.count_named(&one.objects_in_plans()),
            one.objects().len()
        );
        assert_eq!(one.count_named(&other.objects_in_plans()), 0);

        let [a, b] = &roots;
        let again = Samples::open_all(&[a.clone(), a.clone()], "train").unwrap_err();
        assert!(again.what().contains("occurs twice"), "{again}");
        let absent = Samples::open_all(&roots, "test").unwrap_err();
        assert!(absent.to_string().contains("test"), "{absent}");
        let hashes = [vec![a.clone()], vec![b.clone()], roots.to_vec()];
        let hashes: BTreeSet<_> = hashes
            .iter()
            .map(|all| dataset_sha256(all).unwrap())
            .collect();
        assert_eq!(hashes.len(), 3);
    }

    #[test]
    fn names_of_two_plans_are_two_objects() {
        assert!(is_same_object("mug", "mug"));
        assert!(is_same_object("mug", "mug@12345678"));
        assert!(!is_same_object("mug@12345678", "mug@12345679"));
        assert!(!is_same_object("mug", "bowl@12345678"));
        assert!(!is_same_object("mug@home", "mug"));
    }
}
