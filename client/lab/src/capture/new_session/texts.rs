//! The session file and the contact sheet of a folder of photographs.

use std::fmt::Write as _;

use super::{CONTACT, Purpose, SESSION, SortedFolder, SortedShot, stem};
use crate::capture::picture::Thumbnail;
use crate::capture::session_file::BLANK;
use crate::document::{Block, Document, Figure, PagePicture, escaped};

impl SortedFolder {
    /// The session file, with [`BLANK`] for what only a person knows.
    pub(super) fn session_file(&self) -> String {
        let rho = match self.patches {
            Some(1) => {
                "reflectance of the panel, such as [0.985]; list shots at other exposure times as `exposures`"
                    .into()
            }
            Some(count) => {
                format!("reflectances of the {count} patches in their order, such as [0.956, 0.594]")
            }
            None => "reflectances of the patches in their order, such as [0.956, 0.594]".to_owned(),
        };
        let list = |purpose| toml::Value::from(self.names(&purpose)).to_string();
        let mut text = format!(
            "# Photographs by what they show: look at {CONTACT}. Replace each {BLANK:?}, then\n\
             #   farmctl capture {SESSION} --measure\n\n\
             [camera]\ndark = {}\nflat = {}\n",
            list(Purpose::Dark),
            list(Purpose::Flat)
        );
        if let Some(pattern) = &self.pattern {
            let _ = writeln!(text, "pattern = {pattern:?}");
        }
        let _ = write!(
            text,
            "\n[neutral]\nshots = {}\n\
             rho = {BLANK:?}           # {rho}\n\
             std_error = {BLANK:?}     # relative, from the certificate, such as 0.005\n\
             geometry = {BLANK:?}      # of the certificate: \"8:h\", \"45:0\", or \"own\" for the session's own light\n\n\
             [target]\nbare = {}\n",
            list(Purpose::Neutral),
            list(Purpose::Bare)
        );
        for (key, purpose) in [("haze", Purpose::Haze), ("in_gel", Purpose::InGel)] {
            if !self.names(&purpose).is_empty() {
                let _ = writeln!(text, "{key} = {}", list(purpose));
            }
        }
        let _ = writeln!(text, "square_mm = {BLANK:?}     # measured side of the board's squares");
        for shots in self.slabs() {
            let material = material(shots[0]).filter(|_| self.is_named).unwrap_or(BLANK);
            let _ = write!(
                text,
                "\n[[sample]]\nmaterial = {material:?}\n\
                 thickness_mm = {BLANK:?}  # of a micrometer at five places, such as [0.508, 0.511, 0.507, 0.51, 0.509]\n\
                 shots = {}\n",
                toml::Value::from(shots)
            );
        }
        text
    }

    /// A page with all photographs under what they are for.
    pub(super) fn contact_sheet(&self) -> String {
        let pictures = self.shots.iter().filter_map(|shot| shot.thumbnail.as_ref());
        let black = pictures.map(Thumbnail::darkest).reduce(|a, b| std::array::from_fn(|c| a[c].min(b[c])));
        let figure = |shot: &SortedShot| {
            let picture = shot.thumbnail.as_ref()?.data_uri(black.unwrap_or_default());
            let name = escaped(&shot.name);
            let drawing = format!("<img src=\"{picture}\" alt=\"{name}\" style=\"width:100%\">");
            Some(Figure { pictures: vec![PagePicture::Drawing(drawing)], caption: shot.name.clone() })
        };
        let mut blocks: Vec<Block> = vec![Block::warnings(&self.missing())];
        for shots in self.shots.chunk_by(|a, b| a.purpose.title() == b.purpose.title()) {
            blocks.push(Block::heading(2, &shots[0].purpose.title()));
            blocks.push(Block::Row(shots.iter().filter_map(figure).collect()));
            let reasons = shots.iter().filter_map(|shot| match &shot.purpose {
                Purpose::Unused { reason } => Some(format!("{}: {reason}", shot.name)),
                _ => None,
            });
            blocks.push(Block::List(reasons.collect()));
        }
        Document { title: "Photographs by what they show".to_owned(), blocks }.page()
    }
}

/// The material in the name of a shot such as `white_05_1.dng`.
pub(super) fn material(name: &str) -> Option<&str> {
    let name = stem(name).trim_end_matches("mm");
    let name =
        name.trim_end_matches(|c: char| c.is_ascii_digit() || c == '.').trim_end_matches(['_', '-', ' ']);
    (!name.is_empty()).then_some(name)
}
