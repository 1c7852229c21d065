//! Counts lines of code, comments and test code of each crate, and holds them against the budgets in `budget.toml`.
//!
//! A line is code if anything but a comment is on it; blank lines count nowhere. Test code is what lies below `tests` or
//! `benches`, in `tests.rs`, `testing*` or `*_tests.rs`, in modules under `#[cfg(test)]`, and in items under it.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::io::Write as _;
use std::ops::Range;

use crate::files::{own_files, root};

/// The crates, a folder before those that contain it.
const CRATES: [&str; 14] = [
    "optics/fit",
    "optics/capture",
    "optics/model",
    "optics/tracer",
    "optics/layers",
    "proto/link",
    "proto",
    "client/lab",
    "client/figures",
    "client",
    "coordinator",
    "worker",
    "tests",
    "",
];

#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
struct Lines {
    code: usize,
    comments: usize,
    test: usize,
}

/// The kind of each byte: `c` code, `m` comment, `s` inside of a string or character.
fn kinds(text: &[u8]) -> Vec<u8> {
    let mut kinds = vec![b'c'; text.len()];
    let mut i = 0;
    while i < text.len() {
        let rest = &text[i..];
        let (kind, from, end, next) = if rest.starts_with(b"//") {
            let end = position(rest, b"\n").unwrap_or(rest.len());
            (b'm', 0, end, end)
        } else if rest.starts_with(b"/*") {
            let end = block_comment(rest);
            (b'm', 0, end, end)
        } else if let Some((from, end, next)) = raw_string(text, i).or_else(|| literal(rest)) {
            (b's', from, end, next)
        } else {
            (b'c', 0, 1, 1)
        };
        kinds[i + from..i + end].fill(kind);
        i += next;
    }
    kinds
}

fn position(text: &[u8], what: &[u8]) -> Option<usize> {
    text.windows(what.len()).position(|part| part == what)
}

/// Length of a block comment, which may contain others.
fn block_comment(text: &[u8]) -> usize {
    let (mut depth, mut i) = (1, 2);
    while i < text.len() && depth > 0 {
        match &text[i..(i + 2).min(text.len())] {
            b"/*" => (depth, i) = (depth + 1, i + 2),
            b"*/" => (depth, i) = (depth - 1, i + 2),
            _ => i += 1,
        }
    }
    i
}

/// Begin and end of the content of a raw string that starts at `i`, and its length, from there.
fn raw_string(text: &[u8], i: usize) -> Option<(usize, usize, usize)> {
    let is_in_word = i > 0 && (text[i - 1].is_ascii_alphanumeric() || text[i - 1] == b'_');
    let rest = &text[i..];
    let prefix = usize::from(matches!(rest, [b'b' | b'c', b'r', ..]));
    if is_in_word || rest.get(prefix) != Some(&b'r') {
        return None;
    }
    let hashes = rest[prefix + 1..].iter().take_while(|byte| **byte == b'#').count();
    let from = prefix + 2 + hashes;
    if rest.get(from - 1) != Some(&b'"') {
        return None;
    }
    let closing = [&b"\""[..], &b"#".repeat(hashes)].concat();
    let end = position(&rest[from..], &closing).map_or(rest.len(), |at| from + at);
    Some((from, end, (end + closing.len()).min(rest.len())))
}

/// Begin and end of the content of a string or character, and its length.
fn literal(text: &[u8]) -> Option<(usize, usize, usize)> {
    let end = match text {
        [b'"', ..] => {
            let mut end = 1;
            while end < text.len() && text[end] != b'"' {
                end += if text[end] == b'\\' { 2 } else { 1 };
            }
            end.min(text.len())
        }
        // A character has a closing quote, which a lifetime has not.
        [b'\'', b'\\', b'x' | b'u', ..] => position(text, b"}'").map_or(5, |at| at + 1).min(text.len()),
        [b'\'', b'\\', ..] => 3,
        [b'\'', rest @ ..] => {
            let character = std::str::from_utf8(&rest[..rest.len().min(4)]);
            let known = character.or_else(|e| std::str::from_utf8(&rest[..e.valid_up_to()])).ok()?;
            1 + known.chars().next()?.len_utf8()
        }
        _ => return None,
    };
    let closes = text[0] == b'"' || text.get(end) == Some(&b'\'');
    closes.then_some((1, end, (end + 1).min(text.len())))
}

/// The code alone, with spaces in place of the rest.
fn code_only(text: &[u8], kinds: &[u8]) -> String {
    let byte = |(byte, kind): (&u8, &u8)| if *kind == b'c' || *byte == b'\n' { *byte } else { b' ' };
    let bytes = text.iter().zip(kinds).map(byte).map(|byte| if byte.is_ascii() { byte } else { b'?' });
    bytes.map(char::from).collect()
}

/// Ranges of `#[cfg(test)]` and the like, with all(test, …) and any(test, …).
fn test_attributes(code: &str) -> Vec<Range<usize>> {
    let end = |from: usize| {
        let rest = code[from..].strip_prefix("#[cfg(")?;
        let inside = rest.strip_prefix("all(").or_else(|| rest.strip_prefix("any(")).unwrap_or(rest);
        let closing = if inside.len() == rest.len() { "test)]" } else { "test" };
        let after = inside.strip_prefix(closing)?;
        let after =
            if inside.len() == rest.len() { after } else { after.split_once(')')?.1.strip_prefix(")]")? };
        Some(code.len() - after.len())
    };
    code.match_indices("#[cfg(").filter_map(|(from, _)| Some(from..end(from)?)).collect()
}

/// Ranges of the items under these attributes.
fn test_items(code: &str) -> Vec<Range<usize>> {
    let mut items: Vec<Range<usize>> = Vec::new();
    for attribute in test_attributes(code) {
        if items.last().is_some_and(|last| attribute.start < last.end) {
            continue;
        }
        let (mut round, mut curly, mut end) = (0, 0, attribute.end);
        for byte in code[attribute.end..].bytes() {
            end += 1;
            round += i32::from(b"([".contains(&byte)) - i32::from(b")]".contains(&byte));
            curly += i32::from(byte == b'{') - i32::from(byte == b'}');
            if curly < 0 || (round == 0 && curly == 0 && b"};,".contains(&byte)) {
                break;
            }
        }
        items.push(attribute.start..end);
    }
    items
}

/// Names of modules in other files that are declared under these attributes.
fn test_modules(code: &str) -> Vec<String> {
    let items = test_items(code).into_iter().filter(|item| code[item.clone()].starts_with("#[cfg(test)]"));
    let declared = items.filter_map(|item| code[item].strip_suffix(';')?.rsplit_once("mod "));
    declared.map(|(_, name)| name.trim().to_owned()).collect()
}

fn is_test_path(path: &str) -> bool {
    let mut parts: Vec<&str> = path.split('/').collect();
    let name = parts.pop().unwrap_or_default();
    let is_for_tests =
        |part: &&str| part.starts_with("testing") || part.ends_with("_tests") || *part == "tests";
    let of_name =
        matches!(name, "tests.rs" | "test.rs") || name.starts_with("testing") || name.ends_with("_tests.rs");
    of_name || parts.contains(&"benches") || parts.iter().any(is_for_tests)
}

/// Lines by crate.
fn count(files: &[(String, String)]) -> BTreeMap<&'static str, Lines> {
    let known: Vec<_> = files.iter().map(|(path, text)| (path, text, kinds(text.as_bytes()))).collect();
    let mut tests: BTreeSet<&str> =
        known.iter().map(|(path, ..)| path.as_str()).filter(|p| is_test_path(p)).collect();
    for (path, text, kinds) in &known {
        let stem = path.trim_end_matches(".rs");
        let folder = ["/mod", "/lib", "/main"].iter().find_map(|end| stem.strip_suffix(end)).unwrap_or(stem);
        for module in test_modules(&code_only(text.as_bytes(), kinds)) {
            let (file, below) = (format!("{folder}/{module}.rs"), format!("{folder}/{module}/"));
            tests.extend(
                known.iter().map(|(p, ..)| p.as_str()).filter(|p| *p == file || p.starts_with(&below)),
            );
        }
    }
    let mut sums: BTreeMap<&str, Lines> = BTreeMap::new();
    for (path, text, kinds) in &known {
        let krate = CRATES.iter().find(|krate| path.starts_with(&format!("{krate}/")) || krate.is_empty());
        let lines = sums.entry(krate.copied().unwrap_or_default()).or_default();
        let items = test_items(&code_only(text.as_bytes(), kinds));
        let mut start = 0;
        for line in text.split('\n') {
            let end = start + line.len();
            let inked = |kind: &dyn Fn(u8) -> bool| {
                (start..end).any(|i| !b" \t".contains(&text.as_bytes()[i]) && kind(kinds[i]))
            };
            let is_test = tests.contains(path.as_str())
                || items.iter().any(|item| item.start <= end && start < item.end);
            match (inked(&|kind| kind != b'm'), is_test) {
                (true, true) => lines.test += 1,
                (true, false) => lines.code += 1,
                (false, false) if inked(&|kind| kind == b'm') => lines.comments += 1,
                _ => {}
            }
            start = end + 1;
        }
    }
    sums
}

fn sources() -> Vec<(String, String)> {
    own_files("rs").into_iter().map(|(path, text)| (path.to_string_lossy().into_owned(), text)).collect()
}

/// A change that adds lines removes others first. The table is also written to `target/size.txt`.
#[test]
fn crates_stay_within_their_budgets() {
    let budgets: toml::Table = include_str!("../budget.toml").parse().expect("budget.toml is TOML");
    let (mut table, mut over) = (String::new(), Vec::new());
    let mut total = Lines::default();
    let sources = sources();
    let counted = count(&sources);
    let sums = counted.iter().map(|(krate, lines)| (*krate, *lines));
    for (name, lines) in sums.inspect(|(_, lines)| {
        total.code += lines.code;
        total.comments += lines.comments;
        total.test += lines.test;
    }) {
        let name = if name.is_empty() { "other" } else { name };
        let _ = writeln!(
            table,
            "{name:16} code {:6}  comments {:5}  test code {:6}",
            lines.code, lines.comments, lines.test
        );
        for (kind, lines) in [("code", lines.code), ("test_code", lines.test)] {
            let budget =
                budgets.get(name).and_then(|b| b.get(kind)).and_then(toml::Value::as_integer).unwrap_or(0);
            if lines > budget as usize {
                over.push(format!("{name}: {lines} lines of {kind}, the budget is {budget}"));
            }
        }
    }
    let _ = writeln!(
        table,
        "{:16} code {:6}  comments {:5}  test code {:6}",
        "total", total.code, total.comments, total.test
    );
    let target = std::env::current_exe().expect("the test knows its path");
    let target = target.ancestors().nth(3).expect("tests lie three folders deep");
    std::fs::File::create(target.join("size.txt"))
        .and_then(|mut file| file.write_all(table.as_bytes()))
        .expect("target can be written to");
    assert!(
        over.is_empty(),
        "{table}\n{over:#?}: remove something first; tests/house/budget.toml has the budgets"
    );
}

/// Each kind of line is found: strings, comments, characters, tests and their modules.
#[test]
fn lines_are_counted_by_kind() {
    let text = "//! Head\nfn a() {\n    // c\n    let s = \"// no comment\"; let c = '\"'; /* x\n y */\n\n}\n\
                const R: &str = r#\"\n// \"inside\"\n\"#;\nfn l<'a>() {} // tail\n\
                #[cfg(test)]\nmod tests;\n#[cfg(any(test, feature = \"x\"))]\nmod more {\n    fn b() {}\n}\nfn z() {}\n";
    let file = |path: &str, text: &str| (path.to_owned(), text.to_owned());
    let files = [
        file("worker/src/lib.rs", text),
        file("worker/src/tests.rs", "fn t() {}\n// c\n"),
        file("worker/src/more/deep.rs", "fn d() {}"),
        file("proto/link/src/a.rs", "#[cfg(test)]\nmod x;\nfn f() {}"),
        file("proto/link/src/a/x.rs", "fn x() {}\n"),
    ];
    let sums = count(&files);
    assert_eq!(sums["worker"], Lines { code: 9, comments: 3, test: 7 });
    assert_eq!(sums["proto/link"], Lines { code: 1, comments: 0, test: 3 });
    assert!(root().join("tests/house/budget.toml").exists());
}
