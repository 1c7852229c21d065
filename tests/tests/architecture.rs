//! The boundaries that ARCHITECTURE.md draws, checked in the sources.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use std::path::{Path, PathBuf};

use farm_tests::reference::root;

fn sources(folder: &Path) -> Vec<(PathBuf, String)> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(sources(&path));
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push((path.clone(), std::fs::read_to_string(&path).unwrap()));
        }
    }
    assert!(!found.is_empty(), "{} holds no sources", folder.display());
    found
}

fn assert_absent(folder: &str, words: &[&str]) {
    for (path, text) in sources(&root().join(folder)) {
        for word in words {
            assert!(!text.contains(word), "{} must not mention {word}", path.display());
        }
    }
}

fn dependencies(krate: &str) -> Vec<String> {
    let manifest = std::fs::read_to_string(root().join(krate).join("Cargo.toml")).unwrap();
    let manifest: toml::Table = manifest.parse().unwrap();
    manifest["dependencies"].as_table().unwrap().keys().cloned().collect()
}

/// What every crate may use of the project.
const ARROWS: [(&str, &[&str]); 9] = [
    ("optics/model", &[]),
    ("optics/tracer", &["optics-model"]),
    ("optics/fit", &["optics-model"]),
    ("proto", &["optics-model"]),
    ("proto/link", &[]),
    ("coordinator", &["optics-model", "optics-fit", "farm-proto", "farm-link"]),
    ("worker", &["optics-model", "optics-tracer", "farm-proto", "farm-link"]),
    (
        "client",
        &[
            "optics-model",
            "optics-tracer",
            "optics-fit",
            "farm-proto",
            "farm-link",
            "farm-coordinator",
            "farm-worker",
        ],
    ),
    // Sees all.
    (
        "tests",
        &[
            "optics-model",
            "optics-tracer",
            "optics-fit",
            "farm-proto",
            "farm-link",
            "farm-coordinator",
            "farm-worker",
            "farmctl",
        ],
    ),
];

#[test]
fn crates_depend_in_one_direction() {
    for (krate, allowed) in ARROWS {
        let ours = |d: &String| d.starts_with("optics-") || d.starts_with("farm");
        for dependency in dependencies(krate).into_iter().filter(ours) {
            assert!(allowed.contains(&dependency.as_str()), "{krate} must not depend on {dependency}");
        }
    }
}

#[test]
fn the_science_knows_no_runtime_network_clock_database_or_file() {
    let used = ["blake3", "bytes", "fearless_simd", "glam", "rayon", "serde", "thiserror", "toml"];
    for krate in ["optics/model", "optics/tracer", "optics/fit"] {
        for dependency in dependencies(krate).iter().filter(|d| !d.starts_with("optics-")) {
            assert!(used.contains(&dependency.as_str()), "{krate} must not depend on {dependency}");
        }
        let ambient = ["std::time", "std::fs", "std::net", "std::env", "std::process"];
        assert_absent(&format!("{krate}/src"), &ambient);
    }
}

#[test]
fn the_tracers_bits_are_the_same_on_every_machine() {
    assert_absent("optics/tracer/src", &["mul_add"]);
}

/// Grids are stored as their messages, so one module of the store knows those too.
#[test]
fn wire_types_stay_at_the_edges_of_the_coordinator() {
    for (path, text) in sources(&root().join("coordinator/src")) {
        let at_the_edge = ["src/rpc/", "src/store/dictionaries.rs", "src/store/tests.rs"]
            .iter()
            .any(|edge| path.to_string_lossy().contains(edge));
        assert!(at_the_edge || !text.contains("wire::"), "{} must not use wire types", path.display());
    }
}

#[test]
fn dispatch_is_synchronous_and_blind() {
    assert_absent(
        "coordinator/src/dispatch",
        &[
            "tokio",
            "async fn",
            "Instant",
            "SystemTime",
            "sqlx",
            "tonic::",
            "crate::rpc",
            "crate::store::",
            "crate::farm",
        ],
    );
}

#[test]
fn the_store_knows_nothing_above_it() {
    assert_absent(
        "coordinator/src/store",
        &["crate::rpc", "crate::dispatch", "crate::farm", "crate::fit", "tonic::"],
    );
}
