//! Implements `farmctl web`: a page in the browser, for the farm that `farmctl` would connect to.
//!
//! One small server serves the page's files, answers its questions as the other verbs do (`ask`), forwards its calls to the
//! farm (`forward`, `farm`), and authenticates requests by a token (`gate`). The page's source is in `web/`.

mod ask;
mod assets;
mod behind;
mod browser;
mod capture_run;
mod captures;
mod colours;
mod farm;
mod forward;
mod gate;
mod listen;
mod server;

use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use clap::Args;
use farm_link::arguments::listen_address;
use optics_model::quantities::Quantity;
use serde::Serialize;
use serde_json::{Value, json};
use tokio::net::TcpListener;

use crate::cli::Global;
use crate::connection::Connection;
use crate::interrupt::interrupted;
use crate::output::Output;
use crate::slurm::shell_quoted;
use ask::PageState;
use behind::Url;
use capture_run::CaptureRun;
use captures::Captures;
use farm::FarmAccess;
use gate::PageGate;
use server::Server;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  farmctl web                                  the farm of this folder
  farmctl web --access client.toml             a server's farm
  farmctl web session1 session2                with these captures
  farmctl web --listen 0.0.0.0:7780 --behind https://farm.example.org/resins/ --no-browser")]
pub(crate) struct WebArgs {
    /// Folders that `farmctl capture` wrote, to be looked at in the page [default: those in this folder].
    captures: Vec<PathBuf>,
    /// Address to serve on [default: 127.0.0.1:7780, or any free port]. Anything but loopback needs --behind.
    #[arg(long, value_name = "ADDRESS", value_parser = listen_address)]
    listen: Option<SocketAddr>,
    /// URL at which a proxy with TLS shows the page to others.
    #[arg(long, value_name = "https://HOST/PATH/")]
    behind: Option<String>,
    /// Print the address only.
    #[arg(long)]
    no_browser: bool,
}

/// The default address of the page.
const USUAL_PORT: u16 = 7780;

#[derive(Debug, Serialize)]
struct WebJson {
    url: String,
}

pub(crate) async fn run(global: &Global, args: WebArgs, output: &Output) -> Result<()> {
    let behind = args.behind.as_deref().map(str::parse::<Url>).transpose()?;
    if let Some(address) = args.listen.filter(|address| !address.ip().is_loopback() && behind.is_none()) {
        bail!(
            "--listen {address}: others could read along, since the page is served without encryption; put a proxy with \
             TLS before it and name its URL with --behind"
        );
    }
    let captures = Captures::new(args.captures)?;
    let listener = listen(args.listen).await?;
    let farm = Arc::new(FarmAccess::open(global).await?);
    let gate = PageGate::new(listener.local_addr()?, behind.as_ref())
        .map_err(|error| anyhow::anyhow!("making a token: {error}"))?;
    let origin = match &behind {
        Some(url) => url.origin(),
        None => format!("http://{}", listener.local_addr()?),
    };
    let url = format!("{origin}{}", gate.entrance());
    let about = about(global, &*farm.connection().await?);
    let (captures, run) = (Arc::new(captures), CaptureRun::default());
    let state = PageState { farm: Arc::clone(&farm), about, captures, run };
    let server = Server { gate: Arc::new(gate), state: Arc::new(state) };
    output.print("web", &WebJson { url: url.clone() }, || {
        format!("the page is at {url}\nwhoever has this address may do what farmctl may; Ctrl-C ends it")
    })?;
    let opened = if args.no_browser || behind.is_some() { None } else { browser::open(&url) };
    let ended = farm.ended.clone();
    let served = tokio::select! {
        served = server.serve(listener) => served.context("serving the page"),
        () = interrupted() => Ok(()),
        () = ended.cancelled() => Ok(()),
    };
    drop(opened);
    let closed = farm.close().await;
    served.and(closed)
}

/// The given address; otherwise the default, or any free port if that is taken.
async fn listen(given: Option<SocketAddr>) -> Result<TcpListener> {
    if let Some(address) = given {
        return TcpListener::bind(address).await.with_context(|| format!("--listen {address}"));
    }
    let local = Ipv4Addr::LOCALHOST;
    match TcpListener::bind((local, USUAL_PORT)).await {
        Ok(listener) => Ok(listener),
        Err(_) => TcpListener::bind((local, 0)).await.context("opening a port on loopback"),
    }
}

/// The farm that the page shows, the beginning of a command line that reaches it, and the quantities of a set-up.
fn about(global: &Global, connection: &Connection) -> Value {
    let data = global.data.display().to_string();
    let local = !connection.is_server();
    let mut command = "farmctl".to_owned();
    if local && data != "farm-data" {
        command += &format!(" --data {}", shell_quoted(&data));
    }
    if let Some(server) = global.server.as_deref().filter(|_| !local) {
        command += &format!(" --server {}", shell_quoted(server));
    }
    if let Some(access) = global.access.as_deref().filter(|_| !local) {
        command += &format!(" --access {}", shell_quoted(&access.display().to_string()));
    }
    let quantity = |q: &Quantity| json!({ "name": q.name, "help": q.help, "default": q.default, "lowest": q.lowest, "highest": q.highest });
    json!({
        "version": env!("CARGO_PKG_VERSION"),
        "farm": if local { &data } else { connection.address() },
        "own": connection.is_embedded(),
        "command": command,
        "quantities": Quantity::OF_OPTIONS.iter().map(quantity).collect::<Vec<_>>(),
    })
}
