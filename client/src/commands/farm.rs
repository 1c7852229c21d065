//! Commands that run, watch and look after a farm.

pub(crate) mod access;
pub(crate) mod backup;
pub(crate) mod doctor;
pub(crate) mod events;
pub(crate) mod health;
pub(crate) mod serve;
pub(crate) mod status;
pub(crate) mod workers;
