//! Checkpoints: all that a run needs to go on as if it had never been stopped.

use serde::{Deserialize, Serialize, de::DeserializeOwned};
use sha2::{Digest as _, Sha256};

use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, FileKind};

/// What every checkpoint begins with.
const MAGIC: &[u8; 8] = b"gcstate1";
/// Bytes of the hash at the end.
const HASH: usize = 32;

/// Where a run is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Position {
    /// Epochs that are finished.
    pub(super) epoch: u32,
    /// Steps of the next epoch that are done.
    pub(super) step: u64,
    /// Sum of those steps' losses.
    pub(super) loss: f64,
    /// Steps of the optimiser.
    pub(super) steps: u64,
    /// Epoch with the best validation accuracy, from 1.
    pub(super) best_epoch: Option<u32>,
    /// That accuracy, and the loss there.
    pub(super) best: Option<[f64; 2]>,
}

/// Saves a header and numbers: whole or not at all.
///
/// # Errors
/// Those of writing the file; an older one is then as it was.
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

/// Writes a file of a run whole, in the place of what had its name.
///
/// # Errors
/// Those of the operating system.
pub(super) fn write(place: &BeneathPath, bytes: &[u8]) -> Result<()> {
    place
        .replace(bytes)
        .map_err(|e| Error::io("cannot write the file", e).at(place.display()))
}

/// Reads what [`save`] wrote.
///
/// # Errors
/// `Input`: damaged, or no checkpoint of this version. Those of reading the file.
pub(super) fn load<H: DeserializeOwned>(place: &BeneathPath) -> Result<(H, Vec<Vec<f32>>)> {
    let bytes = place
        .read(FileKind::Bulk)
        .map_err(|e| Error::io("cannot read the checkpoint", e).at(place.display()))?;
    parse(&bytes).ok_or_else(|| {
        Error::input("the checkpoint is damaged or of another version")
            .at(place.display())
            .remedy("delete the file: the run then starts from the beginning")
    })
}

/// Arrays of these sizes; none where there are others.
pub(super) fn of_sizes<const N: usize>(
    arrays: Vec<Vec<f32>>,
    sizes: [usize; N],
) -> Option<[Vec<f32>; N]> {
    let arrays = <[Vec<f32>; N]>::try_from(arrays).ok()?;
    let is_whole = arrays.iter().map(Vec::len).eq(sizes);
    is_whole.then_some(arrays)
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

/// A run of items of `size` bytes behind their number.
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
    fn a_checkpoint_comes_back_and_a_damaged_one_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let place = Root::new(folder.path()).top().join("state.bin");
        let position = Position {
            epoch: 3,
            step: 7,
            loss: 0.1 + 0.2,
            steps: 99,
            best_epoch: Some(2),
            best: Some([0.75, 0.5]),
        };
        save(
            &place,
            &position,
            &[&[1.5, -0.0], &[], &[f32::MIN_POSITIVE]],
        )
        .unwrap();
        let (found, arrays): (Position, _) = load(&place).unwrap();
        assert_eq!(found, position);
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
