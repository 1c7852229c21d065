//! Prints text to a terminal. Names and reasons in it are untrusted: control characters are escaped.

use std::io::Write;

use farm_proto::is_printable;

/// Largest number of bytes of an error that are printed: it may quote a line of a file, which may be the whole file.
const LONGEST_ERROR: usize = 3000;

/// Prints a text on standard output. Control characters are escaped, except this program's own styles: names and reasons
/// in the text are untrusted.
pub(crate) fn print_line(text: &str) -> anyhow::Result<()> {
    Ok(writeln!(anstream::stdout(), "{}", shown(text.trim_end()))?)
}

fn shown(mut rest: &str) -> String {
    const OWN: [&str; 3] = ["\u{1b}[0m", "\u{1b}[1m", "\u{1b}[33m"];
    let mut shown = String::new();
    while let Some(at) = rest.find('\u{1b}') {
        let (before, after) = rest.split_at(at);
        let style = OWN.into_iter().find(|style| after.starts_with(style)).unwrap_or_default();
        shown += &steers_nothing(before);
        shown += style;
        rest = &after[style.len()..];
        if style.is_empty() {
            shown += &steers_nothing("\u{1b}");
            rest = &rest[1..];
        }
    }
    shown + &steers_nothing(rest)
}

/// The text with Rust's escapes for unprintable characters.
fn steers_nothing(text: &str) -> String {
    with_escapes(text, |c| c.escape_unicode().to_string())
}

/// The text with escapes for unprintable characters, except line breaks and tabs.
pub(crate) fn with_escapes(text: &str, escape: impl Fn(char) -> String) -> String {
    let mut printable = String::with_capacity(text.len());
    for c in text.chars() {
        if is_printable(c) || matches!(c, '\n' | '\t') { printable.push(c) } else { printable += &escape(c) }
    }
    printable
}

/// The text of an error, which may quote an untrusted file: characters that control a terminal or turn the text
/// direction are escaped, and its length is limited.
pub(crate) fn harmless(text: &str) -> String {
    let mut printable = String::new();
    for c in text.chars() {
        if printable.len() >= LONGEST_ERROR {
            printable.push('…');
            break;
        }
        printable += &steers_nothing(c.encode_utf8(&mut [0; 4]));
    }
    printable
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::output::warning;

    /// A text that an error quotes cannot control the terminal, and has a limited length.
    #[test]
    fn quoted_text_is_harmless_and_short() {
        let message = |quoted: &str| harmless(&format!("line 3: {quoted}"));
        assert_eq!(message("2 µm\n  |\t^"), "line 3: 2 µm\n  |\t^");
        assert_eq!(message("\u{1b}[2Jgone\u{7}\u{202e}"), "line 3: \\u{1b}[2Jgone\\u{7}\\u{202e}");
        for (long, end) in [("ä", "ä…"), ("\0", "\\u{0}…")] {
            let message = message(&long.repeat(100_000));
            assert!(message.len() < LONGEST_ERROR + 10 && message.ends_with(end), "{} bytes", message.len());
        }
    }

    /// A table keeps the styles of this program and no others.
    #[test]
    fn table_keeps_only_our_styles() {
        let text = format!("{} \u{1b}[1mname\u{1b}[0m\na\u{1b}[2Jb\u{202e}", warning("ä"));
        assert_eq!(shown(&text), "\u{1b}[33mä\u{1b}[0m \u{1b}[1mname\u{1b}[0m\na\\u{1b}[2Jb\\u{202e}");
    }
}
