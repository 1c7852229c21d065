//! Keeps traced records in files below the target folder, so that tests with the same jobs trace them once.
//!
//! A record depends on its job alone: a file is named after the identity of its job, ends with a digest of its name and
//! content, and is traced again if that does not match. Tests of the tracer itself do not use it.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, OnceLock};

use optics_fit::{DictionaryBuilder, FitDictionary};
use optics_layers::records_of_set;
use optics_model::job::JobSpec;
use optics_model::{Digest, Grid, PHYSICS_VERSION, PackedRecords};

/// Dictionaries with more bytes, such as those of many bands, are used by one test alone, and are not stored.
const MOST_BYTES: usize = 300 << 20;

/// The records of a job.
pub fn records(job: &JobSpec) -> PackedRecords {
    records_within(folder(), job)
}

fn records_within(folder: &Path, job: &JobSpec) -> PackedRecords {
    read(folder, job).unwrap_or_else(|| {
        let packed = PackedRecords::pack(job, &optics_layers::records(job, &AtomicBool::new(false)).unwrap());
        write(folder, job, &packed);
        packed
    })
}

/// The dictionary of a grid: built once in a process, and traced by one process at a time. It is not for tasks of a pool
/// of threads that trace, which would wait for themselves.
pub fn dictionary(grid: &Grid) -> &'static FitDictionary {
    static BUILT: Mutex<Option<HashMap<Digest, &'static OnceLock<FitDictionary>>>> = Mutex::new(None);
    let place = *BUILT
        .lock()
        .unwrap()
        .get_or_insert_default()
        .entry(Digest::of_grid(grid))
        .or_insert_with(|| Box::leak(Box::default()));
    place.get_or_init(|| {
        let lock = std::fs::File::create(folder().join(format!("{}.lock", Digest::of_grid(grid)))).unwrap();
        lock.lock().unwrap();
        build(folder(), grid)
    })
}

fn build(folder: &Path, grid: &Grid) -> FitDictionary {
    let jobs: Vec<JobSpec> = (0..grid.job_count()).map(|job| JobSpec::of(grid, job)).collect();
    let is_stored = jobs.iter().map(PackedRecords::bytes_of).sum::<usize>() <= MOST_BYTES;
    let mut builder = DictionaryBuilder::new(grid.clone());
    let mut missing = Vec::new();
    for job in jobs {
        match read(folder, &job).filter(|_| is_stored) {
            Some(packed) => builder.add(&packed),
            None => missing.push(job),
        }
    }
    // Points with the same optical thickness have the same walks.
    while let Some(first) = missing.first() {
        let (set, others): (Vec<_>, Vec<_>) =
            missing.iter().cloned().partition(|job| first.shares_walks_with(job));
        missing = others;
        for (job, records) in set.iter().zip(records_of_set(&set, &AtomicBool::new(false)).unwrap()) {
            let packed = PackedRecords::pack(job, &records);
            builder.add(&packed);
            if is_stored {
                write(folder, job, &packed);
            }
        }
    }
    builder.build()
}

/// Bytes of the digest at a file's end.
const DIGEST: usize = 32;

fn file(folder: &Path, job: &JobSpec) -> PathBuf {
    folder.join(job.sums_identity().to_string())
}

fn seal(job: &JobSpec, bytes: &[u8]) -> Digest {
    Digest::of_bytes(&[job.sums_identity().as_bytes(), bytes].concat())
}

/// The stored records of a job, if they are there and sound.
fn read(folder: &Path, job: &JobSpec) -> Option<PackedRecords> {
    let mut bytes = std::fs::read(file(folder, job)).ok()?;
    let digest = bytes.split_off(bytes.len().checked_sub(DIGEST)?);
    (seal(job, &bytes).as_bytes()[..] == digest[..]).then(|| PackedRecords::new(job, bytes.into()).ok())?
}

/// Writes a file under another name and renames it, so that others read nothing or all of it.
fn write(folder: &Path, job: &JobSpec, packed: &PackedRecords) {
    static NUMBER: AtomicU64 = AtomicU64::new(0);
    let number = NUMBER.fetch_add(1, Ordering::Relaxed);
    let part = folder.join(format!("part-{}-{number}", std::process::id()));
    std::fs::write(&part, [packed.bytes(), &seal(job, packed.bytes()).as_bytes()[..]].concat()).unwrap();
    std::fs::rename(&part, file(folder, job)).unwrap();
}

/// `target/test-records/v7`: programs lie in a folder of their profile's.
fn folder() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let program = std::env::current_exe().expect("the test knows its path");
        let target = program.ancestors().nth(3).expect("programs of tests lie three folders deep");
        let folder = target.join(format!("test-records/v{PHYSICS_VERSION}"));
        std::fs::create_dir_all(&folder).expect("the target folder can be written to");
        folder
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grids::small_grid;

    fn is_read(folder: &Path, job: &JobSpec) -> bool {
        read(folder, job).is_some()
    }

    /// Stored records are those of the tracer; a damaged file and that of another job are traced again.
    #[test]
    fn stored_records_are_the_traced_ones() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let [one, other] = [3, 4].map(|job| JobSpec::of(&small_grid(), job));
        let traced =
            PackedRecords::pack(&one, &optics_layers::records(&one, &AtomicBool::new(false)).unwrap());
        assert!(!is_read(folder, &one));
        assert_eq!(records_within(folder, &one), traced);
        assert_eq!(read(folder, &one), Some(traced.clone()));
        assert_eq!(std::fs::read_dir(folder).unwrap().count(), 1);
        std::fs::copy(file(folder, &one), file(folder, &other)).unwrap();
        assert!(!is_read(folder, &other));
        let bytes = std::fs::read(file(folder, &one)).unwrap();
        for spoilt in [&bytes[..bytes.len() - 1], &[], &[&[bytes[0] ^ 1], &bytes[1..]].concat()] {
            std::fs::write(file(folder, &one), spoilt).unwrap();
            assert!(!is_read(folder, &one));
            assert_eq!(records_within(folder, &one), traced);
            assert!(is_read(folder, &one));
        }
    }

    /// A dictionary from walks that its points share, and from files, is the one of single jobs.
    #[test]
    fn stored_dictionaries_are_the_traced_ones() {
        let (grid, folder) = (small_grid(), tempfile::tempdir().unwrap());
        let mut single = DictionaryBuilder::new(grid.clone());
        for job in (0..grid.job_count()).map(|job| JobSpec::of(&grid, job)) {
            single.add(&PackedRecords::pack(
                &job,
                &optics_layers::records(&job, &AtomicBool::new(false)).unwrap(),
            ));
        }
        let single = single.build();
        for built in [(); 2].map(|()| build(folder.path(), &grid)) {
            for record in 0..grid.record_count() {
                assert_eq!(built.values(record, 0), single.values(record, 0), "record {record}");
            }
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), grid.job_count());
    }
}
