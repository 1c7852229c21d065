//! Counts and times events while the coordinator works.
//!
//! Labels take values of fixed lists only, so that no caller can make the metrics grow.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use prometheus_client::encoding::{EncodeLabelSet, text};
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::{Family, MetricConstructor};
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::registry::Registry;

use crate::stored::OutcomeKind;

use super::exposition::{self, Format};
use super::snapshot::{Scrape, Snapshot};

/// Bounds of buckets from 0.1 ms to a minute, three a decade.
const SECONDS: [f64; 18] = [
    0.0001, 0.000_25, 0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0,
    25.0, 60.0,
];
const JOBS: [f64; 11] = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0, 256.0, 512.0, 1024.0];

/// The codes of gRPC by number.
const CODES: [&str; 17] = [
    "OK",
    "CANCELLED",
    "UNKNOWN",
    "INVALID_ARGUMENT",
    "DEADLINE_EXCEEDED",
    "NOT_FOUND",
    "ALREADY_EXISTS",
    "PERMISSION_DENIED",
    "RESOURCE_EXHAUSTED",
    "FAILED_PRECONDITION",
    "ABORTED",
    "OUT_OF_RANGE",
    "UNIMPLEMENTED",
    "INTERNAL",
    "UNAVAILABLE",
    "DATA_LOSS",
    "UNAUTHENTICATED",
];
const UNKNOWN: usize = 2;
/// Label of all methods that the server does not have.
const OTHER: &str = "other";

/// An enumeration whose variants are the values of a label.
macro_rules! label {
    ($(#[$doc:meta])* $name:ident { $($variant:ident = $value:literal),+ }) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum $name { $($variant),+ }

        impl $name {
            const VALUES: &[&str] = &[$($value),+];

            fn value(self) -> &'static str {
                match self { $(Self::$variant => $value),+ }
            }
        }
    };
}

label! {
    /// `Failed`: an attempt failed; `Quarantined`: the job was given up.
    JobFailure { Failed = "failed", Quarantined = "quarantined" }
}
label! {
    /// Reason for which a lease was granted.
    LeaseKind { First = "first", Retry = "retry", Speculative = "speculative" }
}
label! {
    /// Whether a second worker had the same result.
    VerificationOutcome { Agreed = "agreed", Disputed = "disputed" }
}

/// Version of the build, for `farm_build_info`.
#[derive(Debug, Clone)]
pub struct BuildInfo {
    pub version: String,
    pub physics_version: String,
}

/// Counters and histograms; clones count into the same ones.
#[derive(Debug, Clone)]
pub struct Metrics(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    registry: Registry,
    methods: BTreeSet<&'static str>,
    rpc_seconds: Family<Rpc, Histogram, NewSeconds>,
    jobs_completed: Family<Outcome, Counter>,
    jobs_failed: Family<Kind, Counter>,
    leases_expired: Counter,
    leases_granted: Family<Kind, Counter>,
    verifications: Family<Outcome, Counter>,
    records_stored: Counter,
    commits: Counter,
    commit_seconds: Histogram,
    commit_jobs: Histogram,
    connections_refused: Counter,
    access_file_errors: Counter,
    fit_seconds: Histogram,
    fits_stopped: Counter,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, EncodeLabelSet)]
struct Rpc {
    method: &'static str,
    code: &'static str,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, EncodeLabelSet)]
struct Outcome {
    outcome: &'static str,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, EncodeLabelSet)]
struct Kind {
    kind: &'static str,
}

#[derive(Debug, Clone, Copy)]
struct NewSeconds;

impl MetricConstructor<Histogram> for NewSeconds {
    fn new_metric(&self) -> Histogram {
        Histogram::new(SECONDS)
    }
}

impl Metrics {
    /// `methods` are the paths of all methods that are served, such as `/farm.v1.Fits/Fit`.
    pub fn new(build: BuildInfo, methods: impl IntoIterator<Item = &'static str>) -> Self {
        let mut inner = Inner {
            registry: Registry::default(),
            methods: methods.into_iter().collect(),
            rpc_seconds: Family::new_with_constructor(NewSeconds),
            jobs_completed: family(&OutcomeKind::LABELS, |outcome| Outcome { outcome }),
            jobs_failed: family(JobFailure::VALUES, |kind| Kind { kind }),
            leases_expired: Counter::default(),
            leases_granted: family(LeaseKind::VALUES, |kind| Kind { kind }),
            verifications: family(VerificationOutcome::VALUES, |outcome| Outcome { outcome }),
            records_stored: Counter::default(),
            commits: Counter::default(),
            commit_seconds: Histogram::new(SECONDS),
            commit_jobs: Histogram::new(JOBS),
            connections_refused: Counter::default(),
            access_file_errors: Counter::default(),
            fit_seconds: Histogram::new(SECONDS),
            fits_stopped: Counter::default(),
        };
        inner.register(build);
        Self(Arc::new(inner))
    }

    /// Records an answered call: `path` as the client requested it, `code` the number of its gRPC code.
    pub fn rpc(&self, path: &str, code: i32, elapsed: Duration) {
        let method = self.0.methods.get(path).copied().unwrap_or(OTHER);
        let known = usize::try_from(code).ok().and_then(|code| CODES.get(code));
        let code = known.unwrap_or(&CODES[UNKNOWN]);
        self.0.rpc_seconds.get_or_create(&Rpc { method, code }).observe(elapsed.as_secs_f64());
    }

    pub fn job_completed(&self, kind: OutcomeKind) {
        if let Some(outcome) = kind.label() {
            self.0.jobs_completed.get_or_create(&Outcome { outcome }).inc();
        }
    }

    pub fn job_failed(&self, kind: JobFailure) {
        self.0.jobs_failed.get_or_create(&Kind { kind: kind.value() }).inc();
    }

    pub fn leases_expired(&self, leases: u64) {
        self.0.leases_expired.inc_by(leases);
    }

    pub fn leases_granted(&self, kind: LeaseKind, leases: u64) {
        self.0.leases_granted.get_or_create(&Kind { kind: kind.value() }).inc_by(leases);
    }

    pub fn verified(&self, outcome: VerificationOutcome) {
        self.0.verifications.get_or_create(&Outcome { outcome: outcome.value() }).inc();
    }

    /// Records a transaction that is on disk, with the numbers of its jobs and records.
    pub fn committed(&self, elapsed: Duration, jobs: u64, records: u64) {
        self.0.commits.inc();
        self.0.commit_seconds.observe(elapsed.as_secs_f64());
        self.0.commit_jobs.observe(jobs as f64);
        self.0.records_stored.inc_by(records);
    }

    pub fn connection_refused(&self) {
        self.0.connections_refused.inc();
    }

    pub fn access_file_unread(&self) {
        self.0.access_file_errors.inc();
    }

    pub fn fitted(&self, elapsed: Duration) {
        self.0.fit_seconds.observe(elapsed.as_secs_f64());
    }

    pub fn fit_stopped(&self) {
        self.0.fits_stopped.inc();
    }

    /// All metrics as text, including those of the current state.
    pub(super) fn expose(&self, snapshot: Snapshot, format: Format) -> Result<String, std::fmt::Error> {
        let mut now = Registry::default();
        now.register_collector(Box::new(Scrape::new(snapshot)));
        let mut text = String::new();
        text::encode_registry(&mut text, &self.0.registry)?;
        text::encode_registry(&mut text, &now)?;
        text::encode_eof(&mut text)?;
        Ok(match format {
            Format::OpenMetrics => text,
            Format::Prometheus => exposition::to_prometheus(&text),
        })
    }
}

impl Inner {
    /// The library adds `_total` to the names of counters and a full stop to each help.
    fn register(&mut self, build: BuildInfo) {
        let registry = &mut self.registry;
        registry.register("farm_rpc_seconds", "Time to answer a gRPC call", self.rpc_seconds.clone());
        registry.register(
            "farm_jobs_completed",
            "Results of jobs that workers delivered, by what became of them",
            self.jobs_completed.clone(),
        );
        registry.register(
            "farm_jobs_failed",
            "Attempts that failed, and jobs that were given up",
            self.jobs_failed.clone(),
        );
        registry.register(
            "farm_leases_expired",
            "Leases that ended because their worker was silent",
            self.leases_expired.clone(),
        );
        registry.register("farm_leases_granted", "Leases given to workers", self.leases_granted.clone());
        registry.register(
            "farm_verifications",
            "Jobs that a second worker computed for comparison",
            self.verifications.clone(),
        );
        registry.register(
            "farm_records_stored",
            "Records that reached the disk",
            self.records_stored.clone(),
        );
        registry.register("farm_commits", "Transactions that stored jobs", self.commits.clone());
        registry.register(
            "farm_commit_seconds",
            "Time of a transaction until it is on disk",
            self.commit_seconds.clone(),
        );
        registry.register("farm_commit_jobs", "Jobs stored by one transaction", self.commit_jobs.clone());
        registry.register(
            "farm_connections_refused",
            "Connections refused because too many were open",
            self.connections_refused.clone(),
        );
        registry.register(
            "farm_access_file_errors",
            "Attempts to read the changed access file that failed, one per second",
            self.access_file_errors.clone(),
        );
        registry.register("farm_fit_seconds", "Time to answer a fit", self.fit_seconds.clone());
        registry.register(
            "farm_fits_stopped",
            "Fits that were being computed when their client left",
            self.fits_stopped.clone(),
        );
        let build = [("version", build.version), ("physics_version", build.physics_version)];
        let info = Family::<_, Gauge>::default();
        info.get_or_create(&build).set(1);
        registry.register("farm_build_info", "What is running, always 1", info);
    }
}

/// All values exist from the start, at zero: otherwise the first event of a kind would not appear as an increase.
fn family<L: Clone + std::hash::Hash + Eq>(
    values: &[&'static str],
    label: fn(&'static str) -> L,
) -> Family<L, Counter> {
    let family = Family::default();
    for value in values {
        drop(family.get_or_create(&label(value)));
    }
    family
}
