//! Compares texts with files that hold them as users read them.

use std::path::Path;

/// Asserts that a text equals that of a file below `src`, line by line; `FARM_TEST_ACCEPT=1` writes the file.
pub(crate) fn is_stable(file: &str, text: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("src").join(file);
    if std::env::var_os("FARM_TEST_ACCEPT").is_some() {
        std::fs::write(&path, text).unwrap();
    }
    let expected = std::fs::read_to_string(&path).unwrap();
    for (i, (found, expected)) in text.lines().zip(expected.lines()).enumerate() {
        assert_eq!(found, expected, "{file}, line {}", i + 1);
    }
    assert_eq!(text.len(), expected.len(), "{file}");
}
