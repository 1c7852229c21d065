//! Expands file names with wildcards: `*` for any letters and `?` for one, within the name of a folder or a file.

use std::ffi::OsStr;
use std::fs::Metadata;
use std::io::{Error, ErrorKind};
use std::path::{Component, Path, PathBuf};

use optics_model::Invalid;
use unicode_normalization::UnicodeNormalization as _;

/// Largest number of files that the patterns of one field may match.
const MOST_FILES: usize = 10_000;

/// The files that match the patterns of a field, sorted by name per pattern; a pattern without a match is refused.
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
        let name = composed(part.as_os_str());
        // A name with letters outside ASCII may be in composed characters in the pattern and in decomposed ones on the
        // disk.
        let is_wild = matches!(part, Component::Normal(_)) && (name.contains(['*', '?']) || !name.is_ascii());
        let mut next = Vec::new();
        for place in places {
            if !is_wild {
                next.push(place.join(part));
                continue;
            }
            let folder = if place.as_os_str().is_empty() { Path::new(".") } else { &place };
            if !is(folder, Metadata::is_dir)? {
                continue;
            }
            for entry in std::fs::read_dir(folder)? {
                let entry = entry?.file_name();
                if matches(name.as_bytes(), composed(&entry).as_bytes()) {
                    next.push(place.join(entry));
                }
            }
        }
        places = next;
    }
    let mut files = Vec::new();
    for place in places {
        if is(&place, Metadata::is_file)? {
            files.push(place);
        }
    }
    files.sort();
    Ok(files)
}

/// Whether a path is of a kind. An absent path is of no kind; a broken link or an unreadable path is an error, since it
/// would silently be left out of the session.
fn is(path: &Path, kind: fn(&Metadata) -> bool) -> std::io::Result<bool> {
    let error = match std::fs::metadata(path) {
        Ok(metadata) => return Ok(kind(&metadata)),
        Err(error) => error,
    };
    if let Ok(target) = std::fs::read_link(path) {
        let (path, target) = (path.display(), target.display());
        return Err(Error::other(format!("{path} is a link to {target}, which cannot be read ({error})")));
    }
    match error.kind() {
        ErrorKind::NotFound | ErrorKind::NotADirectory => Ok(false),
        kind => Err(Error::new(kind, format!("{}: {error}", path.display()))),
    }
}

/// A name in composed characters, whichever form the filesystem uses.
fn composed(name: &OsStr) -> String {
    name.to_string_lossy().nfc().collect()
}

/// Whether a name matches a pattern; wildcards do not match names that begin with a dot.
fn matches(pattern: &[u8], name: &[u8]) -> bool {
    if name.first() == Some(&b'.') && pattern.first() != Some(&b'.') {
        return false;
    }
    let (mut at, mut read) = (0, 0);
    // Index after the last star, and the end of the text that this star matches: after a mismatch only this star is
    // extended.
    let mut star = None;
    while read < name.len() {
        match (pattern.get(at), star) {
            (Some(b'*'), _) => {
                at += 1;
                star = Some((at, read));
            }
            (Some(&p), _) if p == b'?' || p == name[read] => (at, read) = (at + 1, read + 1),
            (_, Some((behind, reach))) => {
                star = Some((behind, reach + 1));
                (at, read) = (behind, reach + 1);
            }
            (_, None) => return false,
        }
    }
    pattern[at..].iter().all(|p| *p == b'*')
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Wildcards match as in a shell. Many stars are matched quickly: backtracking over all of them would take exponential
    /// time.
    #[test]
    fn wildcards_match_as_in_shells() {
        let stars = "*a".repeat(60) + "*b";
        let [without, with] = ["", "b"].map(|end| "a".repeat(250) + end);

        for (pattern, name, expected) in [
            ("dark_*.dng", "dark_1.dng", true),
            ("dark_*.dng", "dark_.dng", true),
            ("dark_?.dng", "dark_12.dng", false),
            ("*", ".hidden", false),
            ("**a*", "bab", true),
            ("a", "A", false),
            ("*a*b", "xaxbxb", true),
            ("*a*b", "xaxbx", false),
            ("a?*", "a", false),
            ("a*", "a", true),
            (&stars, &without, false),
            (&stars, &with, true),
        ] {
            assert_eq!(matches(pattern.as_bytes(), name.as_bytes()), expected, "{pattern} {name}");
        }
    }

    /// A folder with these files.
    fn folder(names: &[&str]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for name in names {
            let path = folder.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, "").unwrap();
        }
        folder
    }

    /// Names of the files of a pattern, or the refusal.
    fn found(folder: &Path, pattern: &str) -> Result<Vec<String>, String> {
        let files = files_of(folder, "shots", &[pattern.to_owned()]).map_err(|e| e.to_string())?;
        Ok(files.iter().map(|f| f.strip_prefix(folder).unwrap().display().to_string()).collect())
    }

    #[cfg(unix)]
    #[test]
    fn links_to_nothing_are_named() {
        let folder = folder(&["a/x.dng"]);
        let link = |to: &str, name: &str| std::os::unix::fs::symlink(to, folder.path().join(name)).unwrap();
        link("x.dng", "a/y.dng");
        assert_eq!(found(folder.path(), "*/*.dng").unwrap().len(), 2);
        link("gone.dng", "a/z.dng");
        link("disk", "b");
        for (pattern, message) in [
            ("a/*.dng", "a/z.dng is a link to gone.dng, which cannot be read"),
            ("a/z.dng", "a/z.dng is a link to gone.dng, which cannot be read"),
            ("*/x*.dng", "b is a link to disk, which cannot be read"),
        ] {
            let error = found(folder.path(), pattern).unwrap_err();
            assert!(error.contains(message), "{error}");
        }
    }

    /// Patterns match names in composed and in decomposed characters.
    #[test]
    fn patterns_match_any_unicode_form() {
        let folder = folder(&["wei\u{df}_u\u{308}.dng", "\u{fc}/1.dng"]);
        for pattern in ["wei\u{df}_\u{fc}.dng", "wei\u{df}_u\u{308}*", "u\u{308}/1.dng", "*_\u{fc}.*"] {
            assert_eq!(found(folder.path(), pattern).map(|files| files.len()), Ok(1), "{pattern}");
        }
    }

    /// Files are sorted, and folders may be patterns too.
    #[test]
    fn files_are_sorted_and_folders_may_match() {
        let folder = folder(&["b_2.dng", "b_10.dng", "a/x.dng", "c/x.dng"]);
        assert_eq!(found(folder.path(), "b_*.dng").unwrap(), ["b_10.dng", "b_2.dng"]);
        assert_eq!(found(folder.path(), "*/x.dng").unwrap(), ["a/x.dng", "c/x.dng"]);
        let none = files_of(folder.path(), "camera.dark", &["b_2.dng".into(), "d_*".into()]).unwrap_err();
        let message = "camera.dark[1] = \"d_*\" is not valid: no such file is in";
        assert!(none.to_string().starts_with(message), "{none}");
    }
}
