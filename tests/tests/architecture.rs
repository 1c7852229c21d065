//! The boundaries that ARCHITECTURE.md draws, checked in the sources.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use farm_tests::reference::root;

fn sources(folder: &Path) -> Vec<(PathBuf, String)> {
    let found = sources_in(folder);
    assert!(!found.is_empty(), "{} holds no sources", folder.display());
    found
}

fn sources_in(folder: &Path) -> Vec<(PathBuf, String)> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(sources_in(&path));
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push((path.clone(), std::fs::read_to_string(&path).unwrap()));
        }
    }
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
const ARROWS: [(&str, &[&str]); 11] = [
    ("optics/model", &[]),
    ("optics/tracer", &["optics-model"]),
    ("optics/fit", &["optics-model"]),
    ("optics/capture", &["optics-model"]),
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
            "optics-capture",
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
            "optics-capture",
            "farm-proto",
            "farm-link",
            "farm-coordinator",
            "farm-worker",
            "farmctl",
        ],
    ),
    ("tests/browser", &["optics-model", "farm-proto", "farm-tests"]),
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
    let used = [
        "blake3",
        "bytes",
        "fearless_simd",
        "glam",
        "libm",
        "nalgebra",
        "rayon",
        "serde",
        "thiserror",
        "toml",
    ];
    for krate in ["optics/model", "optics/tracer", "optics/fit", "optics/capture"] {
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

#[test]
fn the_scheduler_has_one_door() {
    for (path, text) in sources(&root().join("coordinator/src/farm")) {
        let is_door = path.ends_with("door.rs");
        for word in ["Mutex<Dispatcher>", "send_replace", "take_outbox", "recorder.record("] {
            assert!(is_door || !text.contains(word), "{word} is for door.rs alone, not {}", path.display());
        }
    }
}

/// Streams to clients are handed on in one place; everything else is one call.
#[test]
fn services_do_not_loop() {
    for (path, text) in sources(&root().join("coordinator/src/rpc")) {
        let hands_on = path.ends_with("outgoing.rs");
        for word in ["    loop {", "while let", ".next().await"] {
            assert!(hands_on || !text.contains(word), "{} must not loop ({word})", path.display());
        }
    }
}

/// A file without its folder's `mod.rs` or extension: `fit/view` for both `fit/view.rs` and `fit/view/mod.rs`.
fn module_of(file: &Path, source: &Path) -> Vec<String> {
    let path = file.strip_prefix(source).unwrap().with_extension("");
    let mut parts: Vec<String> = path.iter().map(|part| part.to_str().unwrap().to_owned()).collect();
    if matches!(parts.last().map(String::as_str), Some("mod" | "lib" | "main")) {
        parts.pop();
    }
    parts
}

/// The modules that a file names: paths from `crate::` or `super::`, as far as there are files for them.
fn named_by(module: &[String], text: &str, all: &BTreeSet<Vec<String>>) -> BTreeSet<Vec<String>> {
    let code = text.split("#[cfg(test)]").next().unwrap();
    let code: String = code.lines().filter(|l| !l.trim_start().starts_with("//")).collect();
    let mut named = BTreeSet::new();
    for (at, _) in code.match_indices("crate::").chain(code.match_indices("super::")) {
        let within = code[..at].chars().next_back().is_some_and(|c| c.is_alphanumeric() || c == ':');
        if within {
            continue;
        }
        let mut parts: Vec<&str> = code[at..].split("::").collect();
        let end = |p: &str| p.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(p.len());
        let mut base = module.to_vec();
        if parts[0] == "crate" {
            base.clear();
            parts.remove(0);
        }
        while parts.first() == Some(&"super") {
            base.pop();
            parts.remove(0);
        }
        // The deepest module on the way; of a list in braces, each name.
        let mut deepest = base.clone();
        for part in parts {
            if let Some(list) = part.strip_prefix('{') {
                let list = list.split('}').next().unwrap();
                for name in list.split(',').map(str::trim) {
                    let module = [&deepest[..], &[name[..end(name)].to_owned()]].concat();
                    if all.contains(&module) {
                        named.insert(module);
                    }
                }
                break;
            }
            let next = [&deepest[..], &[part[..end(part)].to_owned()]].concat();
            if !all.contains(&next) {
                break;
            }
            deepest = next;
        }
        named.insert(deepest);
    }
    named
}

/// Files that need each other cannot be understood one after the other. A module and the folder that it lies in may name
/// each other.
#[test]
fn no_files_name_each_other_in_a_circle() {
    let crates = ARROWS.iter().map(|(krate, _)| root().join(krate).join("src"));
    let mut circles = Vec::new();
    for source in crates {
        let files: BTreeMap<Vec<String>, String> = sources(&source)
            .into_iter()
            .filter(|(path, _)| !path.to_string_lossy().contains("tests"))
            .map(|(path, text)| (module_of(&path, &source), text))
            .collect();
        let all: BTreeSet<Vec<String>> = files.keys().cloned().collect();
        let related = |a: &[String], b: &[String]| a.starts_with(b) || b.starts_with(a);
        let arrows: BTreeMap<_, Vec<_>> = files
            .iter()
            .map(|(module, text)| {
                let named = named_by(module, text, &all).into_iter();
                (module, named.filter(|other| all.contains(other) && !related(module, other)).collect())
            })
            .collect();
        for start in &all {
            // Whatever can be reached from a file must not reach back to it.
            let mut reached = BTreeSet::new();
            let mut next: Vec<&Vec<String>> = arrows[start].iter().collect();
            while let Some(module) = next.pop() {
                if reached.insert(module) {
                    next.extend(&arrows[module]);
                }
            }
            if reached.contains(start) {
                circles.push(format!("{}: {}", source.display(), start.join("::")));
            }
        }
    }
    assert!(circles.is_empty(), "files that name each other in a circle: {circles:#?}");
}
