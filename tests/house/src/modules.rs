//! Finds circular dependencies between the modules of a crate, from the tokens of its sources without tests.

use std::collections::{BTreeMap, BTreeSet};
use std::iter::Peekable;
use std::path::{Path, PathBuf};

use proc_macro2::token_stream::IntoIter;
use proc_macro2::{Delimiter, Group, TokenStream, TokenTree};

/// A module by its path from the crate's root.
type Module = Vec<String>;

/// The sources of a crate, by module.
#[derive(Debug)]
pub struct Modules {
    pub sources: BTreeMap<Module, String>,
}

/// The paths in one module's source.
#[derive(Debug, Default)]
struct Names {
    /// Paths from `crate` or `super`.
    paths: Vec<Module>,
    /// Paths that `use` brings in, by the names that they have here.
    uses: BTreeMap<String, Module>,
}

impl Modules {
    /// The modules of a folder with sources.
    ///
    /// # Panics
    /// If the folder cannot be read.
    pub fn of(source: &Path) -> Self {
        Self::from_sources(source, crate::files::files_below(source, "rs"))
    }

    /// The modules of files below `source`; those of tests are left out.
    ///
    /// # Panics
    /// If a file lies elsewhere.
    pub fn from_sources(source: &Path, files: Vec<(PathBuf, String)>) -> Self {
        let files = files.into_iter().map(|(path, text)| {
            let path = path.strip_prefix(source).expect("a file of the folder").to_owned();
            (path, text)
        });
        let files =
            files.filter(|(path, _)| !path.iter().any(|part| part.to_string_lossy().contains("tests")));
        Self { sources: files.map(|(path, text)| (module_of(&path), text)).collect() }
    }

    /// Circles among the modules of one folder, each including its submodules.
    pub fn circles(&self) -> Vec<String> {
        let names: BTreeMap<&Module, Names> =
            self.sources.iter().map(|(module, text)| (module, Names::of(text))).collect();
        let named: Vec<(Module, Module)> = names
            .iter()
            .flat_map(|(module, own)| {
                own.paths.iter().map(|path| ((*module).clone(), resolved(&names, module, path)))
            })
            .collect();
        let folders: BTreeSet<&[String]> =
            self.sources.keys().filter_map(|module| Some(module.split_last()?.1)).collect();
        folders.into_iter().filter_map(|folder| circle_in(folder, &named)).collect()
    }
}

/// The deepest module that a path in the module `from` leads to. Imports of the modules on the path are followed.
fn resolved(names: &BTreeMap<&Module, Names>, from: &Module, path: &[String]) -> Module {
    let mut base = from.clone();
    let mut parts = path.iter().peekable();
    if parts.next_if(|part| *part == "crate").is_some() {
        base.clear();
    }
    while parts.next_if(|part| *part == "super").is_some() {
        base.pop();
    }
    for part in parts {
        let next = [&base[..], std::slice::from_ref(part)].concat();
        let used = names.get(&base).and_then(|own| own.uses.get(part));
        base = match used {
            _ if names.contains_key(&next) => next,
            // A name that resolves to itself belongs to another crate.
            Some(used) if used[0] != *part || used.len() > 1 => resolved(names, &base, used),
            _ => break,
        };
    }
    base
}

/// A file without its folder's `mod.rs` or extension: `fit/view` for both `fit/view.rs` and `fit/view/mod.rs`.
fn module_of(path: &Path) -> Module {
    let path = path.with_extension("");
    let mut parts: Module = path.iter().map(|part| part.to_string_lossy().into_owned()).collect();
    if matches!(parts.last().map(String::as_str), Some("mod" | "lib" | "main")) {
        parts.pop();
    }
    parts
}

/// The modules of a folder that depend on themselves.
fn circle_in(folder: &[String], named: &[(Module, Module)]) -> Option<String> {
    let child = |module: &'_ Module| module.strip_prefix(folder)?.first().cloned();
    let mut arrows: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for (from, to) in named {
        if let (Some(from), Some(to)) = (child(from), child(to))
            && from != to
        {
            arrows.entry(from).or_default().insert(to);
        }
    }
    let reaches_itself = |start: &String| {
        let (mut reached, mut next) = (BTreeSet::new(), vec![start]);
        while let Some(module) = next.pop() {
            let new = arrows.get(module).into_iter().flatten().filter(|to| reached.insert(*to));
            next.extend(new.collect::<Vec<_>>());
        }
        reached.contains(start)
    };
    let circle: Vec<&str> = arrows.keys().filter(|m| reaches_itself(m)).map(String::as_str).collect();
    let place = folder.iter().map(|part| format!("{part}::")).collect::<String>();
    (!circle.is_empty()).then(|| place + &circle.join(", "))
}

impl Names {
    /// # Panics
    /// If the text is not Rust.
    fn of(text: &str) -> Self {
        let mut names = Self::default();
        names.find(text.parse().expect("the sources are Rust"));
        names
    }

    /// Collects all paths except those of test items.
    fn find(&mut self, tokens: TokenStream) {
        let mut tokens = tokens.into_iter().peekable();
        let mut colons = 0;
        while let Some(token) = tokens.next() {
            match token {
                TokenTree::Group(group) if is_for_tests(&group) => skip_item(&mut tokens),
                TokenTree::Group(group) => self.find(group.stream()),
                TokenTree::Ident(ident) if ident == "use" => {
                    if let Some(TokenTree::Ident(first)) =
                        tokens.next_if(|t| matches!(t, TokenTree::Ident(_)))
                    {
                        self.follow(vec![first.to_string()], true, &mut tokens);
                    }
                }
                TokenTree::Ident(ident) if colons < 2 && (ident == "crate" || ident == "super") => {
                    self.follow(vec![ident.to_string()], false, &mut tokens);
                }
                TokenTree::Punct(punct) if punct.as_char() == ':' => {
                    colons += 1;
                    continue;
                }
                _ => {}
            }
            colons = 0;
        }
    }

    /// Parses the rest of a path; for a list in braces, each of its paths.
    fn follow(&mut self, mut path: Module, is_use: bool, tokens: &mut Peekable<IntoIter>) {
        while passes_colons(tokens) {
            match tokens.next() {
                Some(TokenTree::Ident(ident)) => path.push(ident.to_string()),
                Some(TokenTree::Group(list)) => {
                    let mut list = list.stream().into_iter().peekable();
                    while let Some(token) = list.next() {
                        if let TokenTree::Ident(name) = token {
                            self.follow([&path[..], &[name.to_string()]].concat(), is_use, &mut list);
                        }
                    }
                    return;
                }
                _ => break,
            }
        }
        let mut name = path.last().cloned().unwrap_or_default();
        if tokens.next_if(|token| matches!(token, TokenTree::Ident(word) if word == "as")).is_some()
            && let Some(TokenTree::Ident(other)) = tokens.next()
        {
            name = other.to_string();
        }
        if path[0] == "self" {
            path.remove(0);
        }
        if is_use && !path.is_empty() {
            self.uses.insert(name, path.clone());
        }
        if path.first().is_some_and(|first| first == "crate" || first == "super") {
            self.paths.push(path);
        }
    }
}

/// Names of the types that a text defines, without those of test items and without associated types.
///
/// # Panics
/// If the text is not Rust.
pub fn type_names(text: &str) -> Vec<String> {
    let mut found = Vec::new();
    collect_types(text.parse().expect("the sources are Rust"), &mut found);
    found
}

fn collect_types(tokens: TokenStream, found: &mut Vec<String>) {
    let mut tokens = tokens.into_iter().peekable();
    while let Some(token) = tokens.next() {
        match token {
            TokenTree::Group(group) if is_for_tests(&group) => skip_item(&mut tokens),
            TokenTree::Ident(word) if word == "impl" || word == "trait" => {
                if let (true, Some(TokenTree::Ident(name))) = (word == "trait", tokens.peek()) {
                    found.push(name.to_string());
                }
                skip_item(&mut tokens);
            }
            TokenTree::Ident(word) if ["struct", "enum", "union", "type"].iter().any(|kind| word == kind) => {
                if let Some(TokenTree::Ident(name)) = tokens.peek() {
                    found.push(name.to_string());
                }
            }
            TokenTree::Group(group) if group.delimiter() == Delimiter::Brace => {
                collect_types(group.stream(), found);
            }
            _ => {}
        }
    }
}

/// Skips two colons, if they come next.
fn passes_colons(tokens: &mut Peekable<IntoIter>) -> bool {
    let is_colon = |token: &TokenTree| matches!(token, TokenTree::Punct(punct) if punct.as_char() == ':');
    tokens.next_if(is_colon).is_some() && tokens.next_if(is_colon).is_some()
}

/// Whether an attribute's brackets hold `cfg(test)`.
fn is_for_tests(group: &Group) -> bool {
    group.delimiter() == Delimiter::Bracket && group.stream().to_string().replace(' ', "") == "cfg(test)"
}

/// Skips an item up to its semicolon or its braces.
fn skip_item(tokens: &mut Peekable<IntoIter>) {
    for token in tokens {
        match token {
            TokenTree::Punct(punct) if punct.as_char() == ';' => return,
            TokenTree::Group(group) if group.delimiter() == Delimiter::Brace => return,
            _ => {}
        }
    }
}
