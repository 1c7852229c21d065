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

#[test]
fn domain_types_know_no_runtime() {
    let sources = sources(&root().join("proto/src"));
    let domain =
        sources.iter().filter(|(path, _)| !path.components().any(|part| part.as_os_str() == "access"));
    for (path, text) in domain {
        assert!(
            !text.contains("tokio"),
            "only the way to a coordinator needs a runtime, not {}",
            path.display()
        );
    }
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

#[test]
fn crates_depend_in_one_direction() {
    let forbidden = [
        ("proto", &["farm-coordinator", "farm-worker", "farmctl", "sqlx"][..]),
        ("coordinator", &["farm-worker", "farmctl"]),
        ("worker", &["farm-coordinator", "farmctl", "sqlx"]),
    ];
    for (krate, others) in forbidden {
        let found = dependencies(krate);
        for other in others {
            assert!(!found.iter().any(|d| d == other), "{krate} must not depend on {other}");
        }
    }
}

#[test]
fn the_tracer_knows_no_network_and_no_runtime() {
    assert_absent("worker/src/tracer", &["tokio", "tonic::", "sqlx", "std::time", "mul_add"]);
}

#[test]
fn the_fit_is_numerics_alone() {
    assert_absent("coordinator/src/fit", &["sqlx", "tonic::", "tokio", "crate::store", "crate::rpc"]);
}

#[test]
fn dispatch_is_synchronous_and_blind() {
    assert_absent(
        "coordinator/src/dispatch",
        &["tokio", "async fn", "Instant", "SystemTime", "sqlx", "tonic::", "crate::rpc"],
    );
}

#[test]
fn the_store_knows_nothing_above_it() {
    assert_absent(
        "coordinator/src/store",
        &["crate::rpc", "crate::dispatch", "crate::farm", "crate::fit", "tonic::"],
    );
}
