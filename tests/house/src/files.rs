//! Lists the project's own files, without build output and installed packages.

use std::path::{Path, PathBuf};

/// The project's root folder.
///
/// # Panics
/// If the crate lies elsewhere.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .ancestors()
        .nth(2)
        .expect("the crate lies in the workspace")
        .to_owned()
}

/// All files below a folder with this extension, in order, with their texts; without build output and installed
/// packages.
///
/// # Panics
/// If there are none, or one cannot be read.
pub fn files_below(folder: &Path, extension: &str) -> Vec<(PathBuf, String)> {
    let (mut found, mut folders) = (Vec::new(), vec![folder.to_owned()]);
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).expect("the folder can be read") {
            let path = entry.expect("the folder can be read").path();
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            if path.is_dir() && !path.is_symlink() {
                let is_own =
                    !name.starts_with('.') && !["target", "venv", "node_modules"].contains(&name.as_str());
                folders.extend(is_own.then_some(path));
            } else if path.extension().is_some_and(|its| its == extension) {
                let text = std::fs::read_to_string(&path).expect("the file can be read");
                found.push((path, text));
            }
        }
    }
    assert!(!found.is_empty(), "{} holds no .{extension} files", folder.display());
    found.sort_unstable();
    found
}

/// The project's own files with an extension, with paths from its root.
///
/// # Panics
/// If there are none, or one cannot be read.
pub fn own_files(extension: &str) -> Vec<(PathBuf, String)> {
    let root = root();
    let files = files_below(&root, extension).into_iter();
    files.map(|(path, text)| (path.strip_prefix(&root).expect("below the root").to_owned(), text)).collect()
}
