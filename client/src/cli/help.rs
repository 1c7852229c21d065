//! Makes the first help short: ten verbs with the others by group, and of each verb the options that most need.
//! `--help-all` shows all of them.

use clap::{Arg, ArgAction, Command};

use super::figure::FIGURES;
use super::options::{OBJECTIVE, SEARCH};
use super::set_up::SET_UP;

/// The verbs of the first help, in its order.
const FIRST: [&str; 10] = [
    "capture",
    "check",
    "measure",
    "measurements",
    "design",
    "simulate",
    "predict",
    "submit",
    "status",
    "web",
];

/// The other verbs.
const OTHERS: &str = "\
Other commands, each with its --help; `farmctl --help-all` describes them:
  media          chart, compare, recipe, translucency, validate
  dictionaries   list, data, show, watch, wait, explain, pause, resume, cancel, retry,
                 priority, delete, export
  the paper      fit, scale, map, profile, similar
  the farm       serve, workers, events, doctor, backup, restore, health, access, slurm
  the shell      completions, manual

With every command: --data DIR for another folder than ./farm-data, --server URL or --access FILE
for a farm elsewhere, --local for this machine in any case.";

/// Headings and names of the options that only `--help-all` shows.
const SPECIAL: [&str; 4] = [OBJECTIVE, SEARCH, SET_UP, FIGURES];
const SPECIAL_OPTIONS: [&str; 14] = [
    "server",
    "access",
    "local",
    "data",
    "free_g",
    "g_spread",
    "g_change",
    "bound",
    "mu_std_error",
    "second_lobe",
    "phase_function",
    "plot_changes",
    "change",
    "threads",
];

/// Options below these headings that most need.
const USUAL_OPTIONS: [&str; 2] = ["mu", "session"];

/// Option that shows all verbs and options.
pub(crate) const HELP_ALL: &str = "--help-all";

/// The command with `--help` and `--help-all`; `all` also describes every verb in the first help.
pub(crate) fn with_help(command: Command, all: bool) -> Command {
    let command = if all {
        command
    } else {
        let hidden = |verb: Command| {
            let is_first = FIRST.contains(&verb.get_name());
            verb.hide(!is_first)
        };
        let text = command.get_after_help().map(ToString::to_string).unwrap_or_default();
        command.mut_subcommands(hidden).after_help(format!("{OTHERS}\n\n{text}"))
    };
    with_two_helps(command.disable_help_subcommand(true))
}

/// The command and all below it with a short and a long help.
fn with_two_helps(command: Command) -> Command {
    let shortened = |argument: Arg| {
        let id = argument.get_id().as_str();
        let is_special = SPECIAL_OPTIONS.contains(&id)
            || argument.get_help_heading().is_some_and(|heading| SPECIAL.contains(&heading));
        let is_usual = USUAL_OPTIONS.contains(&id);
        argument.hide_short_help(is_special && !is_usual)
    };
    let short = Arg::new("help").short('h').long("help").action(ArgAction::HelpShort);
    let long = Arg::new("help_all").long("help-all").action(ArgAction::HelpLong);
    command
        .mut_args(shortened)
        .mut_subcommands(with_two_helps)
        .disable_help_flag(true)
        .arg(short.help("Print help"))
        .arg(long.help("Print help with all options"))
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    use super::*;
    use crate::commands::Cli;

    /// The lines of help on the arguments of a command line.
    fn help(arguments: &[&str]) -> String {
        let command = with_help(Cli::command(), arguments.contains(&HELP_ALL)).term_width(100);
        command.try_get_matches_from(arguments).unwrap_err().to_string()
    }

    /// The first help names every verb and describes ten. `--help-all` describes all.
    #[test]
    fn first_help_names_every_verb() {
        let (short, all) = (help(&["farmctl", "--help"]), help(&["farmctl", HELP_ALL]));
        for verb in Cli::command().get_subcommands() {
            let (name, about) = (verb.get_name(), verb.get_about().unwrap().to_string());
            let first = about.split(' ').next().unwrap();
            let is_described = |help: &str| {
                help.lines().any(|line| {
                    let mut words = line.split_whitespace();
                    words.next() == Some(name) && words.next() == Some(first)
                })
            };
            assert_eq!(is_described(&short), FIRST.contains(&name), "{name}: {short}");
            assert!(is_described(&all), "{name}: {all}");
            let is_named = short.split([' ', ',', '\n']).any(|word| word == name);
            assert!(is_named, "{name}: {short}");
        }
    }

    /// The help of each verb fits on a screen, and `--help-all` has what it leaves out.
    #[test]
    fn help_of_verbs_fits_a_screen() {
        for verb in Cli::command().get_subcommands().filter(|verb| !verb.has_subcommands()) {
            let text = help(&["farmctl", verb.get_name(), "--help"]);
            assert!(text.lines().count() <= 48, "{} lines: {text}", text.lines().count());
        }
        assert!(!help(&["farmctl", "measure", "-h"]).contains("--mu-step"));
        assert!(help(&["farmctl", "measure", HELP_ALL]).contains("--mu-step"));
    }
}
