//! The worker: leases jobs, traces their walks on all cores, returns the records.
//!
//! `optics-tracer` is the physics and knows nothing of networks; `agent` talks to the coordinator; `pool` stands between
//! them, so that no walk ever blocks an async thread.

mod agent;
mod config;
mod contact;
mod delivery;
mod heartbeat;
mod held;
mod pool;
mod session;

pub use agent::{Ended, run};
pub use config::Config;
pub use session::Error;
