//! Hashes of the contents of rows, independent of the file's encoding.

use sha2::{Digest as _, Sha256};

use super::cell::Cell;

/// Hash of a sequence of cells.
#[derive(Clone, Default)]
pub(super) struct ContentHash(Sha256);

impl ContentHash {
    /// Adds a cell: a letter for its kind, its length if variable, its bytes in little endian.
    pub(super) fn add(&mut self, cell: &Cell<'_>) {
        match cell {
            Cell::Null => self.0.update(b"-"),
            Cell::Text(text) => self.bytes(b"t", text.as_bytes()),
            Cell::Integer(integer) => {
                self.0.update(b"i");
                self.0.update(integer.to_le_bytes());
            }
            Cell::Number(number) => self.numbers(b"n", &[*number]),
            Cell::Numbers(numbers) => self.numbers(b"l", numbers),
            Cell::Image(bytes) => self.bytes(b"p", bytes),
            Cell::Images(images) => {
                self.0.update(b"q");
                self.0.update((images.len() as u64).to_le_bytes());
                images.iter().for_each(|bytes| self.bytes(b"p", bytes));
            }
            Cell::Array(array) => self.bytes(b"a", &array.to_npy()),
        }
    }

    /// Returns the hash as 64 hexadecimal digits.
    pub(super) fn finish(self) -> String {
        let bytes = self.0.finalize();
        bytes.iter().map(|byte| format!("{byte:02x}")).collect()
    }

    fn bytes(&mut self, kind: &[u8], bytes: &[u8]) {
        self.0.update(kind);
        self.0.update((bytes.len() as u64).to_le_bytes());
        self.0.update(bytes);
    }

    fn numbers(&mut self, kind: &[u8], numbers: &[f64]) {
        self.0.update(kind);
        self.0.update((numbers.len() as u64).to_le_bytes());
        for number in numbers {
            self.0.update(number.to_le_bytes());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hash_depends_on_cell_boundaries() {
        let hash = |cells: Vec<Cell<'_>>| {
            let mut hash = ContentHash::default();
            cells.iter().for_each(|cell| hash.add(cell));
            hash.finish()
        };
        let text = Cell::text;
        assert_ne!(hash(vec![text("ab")]), hash(vec![text("a"), text("b")]));
        assert_ne!(hash(vec![text("")]), hash(vec![Cell::Null]));
        assert_ne!(
            hash(vec![text("ab"), text("")]),
            hash(vec![text(""), text("ab")])
        );
        assert_ne!(
            hash(vec![Cell::Number(0.0)]),
            hash(vec![Cell::Number(-0.0)])
        );
        assert_eq!(hash(vec![]).len(), 64);
    }
}
