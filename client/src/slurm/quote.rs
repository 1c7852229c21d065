//! Quotes text for two parsers, which read it back unchanged: bash, and sbatch in its `#SBATCH` lines.

/// Quotes any text as one word of a shell command.
pub(crate) fn shell_quoted(text: &str) -> String {
    let plain = |b: u8| b.is_ascii_alphanumeric() || b"@%+=:,./_-".contains(&b);
    if !text.is_empty() && text.bytes().all(plain) {
        return text.to_owned();
    }
    format!("'{}'", text.replace('\'', r"'\''"))
}

/// Quotes the value of an option in an `#SBATCH` line, where unquoted blanks end a word and an unquoted `#` ends the
/// line. The text must be one line.
pub(crate) fn sbatch_quoted(text: &str) -> String {
    format!("\"{}\"", text.replace('\\', r"\\").replace('"', "\\\""))
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    use super::*;

    const AWKWARD: [&str; 16] = [
        "",
        "plain",
        "/scratch/a b/farm-worker",
        "it's",
        "'",
        "''\"\"",
        r#"say "hi""#,
        "$HOME and ${PATH} and $(id) and `id`",
        r"back\slash\",
        "-n",
        "~/x",
        "*?[a]{b,c}",
        "a;b&c|d<e>f(g)",
        "!history #comment",
        "two\nlines\tand a tab ",
        "σ_t 日本",
    ];

    /// Bash reads a quoted text unchanged, as one word among others.
    #[test]
    fn bash_reads_quoted_text_as_one_word() {
        let words: Vec<_> = AWKWARD.map(shell_quoted).into();
        assert_eq!(words[1], "plain", "it stays readable");
        let script = format!("set -- {}; echo $#; printf '<%s>' \"$@\"", words.join(" "));
        let output = Command::new("bash").args(["-c", &script]).output().unwrap();
        let wanted: String = AWKWARD.map(|text| format!("<{text}>")).concat();
        assert_eq!(String::from_utf8_lossy(&output.stdout), format!("{}\n{wanted}", AWKWARD.len()));
    }

    #[test]
    fn quotes_and_backslashes_are_escaped_for_sbatch() {
        assert_eq!(sbatch_quoted(r#"a "b" \c #d"#), r#""a \"b\" \\c #d""#);
    }
}
