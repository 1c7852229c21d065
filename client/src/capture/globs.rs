//! Names of files with wildcards: `*` for any letters and `?` for one, within a folder's name or a file's.

use std::path::{Component, Path, PathBuf};

use optics_model::Invalid;

/// Most files that the patterns of one field may find.
const MOST_FILES: usize = 10_000;

/// The files that the patterns of a field find, sorted by name; a pattern that finds none is refused.
pub(super) fn files_of(folder: &Path, field: &str, patterns: &[String]) -> Result<Vec<PathBuf>, Invalid> {
    let mut files = Vec::new();
    for (i, pattern) in patterns.iter().enumerate() {
        let place = || format!("{field}[{i}]");
        let given = || format!("{pattern:?}");
        let found = find(folder, Path::new(pattern));
        let found = found.map_err(|error| Invalid::new(place(), given(), error.to_string()))?;
        if found.is_empty() {
            let allowed = format!("no such file is in {}", shown(folder));
            return Err(Invalid::new(place(), given(), allowed));
        }
        files.extend(found);
        if files.len() > MOST_FILES {
            return Err(Invalid::new(place(), given(), format!("at most {MOST_FILES} files are read")));
        }
    }
    Ok(files)
}

fn shown(folder: &Path) -> String {
    if folder.as_os_str().is_empty() { "this folder".to_owned() } else { folder.display().to_string() }
}

fn find(folder: &Path, pattern: &Path) -> std::io::Result<Vec<PathBuf>> {
    let mut places = vec![folder.to_owned()];
    for part in pattern.components() {
        let name = part.as_os_str().to_string_lossy();
        let is_wild = matches!(part, Component::Normal(_)) && name.contains(['*', '?']);
        let mut next = Vec::new();
        for place in places {
            if !is_wild {
                next.push(place.join(part));
                continue;
            }
            let folder = if place.as_os_str().is_empty() { Path::new(".") } else { &place };
            // What is no folder holds nothing.
            let Ok(entries) = std::fs::read_dir(folder) else { continue };
            for entry in entries {
                let entry = entry?.file_name();
                if matches(name.as_bytes(), entry.to_string_lossy().as_bytes()) {
                    next.push(place.join(entry));
                }
            }
        }
        places = next;
    }
    places.retain(|path| path.is_file());
    places.sort();
    Ok(places)
}

/// Whether a name is what a pattern stands for; names that begin with a dot are hidden from wildcards.
fn matches(pattern: &[u8], name: &[u8]) -> bool {
    fn rest(pattern: &[u8], name: &[u8]) -> bool {
        match (pattern, name) {
            ([], []) => true,
            ([b'*', after @ ..], _) => (0..=name.len()).any(|skipped| rest(after, &name[skipped..])),
            ([b'?', after @ ..], [_, left @ ..]) => rest(after, left),
            ([p, after @ ..], [n, left @ ..]) => p == n && rest(after, left),
            _ => false,
        }
    }
    let hidden = name.first() == Some(&b'.') && pattern.first() != Some(&b'.');
    // Stars side by side are one.
    let mut pattern = pattern.to_vec();
    pattern.dedup_by(|a, b| *a == b'*' && *b == b'*');
    !hidden && rest(&pattern, name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wildcards_stand_for_letters() {
        for (pattern, name, expected) in [
            ("dark_*.dng", "dark_1.dng", true),
            ("dark_*.dng", "dark_.dng", true),
            ("dark_?.dng", "dark_12.dng", false),
            ("*", ".hidden", false),
            ("**a*", "bab", true),
            ("a", "A", false),
        ] {
            assert_eq!(matches(pattern.as_bytes(), name.as_bytes()), expected, "{pattern} {name}");
        }
    }

    #[test]
    fn files_come_sorted_and_folders_may_be_wild() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["b_2.dng", "b_10.dng", "a/x.dng", "c/x.dng"] {
            let path = folder.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, "").unwrap();
        }
        let names = |pattern: &str| {
            let files = files_of(folder.path(), "camera.dark", &[pattern.to_owned()]).unwrap();
            files
                .iter()
                .map(|f| f.strip_prefix(folder.path()).unwrap().display().to_string())
                .collect::<Vec<_>>()
        };
        assert_eq!(names("b_*.dng"), ["b_10.dng", "b_2.dng"]);
        assert_eq!(names("*/x.dng"), ["a/x.dng", "c/x.dng"]);
        let none = files_of(folder.path(), "camera.dark", &["b_2.dng".into(), "d_*".into()]).unwrap_err();
        assert!(
            none.to_string().starts_with("camera.dark[1] = \"d_*\" is not valid: no such file is in"),
            "{none}"
        );
    }
}
