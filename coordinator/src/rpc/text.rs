//! Limits texts of callers that are shown in logs, events and terminals to one printable line.

use farm_proto::{RequestLimits, is_printable};
use optics_model::Invalid;

/// Longest label of a worker, and longest other text that lists show of it, in bytes.
const SHORT_BYTES: usize = 200;

/// One line of printable text, of limited length. Otherwise a text could imitate other lines of a log, or send control
/// sequences to a terminal.
pub(super) fn one_line(text: &str) -> String {
    let most = text.floor_char_boundary(RequestLimits::TEXT_BYTES);
    text[..most].chars().map(|c| if is_printable(c) { c } else { ' ' }).collect::<String>().trim().to_owned()
}

/// Printable lines of a note. It is refused rather than cut, since its author would miss the rest later.
pub(super) fn lines(field: &str, text: &str) -> Result<String, Invalid> {
    if text.len() > RequestLimits::NOTE_BYTES {
        let allowed = format!("at most {} are allowed", RequestLimits::NOTE_BYTES);
        return Err(Invalid::new(field, format_args!("{} bytes", text.len()), allowed));
    }
    Ok(text.lines().map(one_line).collect::<Vec<_>>().join("\n").trim_end().to_owned())
}

/// One line of a text that appears in every list of workers, with a lower limit.
pub(super) fn short_line(text: &str) -> String {
    let mut line = one_line(text);
    line.truncate(line.floor_char_boundary(SHORT_BYTES));
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Text from outside becomes one line without control characters and with a maximum length.
    #[test]
    fn text_is_one_line_without_control_codes() {
        assert_eq!(one_line("no space left on /dev/sda (ä, µm)"), "no space left on /dev/sda (ä, µm)");
        let harmful = "done\n2026 WORKER_FENCED\r\t\u{1b}[31mred\u{202e}\n";
        assert_eq!(one_line(harmful), "done 2026 WORKER_FENCED   [31mred");
        let long = "ä".repeat(RequestLimits::TEXT_BYTES);
        assert_eq!(one_line(&long).len(), RequestLimits::TEXT_BYTES);
        assert_eq!(short_line(&long).len(), SHORT_BYTES);
    }

    /// A note keeps its lines, and one that is too long is refused.
    #[test]
    fn notes_keep_their_lines() {
        assert_eq!(lines("note", "slab 2\r\n\u{1b}[31mred\n\n").unwrap(), "slab 2\n[31mred");
        let refused = lines("note", &"a".repeat(RequestLimits::NOTE_BYTES + 1)).unwrap_err();
        assert!(refused.to_string().starts_with("note = 10001 bytes"), "{refused}");
    }
}
