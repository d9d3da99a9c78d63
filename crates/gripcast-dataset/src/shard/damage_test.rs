//! The reader returns an error or the original rows for any damaged file.

use super::foreign_test::{DATASETS, PANDAS, PYARROW};
use super::metadata::CREATED_BY;
use super::reader::ShardReader;
use super::row::{ShardFacts, ShardRow};
use super::sample_rows::sample_rows;
use super::writer::to_bytes;
use gripcast_base::error::{ErrorKind, Result};

/// Seeded random numbers for the offsets of damage.
fn numbers(mut state: u64) -> impl Iterator<Item = u64> {
    std::iter::repeat_with(move || {
        state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = state;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    })
}

fn read(bytes: Vec<u8>) -> Result<(Vec<ShardRow>, Vec<ShardFacts>)> {
    let shard = ShardReader::from_bytes("damaged.parquet", bytes)?;
    let rows: Vec<ShardRow> = shard.rows().collect::<Result<_>>()?;
    let facts: Vec<ShardFacts> = shard.facts().collect::<Result<_>>()?;
    Ok((rows, facts))
}

#[test]
fn truncated_file_is_refused() {
    let bytes = to_bytes(sample_rows(0, 5), "{}").unwrap();
    let step = bytes.len() / 300 + 1;
    let ends = (0..bytes.len()).step_by(step);
    for end in ends.chain(bytes.len() - 40..bytes.len()) {
        let error = read(bytes[..end].to_vec()).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Input, "{error}");
        assert!(
            error.to_string().starts_with("damaged.parquet: "),
            "{error}"
        );
    }
}

#[test]
fn flipped_bits_are_detected() {
    let rows = sample_rows(0, 5);
    let bytes = to_bytes(rows.clone(), "{}").unwrap();
    let mut found = 0;
    for (offset, bits) in numbers(1).zip(numbers(2)).take(600) {
        let mut damaged = bytes.clone();
        let offset = (offset % bytes.len() as u64) as usize;
        damaged[offset] ^= (bits % 255 + 1) as u8;
        match read(damaged) {
            Ok((read, facts)) => {
                assert_eq!(read, rows, "byte {offset}");
                assert!(
                    facts.iter().eq(rows.iter().map(|row| &row.facts)),
                    "byte {offset}"
                );
            }
            Err(error) => {
                found += 1;
                assert_eq!(error.kind(), ErrorKind::Input, "byte {offset}: {error}");
                assert!(
                    error.to_string().starts_with("damaged.parquet: "),
                    "{error}"
                );
            }
        }
    }
    // The rest are names of images, statistics and features, which the reader ignores.
    assert!(found > 150, "{found}");
}

/// Without hashes the decoders receive the damaged bytes.
#[test]
fn flipped_bits_without_hashes_cause_no_panic() {
    let mut ours = to_bytes(sample_rows(0, 40), "{}").unwrap();
    let name = CREATED_BY.as_bytes();
    let offset = ours.windows(name.len()).position(|w| w == name).unwrap();
    ours[offset] = b'x';
    for bytes in [&ours, DATASETS, PANDAS, PYARROW] {
        assert!(read(bytes.to_vec()).is_ok());
        flip(bytes);
    }
}

fn flip(bytes: &[u8]) {
    for (offset, bits) in numbers(3).zip(numbers(4)).take(500) {
        let mut damaged = bytes.to_vec();
        for (k, shift) in [0, 16, 32]
            .into_iter()
            .enumerate()
            .take(1 + offset as usize % 3)
        {
            let offset = (offset.rotate_left(shift) % bytes.len() as u64) as usize;
            damaged[offset] ^= (bits >> (8 * k)) as u8 | 1;
        }
        if let Err(error) = read(damaged) {
            assert_eq!(error.kind(), ErrorKind::Input, "byte {offset}: {error}");
        }
    }
}

#[test]
fn other_files_are_refused() {
    for bytes in [
        b"".to_vec(),
        b"PAR1".to_vec(),
        b"PAR1PAR1".to_vec(),
        b"PAR1\xff\xff\xff\x7fPAR1".to_vec(),
        b"PAR1\x00\x00\x00\x00PAR1".to_vec(),
        b"PAR1\x00\x00\x00\x00PARE".to_vec(),
        [
            b"PAR1".to_vec(),
            vec![0x9c; 5000],
            5000_u32.to_le_bytes().to_vec(),
            b"PAR1".to_vec(),
        ]
        .concat(),
        vec![0; 100_000],
    ] {
        let error = read(bytes).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Input, "{error}");
    }
    let folder = tempfile::tempdir().unwrap();
    let missing = ShardReader::open(folder.path().join("a.parquet")).unwrap_err();
    assert_eq!(missing.kind(), ErrorKind::NotFound);
    assert!(ShardReader::open(folder.path()).is_err());
}
