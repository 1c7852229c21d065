//! Checks the database and the coordinator's state, and names the remedy for each problem.

use std::process::ExitCode;

use anyhow::Result;
use clap::Args;
use farm_proto::status::WorkerState;
use farm_proto::wire::{InspectRequest, InspectResponse, StatusRequest, StatusResponse, UnreadableJobs};
use farm_worker::Speed;
use optics_model::PHYSICS_VERSION;
use serde::Serialize;

use super::workers;
use crate::cli::Global;
use crate::connection::{Purpose, kernel_name, patient, with_farm};
use crate::exit;
use crate::output::{Output, grouped};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  farmctl doctor
  farmctl doctor --repair                         also recompute damaged records")]
pub(crate) struct DoctorArgs {
    /// Recompute damaged jobs.
    #[arg(long)]
    repair: bool,
}

#[derive(Debug, Serialize)]
struct DoctorJson {
    healthy: bool,
    findings: Vec<DoctorFinding>,
}

/// The result of one check.
#[derive(Debug, Serialize)]
struct DoctorFinding {
    what: &'static str,
    ok: bool,
    text: String,
}

fn finding(what: &'static str, ok: bool, text: impl Into<String>) -> DoctorFinding {
    DoctorFinding { what, ok, text: text.into() }
}

pub(crate) async fn run(global: &Global, args: &DoctorArgs, output: &Output) -> Result<ExitCode> {
    let findings = with_farm(global, Purpose::Ask, async |connection| {
        let mut findings =
            vec![finding("connection", true, format!("coordinator at {}", connection.address()))];
        let status = connection.farm().status(StatusRequest {}).await?.into_inner();
        findings.extend(about_coordinator(&status));
        if !connection.is_embedded() {
            let workers = workers::fetch(connection).await?;
            let silent = workers.iter().filter(|w| w.state == WorkerState::Silent).count();
            findings.push(finding(
                "workers",
                workers.len() > silent,
                match (workers.len(), silent) {
                    (0, _) => "no worker is registered: start farm-worker".to_owned(),
                    (n, 0) => format!("{n} registered, {} threads", status.threads),
                    (n, silent) => format!("{n} registered, {silent} of them silent for longer than a lease"),
                },
            ));
            findings.extend(workers.iter().filter(|w| w.state == WorkerState::Suspended).map(|w| {
                let text = format!("{} is suspended: it fails one job after the other; see `farmctl events`", w.label);
                finding("workers", false, text)
            }));
            findings.extend(workers.iter().filter(|w| w.state == WorkerState::Fenced).map(|w| {
                finding(
                    "workers",
                    false,
                    format!("{} is fenced off: the coordinator found other results; check its machine, then give it a new token (`farmctl access add`)", w.label),
                )
            }));
        }
        let inspected =
            connection.admin().inspect(patient(InspectRequest { repair: args.repair })).await?.into_inner();
        findings.extend(about_records(&inspected, args.repair));
        Ok(findings)
    })
    .await?;
    let findings: Vec<_> = findings.into_iter().chain([about_this_machine()]).collect();
    let healthy = findings.iter().all(|f| f.ok);
    let data = DoctorJson { healthy, findings };
    output.print("doctor", &data, || {
        let line = |f: &DoctorFinding| {
            format!("{}  {:<12} {}\n", if f.ok { "ok   " } else { "WRONG" }, f.what, f.text)
        };
        data.findings.iter().map(line).collect()
    })?;
    Ok(if healthy { ExitCode::SUCCESS } else { ExitCode::from(exit::FAILED) })
}

/// The tracing speed and the kernel of this machine.
fn about_this_machine() -> DoctorFinding {
    const WHAT: &str = "this machine";
    let kernel = match farm_worker::choose_kernel(kernel_name().as_deref()) {
        Ok(kernel) => kernel,
        Err(unknown) => return finding(WHAT, false, format!("FARM_KERNEL: {unknown}")),
    };
    let Speed { kernel, scatterings_per_s } = farm_worker::measure(kernel);
    let cores = std::thread::available_parallelism().map_or(1, Into::into);
    let millions = scatterings_per_s / 1e6;
    finding(
        WHAT,
        true,
        format!("{cores} cores; {kernel}: {millions:.0} million scatterings a second and core"),
    )
}

fn about_coordinator(status: &StatusResponse) -> Vec<DoctorFinding> {
    let own = env!("CARGO_PKG_VERSION");
    let version = format!("coordinator {}, this program {own}", status.version);
    let physics = format!("coordinator {}, this program {PHYSICS_VERSION}", status.physics_version);
    let mib = status.database_bytes / (1 << 20);
    let store = match status.store_fault.as_str() {
        "" => finding("store", true, format!("database of {} MiB", grouped(mib))),
        fault => finding("store", false, format!("results cannot be stored: {fault}")),
    };
    let checks = format!(
        "{} results computed by the coordinator, too: {} unequal; {} wait for it",
        grouped(status.checks_agreed + status.checks_disputed),
        grouped(status.checks_disputed),
        grouped(status.checks_waiting)
    );
    vec![
        finding("version", status.version == own, version),
        finding("physics", status.physics_version == PHYSICS_VERSION, physics),
        store,
        finding("checks", status.checks_disputed == 0, checks),
    ]
}

fn about_records(inspected: &InspectResponse, repair: bool) -> Vec<DoctorFinding> {
    let wrong = |what, text| finding(what, false, text);
    let mut findings = Vec::new();
    let unread = "nothing was deleted; look at the disk, then try again";
    if !inspected.unchecked.is_empty() {
        let text = format!("the file could not be checked ({}): {unread}", inspected.unchecked);
        findings.push(wrong("database", text));
    }
    let faults = inspected.faults.iter();
    findings.extend(faults.map(|fault| wrong("database", format!("{fault}: restore a backup"))));
    let again =
        if repair { "they are computed again" } else { "`farmctl doctor --repair` computes them again" };
    findings.extend(
        inspected
            .damaged
            .iter()
            .map(|d| wrong("records", format!("job {} of {}: {}; {again}", d.job, d.dictionary, d.what))),
    );
    findings.extend(inspected.unreadable.iter().map(|u| {
        let UnreadableJobs { dictionary, jobs, first_job, what } = u;
        let which = if *jobs == 1 {
            format!("job {first_job} of {dictionary} could not be read ({what})")
        } else {
            let jobs = grouped(*jobs);
            format!("{jobs} jobs of {dictionary} could not be read (the first, job {first_job}: {what})")
        };
        wrong("unreadable", format!("{which}: {unread}"))
    }));
    if findings.is_empty() {
        let text = format!(
            "{} records of {} jobs are as they were stored",
            grouped(inspected.records),
            grouped(inspected.jobs)
        );
        findings.push(finding("records", true, text));
    }
    findings
}
