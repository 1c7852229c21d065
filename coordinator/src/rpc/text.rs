//! Texts that others write, and that people read in logs, events and terminals.

use farm_proto::RequestLimits;

/// One line of printable text, as long as texts may be. Whoever writes it could else pretend to be other lines of a log,
/// or steer a terminal.
pub(super) fn one_line(text: &str) -> String {
    let most = text.floor_char_boundary(RequestLimits::TEXT_BYTES);
    text[..most].chars().map(|c| if is_printable(c) { c } else { ' ' }).collect::<String>().trim().to_owned()
}

/// Whether it is seen as it stands: no control, and nothing that turns the direction of what follows or hides.
fn is_printable(c: char) -> bool {
    let hidden =
        matches!(c, '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}' | '\u{feff}');
    !c.is_control() && !hidden
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_is_one_line_and_steers_nothing() {
        assert_eq!(one_line("no space left on /dev/sda (ä, µm)"), "no space left on /dev/sda (ä, µm)");
        assert_eq!(
            one_line("done\n2026 WORKER_FENCED\r\t\u{1b}[31mred\u{202e}\n"),
            "done 2026 WORKER_FENCED   [31mred"
        );
        let long = "ä".repeat(RequestLimits::TEXT_BYTES);
        assert_eq!(one_line(&long).len(), RequestLimits::TEXT_BYTES);
    }
}
