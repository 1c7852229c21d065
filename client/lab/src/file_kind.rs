//! Recognises the files that the verbs read by their content. An error about a file of another kind names the verb that
//! reads it.

use anyhow::{Result, anyhow};

/// A kind of file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum FileKind {
    Photograph,
    Measurement,
    Session,
    /// The session file that `capture` writes.
    SetUp,
    Grid,
    Scene,
    Mixtures,
    Media,
}

impl FileKind {
    /// Its name in errors, and what reads it.
    fn words(self) -> (&'static str, &'static str) {
        match self {
            Self::Photograph => {
                ("photograph", "`farmctl capture --check` looks at it, a session file names all of them")
            }
            Self::Measurement => ("measurement", "`farmctl measure` fits it"),
            Self::Session => ("session file", "`farmctl capture` makes profiles of its photographs"),
            Self::SetUp => {
                ("set-up of measured photographs", "`farmctl measure` takes the folder in which it is")
            }
            Self::Grid => ("grid file", "`farmctl submit` computes its dictionary"),
            Self::Scene => ("scene file", "a grid or a session file names it as its `scene`"),
            Self::Mixtures => ("mixture file", "`farmctl measure` and `validate` take it with --mixtures"),
            Self::Media => ("media file", "`farmctl predict`, `recipe`, `validate` and `compare` read it"),
        }
    }

    /// None if the content is of no known kind.
    fn recognised(bytes: &[u8]) -> Option<Self> {
        const PICTURES: [&[u8]; 9] =
            [b"II*\0", b"MM\0*", b"\x89PNG", b"\xff\xd8\xff", b"P5", b"P6", b"PF", b"Pf", b"FUJIFILM"];
        if PICTURES.iter().any(|begin| bytes.starts_with(begin)) {
            return Some(Self::Photograph);
        }
        let text = std::str::from_utf8(bytes).ok()?.trim_start_matches('\u{feff}').trim_start();
        if text.starts_with('{') {
            let json: serde_json::Value = serde_json::from_str(text).ok()?;
            let format = json["format"].as_str()?.split('/').next()?;
            return match format {
                "farmctl-media" => Some(Self::Media),
                "farmctl-session" => Some(Self::SetUp),
                _ => None,
            };
        }
        if let Ok(table) = text.parse::<toml::Table>() {
            let has = |keys: &[&str]| keys.iter().any(|key| table.contains_key(*key));
            return match () {
                () if has(&["camera", "neutral", "target", "sample"]) => Some(Self::Session),
                () if has(&["mixture"]) => Some(Self::Mixtures),
                () if has(&["sigma_t_per_mm", "albedo", "thickness_mm", "walks", "quality"]) => {
                    Some(Self::Grid)
                }
                () if has(&["channel", "sensor", "light", "layer"]) => Some(Self::Scene),
                () => None,
            };
        }
        let head = text.lines().find(|line| !line.trim_start().starts_with('#'))?.to_lowercase();
        let is_table = head.starts_with("cgats") || head.contains("material") && head.contains("value");
        is_table.then_some(Self::Measurement)
    }
}

/// The result of reading a file. An error is replaced if the bytes are those of another kind of file than `what`.
pub fn or_other_kind<T>(read: Result<T>, bytes: &[u8], what: &str) -> Result<T> {
    read.map_err(|error| {
        let words = FileKind::recognised(bytes).map(FileKind::words);
        match words.filter(|(name, _)| *name != what) {
            Some((name, reader)) => anyhow!("this is a {name}: {reader}"),
            None => error,
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every kind is recognised by its content, and an error about it names the verb that reads it.
    #[test]
    fn files_of_another_kind_name_their_verb() {
        for (bytes, reader) in [
            (&b"II*\0\x08\0\0\0"[..], "capture --check"),
            (b"# by hand\nmaterial,channel,thickness_mm,x_mm,value\n", "measure"),
            (b"\xef\xbb\xbfMaterial;Channel;Value\n", "measure"),
            (b"CGATS.17\n", "measure"),
            (b"[camera]\n[neutral]\n", "capture"),
            (b"{\"format\": \"farmctl-session/1\"}", "measure"),
            (b"g = [0.5]\nsigma_t_per_mm = [1, 2]\n", "submit"),
            (b"[[channel]]\nname = \"R\"\n", "a grid or a session file names it"),
            (b"[[mixture]]\nmaterial = \"a\"\n", "--mixtures"),
            (b"{\"format\": \"farmctl-media/1\"}", "predict"),
        ] {
            let read = or_other_kind::<()>(Err(anyhow!("unreadable")), bytes, "else");
            assert!(read.unwrap_err().to_string().contains(reader), "{}", bytes.escape_ascii());
        }
        for bytes in [&b""[..], b"{", b"{}", b"a = 1", b"\xff\xfe", b"no table"] {
            let read = or_other_kind::<()>(Err(anyhow!("unreadable")), bytes, "else");
            assert_eq!(read.unwrap_err().to_string(), "unreadable", "{}", bytes.escape_ascii());
        }
        // An error about a file of the right kind stays.
        let read = or_other_kind::<()>(Err(anyhow!("line 1")), b"[camera]\n[neutral]\n", "session file");
        assert_eq!(read.unwrap_err().to_string(), "line 1");
    }
}
