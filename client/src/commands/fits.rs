//! Commands that answer questions about media from a dictionary.

mod chosen_dictionary;
pub(crate) mod design;
pub(crate) mod fit;
pub(crate) mod map;
pub(crate) mod measure;
mod other_scene;
pub(crate) mod profile;
pub(crate) mod scale;
pub(crate) mod similar;
