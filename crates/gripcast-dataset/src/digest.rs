//! Size and sha256 of a stored file.

use serde::{Deserialize, Serialize};

use gripcast_base::files::sha256_hex;

/// Digest of a stored file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FileDigest {
    /// Size in bytes.
    pub bytes: u64,
    /// sha256, lower-case hex; `sha256sum` prints the same.
    pub sha256: String,
}

/// Computes the digest of a file's contents.
pub(super) fn digest(bytes: &[u8]) -> FileDigest {
    FileDigest {
        bytes: bytes.len() as u64,
        sha256: sha256_hex(bytes),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_base::files::ContentKey;

    #[test]
    fn digest_agrees_with_sha256sum() {
        assert_eq!(
            digest(b"abc"),
            FileDigest {
                bytes: 3,
                sha256: "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad".into(),
            }
        );
        assert_eq!(ContentKey::from_contents(b"abc"), "ba7816bf8f01");
    }
}
