//! The worker: leases jobs, traces their walks on all cores, returns the records.
//!
//! `optics-tracer` is the physics, without any networking; `session` makes the calls to the coordinator; `pool` runs
//! the tracing threads, so that no walk blocks an async thread. `agent` is the main loop: it leases jobs, `job` takes
//! each from its lease to its result, `delivery` keeps results until they are acknowledged, `heartbeat` renews the
//! leases.
//!
//! `docs/glossary.md` explains the terms.

#![warn(clippy::print_stdout, clippy::print_stderr, reason = "they panic where the output is full or closed")]

mod agent;
pub mod cli;
mod config;
mod delivery;
mod heartbeat;
mod idle;
mod job;
mod kernels;
mod leases;
mod log_place;
mod machine;
mod pool;
mod reachability;
mod retry;
mod session;
#[cfg(test)]
mod testing;

pub use agent::{EndReason, run};
pub use config::Config;
pub use kernels::{Speed, UnknownKernel, choose as choose_kernel, measure};
pub use log_place::log_place;
pub use session::Error;
