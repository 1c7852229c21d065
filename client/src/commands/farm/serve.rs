//! Implements `farmctl serve`: keeps the farm of a folder running for other programs of the same user.

use std::time::Duration;

use anyhow::{Result, bail};
use clap::Args;
use farm_proto::wire::StatusRequest;
use serde::Serialize;
use tokio::sync::oneshot;

use crate::cli::Global;
use crate::connection::{Connection, Purpose};
use crate::interrupt::interrupted;
use crate::output::Output;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  farmctl serve                    the farm of ./farm-data
  farmctl serve --data lab         that of another folder")]
pub(crate) struct ServeArgs {
    /// Stop when standard input ends, and so with the program that started this one.
    #[arg(long)]
    until_input_ends: bool,
}

/// Pause before the next check whether a farm still exists.
const LOOK_AGAIN: Duration = Duration::from_millis(500);

#[derive(Debug, Serialize)]
struct ServeJson {
    address: String,
}

pub(crate) async fn run(global: &Global, args: &ServeArgs, output: &Output) -> Result<()> {
    let mut connection = Connection::open(global, Purpose::Serve).await?;
    if connection.is_server() {
        bail!(
            "the farm at {} runs already: serve runs that of a folder, without --server and --access",
            connection.address()
        );
    }
    let data = ServeJson { address: connection.address().to_owned() };
    output.print("serve", &data, || {
        format!(
            "the farm of {} is at {}, for farmctl and other programs of yours on this machine; Ctrl-C ends it",
            global.data.display(),
            data.address
        )
    })?;
    let stopped = stopped(args.until_input_ends);
    tokio::pin!(stopped);
    loop {
        tokio::select! {
            () = gone(&connection) => {}
            () = &mut stopped => return connection.close().await,
        }
        if connection.is_embedded() {
            // The coordinator's error states the reason.
            return connection.close().await;
        }
        // The process that held the folder has ended: this one takes over.
        connection = tokio::select! {
            opened = Connection::open(global, Purpose::Serve) => opened?,
            () = &mut stopped => return Ok(()),
        };
    }
}

/// Ends when the process is requested to stop.
async fn stopped(until_input_ends: bool) {
    tokio::select! {
        () = interrupted() => {}
        () = input_ends(), if until_input_ends => {}
    }
}

/// Ends with standard input, or with the program at its other end.
async fn input_ends() {
    let (sender, ended) = oneshot::channel::<()>();
    // Not a thread of the runtime, since the runtime waits for its threads before the process can end.
    std::thread::spawn(move || {
        let _sender = sender;
        let _ = std::io::copy(&mut std::io::stdin().lock(), &mut std::io::sink());
    });
    let _ = ended.await;
}

/// Ends when the farm has ended.
async fn gone(connection: &Connection) {
    loop {
        tokio::time::sleep(LOOK_AGAIN).await;
        let is_gone = if connection.is_embedded() {
            connection.has_ended()
        } else {
            connection.farm().status(StatusRequest {}).await.is_err()
        };
        if is_gone {
            return;
        }
    }
}
