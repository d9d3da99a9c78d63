//! Checkpoints: the complete state of a run, for bit-identical resumption.

use serde::{Deserialize, Serialize, de::DeserializeOwned};
use sha2::{Digest as _, Sha256};

use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, FileKind};

const MAGIC: &[u8; 8] = b"gcstate2";
/// Size of the SHA-256 at the end, bytes.
const HASH: usize = 32;

/// Progress of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Position {
    /// Finished epochs.
    pub(super) epoch: u32,
    /// Finished steps of the current epoch.
    pub(super) step: u64,
    /// Sum of the losses of these steps.
    pub(super) loss_sum: f64,
    /// Optimiser steps.
    pub(super) optimizer_steps: u64,
    /// Epoch with the best AUROC on the validation split, from 1.
    pub(super) best_epoch: Option<u32>,
    /// Its [score](super::EpochMetrics::score).
    pub(super) best: Option<[f64; 2]>,
}

/// Saves a header and arrays atomically.
///
/// # Errors
/// Errors of writing the file; an existing file is then unchanged.
pub(super) fn save<H: Serialize>(place: &BeneathPath, header: &H, arrays: &[&[f32]]) -> Result<()> {
    let header = serde_json::to_vec(header)
        .map_err(|e| Error::internal("cannot write the checkpoint").because(e))?;
    let floats: usize = arrays.iter().map(|array| array.len()).sum();
    let mut bytes = Vec::with_capacity(64 + header.len() + 4 * floats);
    bytes.extend_from_slice(MAGIC);
    bytes.extend_from_slice(&(header.len() as u64).to_le_bytes());
    bytes.extend_from_slice(&header);
    for array in arrays {
        bytes.extend_from_slice(&(array.len() as u64).to_le_bytes());
        bytes.extend(array.iter().flat_map(|x| x.to_le_bytes()));
    }
    let hash = Sha256::digest(&bytes);
    bytes.extend_from_slice(&hash);
    write(place, &bytes)
}

/// Writes or replaces a file of a run atomically.
///
/// # Errors
/// `Io`.
pub(super) fn write(place: &BeneathPath, bytes: &[u8]) -> Result<()> {
    place
        .replace(bytes)
        .map_err(|e| Error::io("cannot write the file", e).at(place.display()))
}

/// Loads a file of [`save`].
///
/// # Errors
/// `Input`: damaged, or not a checkpoint of this version. Errors of reading the file.
pub(super) fn load<H: DeserializeOwned>(place: &BeneathPath) -> Result<(H, Vec<Vec<f32>>)> {
    let bytes = place
        .read(FileKind::Bulk)
        .map_err(|e| Error::io("cannot read the checkpoint", e).at(place.display()))?;
    parse(&bytes).ok_or_else(|| {
        Error::input("the checkpoint is damaged or of another version")
            .at(place.display())
            .remedy("delete the file to restart the run from the beginning")
    })
}

/// Returns the arrays if they have these sizes.
pub(super) fn with_sizes<const N: usize>(
    arrays: Vec<Vec<f32>>,
    sizes: [usize; N],
) -> Option<[Vec<f32>; N]> {
    let arrays = <[Vec<f32>; N]>::try_from(arrays).ok()?;
    let has_sizes = arrays.iter().map(Vec::len).eq(sizes);
    has_sizes.then_some(arrays)
}

fn parse<H: DeserializeOwned>(bytes: &[u8]) -> Option<(H, Vec<Vec<f32>>)> {
    let (body, hash) = bytes.split_at_checked(bytes.len().checked_sub(HASH)?)?;
    if Sha256::digest(body)[..] != *hash {
        return None;
    }
    let rest = body.strip_prefix(MAGIC)?;
    let (header, mut rest) = sized(rest, 1)?;
    let header = serde_json::from_slice(header).ok()?;
    let mut arrays = Vec::new();
    while !rest.is_empty() {
        let (array, after) = sized(rest, 4)?;
        let floats = array.as_chunks::<4>().0;
        arrays.push(floats.iter().map(|x| f32::from_le_bytes(*x)).collect());
        rest = after;
    }
    Some((header, arrays))
}

/// Splits off a count and as many items of `size` bytes.
fn sized(bytes: &[u8], size: usize) -> Option<(&[u8], &[u8])> {
    let (count, rest) = bytes.split_first_chunk::<8>()?;
    let count = usize::try_from(u64::from_le_bytes(*count)).ok()?;
    rest.split_at_checked(count.checked_mul(size)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_base::files::Root;

    #[test]
    fn checkpoint_roundtrips_and_damage_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let place = Root::new(folder.path()).top().join("state.bin");
        let position = Position {
            epoch: 3,
            step: 7,
            loss_sum: 0.1 + 0.2,
            optimizer_steps: 99,
            best_epoch: Some(2),
            best: Some([0.75, 0.5]),
        };
        save(
            &place,
            &position,
            &[&[1.5, -0.0], &[], &[f32::MIN_POSITIVE]],
        )
        .unwrap();
        let (loaded, arrays): (Position, _) = load(&place).unwrap();
        assert_eq!(loaded, position);
        assert_eq!(arrays, [vec![1.5, -0.0], vec![], vec![f32::MIN_POSITIVE]]);
        let whole = std::fs::read(place.shown()).unwrap();
        for cut in [0, 7, 8, 20, whole.len() - 1] {
            std::fs::write(place.shown(), &whole[..cut]).unwrap();
            assert!(load::<Position>(&place).is_err(), "{cut}");
        }
        let mut flipped = whole;
        flipped[30] ^= 4;
        std::fs::write(place.shown(), &flipped).unwrap();
        let error = load::<Position>(&place).unwrap_err();
        assert!(error.to_string().contains("from the beginning"), "{error}");
    }
}
