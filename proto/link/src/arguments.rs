//! Parses arguments that several programs have.

use std::net::{SocketAddr, ToSocketAddrs as _};

use clap::builder::Resettable;
use clap::error::{ContextKind, ContextValue};
use clap::{Command, Parser};

/// The arguments of this process. An empty environment variable counts as not set, so that scripts and units can clear it.
pub fn parse<A: Parser>() -> A {
    parse_as(A::command())
}

/// The arguments of this process as those of a command with the same arguments.
pub fn parse_as<A: Parser>(command: Command) -> A {
    let matches = without_empty_variables(command).try_get_matches();
    let matches = matches.unwrap_or_else(|error| with_nearest(error).exit());
    A::from_arg_matches(&matches).unwrap_or_else(|error| error.exit())
}

/// The error with the nearest of the subcommands that it suggests: clap lists all that are alike, the nearest last.
fn with_nearest(mut error: clap::Error) -> clap::Error {
    let suggested = error.get(ContextKind::SuggestedSubcommand);
    if let Some(ContextValue::Strings(names)) = suggested
        && let Some(nearest) = names.last().cloned()
    {
        error.insert(ContextKind::SuggestedSubcommand, ContextValue::Strings(vec![nearest]));
    }
    error
}

fn without_empty_variables(command: Command) -> Command {
    let read = |argument: clap::Arg| {
        let name = argument.get_env().map(ToOwned::to_owned);
        let is_empty = name.and_then(std::env::var_os).is_some_and(|value| value.is_empty());
        if is_empty { argument.env(Resettable::Reset) } else { argument }
    };
    command.mut_args(read).mut_subcommands(without_empty_variables)
}

/// An address to listen on, as numbers or by a host's name; of several addresses the first IPv4 one.
pub fn listen_address(text: &str) -> Result<SocketAddr, String> {
    if let Ok(address) = text.parse() {
        return Ok(address);
    }
    let needed = "an address and a port are needed, such as 127.0.0.1:7700, [::1]:7700 or localhost:7700";
    let found = text.to_socket_addrs().map_err(|error| format!("{needed} ({error})"))?;
    let found: Vec<SocketAddr> = found.collect();
    let first = found.iter().find(|address| address.is_ipv4()).or(found.first());
    first.copied().ok_or_else(|| needed.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, Parser)]
    struct Args {
        #[arg(long, env = "FARM_TEST_EMPTY", default_value_t = 7)]
        number: u32,
        #[command(subcommand)]
        verb: Option<Verb>,
    }

    #[derive(Debug, clap::Subcommand)]
    enum Verb {
        Look {
            #[arg(long, env = "FARM_TEST_EMPTY")]
            number: Option<u32>,
        },
    }

    /// Empty environment variables count as not set.
    #[test]
    fn empty_variables_count_as_unset() {
        // Variables belong to the process, so the test runs itself with an empty one.
        if std::env::var_os("FARM_TEST_EMPTY").is_none() {
            let name = "arguments::tests::empty_variables_count_as_unset";
            let mut again = std::process::Command::new(std::env::current_exe().unwrap());
            let ran = again.args(["--exact", name]).env("FARM_TEST_EMPTY", "").output().unwrap();
            assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stdout));
            return;
        }
        let read = |arguments: &[&str]| {
            let matches = without_empty_variables(<Args as clap::CommandFactory>::command());
            let matches = matches.try_get_matches_from(arguments).unwrap();
            <Args as clap::FromArgMatches>::from_arg_matches(&matches).unwrap()
        };
        assert_eq!(read(&["program"]).number, 7);
        assert!(matches!(read(&["program", "look"]).verb, Some(Verb::Look { number: None })));
        assert_eq!(read(&["program", "--number", "8"]).number, 8);
    }

    /// A mistyped verb is answered with the nearest one.
    #[test]
    fn nearest_verb_is_suggested() {
        let verbs = ["slurm", "serve", "restore", "resume", "measurements", "measure"];
        let command = Command::new("program").subcommands(verbs.map(Command::new));
        let mistyped = "measure".replacen('a', "", 1);
        let error = with_nearest(command.try_get_matches_from(["program", mistyped.as_str()]).unwrap_err());
        assert!(error.to_string().contains("a similar subcommand exists: 'measure'"), "{error}");
    }

    /// The address to listen at may be a name.
    #[test]
    fn listen_address_may_be_a_name() {
        assert_eq!(listen_address("10.0.0.1:7700").unwrap().to_string(), "10.0.0.1:7700");
        assert!(listen_address("localhost:7700").unwrap().ip().is_loopback());
        for wrong in ["7700", "localhost", "localhost:port", "no host:7700"] {
            let error = listen_address(wrong).unwrap_err();
            assert!(error.contains("such as 127.0.0.1:7700"), "{error}");
        }
    }
}
