//! Tests backups with random damage, as from a failing disk or by hand. They are restored if SQLite finds no fault in
//! them; reading them then yields the stored data, or an error.
//!
//! `PROPTEST_CASES=20000 cargo test -p farm-coordinator --lib damaged_backup` runs more of them.

use std::sync::OnceLock;

use proptest::prelude::*;
use proptest::sample::Index;
use proptest::test_runner::TestCaseError;

use super::{begun, complete, records};
use crate::store::{DataDir, Store, backup, newest_schema};
use crate::stored::{DesiredState, StoredDictionary};

/// A change of the bytes of a file.
#[derive(Debug, Clone)]
enum Damage {
    /// Bits that have changed.
    Flip(Index, u8),
    /// Bytes that come from elsewhere in the file.
    Copy(Index, Index, usize),
    /// A part that was never written.
    Zeros(Index, usize),
    Cut(Index),
}

fn damage() -> impl Strategy<Value = Damage> {
    let index = any::<Index>;
    prop_oneof![
        8 => (index(), 1..=u8::MAX).prop_map(|(at, bits)| Damage::Flip(at, bits)),
        2 => (index(), index(), 1..5000_usize).prop_map(|(from, to, bytes)| Damage::Copy(from, to, bytes)),
        1 => (index(), 1..5000_usize).prop_map(|(at, bytes)| Damage::Zeros(at, bytes)),
        1 => index().prop_map(Damage::Cut),
    ]
}

impl Damage {
    fn act(&self, file: &mut Vec<u8>) {
        let end = |at: usize, bytes: usize, file: &[u8]| (at + bytes).min(file.len());
        match self {
            Self::Flip(at, bits) => *at.get_mut(file) ^= bits,
            Self::Copy(from, to, bytes) => {
                let (from, to) = (from.index(file.len()), to.index(file.len()));
                let part = file[from..end(from, *bytes, file)].to_vec();
                let until = end(to, part.len(), file);
                file[to..until].copy_from_slice(&part[..until - to]);
            }
            Self::Zeros(at, bytes) => {
                let at = at.index(file.len());
                let until = end(at, *bytes, file);
                file[at..until].fill(0);
            }
            // One byte stays, since further damage may follow.
            Self::Cut(at) => file.truncate(at.index(file.len()) + 1),
        }
    }
}

/// A backup of a farm with a finished job and one that was given up, and its dictionary.
fn whole() -> &'static (Vec<u8>, StoredDictionary) {
    static WHOLE: OnceLock<(Vec<u8>, StoredDictionary)> = OnceLock::new();
    WHOLE.get_or_init(|| {
        wait(async {
            let (dir, store, d) = begun().await;
            complete(&store, &d, 0, 0.25).await;
            store.give_up_job(d.id, 1, "no luck", true).await.unwrap();
            store.set_desire(d.id, DesiredState::Pause, "lunch").await.unwrap();
            let copy = dir.path().join("copy");
            store.backup(&copy).await.unwrap();
            store.close().await;
            (std::fs::read(copy).unwrap(), d)
        })
    })
}

fn wait<T>(work: impl Future<Output = T>) -> T {
    tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap().block_on(work)
}

/// The step that a damaged backup reached.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum End {
    NotRestored,
    NotOpened,
    NotRead,
    Read,
}

async fn restore_and_read(bytes: &[u8]) -> Result<End, TestCaseError> {
    let dir = tempfile::tempdir().unwrap();
    let (file, home) = (dir.path().join("copy"), dir.path().join("home"));
    std::fs::write(&file, bytes).unwrap();
    let folder = DataDir::lock(&home).unwrap();
    if backup::restore(&file, &folder, newest_schema()).await.is_err() {
        prop_assert!(!home.join("farm.db").exists(), "what is refused leaves nothing");
        return Ok(End::NotRestored);
    }
    let Ok(store) = Store::open(folder, |_| {}).await else { return Ok(End::NotOpened) };
    let end = all_that_is_read(&store).await;
    let _ = (store.faults().await, store.backup(&dir.path().join("again")).await);
    store.close().await;
    end
}

async fn all_that_is_read(store: &Store) -> Result<End, TestCaseError> {
    let (_, original) = whole();
    let Ok(dictionaries) = store.dictionaries().await else { return Ok(End::NotRead) };
    for found in dictionaries {
        prop_assert!(found.grid == original.grid, "another grid: {:?}", found.grid);
        let _ = store.ended_jobs(found.id, &found.grid).await;
        let jobs = store.finished_jobs(found.id, &found.grid, 0..2).await.unwrap_or_default();
        for job in jobs.into_iter().flatten() {
            prop_assert_eq!(job.job, 0);
            prop_assert_eq!(job.records.unpack(), records(0, 0.25));
        }
    }
    Ok(End::Read)
}

fn config() -> ProptestConfig {
    let cases = std::env::var("PROPTEST_CASES").ok().and_then(|n| n.parse().ok()).unwrap_or(24);
    ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() }
}

proptest! {
    #![proptest_config(config())]

    /// Data read from a damaged backup equal the data that were stored.
    #[test]
    fn damaged_backup_yields_only_true_data(all in prop::collection::vec(damage(), 1..4)) {
        let mut bytes = whole().0.clone();
        for damage in &all {
            damage.act(&mut bytes);
        }
        wait(restore_and_read(&bytes))?;
    }
}

/// Damage to a backup is refused at the restore or when the data are read.
#[test]
fn damage_is_refused_where_it_is_found() {
    let whole = &whole().0;
    let after = |damage: &dyn Fn(&mut Vec<u8>)| {
        let mut bytes = whole.clone();
        damage(&mut bytes);
        wait(restore_and_read(&bytes)).unwrap()
    };
    let at = |part: &[u8]| whole.windows(part.len()).position(|window| window == part).unwrap();
    assert_eq!(after(&|_| ()), End::Read);
    assert_eq!(after(&|bytes| bytes.truncate(5000)), End::NotRestored);
    assert_eq!(after(&|bytes| bytes[at(b"lunch")] ^= 1), End::Read);
    // Another name of a layer changes no result, but makes another grid all the same.
    assert_eq!(after(&|bytes| bytes[at(b"glass slip")] ^= 1), End::NotRead);
}
