//! Checks the length and the characters of texts on the wire.

use optics_model::{Invalid, Result};

/// Longest name of a layer, channel, material or any other item of a request, in bytes.
const NAME_BYTES: usize = 256;
/// Longest text for people on the wire, in bytes. Of texts that come with an event, such as a worker's reason, the
/// coordinator keeps one line.
const NOTE_BYTES: usize = 64 << 10;
/// Fields with texts for people.
const NOTES: [&str; 8] = ["command", "kernel", "label", "log", "note", "reason", "source", "version"];

/// Whether a character is displayed as it is: it is neither a control character nor hidden, and does not change the
/// direction of the text after it.
pub fn is_printable(c: char) -> bool {
    let hidden = matches!(
        c,
        '\u{61c}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}' | '\u{feff}'
    );
    !c.is_control() && !hidden
}

/// Refuses a text of a request that is too long, is not UTF-8, or is a name with characters that are not printable.
pub(crate) fn check_text(field: &str, text: &[u8]) -> Result<()> {
    let is_note = NOTES.contains(&field);
    let most = if is_note { NOTE_BYTES } else { NAME_BYTES };
    if text.len() > most {
        let allowed = format!("at most {most} bytes are allowed");
        return Err(Invalid::new(field, format_args!("{} bytes", text.len()), allowed));
    }
    let Ok(text) = str::from_utf8(text) else {
        return Err(Invalid::new(field, format_args!("{} bytes", text.len()), "a text in UTF-8 is needed"));
    };
    match text.chars().find(|c| !is_printable(*c)) {
        Some(c) if !is_note => {
            let given = format_args!("a text with {}", c.escape_unicode()).to_string();
            Err(Invalid::new(field, given, "only printable characters are allowed"))
        }
        _ => Ok(()),
    }
}

/// Shortens a name for lists.
pub(crate) fn shortened(name: &mut String) {
    if name.len() > NAME_BYTES {
        name.truncate(name.floor_char_boundary(NAME_BYTES - '…'.len_utf8()));
        name.push('…');
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Notes may be long and have lines.
    #[test]
    fn names_have_a_length_and_are_printable() {
        assert!(check_text("name", "ß wood/µm (ä) – 白".as_bytes()).is_ok());
        assert!(check_text("name", &[b'x'; NAME_BYTES]).is_ok());
        let refused = |text: &[u8]| check_text("name", text).unwrap_err().to_string();
        assert_eq!(refused(&[b'x'; 257]), "name = 257 bytes is not valid: at most 256 bytes are allowed");
        assert_eq!(
            refused(b"\x1b[2J"),
            "name = a text with \\u{1b} is not valid: only printable characters are allowed"
        );
        assert!(refused("a\u{202e}b".as_bytes()).contains("\\u{202e}") && refused(b"\xff").contains("UTF-8"));
        assert!(check_text("reason", "panicked:\n\tat x".repeat(1000).as_bytes()).is_ok());
        assert!(check_text("reason", &vec![b'x'; NOTE_BYTES + 1]).is_err());
    }

    /// A text that was shortened ends with a mark.
    #[test]
    fn shortened_text_is_marked() {
        for (name, bytes) in [("ä".repeat(8_000_000), 255), ("R".to_owned(), 1)] {
            let mut name = name;
            shortened(&mut name);
            assert_eq!((name.len(), name.ends_with('…')), (bytes, bytes > 1));
        }
    }
}
