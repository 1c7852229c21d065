//! Tests of files with several pictures.

use super::*;

/// A TIFF with several pages of the same picture, each modified by `change`.
fn pages(count: usize, change: impl Fn(usize, Maker) -> Maker) -> Vec<u8> {
    let first = change(0, grey());
    let mut file = first.bytes();
    let mut link = 4;
    for i in 0..count {
        let page = change(i, grey());
        let strip = file.len() as u32;
        file.extend(&page.strip);
        let at = file.len() as u32;
        file[link..link + 4].copy_from_slice(&at.to_le_bytes());
        let tags = page.with(273, &[strip]).directory(at as usize);
        link = file.len() + 2 + 12 * usize::from(u16::from_le_bytes([tags[0], tags[1]]));
        file.extend(tags);
    }
    file
}

fn grey() -> Maker {
    Maker { tags: vec![], ..Maker::dng() }.with(262, &[1])
}

/// A file with several pictures is refused with their number.
#[test]
fn file_with_several_pictures_is_refused() {
    let refused = |bytes: &[u8]| decode(bytes).unwrap_err().to_string();
    assert_eq!(decode(&pages(1, |_, page| page)).unwrap().samples, counting());
    for kind in [0, 2] {
        let six = refused(&pages(6, |_, page| page.with(254, &[kind])));
        assert!(six.starts_with("the file holds 6 pictures, of which one would be used"), "{six}");
    }
    let other_size = |i, page| if i == 1 { Maker { width: 3, ..page } } else { page };
    assert!(refused(&pages(2, other_size)).starts_with("the file holds 2 pictures"));
    let preview = |i, page: Maker| page.with(254, &[u32::from(i > 0)]);
    assert_eq!(decode(&pages(3, preview)).unwrap().samples, counting());
    let eight_bits = |i, page: Maker| if i > 0 { page.with(258, &[8]) } else { page };
    assert_eq!(decode(&pages(2, eight_bits)).unwrap().samples, counting(), "a thumbnail");
    let mut stack = grey();
    let text = b"ImageJ=1.53t\nimages=6\nslices=6\n\0".map(u32::from);
    stack.tags.push((270, 1, text.to_vec()));
    assert!(refused(&stack.bytes()).starts_with("the file holds 6 pictures"));
    let pgm = [&b"P5 2 1 65535\n"[..], &[1, 0, 2, 3]].concat();
    assert!(refused(&pgm.repeat(3)).starts_with("the file holds 3 pictures"));
}
