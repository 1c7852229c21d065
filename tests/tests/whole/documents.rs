//! Runs the commands of the documents, and compares what they print with the documents. With `FARM_TEST_ACCEPT=1` the
//! documents get the present output.
//!
//! | fence | what the test does |
//! |---|---|
//! | `console` | lines `$ COMMAND` are run; standard output follows, in which a line `…` stands for lines that are cut |
//! | `sh` | the whole block is run and succeeds |
//! | `<!-- sh`, to a line `-->` | the same: what a document takes for granted |
//! | `… long: REASON` | only with `FARM_TEST_EFFORT=10` |
//! | `… not run: REASON` | nothing |
//! | any other | TOML and JSON are parsed. A fence without a language is an error |
//!
//! The blocks of a document run in bash, in its own empty folder with `examples`, and with the paper's dictionary in
//! `farm-data`. The blocks of Python are run by `python/tests/test_documents.py`.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use farm_tests::cli::folder;
use farm_tests::process::{Ran, program};
use farm_tests::reference::root;
use farm_tests::statistics::effort;

/// Time limit of a block in seconds.
const LIMIT: &str = "1800";
/// A line of a document for lines of an output that it leaves out.
const CUT: &str = "…";
/// Languages of blocks that are no commands.
const TEXTS: [&str; 6] = ["csv", "json", "pycon", "python", "text", "toml"];

/// README.md, those of the deployment, and all pages below docs.
fn documents() -> Vec<PathBuf> {
    let pages = ["docs", "docs/design"].into_iter().flat_map(|folder| {
        let entries = std::fs::read_dir(root().join(folder)).unwrap();
        entries.map(move |entry| Path::new(folder).join(entry.unwrap().file_name()))
    });
    let readmes = ["README.md", "deploy/README.md", "deploy/slurm/README.md", "python/README.md"];
    let all = readmes.into_iter().map(Into::into).chain(pages);
    all.filter(|path: &PathBuf| path.extension().is_some_and(|extension| extension == "md")).collect()
}

fn is_accepted() -> bool {
    std::env::var_os("FARM_TEST_ACCEPT").is_some()
}

/// Runs commands in a folder, with the programs in the path and without settings from the environment, and returns what
/// they print.
fn shell(folder: &Path, commands: &str) -> Result<String, String> {
    let programs = program("farmctl").parent().unwrap().to_owned();
    let path = format!("{}:{}", programs.display(), std::env::var("PATH").unwrap());
    let mut bash = Command::new("timeout");
    bash.args([LIMIT, "bash", "-euo", "pipefail", "-c", commands]).current_dir(folder).stdin(Stdio::null());
    for (name, _) in std::env::vars_os().filter(|(name, _)| name.to_string_lossy().starts_with("FARM_")) {
        bash.env_remove(name);
    }
    let ran: Ran = bash.env("PATH", path).env("HOME", folder).output().unwrap().into();
    if ran.code == 0 { Ok(ran.stdout) } else { Err(format!("{commands}\ncode {}: {}", ran.code, ran.stderr)) }
}

/// How alike two runs of lines are: a point for each letter in its place, and one for each line that is the same.
fn likeness(expected: &[&str], found: &[&str]) -> usize {
    let letters = |(a, b): (&&str, &&str)| {
        a.chars().zip(b.chars()).filter(|(a, b)| a == b).count() + usize::from(a == b)
    };
    expected.iter().zip(found).map(letters).sum()
}

/// The output, cut where the document cuts it: what the document shows if it is right.
fn cut_alike<'a>(expected: &[&str], output: &[&'a str]) -> Vec<&'a str> {
    let parts: Vec<_> = expected.split(|line| *line == CUT).collect();
    let mut needed: usize = parts.iter().map(|part| part.len()).sum();
    if parts.len() == 1 || needed > output.len() {
        return output.to_vec();
    }
    let (mut shown, mut from) = (Vec::new(), 0);
    for (number, part) in parts.iter().enumerate() {
        let last = output.len() - needed;
        // The first part begins with the output, the last one ends with it, and those between are where they fit best.
        let start = match number {
            0 => 0,
            _ if number + 1 == parts.len() => last,
            _ => (from..=last).rev().max_by_key(|start| likeness(part, &output[*start..])).unwrap(),
        };
        if number > 0 {
            shown.push(CUT);
        }
        from = start + part.len();
        needed -= part.len();
        shown.extend(&output[start..from]);
    }
    shown
}

/// The lines that differ, as those of a patch.
fn difference(expected: &[&str], found: &[&str]) -> String {
    let same = expected.iter().zip(found).take_while(|(a, b)| a == b).count();
    let (expected, found) = (&expected[same..], &found[same..]);
    let end = expected.iter().rev().zip(found.iter().rev()).take_while(|(a, b)| a == b).count();
    let marked = |sign: char, lines: &[&str]| -> String {
        lines[..lines.len() - end].iter().map(|line| format!("{sign}{line}\n")).collect()
    };
    marked('-', expected) + &marked('+', found)
}

/// Runs the commands of a console, and returns its lines as they should be.
fn console(folder: &Path, lines: &[&str]) -> Result<Vec<String>, String> {
    let mut shown = Vec::new();
    for block in lines.chunk_by(|_, next| !next.starts_with("$ ")) {
        let command = block[0].strip_prefix("$ ").ok_or("a console begins with `$ COMMAND`")?;
        let output = shell(folder, command)?;
        let output: Vec<&str> = output.trim_end().lines().map(str::trim_end).collect();
        shown.push(block[0].to_owned());
        shown.extend(cut_alike(&block[1..], &output).into_iter().map(str::to_owned));
    }
    Ok(shown)
}

/// Numbers of blocks that were checked, by kind, and the places of others.
#[derive(Default)]
struct Tally {
    consoles: usize,
    scripts: usize,
    texts: usize,
    not_run: Vec<String>,
    wrong: Vec<String>,
}

/// One document in its folder.
struct Document<'a> {
    path: &'a Path,
    folder: &'a Path,
    tally: &'a mut Tally,
}

impl Document<'_> {
    /// Checks all blocks, and returns the text as it should be.
    fn checked(&mut self, text: &str) -> String {
        let lines: Vec<&str> = text.split('\n').collect();
        let (mut fresh, mut number) = (Vec::new(), 0);
        while number < lines.len() {
            let line = lines[number];
            fresh.push(line.to_owned());
            number += 1;
            let fence = line.trim_start();
            let (info, close) = match fence.strip_prefix("```") {
                Some(info) => (info, "```"),
                None if fence == "<!-- sh" => ("sh", "-->"),
                None => continue,
            };
            let end = number + lines[number..].iter().position(|line| line.trim() == close).unwrap();
            fresh.extend(self.block(info, number, &lines[number..end]));
            number = end;
            fresh.push(lines[number].to_owned());
            number += 1;
        }
        fresh.join("\n")
    }

    /// Checks a block that begins after a line, and returns its lines as they should be.
    fn block(&mut self, info: &str, line: usize, lines: &[&str]) -> Vec<String> {
        let (language, condition) = info.split_once(' ').unwrap_or((info, ""));
        let unchanged = || lines.iter().map(|line| (*line).to_owned()).collect();
        let is_long = condition.starts_with("long: ");
        if condition.starts_with("not run: ") || is_long && effort() < 10 {
            self.tally.not_run.push(format!("{}:{line}: {condition}", self.path.display()));
            return unchanged();
        }
        assert!(condition.is_empty() || is_long, "{}:{line}: {condition}", self.path.display());
        let (number, done) = match language {
            "console" => (&mut self.tally.consoles, console(self.folder, lines)),
            "sh" => (&mut self.tally.scripts, shell(self.folder, &lines.join("\n")).map(|_| unchanged())),
            _ => (&mut self.tally.texts, text_block(language, &lines.join("\n")).map(|()| unchanged())),
        };
        *number += 1;
        let difference =
            |fresh: &Vec<String>| difference(lines, &fresh.iter().map(String::as_str).collect::<Vec<_>>());
        let wrong = match done {
            Ok(fresh) if is_accepted() || difference(&fresh).is_empty() => return fresh,
            Ok(fresh) => difference(&fresh),
            Err(failure) => failure,
        };
        self.tally.wrong.push(format!("{}:{line}:\n{wrong}", self.path.display()));
        unchanged()
    }
}

/// Checks a block that is no command.
fn text_block(language: &str, text: &str) -> Result<(), String> {
    match language {
        "toml" => text.parse::<toml::Table>().map(drop).map_err(|e| e.to_string()),
        "json" => serde_json::from_str::<serde_json::Value>(text).map(drop).map_err(|e| e.to_string()),
        _ if TEXTS.contains(&language) => Ok(()),
        _ => Err(format!("a block in {language:?}: `console`, `sh`, or one of {TEXTS:?}?")),
    }
}

#[test]
fn documents_show_what_programs_print() {
    let base = folder();
    shell(base.path(), "farmctl submit -q").unwrap();
    let copy = format!("cp -r {}/farm-data {}/examples .", base.path().display(), root().display());
    let mut tally = Tally::default();
    for path in documents() {
        let text = std::fs::read_to_string(root().join(&path)).unwrap();
        let own = folder();
        if text.contains("```sh\n") || text.contains("```console") {
            shell(own.path(), &copy).unwrap();
        }
        let fresh = Document { path: &path, folder: own.path(), tally: &mut tally }.checked(&text);
        if fresh != text && is_accepted() {
            std::fs::write(root().join(&path), fresh).unwrap();
        }
    }
    let Tally { consoles, scripts, texts, not_run, wrong } = tally;
    println!("{consoles} consoles, {scripts} scripts, {texts} texts; not run:\n{}", not_run.join("\n"));
    assert!(wrong.is_empty(), "`FARM_TEST_ACCEPT=1` accepts the present output:\n{}", wrong.join("\n"));
    assert!(consoles >= 5 && scripts >= 10, "{consoles} consoles, {scripts} scripts");
}

/// Lines are compared apart from those that the document cuts; new output is cut in the same places.
#[test]
fn output_is_cut_like_the_document() {
    let output = ["head", "a 1", "b 2", "c 3", "d 4", "end"];
    for (expected, cut) in [
        (&["head", "a 1", "b 2", "c 3", "d 4", "end"][..], &output[..]),
        (&["head", "…", "b 2", "…", "end"], &["head", "…", "b 2", "…", "end"]),
        (&["head", "…", "b 7", "c 7", "…"], &["head", "…", "b 2", "c 3", "…"]),
        (&["…", "d 3", "end"], &["…", "d 4", "end"]),
        (&["head", "end"], &output),
    ] {
        assert_eq!(cut_alike(expected, &output), cut, "{expected:?}");
    }
    assert_eq!(difference(&["a", "b", "c"], &["a", "x", "y", "c"]), "-b\n+x\n+y\n");
    assert_eq!(difference(&output, &output), "");
}
