use super::*;
use crate::photograph::tests::Maker;

const RGGB: [Colour; 4] = [Colour::Red, Colour::Green, Colour::Green, Colour::Blue];

/// A grey TIFF of 64 × 64 pixels with a tag Orientation.
fn tiff(orientation: u32, seed: u16) -> Vec<u8> {
    let strip = (0..64 * 64_u16).flat_map(|i| (1000 + i % 7 + seed).to_le_bytes()).collect();
    let grey = Maker { width: 64, height: 64, strip, tags: Vec::new(), ..Maker::dng() };
    grey.with(262, &[1]).with(274, &[orientation]).bytes()
}

fn pgm(seed: u16) -> Vec<u8> {
    let samples = (0..64 * 64_u16).map(|i| 1000 + i % 7 + seed);
    [&b"P5 64 64 65535\n"[..], &samples.flat_map(u16::to_be_bytes).collect::<Vec<_>>()].concat()
}

/// Reads files of a folder, each in its group.
fn read(files: &[(&str, &str, Vec<u8>)]) -> Result<Vec<Input>, String> {
    let folder = tempfile::tempdir().unwrap();
    let mut shots = Shots::new(Some(RGGB), folder.path());
    for (name, group, bytes) in files {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        shots.read(&path, group).map_err(|e| format!("{e:#}"))?;
    }
    Ok(shots.into_inputs())
}

#[test]
fn one_photograph_under_two_names_is_refused() {
    assert!(read(&[("a.pgm", "dark", pgm(0)), ("b.pgm", "dark", pgm(1))]).is_ok());
    let refused = "b holds the same photograph as a, sample by sample: each may be used once";
    // In one group, across groups, and in another format.
    for (group, bytes) in [("dark", pgm(0)), ("flat", pgm(0)), ("white 1 mm", tiff(1, 0))] {
        assert_eq!(read(&[("a", "dark", pgm(0)), ("b", group, bytes)]).unwrap_err(), refused);
    }
}

#[test]
fn another_orientation_within_one_subject_is_named() {
    let all = |of: [(u32, &str); 3]| {
        let names = ["a.tif", "b.tif", "c.tif"];
        let files = [0, 1, 2].map(|i| (names[i], of[i].1, tiff(of[i].0, i as u16)));
        turned(&read(&files).unwrap())
    };
    assert_eq!(all([(6, "flat"), (6, "flat"), (6, "flat")]), Vec::<String>::new());
    assert_eq!(all([(0, "flat"), (1, "flat"), (6, "white 1 mm")]), Vec::<String>::new());
    let named = all([(1, "flat"), (1, "flat"), (3, "flat")]);
    let text = "c.tif has Orientation 3 (turned by 180°), a.tif has 1 (as stored); all are used as stored";
    assert!(named.len() == 1 && named[0].starts_with(text), "{named:?}");
}
