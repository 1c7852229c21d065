//! Commands that compute, follow, list, show and export dictionaries.

pub(crate) mod explain;
pub(crate) mod export;
mod following;
pub(crate) mod list;
pub(crate) mod manage;
pub(crate) mod show;
pub(crate) mod submit;
pub(crate) mod watch;

pub(crate) use following::DictionaryDeleted;
