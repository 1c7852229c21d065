//! Arguments of `web`.

use std::net::SocketAddr;
use std::path::PathBuf;

use clap::Args;
use farm_link::arguments::listen_address;

#[derive(Debug, Args)]
pub struct WebArgs {
    /// Folders that `farmctl capture` wrote, to be looked at in the page [default: those in this folder].
    pub captures: Vec<PathBuf>,
    /// Address to serve on [default: 127.0.0.1:7780, or any free port]. Anything but loopback needs --behind.
    #[arg(long, value_name = "ADDRESS", value_parser = listen_address)]
    pub listen: Option<SocketAddr>,
    /// URL at which a proxy with TLS shows the page to others.
    #[arg(long, value_name = "https://HOST/PATH/")]
    pub behind: Option<String>,
    /// Print the address only.
    #[arg(long)]
    pub no_browser: bool,
}
