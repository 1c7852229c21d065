//! Checks the documents: links and paths are valid, the book has every page, and ARCHITECTURE.md stays short.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Component, Path, PathBuf};

use crate::files::{own_files, root};
use optics_model::Quantity;
use serde_json::Value;

fn is_document(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "md")
}

/// All Markdown files by their path from the root.
fn documents() -> BTreeMap<PathBuf, String> {
    own_files("md").into_iter().collect()
}

/// The lines outside of code blocks, with their numbers.
fn prose(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let mut code = false;
    (1..).zip(text.lines()).filter(move |(_, line)| {
        let fence = line.trim_start().starts_with("```");
        code ^= fence;
        !code && !fence
    })
}

/// The ids of headings, as GitHub and mdBook form them.
fn anchors(text: &str) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    let is_heading = |line: &&str| line.trim_start_matches('#').starts_with(' ') && line.starts_with('#');
    for heading in prose(text).map(|(_, line)| line).filter(is_heading) {
        let kept = heading.trim_start_matches('#').trim().to_lowercase();
        let kept: String =
            kept.chars().filter(|c| c.is_alphanumeric() || [' ', '-', '_'].contains(c)).collect();
        let id = kept.replace(' ', "-");
        let again = (1..).map(|n| format!("{id}-{n}"));
        let free = std::iter::once(id.clone()).chain(again).find(|id| !found.contains(id));
        found.insert(free.unwrap());
    }
    found
}

/// Links to files and headings of the project: line and target.
fn links(text: &str) -> Vec<(usize, &str)> {
    let line_links = |(number, line)| {
        let after = str::split(line, "](").skip(1);
        after.filter_map(move |rest: &str| Some((number, rest.split_once(')')?.0)))
    };
    prose(text).flat_map(line_links).filter(|(_, target)| !target.contains("://")).collect()
}

/// The path from the root that a link in `document` refers to.
fn resolved(document: &Path, target: &str) -> PathBuf {
    if target.is_empty() {
        return document.to_owned();
    }
    let mut path = PathBuf::new();
    for part in document.parent().unwrap().join(target).components() {
        match part {
            Component::ParentDir => assert!(path.pop(), "{target} leaves the project"),
            Component::CurDir => {}
            part => path.push(part),
        }
    }
    path
}

fn dead_links(documents: &BTreeMap<PathBuf, String>) -> Vec<String> {
    let mut dead = Vec::new();
    for (document, text) in documents {
        for (line, link) in links(text) {
            let (target, anchor) = link.split_once('#').unwrap_or((link, ""));
            let path = resolved(document, target);
            let is_there = documents.contains_key(&path) || root().join(&path).exists();
            let has_anchor = || documents.get(&path).is_some_and(|text| anchors(text).contains(anchor));
            if !is_there || !(anchor.is_empty() || has_anchor()) {
                dead.push(format!("{}:{line}: {link}", document.display()));
            }
        }
    }
    dead
}

/// Every link leads to a file or a heading.
#[test]
fn every_link_has_a_target() {
    let documents = documents();
    assert!(documents.values().map(|text| links(text).len()).sum::<usize>() > 50, "links are found");
    let dead = dead_links(&documents);
    assert!(dead.is_empty(), "dead links:\n{}", dead.join("\n"));
}

#[test]
fn dead_links_are_found() {
    let text = "# A `b` – σ_t\n## Twice\n## Twice\n[1](#a-b--σ_t) [2](#twice-1) [3](#twice-2)\n\
                ```\n# code\n[4](none)\n```\n[5](#code) [6](../none.md) [7](other.md#none) [8](other.md#other)";
    let texts = [("docs/planted.md", text), ("docs/other.md", "# Other")];
    let dead = dead_links(&texts.map(|(path, text)| (path.into(), text.to_owned())).into());
    let expected = ["4: #twice-2", "9: #code", "9: ../none.md", "9: other.md#none"];
    assert_eq!(dead, expected.map(|link| format!("docs/planted.md:{link}")));
}

/// Paths in code style that begin with a folder of the project.
fn paths(text: &str) -> impl Iterator<Item = &str> {
    let folders =
        ["client", "coordinator", "deploy", "docs", "examples", "optics", "proto", "tests", "worker"];
    let is_path =
        move |code: &&str| code.split_once('/').is_some_and(|(folder, _)| folders.contains(&folder));
    prose(text).flat_map(|(_, line)| line.split('`').skip(1).step_by(2)).filter(is_path)
}

#[test]
fn every_path_in_the_documents_exists() {
    let documents = documents();
    let places = documents.iter().flat_map(|(page, text)| paths(text).map(move |path| (page, path)));
    let gone: Vec<_> = places.filter(|(_, path)| !root().join(path).exists()).collect();
    assert!(gone.is_empty(), "{gone:?}");
    assert!(paths(&documents[Path::new("ARCHITECTURE.md")]).count() > 20, "paths are found");
}

/// A document outside of the book would be a dead link in it.
#[test]
fn book_has_every_page() {
    let documents = documents();
    let summary = Path::new("docs/SUMMARY.md");
    let pages: BTreeSet<PathBuf> =
        links(&documents[summary]).into_iter().map(|(_, target)| resolved(summary, target)).collect();
    let in_docs = documents.keys().filter(|path| path.starts_with("docs") && *path != summary).cloned();
    let linked = pages.iter().flat_map(|page| {
        let targets = links(&documents[page]).into_iter().map(|(_, link)| link.split('#').next().unwrap());
        targets.map(|target| resolved(page, target)).filter(|path| is_document(path))
    });
    for page in in_docs.chain(linked) {
        assert!(pages.contains(&page), "docs/SUMMARY.md does not name {}", page.display());
    }
}

/// The map of the sources and the page of figures stay short.
#[test]
fn map_and_figures_stay_short() {
    let documents = documents();
    for (page, most) in [("ARCHITECTURE.md", 150), ("docs/measured.md", 190)] {
        let lines = documents[Path::new(page)].lines().count();
        assert!((50..=most).contains(&lines), "{page} has {lines} lines, {most} are allowed");
    }
}

/// The design page lists every file of the likelihood.
#[test]
fn design_page_lists_the_likelihoods_files() {
    let page = &documents()[Path::new("docs/design/fit.md")];
    let mut found = 0;
    for (path, _) in own_files("rs") {
        let Ok(path) = path.strip_prefix("optics/fit/src/likelihood") else { continue };
        let name = path.with_extension("").display().to_string();
        let is_test = name.split('/').any(|part| part == "tests");
        assert!(is_test || page.contains(&format!("`{name}`")), "docs/design/fit.md does not name `{name}`");
        found += 1;
    }
    assert!(found > 20, "{found} files");
}

/// Every type, method, variant or module of the glossary's second column is defined, in the owner that it names.
#[test]
fn glossary_names_exist() {
    let sources = own_files("rs");
    let is_letter = |c: char| c.is_alphanumeric() || c == '_';
    let has_word = |text: &str, word: &str| text.split(|c| !is_letter(c)).any(|found| found == word);
    let defines = |text: &str, name: &str| {
        ["struct", "enum", "trait", "type", "fn", "mod"].iter().any(|kind| {
            let definition = format!("{kind} {name}");
            text.split(&definition).skip(1).any(|rest| !rest.starts_with(is_letter))
        })
    };
    let exists = |path: &str| {
        let (owner, name) = path.rsplit_once("::").unwrap_or(("", path));
        let owner = owner.rsplit("::").next().unwrap().to_owned();
        let is_type = owner.starts_with(char::is_uppercase);
        sources.iter().any(|(_, text)| {
            if is_type { defines(text, &owner) && has_word(text, name) } else { defines(text, name) }
        })
    };
    let documents = documents();
    let rows = documents[Path::new("docs/glossary.md")].lines().filter(|line| line.starts_with('|'));
    let columns: Vec<&str> = rows.filter_map(|row| row.split('|').nth(2)).collect();
    let names = || columns.iter().flat_map(|column| column.split('`').skip(1).step_by(2));
    let names: Vec<&str> = names().filter(|name| !name.contains(' ') && !name.contains('.')).collect();
    assert!(names.len() > 30, "{names:?}");
    let missing: Vec<_> = names.into_iter().filter(|name| !exists(name)).collect();
    assert!(missing.is_empty(), "docs/glossary.md names what is not defined: {missing:?}");
    assert!(!exists("Medium::nowhere_defined") && !exists("optics_model::NotThere"));
}

/// The words that follow each `mark` in a file.
fn after<'a>(text: &'a str, mark: &str) -> Vec<&'a str> {
    text.split(mark).skip(1).filter_map(|rest| rest.split([' ', '\n', '}', '`']).next()).collect()
}

#[test]
fn all_files_are_of_the_same_version() {
    let version = env!("CARGO_PKG_VERSION");
    let marks = [
        ("deploy/README.md", "resin-farm:"),
        ("deploy/container/Containerfile", "-t resin-farm:"),
        ("deploy/container/Containerfile", "ARG VERSION="),
        ("deploy/compose/compose.yaml", "-resin-farm:"),
        ("deploy/kubernetes/overlays/example/kustomization.yaml", "newTag: "),
    ];
    for (file, mark) in marks {
        let text = std::fs::read_to_string(root().join(file)).unwrap();
        let found = after(&text, mark);
        assert!(!found.is_empty() && found.iter().all(|named| *named == version), "{file}: {mark}{found:?}");
    }
    let changelog = std::fs::read_to_string(root().join("CHANGELOG.md")).unwrap();
    let mut released = changelog.lines().filter_map(|line| line.strip_prefix("## "));
    let newest = released.find(|heading| *heading != "Unreleased").unwrap();
    assert_eq!(newest.split(' ').next(), Some(version), "CHANGELOG.md");
}

/// The keys of all objects of a JSON value.
fn keys(value: &Value) -> BTreeSet<String> {
    match value {
        Value::Object(fields) => {
            fields.iter().flat_map(|(key, value)| keys(value).into_iter().chain([key.clone()])).collect()
        }
        Value::Array(values) => values.iter().flat_map(keys).collect(),
        _ => BTreeSet::new(),
    }
}

/// Every key of the JSON that the client's snapshot holds is in back-quotes in the reference, or in the guide's table of the
/// set-up.
#[test]
fn formats_name_every_json_key() {
    let read = |file: &str| std::fs::read_to_string(root().join(file)).unwrap();
    let snapshot = read("client/src/commands/tests/farmctl-1.jsonl");
    let answers = snapshot.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
    let keys: BTreeSet<String> = answers.flat_map(|answer| keys(&answer)).collect();
    assert!(keys.len() > 200 && keys.contains("at_end") && keys.contains("quantity"), "{keys:?}");
    let formats = read("docs/formats.md");
    let named: BTreeSet<&str> =
        prose(&formats).flat_map(|(_, line)| line.split('`').skip(1).step_by(2)).collect();
    let is_named = |key: &str| named.contains(key) || Quantity::OF_OPTIONS.iter().any(|q| q.name == key);
    let missing: Vec<_> = keys.iter().filter(|key| !is_named(key)).collect();
    assert!(missing.is_empty(), "docs/formats.md does not name {missing:?}");
}

/// The guide's table of the set-up has every quantity, with its option, column and default, and no other.
#[test]
fn documents_list_the_set_up_quantities() {
    let guide = std::fs::read_to_string(root().join("docs/measuring.md")).unwrap();
    let table = guide.lines().skip_while(|line| !line.contains("name in the session file")).skip(2);
    let table: Vec<&str> = table.take_while(|line| line.starts_with('|')).collect();
    let row_with = |cell: &str| {
        let row = table.iter().find(|row| row.contains(&format!("`{cell}`")));
        *row.unwrap_or_else(|| panic!("the guide has no row with {cell}"))
    };
    let option = |quantity: &Quantity| format!("--{}", quantity.name.replace('_', "-"));
    for quantity in Quantity::OF_OPTIONS {
        let row = row_with(&option(quantity));
        let default = quantity.default.to_string();
        assert!(
            quantity.default == 0.0 || row.contains(&default),
            "{}: {default} is not in {row}",
            quantity.name
        );
    }
    for quantity in Quantity::OF_PROFILES {
        let row = row_with(quantity.name);
        assert!(row.contains(&quantity.default.to_string()), "{} is not in {row}", quantity.default);
    }
    let names = table.iter().flat_map(|row| row.split('`').skip(1).step_by(2));
    for name in names.filter(|name| !name.starts_with("--mu") && !["measure", "fit"].contains(name)) {
        let known = Quantity::ALL.iter().any(|q| q.name == name || option(q) == name);
        assert!(known, "{name} is no quantity of a set-up");
    }
}
