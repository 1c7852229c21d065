//! The worker: leases jobs, traces their walks, returns the records.

pub mod tracer;
