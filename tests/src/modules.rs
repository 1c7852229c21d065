//! Which modules of a crate name which, by the tokens of its sources, without those of tests.

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

impl Modules {
    /// Of a folder with sources.
    ///
    /// # Panics
    /// If it cannot be read.
    pub fn of(source: &Path) -> Self {
        Self::from_sources(source, crate::reference::sources(source))
    }

    /// Of files below `source` with their texts; those of tests are left out.
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

    /// Circles among the modules that lie in one folder, each taken with all that lies below it.
    pub fn circles(&self) -> Vec<String> {
        let named: Vec<(Module, Module)> =
            self.sources.iter().flat_map(|(module, text)| self.named_by(module, text)).collect();
        let folders: BTreeSet<&[String]> =
            self.sources.keys().filter_map(|module| Some(module.split_last()?.1)).collect();
        folders.into_iter().filter_map(|folder| circle_in(folder, &named)).collect()
    }

    /// The module with each that it names.
    fn named_by(&self, module: &Module, text: &str) -> Vec<(Module, Module)> {
        let tokens: TokenStream = text.parse().expect("the sources are Rust");
        let mut paths = Vec::new();
        find_paths(tokens, &mut paths);
        let named = paths.iter().map(|path| (module.clone(), self.resolved(module, path)));
        named.collect()
    }

    /// The deepest module on the way of a path, which is seen from a module.
    fn resolved(&self, from: &Module, path: &[String]) -> Module {
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
            if !self.sources.contains_key(&next) {
                break;
            }
            base = next;
        }
        base
    }
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

/// The modules of a folder that can be reached from themselves.
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

/// Collects all paths from `crate` or `super`, but not those of items for tests alone.
fn find_paths(tokens: TokenStream, paths: &mut Vec<Module>) {
    let mut tokens = tokens.into_iter().peekable();
    let mut colons = 0;
    while let Some(token) = tokens.next() {
        match token {
            TokenTree::Group(group) if is_for_tests(&group) => skip_item(&mut tokens),
            TokenTree::Group(group) => find_paths(group.stream(), paths),
            TokenTree::Ident(ident) if colons < 2 && (ident == "crate" || ident == "super") => {
                follow_path(vec![ident.to_string()], &mut tokens, paths);
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

/// Whether an attribute's brackets hold `cfg(test)`.
fn is_for_tests(group: &Group) -> bool {
    group.delimiter() == Delimiter::Bracket && group.stream().to_string().replace(' ', "") == "cfg(test)"
}

/// Passes an item: up to its semicolon or its braces.
fn skip_item(tokens: &mut Peekable<IntoIter>) {
    for token in tokens {
        match token {
            TokenTree::Punct(punct) if punct.as_char() == ';' => return,
            TokenTree::Group(group) if group.delimiter() == Delimiter::Brace => return,
            _ => {}
        }
    }
}

/// Goes on with a path; of a list in braces, with each of its paths.
fn follow_path(mut path: Module, tokens: &mut Peekable<IntoIter>, paths: &mut Vec<Module>) {
    let is_colon = |token: &TokenTree| matches!(token, TokenTree::Punct(punct) if punct.as_char() == ':');
    loop {
        let mut colons = 0;
        while tokens.next_if(is_colon).is_some() {
            colons += 1;
        }
        if colons != 2 {
            break;
        }
        match tokens.next() {
            Some(TokenTree::Ident(ident)) => path.push(ident.to_string()),
            Some(TokenTree::Group(list)) => {
                let mut list = list.stream().into_iter().peekable();
                while let Some(token) = list.next() {
                    match token {
                        TokenTree::Ident(name) if name == "as" => drop(list.next()),
                        TokenTree::Ident(name) => {
                            let path = [&path[..], &[name.to_string()]].concat();
                            follow_path(path, &mut list, paths);
                        }
                        _ => {}
                    }
                }
                return;
            }
            _ => break,
        }
    }
    paths.push(path);
}
