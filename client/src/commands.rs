//! The verbs, one module each.

pub(crate) mod completions;
pub(crate) mod export;
pub(crate) mod fit;
pub(crate) mod list;
pub(crate) mod map;
pub(crate) mod measure;
pub(crate) mod scale;
pub(crate) mod show;
pub(crate) mod similar;
pub(crate) mod simulate;
pub(crate) mod status;
pub(crate) mod submit;
