//! Checks the language of the sources: test names and comment lines are short, foreign words do not come back, and a
//! type's name is seldom used twice.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use crate::files::own_files;
use crate::modules::type_names;

const LONGEST_NAME: usize = 60;
const MOST_WORDS: usize = 7;
const WIDEST_COMMENT: usize = 125;
const WIDEST_PROSE: usize = 121;

/// Names of types that are still defined more than once, without the conventional ones.
const DUPLICATE_TYPES: usize = 24;

/// Names that several crates may define, since they are used with their crate's.
const CONVENTIONAL: [&str; 4] = ["Args", "Config", "Error", "Result"];

/// Words that give life to programs or translate foreign idioms. Values are given, messages report, errors name.
const WORDS: [&[&str]; 12] = [
    &["told"],
    &["tells"],
    &["tell"],
    &["whoever"],
    &["nobody"],
    &["anybody"],
    &["somebody"],
    &["anew"],
    &["afresh"],
    &["beside"],
    &["made", "least"],
    &["so", "many"],
];

/// Number of uses of [`WORDS`] in the files of each top-level folder: the exact number, so that none comes back.
const WORD_BUDGETS: [(&str, usize); 12] = [
    ("", 3),
    ("client", 3),
    ("coordinator", 27),
    ("deploy", 0),
    ("docs", 0),
    ("examples", 0),
    ("optics", 25),
    ("proto", 6),
    ("python", 5),
    ("tests", 1),
    ("web", 0),
    ("worker", 0),
];

/// The functions under a test attribute: line and name.
fn test_names(text: &str) -> Vec<(usize, &str)> {
    let (mut found, mut is_test) = (Vec::new(), false);
    for (number, line) in (1..).zip(text.lines().map(str::trim_start)) {
        is_test |= ["#[test]", "#[tokio::test", "#[rstest"].iter().any(|mark| line.starts_with(mark));
        let line =
            ["pub ", "async ", "unsafe "].iter().fold(line, |l, word| l.strip_prefix(word).unwrap_or(l));
        let function = line.strip_prefix("fn ");
        if let Some(function) = function
            && std::mem::take(&mut is_test)
        {
            found.push((number, function.split(['(', '<']).next().unwrap()));
        }
    }
    found
}

/// Test names that meet a condition, each with its place.
fn names_with(path: &Path, text: &str, is_bad: fn(&str) -> bool) -> Vec<String> {
    let bad = test_names(text).into_iter().filter(|(_, name)| is_bad(name));
    bad.map(|(line, name)| format!("{}:{line}: {name}", path.display())).collect()
}

fn is_long(name: &str) -> bool {
    name.chars().count() > LONGEST_NAME
}

fn is_wordy(name: &str) -> bool {
    name.split('_').count() > MOST_WORDS
}

fn wide_comments(path: &Path, text: &str) -> Vec<String> {
    let is_wide = |line: &str| line.trim_start().starts_with("//") && line.chars().count() > WIDEST_COMMENT;
    let wide = (1..).zip(text.lines()).filter(|(_, line)| is_wide(line));
    wide.map(|(number, line): (usize, _)| format!("{}:{number}: {line}", path.display())).collect()
}

/// Wide lines of Markdown outside tables and code.
fn wide_prose(path: &Path, text: &str) -> Vec<String> {
    let (mut wide, mut is_code) = (Vec::new(), false);
    for (number, line) in (1..).zip(text.lines()) {
        let begins = line.trim_start();
        is_code ^= begins.starts_with("```");
        if !is_code && !begins.starts_with('|') && line.chars().count() > WIDEST_PROSE {
            wide.push(format!("{}:{number}: {line}", path.display()));
        }
    }
    wide
}

/// The words of a line in lower case; parts of identifiers are words too.
fn words(line: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    for letter in line.chars() {
        if !letter.is_alphabetic() || letter.is_uppercase() {
            words.push(String::new());
        }
        if letter.is_alphabetic() {
            words.last_mut().unwrap().extend(letter.to_lowercase());
        }
    }
    words.retain(|word| !word.is_empty());
    words
}

/// Uses of [`WORDS`], each with its place.
fn foreign_words(path: &Path, text: &str) -> Vec<String> {
    let mut found = Vec::new();
    for (number, line) in (1..).zip(text.lines()) {
        let words = words(line);
        for foreign in WORDS {
            let uses = words.windows(foreign.len()).filter(|window| *window == foreign).count();
            let place = format!("{}:{number}: {}: {}", path.display(), foreign.join(" "), line.trim());
            found.extend(std::iter::repeat_n(place, uses));
        }
    }
    found
}

fn assert_tests_are_found(sources: &[(PathBuf, String)]) {
    let count: usize = sources.iter().map(|(_, text)| test_names(text).len()).sum();
    assert!(count > 1000, "only {count} tests are found");
}

/// The names that are defined in several files, with these files.
fn duplicates(sources: &[(PathBuf, String)]) -> BTreeMap<String, Vec<String>> {
    let mut places: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for (path, text) in sources {
        for name in type_names(text) {
            places.entry(name).or_default().push(path.display().to_string());
        }
    }
    places.retain(|name, places| places.len() > 1 && !CONVENTIONAL.contains(&name.as_str()));
    places
}

/// Sources without tests, benches and examples.
fn is_product(path: &Path) -> bool {
    let for_tests = ["tests", "testing", "benches", "examples"];
    !path.iter().any(|part| for_tests.iter().any(|mark| part.to_string_lossy().contains(mark)))
}

#[test]
fn test_names_have_at_most_60_characters() {
    let sources = own_files("rs");
    assert_tests_are_found(&sources);
    let long: Vec<_> = sources.iter().flat_map(|(path, text)| names_with(path, text, is_long)).collect();
    assert!(
        long.is_empty(),
        "names with more than {LONGEST_NAME} characters; details belong in a comment above the test:\n{}",
        long.join("\n")
    );
}

#[test]
fn test_names_have_at_most_7_words() {
    let sources = own_files("rs");
    let wordy: Vec<_> = sources.iter().flat_map(|(path, text)| names_with(path, text, is_wordy)).collect();
    assert!(
        wordy.is_empty(),
        "{} names with more than {MOST_WORDS} words; details belong in a comment above the test:\n{}",
        wordy.len(),
        wordy.join("\n")
    );
}

#[test]
fn comment_lines_have_at_most_125_columns() {
    let sources = own_files("rs");
    assert_tests_are_found(&sources);
    let wide: Vec<_> = sources.iter().flat_map(|(path, text)| wide_comments(path, text)).collect();
    assert!(wide.is_empty(), "comments with more than {WIDEST_COMMENT} columns:\n{}", wide.join("\n"));
}

#[test]
fn prose_lines_have_at_most_121_columns() {
    let (fits, wide) = ("n".repeat(121), "n".repeat(122));
    let text = format!("{fits}\n| {wide} |\n```\n{wide}\n```\n* {wide}");
    assert_eq!(wide_prose(Path::new("a.md"), &text), [format!("a.md:6: * {wide}")]);
    let wide: Vec<_> = own_files("md").iter().flat_map(|(path, text)| wide_prose(path, text)).collect();
    assert!(wide.is_empty(), "prose with more than {WIDEST_PROSE} columns:\n{}", wide.join("\n"));
}

/// A comment whose first word stands for its subject has none.
fn headless_comments(path: &Path, text: &str) -> Vec<String> {
    const BEGINNINGS: [&str; 8] =
        ["Of ", "What ", "Who ", "Whoever ", "Nobody ", "So many ", "That of ", "The same "];
    let (mut found, mut inside) = (Vec::new(), false);
    for (number, line) in (1..).zip(text.lines()) {
        let comment =
            line.trim_start().strip_prefix("//").map(|rest| rest.trim_start_matches(['/', '!']).trim());
        let begins = comment.is_some_and(|c| BEGINNINGS.iter().any(|word| c.starts_with(word)));
        if begins && !inside {
            found.push(format!("{}:{number}: {line}", path.display()));
        }
        inside = comment.is_some_and(|c| !c.is_empty());
    }
    found
}

/// A comment names its subject: it does not begin with "Of", "What" or "Whoever".
#[test]
fn comments_name_their_subject() {
    let path = Path::new("a.rs");
    let text = "    /// What it is.\n    /// Of none.\nlet x = 1;\n// Whoever asks\n/// A subject.\n";
    assert_eq!(headless_comments(path, text).len(), 2);
    let sources = own_files("rs").into_iter();
    let found: Vec<String> = sources.flat_map(|(path, text)| headless_comments(&path, &text)).collect();
    assert!(found.is_empty(), "comments without a subject:\n{}", found.join("\n"));
}

/// Bindings called `of`, and closures whose name begins with it: neither says what it is.
fn nameless_bindings(path: &Path, text: &str) -> Vec<String> {
    let is_nameless = |line: &str| {
        let Some(binding) = line.trim_start().strip_prefix("let ") else { return false };
        let Some((name, value)) = binding.trim_start_matches("mut ").split_once(" = ") else { return false };
        name == "of" || name.starts_with("of_") && value.trim_start_matches("move ").starts_with('|')
    };
    let found = (1..).zip(text.lines()).filter(|(_, line)| is_nameless(line));
    found.map(|(number, line): (usize, _)| format!("{}:{number}: {line}", path.display())).collect()
}

#[test]
fn bindings_say_what_they_are() {
    let text = "let of = 1;\nlet mut of_slab = move |i| i;\nlet of_slab = 2;\nlet profile = |of| of;";
    assert_eq!(nameless_bindings(Path::new("a.rs"), text).len(), 2);
    let sources = own_files("rs").into_iter();
    let found: Vec<String> = sources.flat_map(|(path, text)| nameless_bindings(&path, &text)).collect();
    assert!(found.is_empty(), "name these after what they are or return:\n{}", found.join("\n"));
}

#[test]
fn foreign_words_stay_within_their_budgets() {
    let mut found: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for extension in ["rs", "proto", "md", "py", "svelte", "ts"] {
        for (path, text) in own_files(extension) {
            // The list of words is here, and the page's messages are generated.
            if !path.ends_with("house/src/language.rs") && !path.starts_with("web/src/gen") {
                let is_below = path.components().count() > 1;
                let folder = path.iter().next().filter(|_| is_below).unwrap_or_default();
                let folder = folder.to_string_lossy().into_owned();
                found.entry(folder).or_default().extend(foreign_words(&path, &text));
            }
        }
    }
    let budgets = BTreeMap::from(WORD_BUDGETS);
    let mut message = String::new();
    for (folder, places) in found {
        let budget = budgets.get(folder.as_str()).copied().unwrap_or_default();
        println!("{folder:?}: {} foreign words, budget {budget}", places.len());
        if places.len() > budget {
            let list = places.join("\n");
            writeln!(message, "{} in folder {folder:?}, {budget} are allowed:\n{list}", places.len())
                .unwrap();
        } else if places.len() < budget {
            writeln!(message, "{} in folder {folder:?}: lower its budget from {budget}", places.len())
                .unwrap();
        }
    }
    assert!(message.is_empty(), "foreign words; CONTRIBUTING.md (Style) has the field's:\n{message}");
}

#[test]
fn few_type_names_are_defined_twice() {
    let sources: Vec<_> = own_files("rs").into_iter().filter(|(path, _)| is_product(path)).collect();
    assert!(sources.iter().map(|(_, text)| type_names(text).len()).sum::<usize>() > 500, "types are found");
    let twice = duplicates(&sources);
    let list: String =
        twice.iter().map(|(name, places)| format!("{name}: {}\n", places.join(", "))).collect();
    println!("{} names of types are defined more than once:\n{list}", twice.len());
    assert_eq!(
        twice.len(),
        DUPLICATE_TYPES,
        "names of types are defined more than once; choose names that say of what they are, or lower the number:\n{list}",
    );
}

#[test]
fn long_names_and_wide_comments_are_found() {
    let (short, long) = ("n".repeat(60), "n".repeat(61));
    let text = format!(
        "fn {long}() {{}}\n#[test]\nfn {short}() {{}}\n    #[tokio::test(start_paused = true)]\n    #[ignore = \"\"]\n    \
         async fn {long}() {{}}\n#[rstest]\nfn {long}(#[case] a: u8) {{}}\nfn {long}() {{}}"
    );
    let expected = [6, 8].map(|line| format!("a.rs:{line}: {long}"));
    assert_eq!(names_with(Path::new("a.rs"), &text, is_long), expected);
    let text = "#[test]\nfn a_b_c_d_e_f_g() {}\n#[test]\nfn a_b_c_d_e_f_g_h() {}";
    assert_eq!(names_with(Path::new("a.rs"), text, is_wordy), ["a.rs:4: a_b_c_d_e_f_g_h"]);
    let (narrow, wide) = ("σ".repeat(121), "σ".repeat(122));
    let text = format!("/// {narrow}\n//! {narrow}\n    // {wide}\n{wide}{wide}\n/// {wide}");
    let expected = [format!("a.rs:3:     // {wide}"), format!("a.rs:5: /// {wide}")];
    assert_eq!(wide_comments(Path::new("a.rs"), &text), expected);
}

#[test]
fn foreign_words_are_found_with_their_places() {
    let text = "let retold = untold_prior;\n// So many errors, ToldNumber\n\"what is told_of\"";
    let places = foreign_words(Path::new("a.rs"), text);
    let expected = [
        "a.rs:2: told: // So many errors, ToldNumber",
        "a.rs:2: so many: // So many errors, ToldNumber",
        "a.rs:3: told: \"what is told_of\"",
    ];
    assert_eq!(places, expected);
}

#[test]
fn types_that_are_defined_twice_are_found() {
    let file = |name: &str, text: &str| (PathBuf::from(name), text.to_owned());
    let sources = [
        file("a.rs", "pub struct Plan { at: u8 } impl Iterator for Plan { type Item = u8; } enum Error {}"),
        file(
            "b.rs",
            "mod inner { type Plan = u8; } trait Seen { type Item; } #[cfg(test)] mod t { struct Seen; }",
        ),
        file("c.rs", "enum Error {} #[cfg(test)] struct Seen; fn f() { struct Seen2; } struct Item;"),
    ];
    let found = duplicates(&sources);
    assert_eq!(found, BTreeMap::from([("Plan".to_owned(), vec!["a.rs".to_owned(), "b.rs".to_owned()])]));
    assert!(
        !is_product(Path::new("worker/src/agent/tests.rs")) && is_product(Path::new("worker/src/agent.rs"))
    );
}
