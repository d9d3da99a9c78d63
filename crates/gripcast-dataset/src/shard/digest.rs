//! Hashes of the contents of rows, independent of the file's encoding.

use sha2::{Digest as _, Sha256};

use super::cell::Cell;

/// Columns of the facts in the first files of this format.
const FIRST_FACTS: usize = 22;

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

    /// Adds the cells of a row's facts. Nulls of columns that older files lack are left out where no
    /// value follows, so that those files keep their hash.
    pub(super) fn add_facts(&mut self, cells: &[Cell<'_>]) {
        let values = cells.iter().rposition(|cell| *cell != Cell::Null);
        let count = values.map_or(0, |at| at + 1).max(FIRST_FACTS);
        cells.iter().take(count).for_each(|cell| self.add(cell));
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
    fn later_columns_without_values_leave_the_hash() {
        let hash = |later: &[Cell<'_>]| {
            let mut cells = vec![Cell::Integer(1); FIRST_FACTS - 1];
            cells.push(Cell::Null);
            cells.extend_from_slice(later);
            let mut hash = ContentHash::default();
            hash.add_facts(&cells);
            hash.finish()
        };
        assert_eq!(hash(&[]), hash(&[Cell::Null, Cell::Null]));
        assert_ne!(hash(&[]), hash(&[Cell::Integer(1)]));
        let [first, second] = [
            hash(&[Cell::Integer(1), Cell::Null]),
            hash(&[Cell::Null, Cell::Integer(1)]),
        ];
        assert_ne!(first, second);
    }

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
