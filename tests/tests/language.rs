//! The language of the sources: the names of tests and the lines of comments are short.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use std::path::{Path, PathBuf};

use farm_tests::reference::own_files;

const LONGEST_NAME: usize = 60;
const WIDEST_COMMENT: usize = 125;

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

fn long_names(path: &Path, text: &str) -> Vec<String> {
    let long = test_names(text).into_iter().filter(|(_, name)| name.chars().count() > LONGEST_NAME);
    long.map(|(line, name)| format!("{}:{line}: {name}", path.display())).collect()
}

fn wide_comments(path: &Path, text: &str) -> Vec<String> {
    let is_wide = |line: &str| line.trim_start().starts_with("//") && line.chars().count() > WIDEST_COMMENT;
    let wide = (1..).zip(text.lines()).filter(|(_, line)| is_wide(line));
    wide.map(|(number, line): (usize, _)| format!("{}:{number}: {line}", path.display())).collect()
}

fn assert_tests_are_found(sources: &[(PathBuf, String)]) {
    let count: usize = sources.iter().map(|(_, text)| test_names(text).len()).sum();
    assert!(count > 1000, "only {count} tests are found");
}

#[test]
fn test_names_have_at_most_60_characters() {
    let sources = own_files("rs");
    assert_tests_are_found(&sources);
    let long: Vec<_> = sources.iter().flat_map(|(path, text)| long_names(path, text)).collect();
    assert!(
        long.is_empty(),
        "names with more than {LONGEST_NAME} characters; details belong in a comment above the test:\n{}",
        long.join("\n")
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
fn long_names_and_wide_comments_are_found() {
    let (short, long) = ("n".repeat(60), "n".repeat(61));
    let text = format!(
        "fn {long}() {{}}\n#[test]\nfn {short}() {{}}\n    #[tokio::test(start_paused = true)]\n    #[ignore = \"\"]\n    \
         async fn {long}() {{}}\n#[rstest]\nfn {long}(#[case] a: u8) {{}}\nfn {long}() {{}}"
    );
    let expected = [6, 8].map(|line| format!("a.rs:{line}: {long}"));
    assert_eq!(long_names(Path::new("a.rs"), &text), expected);
    let (narrow, wide) = ("σ".repeat(121), "σ".repeat(122));
    let text = format!("/// {narrow}\n//! {narrow}\n    // {wide}\n{wide}{wide}\n/// {wide}");
    let expected = [format!("a.rs:3:     // {wide}"), format!("a.rs:5: /// {wide}")];
    assert_eq!(wide_comments(Path::new("a.rs"), &text), expected);
}
