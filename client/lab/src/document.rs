//! Documents: the text of an answer, built once from headings, remarks, tables, figures and files. Builders stand next to
//! their answers; `html` renders a page of it, `farmctl` lines for a terminal.

mod html;

use serde::{Deserialize, Serialize};

pub(crate) use html::escaped;

/// A text with its title. Backticks in sentences enclose commands.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Document {
    pub title: String,
    pub blocks: Vec<Block>,
}

/// A part of a document.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub enum Block {
    /// A heading of level 2 or 3.
    Heading(u8, String),
    /// The sentence that stands first.
    Verdict(String),
    Paragraph(String),
    /// A paragraph in small letters, about what is next to it.
    Aside(String),
    Remarks(Vec<Remark>),
    List(Vec<String>),
    Table(ValueTable),
    /// Names with their texts.
    Entries(Vec<(String, String)>),
    /// Names of files in the folder of the document, with their purpose.
    Files(Vec<(Vec<String>, String)>),
    Figure(Figure),
    /// Figures next to each other.
    Row(Vec<Figure>),
    Preformatted(String),
    /// A summary, and what readers unfold.
    Folded(String, Vec<Block>),
    /// Places for signatures, by what they are for.
    SignOff(Vec<String>),
}

/// A remark that restricts the use of numbers.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Remark {
    /// Whom it concerns, for example material and channel; empty if all.
    pub about: Vec<String>,
    pub text: String,
    /// Whether the remark means that the numbers may be wrong.
    pub warning: bool,
}

/// A table of texts.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct ValueTable {
    pub head: Vec<TableColumn>,
    pub rows: Vec<Vec<String>>,
    /// Whether rows become cards on narrow screens.
    pub cards: bool,
    /// Rows that are marked as doubtful.
    pub doubtful: Vec<usize>,
    /// Shares of each row's last cell with their names, which add up to 1 at most; empty in most tables.
    pub shares: Vec<Vec<(String, f64)>>,
}

/// A column of a table.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct TableColumn {
    /// A unit may stand in a line of its own.
    pub name: String,
    /// Numbers are aligned to the right.
    pub is_number: bool,
}

/// Pictures with a caption.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Figure {
    pub pictures: Vec<PagePicture>,
    pub caption: String,
}

/// A picture that a page contains.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub enum PagePicture {
    /// A chart as SVG, on white.
    Chart(String),
    /// Another drawing as SVG, as wide as its place.
    Drawing(String),
    /// A strip of pixels.
    Strip { uri: String, alt: String },
}

impl Block {
    pub fn heading(level: u8, text: &str) -> Self {
        Self::Heading(level, text.to_owned())
    }

    pub fn paragraph(text: impl Into<String>) -> Self {
        Self::Paragraph(text.into())
    }

    pub fn aside(text: impl Into<String>) -> Self {
        Self::Aside(text.into())
    }

    /// Warnings about all of a section.
    pub fn warnings<T: ToString>(texts: &[T]) -> Self {
        Self::Remarks(texts.iter().map(|text| Remark::warning(text.to_string())).collect())
    }

    pub fn chart(svg: String, caption: &str) -> Self {
        Self::Figure(Figure { pictures: vec![PagePicture::Chart(svg)], caption: caption.to_owned() })
    }
}

impl Remark {
    /// A warning that concerns all.
    pub fn warning(text: String) -> Self {
        Self { about: Vec::new(), text, warning: true }
    }

    /// The remark after whom it concerns.
    pub fn sentence(&self) -> String {
        if self.about.is_empty() {
            self.text.clone()
        } else {
            format!("{}: {}", self.about.join(", "), self.text)
        }
    }
}

impl ValueTable {
    /// The head has the names of columns between `|`; those of numbers begin with `>`.
    pub fn new(head: &str, rows: impl IntoIterator<Item = Vec<String>>) -> Self {
        let column = |name: &str| {
            let number = name.trim_start_matches(' ').strip_prefix('>');
            TableColumn {
                name: number.unwrap_or(name).trim_matches(' ').to_owned(),
                is_number: number.is_some(),
            }
        };
        Self {
            head: head.split('|').map(column).collect(),
            rows: rows.into_iter().collect(),
            ..Self::default()
        }
    }

    /// A table of numbers for each of these columns.
    pub fn of_numbers(
        first: &str,
        columns: impl IntoIterator<Item = String>,
        rows: impl IntoIterator<Item = Vec<String>>,
    ) -> Self {
        let mut table = Self::new(first, rows);
        table.head.extend(columns.into_iter().map(|name| TableColumn { name, is_number: true }));
        table
    }

    /// Rows become cards on narrow screens.
    #[must_use]
    pub fn cards(self) -> Self {
        Self { cards: true, ..self }
    }

    pub fn block(self) -> Block {
        Block::Table(self)
    }
}
