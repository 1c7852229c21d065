//! Checks the boundaries of ARCHITECTURE.md in the sources.

use std::path::{Path, PathBuf};

use crate::files::{files_below, own_files, root};
use crate::modules::Modules;

/// The sources of a module or a crate: its folder, and the file next to it of the same name.
fn sources(folder: &str) -> Vec<(PathBuf, String)> {
    let mut all = files_below(&root().join(folder), "rs");
    let file = root().join(folder).with_extension("rs");
    if let Ok(text) = std::fs::read_to_string(&file) {
        all.push((file, text));
    }
    all
}

fn assert_absent(folder: &str, words: &[&str]) {
    for (path, text) in sources(folder) {
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

/// The crates of the project that each crate may use.
const ARROWS: [(&str, &[&str]); 15] = [
    ("optics/model", &[]),
    ("optics/tracer", &["optics-model"]),
    ("optics/fit", &["optics-model"]),
    ("optics/layers", &["optics-model", "optics-tracer"]),
    ("optics/chart", &["optics-model", "optics-layers"]),
    ("optics/capture", &["optics-model"]),
    ("proto", &["optics-model"]),
    ("proto/link", &[]),
    ("coordinator", &["optics-model", "optics-fit", "optics-layers", "farm-proto", "farm-link"]),
    ("worker", &["optics-model", "optics-tracer", "optics-layers", "farm-proto", "farm-link"]),
    ("client/figures", &["optics-model"]),
    (
        "client/lab",
        &["optics-model", "optics-tracer", "optics-layers", "optics-capture", "optics-chart", "farm-figures"],
    ),
    (
        "client",
        &[
            "farm-figures",
            "farm-lab",
            "optics-model",
            "optics-tracer",
            "optics-fit",
            "optics-layers",
            "optics-capture",
            "optics-chart",
            "farm-proto",
            "farm-link",
            "farm-coordinator",
            "farm-worker",
        ],
    ),
    // May use everything.
    (
        "tests",
        &[
            "optics-model",
            "optics-tracer",
            "optics-fit",
            "optics-layers",
            "optics-capture",
            "optics-chart",
            "farm-proto",
            "farm-link",
            "farm-coordinator",
            "farm-worker",
            "farm-figures",
            "farm-lab",
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

/// The science crates use no runtime, network, clock, database or file.
#[test]
fn science_has_no_runtime_or_io() {
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
    for krate in
        ["optics/model", "optics/tracer", "optics/fit", "optics/layers", "optics/capture", "optics/chart"]
    {
        for dependency in dependencies(krate).iter().filter(|d| !d.starts_with("optics-")) {
            assert!(used.contains(&dependency.as_str()), "{krate} must not depend on {dependency}");
        }
        let ambient = ["std::time", "std::fs", "std::net", "std::env", "std::process"];
        assert_absent(&format!("{krate}/src"), &ambient);
    }
}

/// Files are for `lab`; figures are drawn in memory.
#[test]
fn lab_and_figures_have_no_runtime() {
    let farm = ["tokio", "tonic", "prost", "hyper", "axum", "sqlx", "clap"];
    for krate in ["client/lab", "client/figures"] {
        for dependency in dependencies(krate) {
            assert!(
                !farm.iter().any(|name| dependency.starts_with(name)),
                "{krate} must not depend on {dependency}"
            );
        }
        let ambient = ["std::time", "std::net", "std::env", "async fn"];
        assert_absent(&format!("{krate}/src"), &ambient);
    }
    assert_absent("client/figures/src", &["std::fs", "std::path"]);
}

/// The tracer uses no fused multiply-add, so that its bits are the same on every machine.
#[test]
fn tracer_has_no_fused_multiply_add() {
    assert_absent("optics/tracer/src", &["mul_add"]);
    assert_absent("optics/model/src", &["mul_add"]);
}

/// Grids are stored as their messages, so one module of the store uses these too.
#[test]
fn wire_types_stay_at_coordinator_edges() {
    for (path, text) in files_below(&root().join("coordinator/src"), "rs") {
        let at_the_edge = ["src/rpc.rs", "src/rpc/", "src/store/dictionaries.rs", "src/store/tests.rs"]
            .iter()
            .any(|edge| path.to_string_lossy().contains(edge));
        assert!(at_the_edge || !text.contains("wire::"), "{} must not use wire types", path.display());
    }
}

/// The dispatch module uses no runtime, clock, database or network.
#[test]
fn dispatch_is_synchronous_and_pure() {
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

/// The store depends on no module above it.
#[test]
fn store_depends_on_nothing_above_it() {
    assert_absent(
        "coordinator/src/store",
        &["crate::rpc", "crate::dispatch", "crate::farm", "crate::fit", "tonic::"],
    );
}

#[test]
fn only_the_scheduler_holds_the_dispatcher() {
    for (path, text) in files_below(&root().join("coordinator/src/farm"), "rs") {
        let is_scheduler = path.ends_with("scheduler.rs");
        for word in ["Mutex<Dispatcher>", "send_replace", "take_outbox", "recorder.record("] {
            assert!(
                is_scheduler || !text.contains(word),
                "{word} is for scheduler.rs alone, not {}",
                path.display()
            );
        }
    }
}

/// Streams to clients are forwarded in one place; everything else is one call.
#[test]
fn services_do_not_loop() {
    for (path, text) in sources("coordinator/src/rpc") {
        let hands_on = path.ends_with("outgoing.rs");
        for word in ["    loop {", "while let", ".next().await"] {
            assert!(hands_on || !text.contains(word), "{} must not loop ({word})", path.display());
        }
    }
}

/// Files that depend on each other cannot be understood one after the other.
#[test]
fn modules_of_a_folder_have_no_circle() {
    let mut circles = Vec::new();
    for (krate, _) in ARROWS {
        let source = root().join(krate).join("src");
        for circle in Modules::of(&source).circles() {
            circles.push(format!("{krate}: {circle}"));
        }
    }
    assert!(circles.is_empty(), "circular dependencies between modules: {circles:#?}");
}

/// A module with submodules is `x.rs` next to `x/`.
#[test]
fn no_module_is_a_mod_rs() {
    let paths: Vec<PathBuf> = own_files("rs").into_iter().map(|(path, _)| path).collect();
    assert!(paths.len() > 300, "sources are found");
    let old: Vec<_> = paths.into_iter().filter(|path| path.ends_with("mod.rs")).collect();
    assert!(old.is_empty(), "x/mod.rs is to be x.rs: {old:?}");
}

/// The search finds circles through submodules.
#[test]
fn circle_below_two_modules_is_found() {
    let file = |name: &str, text: &str| (PathBuf::from(name), text.to_owned());
    let files = |deep: &str| {
        let tests = "#[cfg(test)]\nmod tests;\n";
        Modules::from_sources(
            Path::new(""),
            vec![
                file("lib.rs", "mod farm;\nmod config;"),
                file("farm.rs", &format!("{tests}use crate::config::{{Config, Other}};")),
                file("config.rs", "pub struct Config(crate::farm::Backup);"),
                file("farm/deep.rs", deep),
                file("farm/tests.rs", "use crate::config::tests;"),
            ],
        )
    };
    assert_eq!(files("").circles(), ["config, farm"]);
    // Names in strings, comments and tests do not count, those in macros do.
    let mut without = files("");
    without
        .sources
        .insert(vec!["config".to_owned()], "const A: &str = \"crate::farm\"; // crate::farm".to_owned());
    assert_eq!(without.circles(), Vec::<String>::new());
    without.sources.insert(vec!["config".to_owned()], "#[cfg(test)] mod t { use crate::farm; }".to_owned());
    assert_eq!(without.circles(), Vec::<String>::new());
    without
        .sources
        .insert(vec!["config".to_owned()], "fn f() { println!(\"{}\", crate::farm::deep::g()) }".to_owned());
    assert_eq!(without.circles(), ["config, farm"]);
    // Through a name that the parent module imports.
    without.sources.insert(vec![], "mod farm; mod config; pub use farm::{deep::G as H, Farm};".to_owned());
    without.sources.insert(vec!["config".to_owned()], "use super::H;".to_owned());
    assert_eq!(without.circles(), ["config, farm"]);
}
