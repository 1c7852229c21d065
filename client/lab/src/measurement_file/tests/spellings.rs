//! Tests of names and thicknesses that look alike.

use super::*;

#[test]
fn names_in_different_characters_are_one_name() {
    let text = |names: [&str; 2]| {
        let body = [(names[0], "R"), (names[1], "G")]
            .map(|(name, channel)| rows("a", channel, 0.5).replace("a,", &format!("{name},")));
        format!("{HEAD}{}", body.concat())
    };
    for other in ["grün 1", "gru\u{308}n 1", "gr\u{200b}ün 1", "grün\u{a0}1\u{feff}"] {
        let file = parse(&text(["grün 1", other]));
        let names: Vec<&str> = file.materials.iter().map(Measurement::material).collect();
        assert_eq!((names, file.materials[0].channels()), (vec!["grün 1"], vec!["R", "G"]), "{other:?}");
        assert_eq!(file.notes.len(), usize::from(other != "grün 1"));
        let end = "\"grün 1\" (line 2 and 62)";
        assert!(file.notes.iter().all(|n| n.code == "NAMES" && n.text.ends_with(end)), "{:?}", file.notes);
    }
}

/// Names and thicknesses that look alike get a note.
#[test]
fn similar_names_are_noted() {
    for (rows, code, text) in [
        (
            rows("White", "R", 0.5) + &rows("white", "G", 0.5),
            "ALIKE_NAMES",
            "materials with names that look alike are taken for different ones: \"White\" (line 2) and \"white\" (line 62)",
        ),
        (
            rows("w", "R", 0.5) + &rows("w", "G", 0.500_000_001),
            "ALIKE_THICKNESSES",
            "material w: thicknesses 0.5 mm (line 2) and 0.500000001 mm (line 62)",
        ),
    ] {
        let file = parse(&(HEAD.to_owned() + &rows));
        assert_eq!(codes(&file), [code]);
        assert!(file.notes[0].text.starts_with(text), "{}", file.notes[0].text);
    }
}
