//! Compares texts with files that hold them as users read them, and has the status of dictionaries.

use std::path::Path;

use farm_proto::DictionaryName;
use farm_proto::status::{DictionaryState, DictionaryStatus, FailedJob};
use optics_model::grid::{Axes, Quality};
use optics_model::{Digest, Grid, Scene, Walks};

/// Asserts that a text equals that of a file below `src`, line by line; `FARM_TEST_ACCEPT=1` writes the file.
pub(crate) fn is_stable(file: &str, text: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("src").join(file);
    if std::env::var_os("FARM_TEST_ACCEPT").is_some() {
        std::fs::write(&path, text).unwrap();
    }
    let expected = std::fs::read_to_string(&path).unwrap();
    for (i, (found, expected)) in text.lines().zip(expected.lines()).enumerate() {
        assert_eq!(found, expected, "{file}, line {}", i + 1);
    }
    assert_eq!(text.len(), expected.len(), "{file}");
}

/// A dictionary that is done, or that was cancelled with failed jobs.
pub(crate) fn dictionary(done: bool) -> DictionaryStatus {
    let axes = Axes {
        sigma_t_per_mm: vec![1.0, 4.5],
        albedo: vec![0.5, 0.9, 0.99],
        g: vec![-0.1, 0.4],
        thickness_mm: vec![0.5],
        sample_ior: vec![1.53],
    };
    let walks = Walks::new(25_000).unwrap();
    let scene = if done { Scene::paper() } else { Scene::smooth() };
    let grid = Grid::new(scene, axes, walks, 1, done).unwrap();
    let target = Quality::new(0.01, Walks::new(1_000_000).unwrap()).unwrap();
    let grid = if done { grid } else { grid.with_quality(target).unwrap() };
    let failed = |quarantined| FailedJob { job: 2, reason: "no reason".to_owned(), quarantined };
    DictionaryStatus {
        name: DictionaryName::new(if done { "paper" } else { "fine" }).unwrap(),
        grid,
        grid_digest: Digest::from_bytes([0x5a; 32]),
        records_digest: done.then_some(Digest::from_bytes([0xc3; 32])),
        created_unix_ms: 1_790_000_000_123,
        state: if done { DictionaryState::Done } else { DictionaryState::Cancelled },
        jobs_done: if done { 4 } else { 1 },
        jobs_leased: 2,
        jobs_disputed: if done { 2 } else { 0 },
        jobs_failed: if done { 0 } else { 2 },
        failed: if done { Vec::new() } else { vec![failed(true), failed(false)] },
        work_done: if done { 1.0 } else { 0.362 },
        priority: -3,
        reason: if done { String::new() } else { "not needed".to_owned() },
        owner: if done { "alice".to_owned() } else { String::new() },
        eta_s: (!done).then_some(75.5),
        goes_first: (!done).then(|| DictionaryName::new("paper").unwrap()),
        records_reused: 3,
        walks: (25_000, 1_000_000),
    }
}
