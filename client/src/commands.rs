//! The verbs, one module each.

pub(crate) mod access;
pub(crate) mod backup;
pub(crate) mod capture;
pub(crate) mod check;
mod chosen_dictionary;
pub(crate) mod completions;
pub(crate) mod design;
pub(crate) mod doctor;
pub(crate) mod events;
pub(crate) mod explain;
pub(crate) mod export;
pub(crate) mod fit;
mod following;
pub(crate) mod health;
pub(crate) mod list;
pub(crate) mod manage;
pub(crate) mod manual;
pub(crate) mod map;
pub(crate) mod measure;
pub(crate) mod profile;
pub(crate) mod scale;
pub(crate) mod serve;
pub(crate) mod show;
pub(crate) mod similar;
pub(crate) mod simulate;
pub(crate) mod slurm;
pub(crate) mod status;
pub(crate) mod submit;
#[cfg(test)]
mod tests;
pub(crate) mod watch;
pub(crate) mod workers;

pub(crate) use following::Deleted;
