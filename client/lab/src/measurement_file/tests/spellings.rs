//! Tests of names and thicknesses that look alike.

use super::*;

#[test]
fn names_in_different_characters_are_one_name() {
    let text = |names: [&str; 2]| {
        let body = [(names[0], "R"), (names[1], "G")]
            .map(|(name, channel)| rows("a", channel, 0.5).replace("a,", &format!("{name},")));
        format!("{HEAD}{}", body.concat())
    };
    for (other, noted) in [("grün", false), ("gru\u{308}n", true), ("gr\u{200b}ün", true)] {
        let file = parse(&text(["grün", other]));
        let names: Vec<&str> = file.materials.iter().map(Measurement::material).collect();
        assert_eq!((names, file.materials[0].channels()), (vec!["grün"], vec!["R", "G"]), "{other:?}");
        assert_eq!(file.notes.len(), usize::from(noted));
        assert!(file.notes.iter().all(|n| n.code == "NAMES" && n.text.ends_with("\"grün\" (line 2 and 62)")));
    }
}

/// An invisible blank in a name gets a note.
#[test]
fn invisible_blank_in_a_name_is_noted() {
    let body = rows("w", "R", 0.5) + &rows("w", "G", 0.5).replace("w,", "w\u{200b},");
    let file = parse(&(HEAD.to_owned() + &body));
    assert_eq!((file.materials.len(), file.notes.len()), (1, 1));
    assert!(file.notes[0].text.ends_with("\"w\" (line 62)"), "{:?}", file.notes);
}

/// Names and thicknesses that look alike get a note.
#[test]
fn similar_names_are_noted() {
    let case = parse(&(HEAD.to_owned() + &rows("White", "R", 0.5) + &rows("white", "G", 0.5)));
    assert_eq!(case.notes.iter().map(|n| n.code).collect::<Vec<_>>(), ["ALIKE_NAMES"]);
    let wanted = "materials with names that look alike are taken for different ones: \"White\" (line 2) and \"white\" (line 62)";
    assert_eq!(case.notes[0].text, wanted);
    let thickness = HEAD.to_owned() + &rows("w", "R", 0.5) + &rows("w", "G", 0.500_000_001);
    let notes = parse(&thickness).notes;
    assert_eq!(notes.iter().map(|n| n.code).collect::<Vec<_>>(), ["ALIKE_THICKNESSES"]);
    assert!(
        notes[0].text.starts_with("material w: thicknesses 0.5 mm (line 2) and 0.500000001 mm (line 62)")
    );
}
