//! Finds samples that occur in two splits: metrics on them say nothing about other grasps.

use std::collections::HashMap;

use rayon::prelude::*;
use sha2::{Digest as _, Sha256};

use super::samples::Samples;
use gripcast_base::error::Result;
use gripcast_dataset::shard::ShardRow;

/// Hashes of the images of a grasp.
type Hashes = [[u8; 32]; 3];

/// Describes ids that occur in two splits, and samples that share an image of the grasp, byte for byte,
/// with a sample of an earlier split. Empty if there are none.
///
/// # Errors
/// Errors of reading the files.
pub(super) fn duplicates(splits: &[&Samples]) -> Result<Vec<String>> {
    let mut found = Vec::new();
    let mut ids: HashMap<&str, &str> = HashMap::new();
    let mut images: HashMap<[u8; 32], (&Samples, usize)> = HashMap::new();
    for samples in splits {
        let split = samples.split();
        let mut same_id = Vec::new();
        for facts in samples.facts() {
            if let Some(earlier) = ids.insert(&facts.id, split) {
                same_id.push(format!("`{}` (also in `{earlier}`)", facts.id));
            }
        }
        if let Some(first) = same_id.first() {
            found.push(format!(
                "{} of {} ids in `{split}` occur in an earlier split, for example {first}: metrics \
                 on `{split}` may be biased",
                same_id.len(),
                samples.facts().len()
            ));
        }
        let hashes = hashes(samples)?;
        let shared = hashes.iter().enumerate().filter_map(|(sample, hashes)| {
            let earlier = hashes.iter().find_map(|hash| images.get(hash));
            earlier.map(|earlier| (sample, earlier))
        });
        let mut by_split: HashMap<&str, (usize, [&str; 2])> = HashMap::new();
        for (sample, (earlier, of_earlier)) in shared {
            let example = [
                &*samples.facts()[sample].id,
                &*earlier.facts()[*of_earlier].id,
            ];
            by_split.entry(earlier.split()).or_insert((0, example)).0 += 1;
        }
        let mut by_split: Vec<_> = by_split.into_iter().collect();
        by_split.sort_unstable();
        found.extend(by_split.into_iter().map(|(earlier, (count, [id, other]))| {
            format!(
                "{count} of {} samples in `{split}` have an image that is byte for byte one of \
                 `{earlier}`, for example `{id}` and `{other}`: metrics on `{split}` are biased",
                samples.facts().len()
            )
        }));
        for (sample, hashes) in hashes.iter().enumerate() {
            for hash in hashes {
                images.entry(*hash).or_insert((samples, sample));
            }
        }
    }
    Ok(found)
}

/// Hashes the images of all samples, in their order.
fn hashes(samples: &Samples) -> Result<Vec<Hashes>> {
    let of_row = |row: ShardRow| {
        let images = row.images;
        [images.grasp_left, images.grasp_right, images.grasp_rgb]
            .map(|image| Sha256::digest(image).into())
    };
    let groups = (0..samples.num_groups()).into_par_iter();
    let groups: Vec<Vec<Hashes>> = groups
        .map(|group| Ok(samples.read(group)?.into_iter().map(of_row).collect()))
        .collect::<Result<_>>()?;
    Ok(groups.concat())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample_dataset::{row, write_split};

    fn found(rows: [Vec<ShardRow>; 2]) -> Vec<String> {
        let folder = tempfile::tempdir().unwrap();
        let [train, test] = rows;
        write_split(folder.path(), "train", train);
        write_split(folder.path(), "test", test);
        let [train, test] = ["train", "test"].map(|s| Samples::open(folder.path(), s).unwrap());
        duplicates(&[&train, &test]).unwrap()
    }

    fn rows(split: &str) -> Vec<ShardRow> {
        (0..4).map(|number| row(split, number)).collect()
    }

    #[test]
    fn splits_with_other_images_and_ids_have_no_duplicates() {
        assert!(found([rows("train"), rows("test")]).is_empty());
    }

    #[test]
    fn one_shared_image_under_another_name_is_found() {
        let mut test = rows("test");
        test[2].images.grasp_left = rows("train")[1].images.grasp_left.clone();
        let found = found([rows("train"), test]);
        assert_eq!(found.len(), 1, "{found:?}");
        let expected = "1 of 4 samples in `test` have an image that is byte for byte one of \
                        `train`, for example `test-0002` and `train-0001`";
        assert!(found[0].starts_with(expected), "{found:?}");
    }

    #[test]
    fn id_that_occurs_in_two_splits_is_found() {
        let mut test = rows("test");
        test[0].facts.id = "train-0001".to_owned();
        let found = found([rows("train"), test]);
        assert_eq!(found.len(), 1, "{found:?}");
        assert!(
            found[0].contains("`train-0001` (also in `train`)"),
            "{found:?}"
        );
    }
}
