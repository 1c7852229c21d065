//! Tests backups that are received from elsewhere.

use super::*;

/// A folder, the bytes of a backup and their BLAKE3.
async fn sent() -> (tempfile::TempDir, Vec<u8>, String) {
    let (dir, copy) = with_backup().await;
    let bytes = std::fs::read(copy).unwrap();
    let digest = blake3::hash(&bytes).to_hex().to_string();
    (dir, bytes, digest)
}

fn received(file: &Path, bytes: &[u8]) -> Incoming {
    let mut incoming = Incoming::create(file).unwrap();
    bytes.chunks(1 << 20).for_each(|piece| incoming.write(piece).unwrap());
    incoming
}

/// Another file that took the name of an incoming backup keeps its checksum.
#[tokio::test]
async fn occupied_name_keeps_its_checksum() {
    let (dir, bytes, digest) = sent().await;
    let (file, checksum) = (dir.path().join("received"), dir.path().join("received.b3"));
    let incoming = received(&file, &bytes);
    let busy = Incoming::create(&file).unwrap_err();
    assert!(matches!(busy, BackupError::Busy { .. }), "{busy}");
    std::fs::write(&file, "another").unwrap();
    std::fs::write(&checksum, "its checksum").unwrap();
    let taken = incoming.publish(&digest, newest()).await.unwrap_err();
    assert!(matches!(taken, BackupError::Exists { .. }), "{taken}");
    assert_eq!(std::fs::read_to_string(&file).unwrap(), "another");
    assert_eq!(std::fs::read_to_string(&checksum).unwrap(), "its checksum");
}

/// A backup that arrives truncated or changed leaves no files.
#[tokio::test]
async fn incomplete_incoming_backup_leaves_nothing() {
    let (dir, bytes, digest) = sent().await;
    let file = dir.path().join("received");
    let mut changed = bytes.clone();
    let mark = bytes.windows(MARK.len()).position(|window| window == MARK).unwrap();
    changed[mark] ^= 1;
    for wrong in [&bytes[..bytes.len() - PAGE_BYTES], &changed] {
        let refused = received(&file, wrong).publish(&digest, newest()).await.unwrap_err();
        assert!(matches!(refused, BackupError::Damaged { .. }), "{refused}");
        let left = |name: &str| dir.path().join(name).exists();
        assert!(!left("received") && !left("received.b3") && !left("received.draft"));
    }
}
