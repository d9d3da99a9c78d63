//! Cache of decompositions, in memory and as files of a folder.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use glam::DVec3;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use super::decomposition::Decomposition;
use super::settings::DecompositionSettings;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, FileKind, FileName, hex, sha256_hex};
use gripcast_geometry::TriangleMesh;

/// Format name of a cache file.
const FORMAT: &str = "gripcast-convex-pieces-v2";

type Slot = Arc<OnceLock<std::result::Result<Arc<Decomposition>, String>>>;

/// Decompositions by mesh and parameters. Concurrent requests for the same one wait for the first.
#[derive(Debug, Default)]
pub(super) struct DecompositionCache {
    folder: Option<BeneathPath>,
    slots: Mutex<BTreeMap<FileName, Slot>>,
}

impl DecompositionCache {
    /// Cache with files in a folder, which is created if missing.
    pub(super) fn in_folder(folder: BeneathPath) -> Result<Self> {
        folder.create_dir_all().map_err(|e| {
            Error::io("cannot create the folder for convex pieces", e).at(folder.display())
        })?;
        Ok(Self {
            folder: Some(folder),
            ..Self::default()
        })
    }

    pub(super) fn get(
        &self,
        mesh: &TriangleMesh,
        settings: &DecompositionSettings,
    ) -> Result<Arc<Decomposition>> {
        let key = Key::new(mesh, settings)?;
        let slot = {
            let mut slots = self.slots.lock().unwrap_or_else(PoisonError::into_inner);
            slots.entry(key.file_name()?).or_default().clone()
        };
        // Computed outside the lock, so that other meshes do not wait.
        slot.get_or_init(|| self.load_or_compute(&key, mesh))
            .clone()
            .map_err(Error::input)
    }

    fn load_or_compute(
        &self,
        key: &Key,
        mesh: &TriangleMesh,
    ) -> std::result::Result<Arc<Decomposition>, String> {
        let name = key.file_name().map_err(|error| error.to_string())?;
        let path = self.folder.as_ref().map(|folder| folder.join(&name));
        if let Some(cached) = path.as_ref().and_then(|path| read(path, key)) {
            return Ok(Arc::new(cached));
        }
        let computed =
            Decomposition::compute(mesh, &key.settings).map_err(|error| error.to_string())?;
        if let Some(path) = path {
            // On failure the decomposition is recomputed next time.
            let _ = write(&path, key, &computed);
        }
        Ok(Arc::new(computed))
    }
}

/// Inputs of a decomposition.
struct Key {
    mesh: String,
    settings: DecompositionSettings,
    settings_hash: String,
}

impl Key {
    fn new(mesh: &TriangleMesh, settings: &DecompositionSettings) -> Result<Self> {
        let json = serde_json::to_vec(settings)
            .map_err(|e| Error::internal("cannot encode the parameters").because(e))?;
        Ok(Self {
            mesh: mesh.content_hash(),
            settings: *settings,
            settings_hash: sha256_hex(&json),
        })
    }

    fn file_name(&self) -> Result<FileName> {
        let (mesh, settings) = (&self.mesh[..32], &self.settings_hash[..16]);
        FileName::parse(&format!("{mesh}-{settings}.json"))
    }
}

#[derive(Serialize, Deserialize)]
struct File {
    format: String,
    mesh: String,
    settings: DecompositionSettings,
    pieces: Vec<Piece>,
    /// Checksum of the pieces.
    sha256: String,
}

#[derive(Serialize, Deserialize)]
struct Piece {
    vertices_m: Vec<[f64; 3]>,
    triangles: Vec<[u32; 3]>,
}

fn checksum(pieces: &[TriangleMesh]) -> String {
    let mut hash = Sha256::new();
    for piece in pieces {
        hash.update(piece.content_hash());
    }
    hex(&hash.finalize())
}

/// Reads the pieces of a file; `None` if it is damaged or belongs to another key.
fn read(path: &BeneathPath, key: &Key) -> Option<Decomposition> {
    let bytes = path.read(FileKind::Mesh).ok()?;
    let file: File = serde_json::from_slice(&bytes).ok()?;
    if file.format != FORMAT || file.mesh != key.mesh || file.settings != key.settings {
        return None;
    }
    let mesh = |piece: Piece| TriangleMesh {
        vertices: piece
            .vertices_m
            .into_iter()
            .map(DVec3::from_array)
            .collect(),
        triangles: piece.triangles,
    };
    let pieces: Vec<TriangleMesh> = file.pieces.into_iter().map(mesh).collect();
    if checksum(&pieces) != file.sha256 {
        return None;
    }
    Decomposition::from_pieces(pieces).ok()
}

fn write(path: &BeneathPath, key: &Key, decomposition: &Decomposition) -> Result<()> {
    let piece = |mesh: &TriangleMesh| Piece {
        vertices_m: mesh.vertices.iter().map(|v| v.to_array()).collect(),
        triangles: mesh.triangles.clone(),
    };
    let file = File {
        format: FORMAT.to_owned(),
        mesh: key.mesh.clone(),
        settings: key.settings,
        pieces: decomposition.pieces().iter().map(piece).collect(),
        sha256: checksum(decomposition.pieces()),
    };
    let json =
        serde_json::to_vec(&file).map_err(|e| Error::internal("cannot encode JSON").because(e))?;
    path.replace(&json)
        .map_err(|e| Error::io("cannot write the file", e).at(path.display()))
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::{Path, PathBuf};

    use super::*;
    use gripcast_base::files::Root;
    use gripcast_geometry::builtin;

    const SETTINGS: fn() -> DecompositionSettings = || DecompositionSettings {
        resolution: 16,
        ..DecompositionSettings::default()
    };

    fn only_file(folder: &Path) -> PathBuf {
        let mut files = fs::read_dir(folder).unwrap();
        let found = files.next().unwrap().unwrap().path();
        assert!(files.next().is_none());
        found
    }

    fn pieces(folder: &Path) -> Vec<TriangleMesh> {
        let cache = DecompositionCache::in_folder(Root::new(folder).top()).unwrap();
        let mesh = builtin("spike").unwrap();
        cache.get(&mesh, &SETTINGS()).unwrap().pieces().to_vec()
    }

    /// If this fails, decompositions have changed: increment [`FORMAT`], so that old files are not
    /// read, and update the checksum.
    #[test]
    fn format_identifies_the_current_decomposition() {
        let mesh = builtin("mug").unwrap();
        let computed = Decomposition::compute(&mesh, &SETTINGS()).unwrap();
        let sum = checksum(computed.pieces());
        assert_eq!(
            (FORMAT, &sum[..16]),
            ("gripcast-convex-pieces-v2", "260977b5f4f1f002")
        );
    }

    #[test]
    fn cache_files_round_trip_bit_for_bit() {
        let folder = tempfile::tempdir().unwrap();
        let nested = folder.path().join("a/b");
        fs::create_dir_all(&nested).unwrap();
        let first = pieces(&nested);
        let file = only_file(&nested);
        let before = fs::metadata(&file).unwrap().modified().unwrap();
        assert_eq!(checksum(&pieces(&nested)), checksum(&first));
        assert_eq!(fs::metadata(&file).unwrap().modified().unwrap(), before);
    }

    #[test]
    fn damaged_and_foreign_files_are_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let first = pieces(folder.path());
        let file = only_file(folder.path());
        let good = fs::read_to_string(&file).unwrap();
        let digit = good.find("0.0").unwrap();
        let mut altered = good.clone();
        altered.replace_range(digit + 2..digit + 3, "1");
        let other = good.replace(&good[good.find("\"mesh\"").unwrap() + 8..][..4], "beef");
        let damaged = [
            "",
            "{}",
            "no json",
            &good[..good.len() / 2],
            &altered,
            &other,
        ];
        for bad in damaged {
            assert_ne!(bad, good);
            fs::write(&file, bad).unwrap();
            assert_eq!(checksum(&pieces(folder.path())), checksum(&first));
            assert_eq!(fs::read_to_string(&file).unwrap(), good);
        }
    }

    #[test]
    fn symlink_is_replaced_and_its_target_kept() {
        let folder = tempfile::tempdir().unwrap();
        let [cache, secret] = ["cache", "secret"].map(|name| folder.path().join(name));
        fs::create_dir(&cache).unwrap();
        pieces(&cache);
        let file = only_file(&cache);
        fs::remove_file(&file).unwrap();
        fs::write(&secret, "secret").unwrap();
        std::os::unix::fs::symlink(&secret, &file).unwrap();
        pieces(&cache);
        assert_eq!(fs::read(&secret).unwrap(), b"secret");
        assert!(!file.is_symlink());
    }

    #[test]
    fn threads_share_one_decomposition() {
        let cache = DecompositionCache::default();
        let mesh = builtin("spike").unwrap();
        let get = || cache.get(&mesh, &SETTINGS()).unwrap();
        let (a, b) = std::thread::scope(|scope| {
            let other = scope.spawn(get);
            (get(), other.join().unwrap())
        });
        assert!(Arc::ptr_eq(&a, &b));
        let finer = DecompositionSettings {
            resolution: 20,
            ..SETTINGS()
        };
        assert!(!Arc::ptr_eq(&a, &cache.get(&mesh, &finer).unwrap()));
    }

    #[test]
    fn invalid_folder_is_an_error() {
        let file = tempfile::NamedTempFile::new().unwrap();
        assert!(DecompositionCache::in_folder(Root::new(file.path()).top().join("a")).is_err());
    }
}
